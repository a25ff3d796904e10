//! Table 1: time to set up a skeleton, and time of a step with two V(2,1) cycles.

use super::bodies::{PaperBody, bar, dragon, flesh, manikin};
use super::{Job, Results, failed};
use crate::commands::bench::{Clocks, Time, TimedModel, TimedSolver};
use crate::failure::{Failure, Outcome};
use rayon::prelude::*;
use softrig::body::Body;
use softrig::integrate::{Scheme, State, StepInput, StepOutput, implicit};
use softrig::simulation::interpolations;
use softrig_linalg::solver::{MultigridSettings, Rebuild, multigrid};
use softrig_linalg::{DofConstraints, LinearSolver, Scalar, par};
use std::sync::Arc;
use std::time::Instant;

/// Time step [s].
const STEP: f64 = 1.0 / 30.0;
/// Largest angle of a joint [rad].
const BEND: f64 = 0.15;

/// Turn of a cell after which the coarse operators are made anew [rad]: cycles without conjugate gradients stay convergent (numerics 5.7).
const TURN: f64 = 10.0 * std::f64::consts::PI / 180.0;

/// The three bodies: by the paper's solver to the letter, by the same that keeps its coarse operators while they are good (both in
/// f32, the arithmetic of interactive work), and by the default one.
pub fn run(job: &Job, results: &Results) -> Outcome {
    let bodies = [manikin(if job.quick { 3_000 } else { 14_062 })?, bar(if job.quick { 2 } else { 3 })?, dragon(job)?];
    let kept = MultigridSettings { rebuild: Rebuild::WhenTurned(TURN), ..MultigridSettings::paper() };
    let mut rows = Vec::new();
    for body in &bodies {
        let measured = [
            ("two V(2;1); operators every step", "f32", measure::<f32>(job, body, MultigridSettings::paper())?),
            ("two V(2;1); operators after 10 degrees", "f32", measure::<f32>(job, body, kept)?),
            ("default to 1e-3", "f64", measure::<f64>(job, body, MultigridSettings::default())?),
        ];
        for (solver, precision, m) in measured {
            let row = [body.name, &body.mesh.tets.len().to_string(), &body.spine.joints.len().to_string(), body.kind];
            let [forces, assembly, solve] = m.stages;
            let numbers = [m.init, m.median, m.min, forces, assembly, solve].map(|t| format!("{t:.2}"));
            let rest = [m.rebuilds.to_string(), format!("{:.1e}", m.residual)];
            let words = row.into_iter().chain([solver, precision]).map(String::from);
            rows.push(words.chain(numbers).chain(rest).collect());
        }
    }
    let columns = [
        "body",
        "tets",
        "joints",
        "hierarchy",
        "solver",
        "precision",
        "init_ms",
        "step_ms_median",
        "step_ms_min",
        "rotations_and_forces_ms",
        "assembly_ms",
        "solve_ms",
        "rebuilds",
        "residual_max",
    ];
    results.table("table1", &columns, &rows)
}

struct Measured {
    /// Constraints exchanged on a body that is being simulated [ms].
    init: f64,
    median: f64,
    min: f64,
    /// Rotations and forces, assembly and solve, medians [ms].
    stages: [f64; 3],
    /// Steps that made the coarse operators anew.
    rebuilds: usize,
    /// Largest true residual of a step [-].
    residual: f64,
}

fn measure<R: Scalar>(job: &Job, paper: &PaperBody, settings: MultigridSettings) -> Result<Measured, Failure> {
    let at = |e: &dyn std::error::Error| failed(paper.name, e);
    let clocks = Arc::new(Clocks::default());
    let body = flesh::<R>(paper, 0.3)?;
    let model = TimedModel { inner: body.model, clocks: clocks.clone() };
    let mut body = Body { model: Box::new(model), ..body };
    let inner = multigrid(interpolations(paper.levels.clone()), settings);
    let mut solver = TimedSolver { inner, clocks: clocks.clone() };
    // first without a skeleton, then with it: what changing the constraints costs
    solver.prepare(&body.pattern, &DofConstraints::none(body.mesh.node_count())).map_err(|e| at(&e))?;
    let start = Instant::now();
    body.set_constraints(DofConstraints::from_mask(paper.spine.bound())).map_err(|e| at(&e))?;
    solver.prepare(&body.pattern, &body.constraints).map_err(|e| at(&e))?;
    let init = start.elapsed().as_secs_f64() * 1e3;

    // implicit Euler: Newmark with one linearisation gains energy (numerics 3.4)
    let mut integrator = implicit(Scheme::ImplicitEuler, 1);
    let cast = |x: &[f64; 3]| x.map(R::from_f64);
    let weight = body.weight([0.0, -9.81, 0.0]);
    let mut state = State::at_rest(body.mesh.nodes.iter().map(cast).collect());
    let mut output = StepOutput::default();
    let (mut times, mut stages, mut rebuilds, mut residual) = (Vec::new(), [const { Vec::new() }; 3], 0, 0.0f64);
    for step in 0..if job.quick { 6 } else { 31 } {
        clocks.take();
        let start = Instant::now();
        let time = f64::from(step + 1) * STEP;
        let bent = paper.spine.bent(&body.mesh, BEND * (std::f64::consts::TAU * time).sin());
        let target: Vec<[R; 3]> = bent.par_iter().with_min_len(par::CHUNK).map(cast).collect();
        let inverse = R::from_f64(1.0 / STEP);
        let velocity: Vec<[R; 3]> = target
            .par_iter()
            .zip(&state.position)
            .with_min_len(par::CHUNK)
            .map(|(to, from)| std::array::from_fn(|k| (to[k] - from[k]) * inverse))
            .collect();
        let input = StepInput {
            target_position: &target,
            target_velocity: &velocity,
            external_force: &weight,
            dt: STEP,
            tolerance: 1e-3,
            reactions: false,
        };
        integrator.step(&mut body, &mut solver, &input, &mut state, &mut output).map_err(|e| at(&e))?;
        let (whole, taken) = (start.elapsed().as_secs_f64() * 1e3, clocks.take());
        if step > 0 {
            times.push(whole);
            stages.iter_mut().zip(taken.times).for_each(|(list, t)| list.push(t));
            rebuilds += usize::from(taken.rebuilds > 0);
        }
        residual = residual.max(output.residual);
    }
    let whole = Time::of(times);
    let stages = stages.map(|t| Time::of(t).median);
    Ok(Measured { init, median: whole.median, min: whole.min, stages, rebuilds, residual })
}
