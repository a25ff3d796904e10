//! Table 1: time to set up a skeleton, and time of a step with two V(2,1) cycles.

use super::bodies::{PaperBody, bar, dragon, flesh, manikin};
use super::{Job, Results, failed};
use crate::failure::{Failure, Outcome};
use softrig::integrate::{Implicit, Integrator, Scheme, State, StepInput, StepOutput};
use softrig::simulation::interpolations;
use softrig_linalg::solver::{Multigrid, MultigridSettings};
use softrig_linalg::{DofConstraints, LinearSolver};
use std::time::Instant;

/// Time step [s].
const STEP: f64 = 1.0 / 30.0;
/// Largest angle of a joint [rad].
const BEND: f64 = 0.15;

/// The three bodies, by the paper's solver and by the default one.
pub fn run(job: &Job, results: &Results) -> Outcome {
    let bodies = [manikin(if job.quick { 3_000 } else { 14_062 })?, bar(if job.quick { 2 } else { 3 })?, dragon(job)?];
    let mut rows = Vec::new();
    for body in &bodies {
        for (solver, settings) in
            [("two V(2;1)", MultigridSettings::paper()), ("default", MultigridSettings::default())]
        {
            let measured = measure(job, body, settings)?;
            let row =
                [body.name, &body.mesh.tets.len().to_string(), &body.spine.joints.len().to_string(), body.kind, solver];
            let numbers = [measured.init, measured.median, measured.min].map(|t| format!("{t:.2}"));
            let residual = [format!("{:.1e}", measured.residual)];
            rows.push(row.map(String::from).into_iter().chain(numbers).chain(residual).collect());
        }
    }
    let columns =
        ["body", "tets", "joints", "hierarchy", "solver", "init_ms", "step_ms_median", "step_ms_min", "residual_max"];
    results.table("table1", &columns, &rows)
}

struct Measured {
    /// Constraints exchanged on a body that is being simulated [ms].
    init: f64,
    median: f64,
    min: f64,
    /// Largest true residual of a step [-].
    residual: f64,
}

fn measure(job: &Job, paper: &PaperBody, settings: MultigridSettings) -> Result<Measured, Failure> {
    let at = |e: &dyn std::error::Error| failed(paper.name, e);
    let mut body = flesh(paper, 0.3)?;
    let mut solver = Multigrid::with_settings(interpolations(paper.levels.clone()), settings);
    // first without a skeleton, then with it: what changing the constraints costs
    solver.prepare(&body.pattern, &DofConstraints::none(body.mesh.node_count())).map_err(|e| at(&e))?;
    let start = Instant::now();
    body.set_constraints(DofConstraints::from_mask(paper.spine.bound())).map_err(|e| at(&e))?;
    solver.prepare(&body.pattern, &body.constraints).map_err(|e| at(&e))?;
    let init = start.elapsed().as_secs_f64() * 1e3;

    // implicit Euler: Newmark with one linearisation gains energy (numerics 3.4)
    let mut integrator = Implicit::new(Scheme::ImplicitEuler, 1);
    let weight = body.weight([0.0, -9.81, 0.0]);
    let mut state = State::at_rest(body.mesh.nodes.clone());
    let mut output = StepOutput::default();
    let (mut times, mut residual) = (Vec::new(), 0.0f64);
    for step in 0..if job.quick { 6 } else { 31 } {
        let start = Instant::now();
        let time = f64::from(step + 1) * STEP;
        let target = paper.spine.bent(&body.mesh, BEND * (std::f64::consts::TAU * time).sin());
        let velocity: Vec<[f64; 3]> = target
            .iter()
            .zip(&state.position)
            .map(|(to, from)| std::array::from_fn(|k| (to[k] - from[k]) / STEP))
            .collect();
        let input = StepInput {
            target_position: &target,
            target_velocity: &velocity,
            external_force: &weight,
            dt: STEP,
            tolerance: 1e-3,
        };
        integrator.step(&mut body, &mut solver, &input, &mut state, &mut output).map_err(|e| at(&e))?;
        if step > 0 {
            times.push(start.elapsed().as_secs_f64() * 1e3);
        }
        residual = residual.max(output.residual);
    }
    times.sort_by(f64::total_cmp);
    Ok(Measured { init, median: times[times.len() / 2], min: times[0], residual })
}
