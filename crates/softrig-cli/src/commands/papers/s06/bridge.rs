//! Figure 4: planks that are a net, until those constraints are switched off and others make a bridge of them.

use super::picture::{self, Look};
use super::{Job, Outcome, Results, add, energies, failed};
use softrig::integrate::State;
use softrig::mesh::VolumeMesh;
use softrig_explicit::constraint::{Constraint, ConstraintId, Constraints};
use softrig_explicit::mass_point::MassPoints;
use softrig_explicit::sample::five_tets;
use softrig_explicit::scheme::Scheme;
use softrig_explicit::stepper::Stepper;
use softrig_render::View;

/// Planks along and across.
const PLANKS: [usize; 2] = [12, 6];

pub fn run(job: &Job, results: &Results) -> Outcome {
    let plank = five_tets([2, 1, 2], false, |p| [0.2 * p[0], 0.04 * p[1], 0.2 * p[2]]);
    let node = |i: usize, j: usize, k: usize| ((i * 2 + j) * 3 + k) as u32;
    let mut mesh = VolumeMesh::default();
    let mut first = Vec::new();
    for i in 0..PLANKS[0] {
        for j in 0..PLANKS[1] {
            let place = [0.26 * i as f64, 0.0, 0.26 * j as f64];
            first.push(add(&mut mesh, &plank, |p| std::array::from_fn(|k| p[k] + place[k])));
        }
    }
    let at = |i: usize, j: usize| first[i * PLANKS[1] + j];
    let mut set = Constraints::new(mesh.node_count());
    let mut law = MassPoints::new(&mesh, &energies()).map_err(|e| failed(&e))?;
    law.gravity = [0.0, -9.81, 0.0];
    let mass = law.mass().to_vec();
    let mut stepper = Stepper::new(Scheme::Verlet, &mass, &mesh.nodes, &mut law, 0.0).map_err(|e| failed(&e))?;
    let dt = 0.5 * stepper.limit();
    let nail = |n: u32, mesh: &VolumeMesh| Constraint::Nail { node: n, goal: mesh.nodes[n as usize] };
    let (mut net, mut bridge) = (Vec::new(), Vec::new());
    let mut new = |list: &mut Vec<ConstraintId>, c: Constraint| {
        let id = set.add_inactive(c).map_err(|e| failed(&e))?;
        list.push(id);
        Ok::<_, crate::failure::Failure>(id)
    };
    for i in 0..PLANKS[0] {
        for j in 0..PLANKS[1] {
            let p = at(i, j);
            // net: planks hang on one another by the middles of their edges, upper side
            if i + 1 < PLANKS[0] {
                new(
                    &mut net,
                    Constraint::PointsToPoint { nodes: vec![p + node(2, 1, 1), at(i + 1, j) + node(0, 1, 1)] },
                )?;
            }
            if j + 1 < PLANKS[1] {
                new(
                    &mut net,
                    Constraint::PointsToPoint { nodes: vec![p + node(1, 1, 2), at(i, j + 1) + node(1, 1, 0)] },
                )?;
            }
            if i == 0 || i + 1 == PLANKS[0] {
                new(&mut net, nail(p + node(if i == 0 { 0 } else { 2 }, 1, 1), &mesh))?;
            }
            // bridge: closed rows, by all corners of touching faces
            let mut faces = Vec::new();
            if i + 1 < PLANKS[0] {
                faces.extend([0, 2].map(|k| [p + node(2, 1, k), at(i + 1, j) + node(0, 1, k)]));
            }
            if j + 1 < PLANKS[1] {
                faces.push([p + node(1, 0, 2), at(i, j + 1) + node(1, 0, 0)]);
            }
            for nodes in faces {
                new(&mut bridge, Constraint::PointsToPoint { nodes: nodes.to_vec() })?;
            }
            if i == 0 || i + 1 == PLANKS[0] {
                let end = if i == 0 { 0 } else { 2 };
                for k in [0, 2] {
                    new(&mut bridge, nail(p + node(end, 1, k), &mesh))?;
                }
            }
        }
    }
    let counts = [net.len(), bridge.len()];
    let mut state = State::at_rest(mesh.nodes.clone());
    let ramp = (0.3 / dt) as u32;
    let mut rows = Vec::new();
    let mut shots = vec![state.position.clone()];
    for (name, off, on) in [("net", &Vec::new(), &net), ("bridge", &net, &bridge)] {
        for id in off {
            set.set_active(*id, false).map_err(|e| failed(&e))?;
        }
        for id in on {
            set.set_active(*id, true).map_err(|e| failed(&e))?;
            set.approach(*id, ramp).map_err(|e| failed(&e))?;
        }
        let until = state.time + if job.quick { 0.05 } else { 1.2 };
        let start = std::time::Instant::now();
        let mut steps = 0;
        while state.time < until {
            stepper.step(&mut law, Some(&mut set), &mut state, dt).map_err(|e| failed(&e))?;
            steps += 1;
        }
        let us = start.elapsed().as_secs_f64() * 1e6 / f64::from(steps);
        let low = state.position.iter().fold(0.0f64, |m, p| m.min(p[1]));
        rows.push(vec![name.into(), on.len().to_string(), format!("{us:.1}"), format!("{low:.3}")]);
        shots.push(state.position.clone());
    }
    rows.push(vec![
        format!("{} tets", mesh.tets.len()),
        counts[0].to_string(),
        format!("dt {dt:.2e} s"),
        String::new(),
    ]);
    results.table("figure4", &["phase", "constraints", "mean_step_us", "lowest_point_m"], &rows)?;
    let look = Look { title: "", range: [0.0, 1.0], view: View::ThreeQuarter };
    let names = ["planks", "net", "bridge"];
    let shown: Vec<_> = names.iter().zip(&shots).map(|(n, s)| (*n, &s[..], None)).collect();
    picture::states(results, "figure4.png", &mesh, &look, &shown)
}
