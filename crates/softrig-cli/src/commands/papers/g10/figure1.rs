//! Figure 1: a body that its skeleton moves and that moves its skeleton, with the time of a step, beside the same body one way.

use super::{Job, Results, failed};
use crate::failure::{Failure, Outcome};
use softrig::character::Character;
use softrig::couple::{BindSettings, Binding};
use softrig::material::{Material, MaterialMap};
use softrig::mesh::{LatticeOptions, Resolution, VolumeMesh, tetrahedralize, voxelize};
use softrig::rig::{JointSetup, RootKind, automatic};
use softrig::simulation::{ClipMotion, Coupling, Simulation, SimulationSettings, TwoWay, TwoWayScheme};
use std::time::Instant;

/// Steps that are timed, after some that are not.
const STEPS: usize = 24;
const FIRST: usize = 4;
/// [s]
const STEP: f64 = 1.0 / 60.0;
/// How far the clip leads: the flesh has its say.
const DRIVE: f64 = 0.7;

/// The built-in character, walking.
pub fn run(job: &Job, results: &Results) -> Outcome {
    let cells = if job.quick { 600 } else { 11_500 };
    let character = softrig::sample::character();
    let options = LatticeOptions { resolution: Resolution::Cells(cells), ..LatticeOptions::default() };
    let lattice = voxelize(&character.surface(true), &options).map_err(|e| failed("figure 1", &e))?;
    let mut rows = Vec::new();
    for mesh in [tetrahedralize(&lattice), lattice] {
        for two_way in [false, true] {
            rows.push(row(&character, &mesh, two_way)?);
        }
    }
    let columns =
        ["cells", "kind", "nodes", "coupling", "joint_unknowns", "step_ms_median", "step_ms_min", "iterations_mean"];
    results.table("figure1", &columns, &rows)
}

fn row(character: &Character, mesh: &VolumeMesh, two_way: bool) -> Result<Vec<String>, Failure> {
    let binding = Binding::new(character, mesh, &BindSettings::default()).map_err(|e| failed("figure 1", &e))?;
    let materials = MaterialMap::uniform(Material::default());
    let settings = SimulationSettings { tolerance: 1e-6, longest_step: STEP, ..SimulationSettings::default() };
    let mut simulation = Simulation::<f64>::new(character, mesh.clone(), binding, &materials, settings)
        .map_err(|e| failed("figure 1", &e))?;
    if two_way {
        let coupling = coupling(character, &simulation.binding, DRIVE, RootKind::Driven);
        simulation.couple(&coupling, Vec::new()).map_err(|e| failed("figure 1", &e))?;
    }
    let motion = ClipMotion::new(&character.skeleton, &character.clips[0]);
    simulation.start(&motion).map_err(|e| failed("figure 1", &e))?;
    let (mut ms, mut iterations) = (Vec::new(), 0);
    for step in 1..=FIRST + STEPS {
        let begun = Instant::now();
        let report = simulation.advance(&motion, step as f64 * STEP).map_err(|e| failed("figure 1", &e))?;
        if step > FIRST {
            ms.push(1e3 * begun.elapsed().as_secs_f64() / report.substeps as f64);
            iterations += report.iterations;
        }
    }
    ms.sort_by(f64::total_cmp);
    let kind = if mesh.tets.is_empty() { "hexahedra" } else { "tetrahedra" };
    Ok(vec![
        mesh.cell_count().to_string(),
        kind.into(),
        mesh.node_count().to_string(),
        if two_way { "two-way" } else { "one-way" }.into(),
        simulation.joint_unknowns().to_string(),
        format!("{:.2}", ms[ms.len() / 2]),
        format!("{:.2}", ms[0]),
        format!("{:.1}", iterations as f64 / STEPS as f64),
    ])
}

/// Joints as they are chosen for a character, led so far by its clip.
pub fn coupling(character: &Character, binding: &Binding, drive: f64, root: RootKind) -> Coupling {
    let bones: Vec<_> = binding.bones.iter().map(|b| b.joint).collect();
    let mut joints = vec![JointSetup::default(); character.skeleton.joint_count()];
    for choice in automatic(&character.skeleton, &bones, &character.clips) {
        joints[choice.joint.index()] = JointSetup { drive, ..choice.setup };
    }
    Coupling::TwoWay(TwoWay { scheme: TwoWayScheme::Monolithic, joints, root })
}
