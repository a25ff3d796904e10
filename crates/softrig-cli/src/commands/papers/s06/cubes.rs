//! Figures 1 and 2: hanging cubes, and the time of a step over the number of constraints.

use super::picture::{self, Look};
use super::{Curve, Job, Outcome, Plot, Results, Times, energies, failed};
use softrig::integrate::State;
use softrig_explicit::constraint::{ConstraintId, Constraints};
use softrig_explicit::mass_point::MassPoints;
use softrig_explicit::sample::hanging_cubes;
use softrig_explicit::scheme::Scheme;
use softrig_explicit::stepper::{ForceLaw, Stepper};
use softrig_render::View;
use std::convert::Infallible;

pub fn run(job: &Job, results: &Results) -> Outcome {
    let counts: &[usize] = if job.quick { &[790] } else { &[790, 2990, 4990, 6990, 9990] };
    let rounds = if job.quick { 20 } else { 400 };
    let mut rows = Vec::new();
    let mut curves = [("force", Vec::new()), ("constraints", Vec::new()), ("whole step", Vec::new())];
    for &count in counts {
        let (mesh, list) = hanging_cubes(count);
        let constraints = list.len();
        let mut law = MassPoints::new(&mesh, &energies()).map_err(|e| failed(&e))?;
        law.gravity = [0.0, -9.81, 0.0];
        let mass = law.mass().to_vec();
        let mut set = Constraints::new(mesh.node_count());
        for c in list {
            set.add(c).map_err(|e| failed(&e))?;
        }
        let mut stepper = Stepper::new(Scheme::Verlet, &mass, &mesh.nodes, &mut law, 0.0).map_err(|e| failed(&e))?;
        let dt = 0.5 * stepper.limit();
        let mut state = State::at_rest(mesh.nodes.clone());
        let mut scratch = state.position.clone();
        let Ok(force) = Times::of::<Infallible>(rounds, || {
            law.force(&state.position, &state.velocity, &mut scratch);
            Ok(())
        });
        let inverse = stepper.inverse_mass().to_vec();
        let mut next = state.clone();
        let enforce = || set.enforce(Scheme::Verlet, dt, &inverse, &mut next);
        let constraint = Times::of(rounds, enforce).map_err(|e| failed(&e))?;
        let step = || stepper.step(&mut law, Some(&mut set), &mut state, dt).map(|_| ());
        let step = Times::of(rounds, step).map_err(|e| failed(&e))?;
        let number = |x: f64| format!("{x:.1}");
        let mut row = vec![count.to_string(), mesh.tets.len().to_string(), constraints.to_string()];
        let times = [force, constraint, step];
        row.extend(times.iter().flat_map(|t| [number(t.median), number(t.least)]));
        row.push(format!("{dt:.2e}"));
        rows.push(row);
        for (curve, t) in curves.iter_mut().zip(times) {
            curve.1.push((constraints as f64, t.median / 1e3));
        }
        if count == 790 {
            released(results, &mesh, &mut stepper, &mut law, &mut set, state, constraints)?;
        }
    }
    let columns = [
        "cubes",
        "tets",
        "constraints",
        "force_us_median",
        "force_us_min",
        "constraints_us_median",
        "constraints_us_min",
        "step_us_median",
        "step_us_min",
        "dt_s",
    ];
    results.table("figures_1_and_2", &columns, &rows)?;
    let curves = curves.into_iter().map(|(name, points)| Curve { name, points }).collect();
    let plot = Plot { title: "Time of one step", x: "constraints", y: "time [ms]", log: false, curves };
    results.plot("figure2", &plot)
}

/// Figure 1: all constraints on, then all off.
fn released(
    results: &Results,
    mesh: &softrig::mesh::VolumeMesh,
    stepper: &mut Stepper<f64>,
    law: &mut MassPoints<f64>,
    set: &mut Constraints,
    mut state: State<f64>,
    constraints: usize,
) -> Outcome {
    let held = state.position.clone();
    for id in 0..constraints as u32 {
        set.set_active(ConstraintId(id), false).map_err(|e| failed(&e))?;
    }
    while state.time < 0.6 {
        stepper.step(law, Some(set), &mut state, 1e-2).map_err(|e| failed(&e))?;
    }
    let look = Look { title: "", range: [0.0, 1.0], view: View::Front };
    let shown = [("all constraints on", &held[..], None), ("all off, later", &state.position[..], None)];
    picture::states(results, "figure1.png", mesh, &look, &shown)
}
