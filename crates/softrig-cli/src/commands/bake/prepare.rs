//! From a scene to what is simulated: clips, cells, binding, materials, settings.

use super::objects::{self, Layout};
use crate::args::{DynamicsName, KindName};
use crate::failure::Failure;
use crate::load;
use crate::scene::{DEFAULT_CELLS, Scene, is_bvh};
use crate::ui;
use softrig::character::Character;
use softrig::couple::{BindSettings, Binding, BoneRule, NearBone, Region, Selector, material_map};
use softrig::integrate::Dynamics;
use softrig::material::MaterialMap;
use softrig::mesh::{self, LatticeOptions, Resolution, VolumeMesh};
use softrig::rig::Clip;
use softrig::simulation::SimulationSettings;
use softrig_io::bvh;
use std::path::Path;
use std::time::{Duration, Instant};

/// A character with its body, ready to be simulated under any clip.
#[derive(Debug)]
pub struct Prepared {
    /// The character.
    pub character: Character,
    /// Its cells.
    pub volume: VolumeMesh,
    /// Which nodes hang on which bones; objects have none.
    pub binding: Option<Binding>,
    /// What the cells are made of.
    pub materials: MaterialMap,
    /// How it is simulated.
    pub settings: SimulationSettings,
    /// Time it took.
    pub took: Duration,
}

impl Prepared {
    /// Fills the character with cells, hangs them on its bones, and lays out the materials.
    ///
    /// # Errors
    /// [`Failure`] says what the character or the scene lacks.
    pub fn new(scene: &Scene, character: Character) -> Result<Self, Failure> {
        let start = Instant::now();
        if scene.has_objects() {
            let volume = Layout::new(scene).mesh;
            let materials = MaterialMap::uniform(scene.material.material());
            let took = start.elapsed();
            return Ok(Self { character, volume, binding: None, materials, settings: settings(scene), took });
        }
        let at = |e: &(dyn std::error::Error + 'static)| Failure::reading(&scene.character, e);
        let volume = volume(scene, &character).map_err(|e| at(&e))?;
        let binding = Binding::new(&character, &volume, &bind_settings(scene)).map_err(|e| at(&e))?;
        let base = scene.material.material();
        let near = scene.material.near_bones.map(|n| NearBone { factor: n.factor, radius: n.radius });
        let regions: Vec<Region> = scene
            .region
            .iter()
            .map(|r| {
                let named = |name: &Option<String>| name.clone().unwrap_or_default();
                let selector = if r.look.is_some() {
                    Selector::Look(named(&r.look))
                } else if r.group.is_some() {
                    Selector::Group(named(&r.group), r.threshold.unwrap_or(0.5) as f32)
                } else {
                    Selector::Bone(named(&r.bone))
                };
                Region { selector, material: r.material(base) }
            })
            .collect();
        let materials = material_map(&character, &volume, &binding, base, &regions, near).map_err(|e| at(&e))?;
        Ok(Self {
            character,
            volume,
            binding: Some(binding),
            materials,
            settings: settings(scene),
            took: start.elapsed(),
        })
    }
}

impl Prepared {
    /// Which nodes of a character hang on which bones.
    ///
    /// # Panics
    /// For objects, which have no bones.
    #[must_use]
    pub fn bones(&self) -> &Binding {
        self.binding.as_ref().expect("only characters are asked for their bones")
    }
}

/// The cells of a scene's character: only what has skin weights is flesh, or everything where nothing has.
///
/// # Errors
/// [`mesh::MeshError`] when its surface cannot be filled.
pub fn volume(scene: &Scene, character: &Character) -> Result<VolumeMesh, mesh::MeshError> {
    let resolution = match scene.body.spacing {
        Some(spacing) => Resolution::Spacing(spacing),
        None => Resolution::Cells(scene.body.cells.unwrap_or(DEFAULT_CELLS)),
    };
    let has_flesh = character.meshes.iter().any(softrig::character::CharacterMesh::is_weighted);
    let surface = character.surface(has_flesh);
    let options = LatticeOptions { resolution, ..LatticeOptions::default() };
    let lattice = mesh::voxelize(&surface, &options)?;
    match scene.body.kind {
        KindName::Hex => Ok(lattice),
        KindName::Tet => Ok(mesh::tetrahedralize(&lattice)),
    }
}

fn bind_settings(scene: &Scene) -> BindSettings {
    let bones = scene.bone.iter().filter_map(|b| {
        let rule = if b.exclude {
            Some(BoneRule::Exclude)
        } else if b.whole {
            Some(BoneRule::Whole)
        } else {
            b.radius.map(BoneRule::Radius)
        };
        rule.map(|rule| (b.joint.clone(), rule))
    });
    BindSettings { bones: bones.collect(), ..BindSettings::default() }
}

fn settings(scene: &Scene) -> SimulationSettings {
    let s = &scene.simulation;
    SimulationSettings {
        dynamics: match s.dynamics {
            DynamicsName::Lively => Dynamics::Lively,
            DynamicsName::Calm => Dynamics::Calm,
            DynamicsName::Paper => Dynamics::Paper,
        },
        solver: s.solver.into(),
        multigrid: scene.multigrid.options(),
        tolerance: s.tolerance,
        gravity: s.gravity,
        preroll: scene.motion.preroll,
        sag: scene.motion.sag,
        longest_step: s.step.unwrap_or(SimulationSettings::default().longest_step),
        ..SimulationSettings::default()
    }
}

/// The clips a scene asks for.
///
/// # Errors
/// [`Failure`] names the clips there are.
pub fn clips(scene: &Scene, character: &Character) -> Result<Vec<Clip>, Failure> {
    let file = scene.character.display();
    if scene.has_objects() {
        return Ok(vec![objects::clip(scene)]);
    }
    let wanted = scene.motion.clip.as_deref();
    if let Some(name) = wanted
        && is_bvh(Path::new(name))
    {
        return motion_capture(Path::new(name), character, &scene.motion.names).map(|clip| vec![clip]);
    }
    if character.clips.is_empty() {
        let bones = character.meshes.iter().any(softrig::character::CharacterMesh::is_weighted);
        // without a rig the missing clip is the smaller problem: the binding says it better
        return if bones {
            Err(Failure::Input(format!(
                "{file} has no animation clip; export one with the character, or give a motion with --clip FILE.bvh"
            )))
        } else {
            Err(Failure::Input(format!(
                "{file} is a surface without a rig: it has no skeleton, no skin weights and no clip. Bind it to an armature, \
                 animate that, and export it as .glb; `softrig mesh` fills it with cells as it is"
            )))
        };
    }
    match wanted {
        None => Ok(vec![character.clips[0].clone()]),
        Some("all") => Ok(character.clips.clone()),
        Some(name) => match find_clip(character, name) {
            Some(i) => Ok(vec![character.clips[i].clone()]),
            None => {
                let names: Vec<_> = character.clips.iter().map(|c| c.name.as_str()).collect();
                Err(Failure::Input(format!(
                    "{file} has no clip `{name}`; it has: {} (or a number from 0 to {})",
                    names.join(", "),
                    names.len() - 1
                )))
            }
        },
    }
}

/// A clip by its name or number, or by what comes after the armature's name, as Blender writes it: `Armature|Walk`.
fn find_clip(character: &Character, name: &str) -> Option<usize> {
    let by_end = || character.clips.iter().position(|c| c.name.rsplit_once('|').is_some_and(|(_, end)| end == name));
    character.find_clip(name).or_else(by_end)
}

/// A clip from a motion-capture file, on the character's joints of the same names.
fn motion_capture(path: &Path, character: &Character, names: &[[String; 2]]) -> Result<Clip, Failure> {
    let failed = |e: softrig_io::ImportError| load::import_failure(&e);
    let bvh = bvh::read(path).map_err(failed)?;
    bvh.notes.iter().for_each(ui::warn);
    let (clip, notes) = bvh::apply_named(character, &bvh, names).map_err(failed)?;
    notes.iter().for_each(ui::warn);
    Ok(clip)
}
