//! Figure 2: a hoof is pulled as a whole, with a skeleton that keeps its bones as they are, and without.
//!
//! Without it only the bone at the root holds the body, and everything else is flesh. What the bones then look like is measured by
//! the distances between the nodes of each: mean over pairs and bones of their relative change.

use super::figure1::coupling;
use super::{Job, Results, failed};
use crate::commands::papers::picture::skins;
use crate::failure::{Failure, Outcome};
use crate::load;
use softrig::character::{Character, Skin};
use softrig::couple::{BindSettings, Binding, BoneRule};
use softrig::material::{Material, MaterialMap};
use softrig::mesh::{LatticeOptions, Resolution, VolumeMesh, voxelize};
use softrig::rig::{JointKind, RootKind};
use softrig::simulation::{Action, Coupling, Event, Key, RestMotion, Simulation, SimulationSettings};
use softrig_io::ImportOptions;
use softrig_render::View;
use std::f64::consts::PI;

/// Frames of the pull, and frames it is held [1/30 s].
const PULL: usize = 30;
const HELD: usize = 15;
/// How far up and forward, as a share of the height.
const WAY: f64 = 0.25;
/// Nodes of a bone that are compared with each other.
const SAMPLE: usize = 40;
/// Points of the skin that share the pull: all around what follows the same joint as the lowest vertex.
const POINTS: usize = 48;
/// How far the rest pose leads the joints: enough to bring a leg back that nothing pulls.
const DRIVE: f64 = 0.02;
/// Room of each joint beyond what its clips do [rad]: none of them lifts a hoof as far as this pull.
const ROOM: f64 = 0.5;
/// The pull as a spring on the whole body would swing it this often a second [1/s].
const FREQUENCY: f64 = 3.0;

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
    let points = hoof(&character);
    let way = WAY * character.height();
    let pull = |stiffness: f64| {
        let spring = |(mesh, vertex, at): &(usize, usize, [f64; 3])| {
            let path = [(0.0, 0.0), (PULL as f64 / 30.0, way)]
                .map(|(time, s)| Key { time, position: [at[0], at[1] + s, at[2] + s] })
                .to_vec();
            let stiffness = Some(stiffness / points.len() as f64);
            let action = Action::PullFlesh { mesh: *mesh, vertex: *vertex, path, stiffness };
            Event { start: 0.0, end: f64::INFINITY, action }
        };
        points.iter().map(spring).collect()
    };
    let frames = if job.quick { 10 } else { PULL + HELD };
    let with = pulled(&character, &mesh, held.clone(), true, &pull, frames)?;
    let loose = BindSettings { bones: rootless(&character, &held), ..BindSettings::default() };
    let loose = Binding::new(&character, &mesh, &loose).map_err(|e| failed("figure 2", &e))?;
    let without = pulled(&character, &mesh, loose, false, &pull, frames)?;
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
    let rows = [row("with skeletal constraints", &with.nodes), row("without", &without.nodes)];
    results.table("figure2", &["body", "pulled", "cells", "bone_shape_error_mean", "bone_shape_error_max"], &rows)?;
    let rest: Vec<_> = character.meshes.iter().map(|m| m.positions.clone()).collect();
    let shown = [("rest", &rest), ("with bones", &with.skin), ("without", &without.skin)];
    skins(results, "figure2.png", &character, View::ThreeQuarter, &shown)
}

/// Points of the skin that follow the joint of the lowest vertex, of equals the foremost: mesh, number and place of each, well apart.
fn hoof(character: &Character) -> Vec<(usize, usize, [f64; 3])> {
    let mut all = Vec::new();
    for (k, mesh) in character.meshes.iter().enumerate() {
        let Skin::Weighted(weights) = &mesh.skin else { continue };
        for (v, p) in mesh.positions.iter().enumerate() {
            let heaviest = weights.of(v).max_by(|a, b| a.1.total_cmp(&b.1));
            all.extend(heaviest.map(|(joint, _)| (k, v, *p, joint)));
        }
    }
    let height = character.height();
    let rank = |p: [f64; 3]| p[1] - 0.1 * p[2] + 1e-3 * height * p[0].signum();
    let Some(lowest) = all.iter().min_by(|a, b| rank(a.2).total_cmp(&rank(b.2))) else { return Vec::new() };
    let square = |a: [f64; 3], b: [f64; 3]| (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f64>();
    let own: Vec<_> = all.iter().filter(|p| p.3 == lowest.3).collect();
    let mut chosen = vec![(lowest.0, lowest.1, lowest.2)];
    while chosen.len() < POINTS.min(own.len()) {
        let apart = |p: [f64; 3]| chosen.iter().map(|c| square(c.2, p)).fold(f64::INFINITY, f64::min);
        let Some(next) = own.iter().max_by(|a, b| apart(a.2).total_cmp(&apart(b.2))) else { break };
        chosen.push((next.0, next.1, next.2));
    }
    chosen
}

/// Rules that leave only the bone at the root.
fn rootless(character: &Character, binding: &Binding) -> Vec<(String, BoneRule)> {
    let loose = binding.bones.iter().filter(|b| b.parent.is_some());
    loose.map(|b| (character.skeleton.joint(b.joint).name.clone(), BoneRule::Exclude)).collect()
}

/// The same joints with more room.
fn roomy(mut coupling: Coupling) -> Coupling {
    if let Coupling::TwoWay(two) = &mut coupling {
        for joint in &mut two.joints {
            match &mut joint.kind {
                JointKind::Fixed => {}
                JointKind::Hinge { range, .. } => *range = [range[0] - ROOM, range[1] + ROOM],
                JointKind::Ball { cone, .. } => *cone = (*cone + ROOM).min(PI),
            }
        }
    }
    coupling
}

/// Where nodes and skin are after the pull.
struct Pulled {
    nodes: Vec<[f64; 3]>,
    skin: Vec<Vec<[f64; 3]>>,
}

/// Pulls by springs of so much stiffness in all [N/m].
fn pulled(
    character: &Character,
    mesh: &VolumeMesh,
    binding: Binding,
    bones: bool,
    events: &dyn Fn(f64) -> Vec<Event>,
    frames: usize,
) -> Result<Pulled, Failure> {
    let coupling = if bones { roomy(coupling(character, &binding, DRIVE, RootKind::Driven)) } else { Coupling::OneWay };
    let materials = MaterialMap::uniform(Material::default());
    let settings = SimulationSettings {
        gravity: [0.0; 3],
        dynamics: softrig::integrate::Dynamics::Calm,
        ..SimulationSettings::default()
    };
    let mut simulation = Simulation::<f64>::new(character, mesh.clone(), binding, &materials, settings)
        .map_err(|e| failed("figure 2", &e))?;
    let stiffness = simulation.body.total_mass() * (std::f64::consts::TAU * FREQUENCY).powi(2);
    simulation.couple(&coupling, events(stiffness)).map_err(|e| failed("figure 2", &e))?;
    let motion = RestMotion(&character.skeleton);
    simulation.start(&motion).map_err(|e| failed("figure 2", &e))?;
    for frame in 1..=frames {
        simulation.advance(&motion, frame as f64 / 30.0).map_err(|e| failed("figure 2", &e))?;
    }
    Ok(Pulled { nodes: simulation.state.position.clone(), skin: simulation.frame(frames).skin.to_vec() })
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
