//! Figure 2: a hoof is pulled, with a skeleton that keeps its bones as they are, and without.
//!
//! Without it only the bone at the root holds the body, and everything else is flesh. What the bones then look like is measured by
//! the distances between the nodes of each: mean over pairs and bones of their relative change.

use super::figure1::coupling;
use super::{Job, Results, failed};
use crate::commands::papers::picture::{Look, states};
use crate::failure::{Failure, Outcome};
use crate::load;
use softrig::character::{Character, Skin};
use softrig::couple::{BindSettings, Binding, BoneRule};
use softrig::material::{Material, MaterialMap};
use softrig::mesh::{LatticeOptions, Resolution, VolumeMesh, voxelize};
use softrig::rig::RootKind;
use softrig::simulation::{Action, Coupling, Event, Key, RestMotion, Simulation, SimulationSettings};
use softrig_io::ImportOptions;
use softrig_render::View;

/// Frames of the pull, and frames it is held [1/30 s].
const PULL: usize = 30;
const HELD: usize = 15;
/// How far up and forward, as a share of the height.
const WAY: f64 = 0.25;
/// Nodes of a bone that are compared with each other.
const SAMPLE: usize = 40;

/// The horse, or the built-in character where it is not there.
pub fn run(job: &Job, results: &Results) -> Outcome {
    let file = job.shared.join("data/characters/Horse.glb");
    let (name, character) = if file.exists() {
        let read = softrig_io::import(&file, &ImportOptions::default());
        ("horse", read.map_err(|e| load::import_failure(&e))?)
    } else {
        ("sample", softrig::sample::character())
    };
    let cells = if job.quick { 500 } else { 6000 };
    let options = LatticeOptions { resolution: Resolution::Cells(cells), ..LatticeOptions::default() };
    let mesh = voxelize(&character.surface(true), &options).map_err(|e| failed("figure 2", &e))?;
    let held = Binding::new(&character, &mesh, &BindSettings::default()).map_err(|e| failed("figure 2", &e))?;
    let Some((hoof, vertex, at)) = lowest(&character) else { return Ok(()) };
    let height = character.height();
    let path = [(0.0, 0.0), (PULL as f64 / 30.0, WAY * height)]
        .map(|(time, s)| Key { time, position: [at[0], at[1] + s, at[2] + s] })
        .to_vec();
    let pull = || {
        vec![Event {
            start: 0.0,
            end: f64::INFINITY,
            action: Action::PullFlesh { mesh: hoof, vertex, path: path.clone(), stiffness: None },
        }]
    };
    let frames = if job.quick { 10 } else { PULL + HELD };
    let with = pulled(&character, &mesh, held.clone(), true, pull(), frames)?;
    let loose = BindSettings { bones: rootless(&character, &held), ..BindSettings::default() };
    let loose = Binding::new(&character, &mesh, &loose).map_err(|e| failed("figure 2", &e))?;
    let without = pulled(&character, &mesh, loose, false, pull(), frames)?;
    let error = |x: &[[f64; 3]]| bone_shape_error(&held, &mesh.nodes, x);
    let row = |what: &str, x: &[[f64; 3]]| {
        let e = error(x);
        vec![
            name.to_owned(),
            what.to_owned(),
            mesh.cell_count().to_string(),
            format!("{:.2e}", e.0),
            format!("{:.2e}", e.1),
        ]
    };
    let rows = [row("with skeletal constraints", &with), row("without", &without)];
    results.table("figure2", &["body", "pulled", "cells", "bone_shape_error_mean", "bone_shape_error_max"], &rows)?;
    let look = Look { title: "", range: [0.0, 1.0], view: View::ThreeQuarter };
    let shown: [(&str, &[[f64; 3]], Option<Vec<f32>>); 3] =
        [("rest", &mesh.nodes, None), ("with bones", &with, None), ("without", &without, None)];
    states(results, "figure2.png", &mesh, &look, &shown)
}

/// The lowest vertex of the skin: its mesh, its number and its place. Of equals the foremost.
fn lowest(character: &Character) -> Option<(usize, usize, [f64; 3])> {
    let skins = character.meshes.iter().enumerate().filter(|(_, m)| matches!(m.skin, Skin::Weighted(_)));
    let all = skins.flat_map(|(k, m)| m.positions.iter().enumerate().map(move |(v, p)| (k, v, *p)));
    let height = character.height();
    let rank = |p: [f64; 3]| p[1] - 0.1 * p[2] + 1e-3 * height * p[0].signum();
    all.min_by(|a, b| rank(a.2).total_cmp(&rank(b.2)))
}

/// Rules that leave only the bone at the root.
fn rootless(character: &Character, binding: &Binding) -> Vec<(String, BoneRule)> {
    let loose = binding.bones.iter().filter(|b| b.parent.is_some());
    loose.map(|b| (character.skeleton.joint(b.joint).name.clone(), BoneRule::Exclude)).collect()
}

/// Where the nodes are after the pull.
fn pulled(
    character: &Character,
    mesh: &VolumeMesh,
    binding: Binding,
    bones: bool,
    events: Vec<Event>,
    frames: usize,
) -> Result<Vec<[f64; 3]>, Failure> {
    let coupling = if bones { coupling(character, &binding, 0.3, RootKind::Driven) } else { Coupling::OneWay };
    let materials = MaterialMap::uniform(Material::default());
    let settings = SimulationSettings {
        gravity: [0.0; 3],
        dynamics: softrig::integrate::Dynamics::Calm,
        ..SimulationSettings::default()
    };
    let mut simulation = Simulation::<f64>::new(character, mesh.clone(), binding, &materials, settings)
        .map_err(|e| failed("figure 2", &e))?;
    simulation.couple(&coupling, events).map_err(|e| failed("figure 2", &e))?;
    let motion = RestMotion(&character.skeleton);
    simulation.start(&motion).map_err(|e| failed("figure 2", &e))?;
    for frame in 1..=frames {
        simulation.advance(&motion, frame as f64 / 30.0).map_err(|e| failed("figure 2", &e))?;
    }
    Ok(simulation.state.position.clone())
}

/// Mean and largest relative change of the distances between nodes of one bone: the mean of each bone's pairs, over the bones.
fn bone_shape_error(binding: &Binding, rest: &[[f64; 3]], now: &[[f64; 3]]) -> (f64, f64) {
    let distance = |x: &[[f64; 3]], a: usize, b: usize| (0..3).map(|k| (x[a][k] - x[b][k]).powi(2)).sum::<f64>().sqrt();
    let (mut mean, mut most, mut bones) = (0.0, 0.0f64, 0.0);
    for bone in 0..binding.bones.len() {
        // nodes that follow this bone alone: those of joints bend on purpose
        let own: Vec<usize> = (0..rest.len())
            .filter(|n| binding.bound[*n] && binding.owner[*n] as usize == bone && binding.blend(*n).len() == 1)
            .collect();
        let sample: Vec<usize> = own.iter().copied().step_by(own.len().div_ceil(SAMPLE).max(1)).collect();
        let (mut sum, mut pairs) = (0.0, 0.0);
        for (i, a) in sample.iter().enumerate() {
            for b in &sample[i + 1..] {
                let length = distance(rest, *a, *b);
                if length > 0.0 {
                    sum += (distance(now, *a, *b) / length - 1.0).abs();
                    pairs += 1.0;
                }
            }
        }
        if pairs > 0.0 {
            (mean, most, bones) = (mean + sum / pairs, most.max(sum / pairs), bones + 1.0);
        }
    }
    (mean / f64::max(bones, 1.0), most)
}
