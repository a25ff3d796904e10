//! Self-assembly [Gissler2006 §4.5]: scattered cubes pull themselves together into a tower: at once, on a ramp of the force, and
//! approaching evenly.

use super::picture::{self, Look};
use super::{Curve, Job, Outcome, Plot, Results, add, energies, failed};
use softrig::integrate::State;
use softrig::mesh::VolumeMesh;
use softrig_explicit::constraint::{Constraint, Constraints};
use softrig_explicit::mass_point::MassPoints;
use softrig_explicit::sample::five_tets;
use softrig_explicit::scheme::Scheme;
use softrig_explicit::stepper::Stepper;
use softrig_render::View;

/// Cubes of the tower.
const CUBES: usize = 8;
/// Edge of a cube [m].
const EDGE: f64 = 0.1;

/// Cubes that are so many times as far away as they were at the start have come apart.
const APART: f64 = 10.0;

/// How the joins come to act.
#[derive(Clone, Copy)]
enum Ramp {
    None,
    Force,
    Approach,
}

pub fn run(job: &Job, results: &Results) -> Outcome {
    let cube = five_tets([1, 1, 1], false, |p| p.map(|x| EDGE * x));
    let mut mesh = VolumeMesh::default();
    let mut first = Vec::new();
    for i in 0..CUBES {
        // on a ring around where the tower will be
        let turn = i as f64 * 2.4;
        let at = [0.4 * turn.cos(), 0.05 * i as f64, 0.4 * turn.sin()];
        first.push(add(&mut mesh, &cube, |p| std::array::from_fn(|k| p[k] + at[k])));
    }
    // of the ramps [s]
    let seconds = if job.quick { 0.01 } else { 0.5 };
    let mut rows = Vec::new();
    let mut curves = Vec::new();
    let mut shots = vec![("scattered", mesh.nodes.clone())];
    for (name, ramp) in [("no ramp", Ramp::None), ("force ramp", Ramp::Force), ("approach", Ramp::Approach)] {
        let mut set = Constraints::new(mesh.node_count());
        let top = [2, 3, 6, 7];
        for c in [0, 1, 4, 5] {
            let node = first[0] + c;
            let nail = Constraint::Nail { node, goal: mesh.nodes[node as usize] };
            set.add(nail).map_err(|e| failed(&e))?;
        }
        let (mut pairs, mut made) = (Vec::new(), Vec::new());
        for i in 1..CUBES {
            for c in top {
                let nodes = vec![first[i - 1] + c, first[i] + c - 2];
                let id = set.add(Constraint::PointsToPoint { nodes: nodes.clone() }).map_err(|e| failed(&e))?;
                made.push(id);
                pairs.push(nodes);
            }
        }
        let mut law = MassPoints::new(&mesh, &energies()).map_err(|e| failed(&e))?;
        law.drag = 4.0;
        let mass = law.mass().to_vec();
        let stepper = Stepper::new(Scheme::Verlet, &mass, &mesh.nodes, &mut law, 4.0);
        let mut stepper = stepper.map_err(|e| failed(&e))?;
        let dt = 0.25 * stepper.limit();
        let count = (seconds / dt) as u32;
        for id in made {
            match ramp {
                Ramp::None => Ok(()),
                Ramp::Force => set.ramp(id, count),
                Ramp::Approach => set.approach(id, count),
            }
            .map_err(|e| failed(&e))?;
        }
        let mut state = State::at_rest(mesh.nodes.clone());
        // the ramp, and as long again
        let steps = 2 * count as usize;
        let every = (steps / 1000).max(1);
        let (mut points, mut fastest, mut came_apart) = (Vec::new(), 0.0f64, None);
        let widest_gap = |state: &State<f64>| {
            let gaps = pairs.iter().map(|p| {
                let [a, b] = [p[0], p[1]].map(|n| state.position[n as usize]);
                (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f64>().sqrt()
            });
            gaps.fold(0.0, f64::max)
        };
        let reach = APART * widest_gap(&state);
        let mut shown = state.clone();
        for k in 0..steps {
            let failed = stepper.step(&mut law, Some(&mut set), &mut state, dt).is_err();
            let far = state.position.iter().flatten().any(|x| x.is_nan() || x.abs() > reach);
            if failed || far {
                // numbers from here on say nothing about assembling
                came_apart = Some(format!("after {} steps ({:.1e} s)", k + 1, (k + 1) as f64 * dt));
                break;
            }
            shown.clone_from(&state);
            fastest = state.velocity.iter().flatten().fold(fastest, |m, v| m.max(v.abs()));
            if k % every == 0 || k + 1 == steps {
                points.push((state.time, widest_gap(&state)));
            }
        }
        let last = points.last().map_or(f64::NAN, |p| p.1);
        let (gap, speed) = match came_apart {
            Some(_) => ("none".into(), "none".into()),
            None => (format!("{last:.2e}"), format!("{fastest:.1}")),
        };
        rows.push(vec![name.into(), gap, speed, came_apart.unwrap_or_else(|| "never".into())]);
        curves.push(Curve { name, points });
        shots.push((name, shown.position));
    }
    results.table("assembly", &["run", "largest_gap_at_the_end_m", "fastest_m_per_s", "came_apart"], &rows)?;
    let plot = Plot { title: "Self-assembly", x: "time [s]", y: "largest gap [m]", log: false, curves };
    results.plot("assembly", &plot)?;
    let look = Look { title: "", range: [0.0, 1.0], view: View::ThreeQuarter };
    let shown: Vec<_> = shots.iter().map(|(n, s)| (*n, &s[..], None)).collect();
    picture::states(results, "assembly.png", &mesh, &look, &shown)
}
