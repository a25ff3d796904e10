//! One body, measured: half a second of falling under its own weight.

use super::body::BenchBody;
use super::stages::{Clocks, TimedModel, TimedSolver};
use crate::failure::Failure;
use crate::report::peak_rss_mib;
use serde::Serialize;
use softrig::body::Body;
use softrig::force::ElasticModel;
use softrig::integrate::{Implicit, Integrator, Scheme, State, StepInput, StepOutput, initial_acceleration};
use softrig::material::{Material, MaterialMap};
use softrig::simulation::SolverKind;
use softrig_linalg::{DofConstraints, LinearSolver, Scalar};
use std::hash::Hasher;
use std::sync::Arc;
use std::time::Instant;
use twox_hash::XxHash64;

/// Steps of 1/60 s.
const STEPS: usize = 31;
/// The steps after which the displacement is told: a quarter and half a second.
const LOOKS: [usize; 2] = [15, 30];

/// Median and minimum over the steps after the first [ms].
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Time {
    /// Half of the steps took less.
    pub median: f64,
    /// The fastest step.
    pub min: f64,
}

/// Where a step's time goes [ms].
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Stages {
    /// Rotations and internal forces, before and after the solve.
    pub force_ms: Time,
    /// Assembling the stiffness matrix.
    pub matrix_ms: Time,
    /// The linear solve.
    pub solve_ms: Time,
    /// Everything else of the step.
    pub other_ms: Time,
}

/// What `softrig bench NAME --json` prints.
#[derive(Clone, Debug, Serialize)]
pub struct Measurement {
    /// Name of the body.
    pub name: &'static str,
    /// Number of cells.
    pub cells: usize,
    /// Number of nodes.
    pub nodes: usize,
    /// Threads used.
    pub threads: usize,
    /// Linear solver.
    pub solver: &'static str,
    /// Numbers computed with.
    pub precision: &'static str,
    /// Vector instructions used.
    pub instructions: String,
    /// Steps measured.
    pub steps: usize,
    /// Median time of a step [ms].
    pub step_ms_median: f64,
    /// Fastest step [ms].
    pub step_ms_min: f64,
    /// Median of the linear iterations of a step.
    pub iterations: usize,
    /// Largest true relative residual [-].
    pub residual: f64,
    /// Where the time goes.
    pub stages: Stages,
    /// Largest memory of this process so far [MiB]; absent where the system does not tell.
    pub peak_rss_mib: Option<f64>,
    /// Mean displacement of the free end (bar) or the head (cow) after 0.25 and 0.5 s [m].
    pub tip_displacement_m: [[f64; 3]; 2],
    /// Hash of the bits of all positions at the end.
    pub state_hash: String,
}

/// Runs the body in f64: Newmark with one linearisation, h = 1/60 s, undamped, true residual 1e-3.
///
/// # Errors
/// [`Failure::Simulation`] when a step fails.
pub fn measure(bench: BenchBody, solver: SolverKind, threads: usize) -> Result<Measurement, Failure> {
    run::<f64>(bench, solver, threads)
}

fn run<R: Scalar>(bench: BenchBody, solver: SolverKind, threads: usize) -> Result<Measurement, Failure> {
    let failed = |e: &dyn std::error::Error| Failure::Simulation(format!("bench {}: {e}", bench.name));
    let (name, cells, nodes) = (bench.name, bench.mesh.cell_count(), bench.mesh.node_count());
    let material =
        Material { young_modulus: 1e5, poisson_ratio: 0.4, density: 1000.0, mass_damping: 0.0, stiffness_damping: 0.0 };
    let rest: Vec<[R; 3]> = bench.mesh.nodes.iter().map(|x| x.map(R::from_f64)).collect();
    let constraints = DofConstraints::from_mask(bench.fixed.clone());
    let body = Body::<R>::new(bench.mesh, &MaterialMap::uniform(material), ElasticModel::Corotated, constraints);
    let body = body.map_err(|e| failed(&e))?;
    let clocks = Arc::new(Clocks::default());
    let model = TimedModel { inner: body.model, clocks: clocks.clone() };
    let mut body = Body { model: Box::new(model), ..body };
    let mut solver = TimedSolver { inner: solver.build::<R>(&body.mesh), clocks: clocks.clone() };
    let mut integrator = Implicit::new(Scheme::Newmark { beta: 0.25, gamma: 0.5 }, 1);
    let weight = body.weight([0.0, -9.81, 0.0]);
    let still = vec![[R::zero(); 3]; nodes];
    let mut state = State::at_rest(rest.clone());
    initial_acceleration(&mut body, &weight, &mut state).map_err(|e| failed(&e))?;

    let mut output = StepOutput::default();
    let (mut iterations, mut residual) = (Vec::new(), 0.0_f64);
    let mut times: [Vec<f64>; 5] = Default::default();
    let mut tip_displacement_m = [[0.0; 3]; 2];
    for step in 0..STEPS {
        clocks.take();
        let start = Instant::now();
        let input = StepInput {
            target_position: &rest,
            target_velocity: &still,
            external_force: &weight,
            dt: 1.0 / 60.0,
            tolerance: 1e-3,
        };
        integrator.step(&mut body, &mut solver, &input, &mut state, &mut output).map_err(|e| failed(&e))?;
        let whole = start.elapsed().as_secs_f64() * 1e3;
        let [force, matrix, solve] = clocks.take();
        if step > 0 {
            // the first step also allocates and does the symbolic work
            for (list, t) in times.iter_mut().zip([whole, force, matrix, solve, whole - force - matrix - solve]) {
                list.push(t);
            }
        }
        iterations.push(output.iterations);
        residual = residual.max(output.residual);
        if let Some(look) = LOOKS.iter().position(|s| *s == step + 1) {
            tip_displacement_m[look] = mean_displacement(&bench.tip, &rest, &state.position);
        }
    }
    iterations.sort_unstable();
    let [step, force_ms, matrix_ms, solve_ms, other_ms] = times.map(statistics);
    Ok(Measurement {
        name,
        cells,
        nodes,
        threads,
        solver: LinearSolver::<R>::name(&solver),
        precision: R::NAME,
        instructions: format!("{:?}", softrig_linalg::Instructions::best()).to_lowercase(),
        steps: STEPS,
        step_ms_median: step.median,
        step_ms_min: step.min,
        iterations: iterations[iterations.len() / 2],
        residual,
        stages: Stages { force_ms, matrix_ms, solve_ms, other_ms },
        peak_rss_mib: peak_rss_mib().map(|mib| (10.0 * mib).round() / 10.0),
        tip_displacement_m,
        state_hash: hash(&state.position),
    })
}

fn statistics(mut t: Vec<f64>) -> Time {
    t.sort_by(f64::total_cmp);
    let rounded = |ms: f64| (ms * 1e4).round() / 1e4;
    Time { median: rounded(t[t.len() / 2]), min: rounded(t[0]) }
}

fn mean_displacement<R: Scalar>(tip: &[usize], rest: &[[R; 3]], now: &[[R; 3]]) -> [f64; 3] {
    std::array::from_fn(|c| {
        tip.iter().map(|i| now[*i][c].to_f64() - rest[*i][c].to_f64()).sum::<f64>() / tip.len().max(1) as f64
    })
}

fn hash<R: Scalar>(position: &[[R; 3]]) -> String {
    let mut hasher = XxHash64::with_seed(0);
    for x in position.as_flattened() {
        hasher.write(&x.bits().to_le_bytes());
    }
    format!("{:016x}", hasher.finish())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::commands::bench::body::bar;

    fn on_threads(threads: usize) -> Measurement {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| measure(bar([16, 4, 8]), SolverKind::Multigrid, threads)).unwrap()
    }

    /// What the command promises of its numbers; and the law that threads change no bit.
    #[test]
    fn a_measured_bar_falls_and_hashes_alike_on_any_number_of_threads() {
        let one = on_threads(1);
        assert!(one.tip_displacement_m[0][1] < -0.1 && one.residual <= 1e-3 && one.iterations > 1, "{one:?}");
        assert!(one.step_ms_min > 0.0 && one.step_ms_min <= one.step_ms_median);
        let two = on_threads(2);
        assert_eq!(one.state_hash, two.state_hash);
        let json = serde_json::to_value(&two).unwrap();
        for key in [
            "name",
            "cells",
            "nodes",
            "threads",
            "solver",
            "step_ms_median",
            "iterations",
            "residual",
            "stages",
            "peak_rss_mib",
            "state_hash",
        ] {
            assert!(json.get(key).is_some(), "{key} is missing");
        }
    }
}
