//! What a clip's accelerations ask of the flesh, and what is said about it.

use super::prepare::Prepared;
use softrig::material::MaterialMap;
use softrig::simulation::{Motion, stiffening};

/// The materials a clip is baked with.
#[derive(Debug)]
pub struct Stiffened {
    /// What the cells are made of.
    pub materials: MaterialMap,
    /// Largest factor on their stiffness [-].
    pub factor: f64,
    /// The bone with the cell that has it.
    bone: String,
}

/// Below this factor nobody sees a difference.
const WORTH_SAYING: f64 = 1.5;

impl Stiffened {
    /// The scene's materials, stiffened for the motion where the scene allows it.
    pub fn new(prepared: &Prepared, allowed: bool, motion: &dyn Motion, duration: f64) -> Self {
        let mut out = Self { materials: prepared.materials.clone(), factor: 1.0, bone: String::new() };
        if !allowed {
            return out;
        }
        let (mesh, binding, skeleton) = (&prepared.volume, prepared.bones(), &prepared.character.skeleton);
        let factors = stiffening(skeleton, mesh, binding, &out.materials, motion, duration);
        if let Some((cell, factor)) = factors.iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1)) {
            out.factor = f64::from(*factor);
            let owner = binding.owner[mesh.cell(cell)[0] as usize];
            out.bone.clone_from(&skeleton.joint(binding.joint(owner)).name);
        }
        out.materials.stiffen(&factors);
        out
    }

    /// In words, when it is worth any.
    pub fn note(&self) -> Option<String> {
        (self.factor >= WORTH_SAYING).then(|| {
            format!(
                "the clip's accelerations would crush soft flesh: it is up to {:.1} times stiffer, most on the bone `{}` \
                 (in a scene file, stiffen = false under [simulation] leaves it soft)",
                self.factor, self.bone
            )
        })
    }
}
