//! The box in softrig with two bones that its flesh moves: the core of the box bound to them, ball joints between them and to the
//! world.

use crate::boxes::FleshBox;
use crate::scene;
use softrig::character::{Character, CharacterMesh, Skin, SkinWeights};
use softrig::couple::{BindSettings, Binding};
use softrig::integrate::Dynamics;
use softrig::material::{Material, MaterialMap};
use softrig::mesh::{boundary_faces, renumbered};
use softrig::rig::{Affine, Joint, JointId, JointKind, JointSetup, RootKind, Skeleton, Transform};
use softrig::simulation::{Coupling, FrameReport, RestMotion, Simulation, SimulationSettings, TwoWay, TwoWayScheme};
use std::error::Error;
use std::f64::consts::PI;

/// A coupled simulation of the box, in the peer's numbers.
pub struct TwoWayBox {
    simulation: Simulation<f32>,
    character: Character,
    frame: usize,
    /// Numbers of the nodes of the flesh box here.
    old: Vec<usize>,
}

impl TwoWayBox {
    /// Implicit Euler with so many linearisations; free ball joints, the root pinned.
    pub fn new(flesh: &FleshBox, young_modulus: f64, linearisations: usize) -> Result<Self, Box<dyn Error>> {
        let character = character(flesh)?;
        let (mesh, order) = renumbered(&flesh.mesh());
        let mut old = vec![0; order.len()];
        order.iter().enumerate().for_each(|(new, n)| old[*n as usize] = new);
        let mut binding = Binding::new(&character, &mesh, &BindSettings::default())?;
        // the peer's nodes and no others
        binding.bound.fill(false);
        flesh.bone.iter().for_each(|n| binding.bound[old[*n as usize]] = true);
        let material = Material {
            young_modulus,
            poisson_ratio: scene::POISSON_RATIO,
            density: scene::DENSITY,
            mass_damping: 0.0,
            stiffness_damping: 0.0,
        };
        let settings = SimulationSettings {
            dynamics: Dynamics::Calm,
            tolerance: scene::TOLERANCE,
            preroll: 0.0,
            longest_step: scene::STEP,
            coupled_linearisations: linearisations,
            ..SimulationSettings::default()
        };
        let materials = MaterialMap::uniform(material);
        let mut simulation = Simulation::new(&character, mesh, binding, &materials, settings)?;
        let kind = JointKind::Ball { axis: [1.0, 0.0, 0.0], cone: PI, twist: [-PI, PI] };
        let joint = JointSetup { kind, drive: 0.0, stiffness: 0.0, damping: 0.0 };
        let joints = vec![joint; 2];
        let two_way = TwoWay { scheme: TwoWayScheme::Monolithic, joints, root: RootKind::Pinned };
        simulation.couple(&Coupling::TwoWay(two_way), Vec::new())?;
        simulation.start(&RestMotion(&character.skeleton))?;
        Ok(Self { simulation, character, frame: 0, old })
    }

    /// One step.
    pub fn step(&mut self) -> Result<FrameReport, Box<dyn Error>> {
        self.frame += 1;
        let time = self.frame as f64 * scene::STEP;
        let report = self.simulation.advance(&RestMotion(&self.character.skeleton), time)?;
        match report.substeps {
            1 => Ok(report),
            n => Err(format!("step {} was cut into {n}, as bones are fast; ask for fewer --steps", self.frame).into()),
        }
    }

    /// Height of a node [m].
    pub fn height(&self, node: usize) -> f64 {
        f64::from(self.simulation.state.position[self.old[node]][1])
    }

    /// How many nodes are bound.
    pub fn bound(&self) -> usize {
        self.simulation.binding.bound_count()
    }
}

/// The surface of the box as a skin, and its two bones.
fn character(flesh: &FleshBox) -> Result<Character, Box<dyn Error>> {
    let mesh = flesh.mesh();
    let faces = boundary_faces(&mesh).triangles;
    let mut used: Vec<u32> = faces.iter().flatten().copied().collect();
    used.sort_unstable();
    used.dedup();
    let place = |n: &u32| used.binary_search(n).map_or(0, |k| k as u32);
    let positions: Vec<[f64; 3]> = used.iter().map(|n| mesh.nodes[*n as usize]).collect();
    let [start, end] = flesh.extent.map(f64::from);
    let middle = 0.5 * (start + end);
    let mut weights = SkinWeights::default();
    for x in &positions {
        let far = if x[0] > middle { 1.0 } else { 0.0 };
        weights.push([(JointId(0), 1.0 - far), (JointId(1), far)]);
    }
    let joint = |name: &str, parent: Option<u32>, x: f64, world: f64| Joint {
        name: name.into(),
        parent: parent.map(JointId),
        local: Transform { translation: [x, 0.0, 0.0], ..Transform::default() },
        local_matrix: None,
        rest: Affine::from_translation([world, 0.0, 0.0]),
    };
    let joints = vec![joint("near", None, start, start), joint("far", Some(0), middle - start, middle)];
    Ok(Character {
        name: "box".into(),
        meshes: vec![CharacterMesh {
            name: "skin".into(),
            positions,
            triangles: faces.iter().map(|t| [place(&t[0]), place(&t[1]), place(&t[2])]).collect(),
            skin: Skin::Weighted(weights),
            ..CharacterMesh::default()
        }],
        skeleton: Skeleton::new(joints, Affine::IDENTITY)?,
        clips: Vec::new(),
        looks: Vec::new(),
        textures: Vec::new(),
        notes: Vec::new(),
    })
}
