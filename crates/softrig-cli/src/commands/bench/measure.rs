//! One body, measured: half a second of falling under its own weight.

use super::body::BenchBody;
use super::machine::bandwidth;
use super::stages::{Clocks, Taken, TimedModel, TimedSolver};
use crate::failure::Failure;
use crate::report::peak_rss_mib;
use serde::Serialize;
use softrig::body::Body;
use softrig::force::ElasticModel;
use softrig::integrate::{Scheme, State, StepInput, StepOutput, implicit, initial_acceleration};
use softrig::material::{Material, MaterialMap};
use softrig::simulation::SolverKind;
use softrig_linalg::{DofConstraints, LinearSolver, Scalar, Traffic};
use std::collections::BTreeMap;
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
    /// Rotations of the cells, and the internal forces that come from the same pass.
    pub rotations_and_forces_ms: Time,
    /// Assembling the stiffness matrix, or what stands for it.
    pub assembly_ms: Time,
    /// The linear solves, rebuilds of coarse operators included.
    pub solve_ms: Time,
    /// Carrying the skin; zero for bodies without one.
    pub embedding_ms: Time,
    /// Everything else of the step.
    pub other_ms: Time,
}

/// Memory traffic of the solves.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct TrafficReport {
    /// What the iterations of a step read and write, by count [MB].
    pub megabytes_a_step: f64,
    /// The same over the fastest solve [GB/s].
    pub gigabytes_a_second: f64,
    /// What of that is different memory [MB].
    pub held_megabytes: f64,
    /// What all threads read of a buffer of that size, measured [GB/s].
    pub machine_gigabytes_a_second: f64,
}

/// What `softrig bench NAME --json` prints.
#[derive(Clone, Debug, Serialize)]
pub struct Measurement {
    /// Name of the body.
    pub name: String,
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
    /// Solves by each solver.
    pub solves_by: BTreeMap<&'static str, usize>,
    /// Where the time goes.
    pub stages: Stages,
    /// Steps in which the coarse operators were rebuilt.
    pub rebuilds: usize,
    /// Time of one rebuild [ms]; absent for solvers without.
    pub galerkin_ms: Option<f64>,
    /// Time to exchange the bound nodes of a body that is being simulated [ms]; absent for characters.
    pub constraints_ms: Option<f64>,
    /// Memory traffic of the solves; absent for solvers that do not count it.
    pub traffic: Option<TrafficReport>,
    /// Largest memory of this process so far [MiB]; absent where the system does not tell.
    pub peak_rss_mib: Option<f64>,
    /// Mean displacement of the free end (bar) or the top (cow, dragon) after 0.25 and 0.5 s [m]; zero for characters.
    pub tip_displacement_m: [[f64; 3]; 2],
    /// Hash of the bits of all positions at the end.
    pub state_hash: String,
}

/// Collects the steps of a run.
#[derive(Default)]
pub struct Record {
    /// Whole step, rotations and forces, assembly, solve, embedding, other [ms].
    times: [Vec<f64>; 6],
    iterations: Vec<usize>,
    residual: f64,
    rebuilds: usize,
}

impl Record {
    /// Adds a step; `whole` and `embedding` in ms.
    pub fn add(&mut self, whole: f64, embedding: f64, taken: Taken, iterations: usize, residual: f64) {
        let [forces, assembly, solve] = taken.times;
        let other = whole - forces - assembly - solve - embedding;
        for (list, t) in self.times.iter_mut().zip([whole, forces, assembly, solve, embedding, other]) {
            list.push(t);
        }
        self.iterations.push(iterations);
        self.residual = self.residual.max(residual);
        self.rebuilds += usize::from(taken.rebuilds > 0);
    }

    /// What is printed.
    pub fn measurement(
        mut self,
        name: &str,
        size: [usize; 2],
        solver: &'static str,
        clocks: &Clocks,
        traffic: Option<Traffic>,
    ) -> Measurement {
        self.iterations.sort_unstable();
        let iterations = self.iterations[self.iterations.len() / 2];
        let [step, rotations_and_forces_ms, assembly_ms, solve_ms, embedding_ms, other_ms] = self.times.map(Time::of);
        let traffic = traffic.filter(|_| iterations > 0).map(|t| {
            let total = (t.moved * iterations) as f64;
            TrafficReport {
                megabytes_a_step: tenths(total * 1e-6),
                gigabytes_a_second: tenths(total / solve_ms.min * 1e-6),
                held_megabytes: tenths(t.held as f64 * 1e-6),
                machine_gigabytes_a_second: tenths(bandwidth(t.held)),
            }
        });
        Measurement {
            name: name.into(),
            cells: size[0],
            nodes: size[1],
            threads: rayon::current_num_threads(),
            solver,
            precision: f64::NAME,
            instructions: super::instructions_name(softrig_linalg::Instructions::best()),
            steps: self.iterations.len(),
            step_ms_median: step.median,
            step_ms_min: step.min,
            iterations,
            residual: self.residual,
            solves_by: clocks.solves(),
            stages: Stages { rotations_and_forces_ms, assembly_ms, solve_ms, embedding_ms, other_ms },
            rebuilds: self.rebuilds,
            galerkin_ms: None,
            constraints_ms: None,
            traffic,
            peak_rss_mib: peak_rss_mib().map(tenths),
            tip_displacement_m: [[0.0; 3]; 2],
            state_hash: String::new(),
        }
    }
}

fn tenths(v: f64) -> f64 {
    (10.0 * v).round() / 10.0
}

/// Milliseconds since then.
pub fn since(start: Instant) -> f64 {
    start.elapsed().as_secs_f64() * 1e3
}

/// Runs the body in f64: Newmark with one linearisation, h = 1/60 s, undamped, true residual 1e-3.
///
/// # Errors
/// [`Failure::Simulation`] when a step fails.
pub fn measure(bench: BenchBody, kind: SolverKind) -> Result<Measurement, Failure> {
    let failed = |e: &dyn std::error::Error| Failure::Simulation(format!("bench {}: {e}", bench.name));
    let size = [bench.mesh.cell_count(), bench.mesh.node_count()];
    let material =
        Material { young_modulus: 1e5, poisson_ratio: 0.4, density: 1000.0, mass_damping: 0.0, stiffness_damping: 0.0 };
    let rest = bench.mesh.nodes.clone();
    let constraints = DofConstraints::from_mask(bench.fixed.clone());
    let body = Body::<f64>::new(bench.mesh, &MaterialMap::uniform(material), ElasticModel::Corotated, constraints);
    let body = body.map_err(|e| failed(&e))?;
    let clocks = Arc::new(Clocks::default());
    let model = TimedModel { inner: body.model, clocks: clocks.clone() };
    let mut body = Body { model: Box::new(model), ..body };
    let mut solver = TimedSolver { inner: kind.build::<f64>(&body.mesh), clocks: clocks.clone() };
    let mut integrator = implicit(Scheme::Newmark { beta: 0.25, gamma: 0.5 }, 1);
    let weight = body.weight([0.0, -9.81, 0.0]);
    let still = vec![[0.0; 3]; rest.len()];
    let mut state = State::at_rest(rest.clone());
    initial_acceleration(&mut body, &weight, &mut state).map_err(|e| failed(&e))?;

    let mut output = StepOutput::default();
    let mut record = Record::default();
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
            reactions: false,
        };
        integrator.step(&mut body, &mut solver, &input, &mut state, &mut output).map_err(|e| failed(&e))?;
        let (whole, taken) = (since(start), clocks.take());
        if step > 0 {
            // the first step also allocates and does the symbolic work
            record.add(whole, 0.0, taken, output.iterations, output.residual);
        }
        if let Some(look) = LOOKS.iter().position(|s| *s == step + 1) {
            tip_displacement_m[look] = mean_displacement(&bench.tip, &rest, &state.position);
        }
    }
    let traffic = LinearSolver::<f64>::traffic(&solver);
    let name = LinearSolver::<f64>::name(&solver);
    let mut m = record.measurement(bench.name, size, name, &clocks, traffic);
    (m.galerkin_ms, m.constraints_ms) = extras(&mut body, &mut *solver.inner, &weight).map_err(|e| failed(&e))?;
    Ok(Measurement { tip_displacement_m, state_hash: hash(&state.position), ..m })
}

/// Rounds whose median counts.
const ROUNDS: usize = 5;

/// Time of a rebuild of the coarse operators, where there are any, and of exchanging the bound nodes [ms].
fn extras(
    body: &mut Body<f64>,
    solver: &mut dyn LinearSolver<f64>,
    load: &[[f64; 3]],
) -> Result<(Option<f64>, Option<f64>), softrig_linalg::SolveError> {
    let matrix = body.system_matrix(14_400.0);
    let mut x = vec![[0.0; 3]; load.len()];
    let mut times: [Vec<f64>; 3] = Default::default();
    let mut rebuilt = false;
    for _ in 0..ROUNDS {
        solver.forget();
        for (k, times) in times[..2].iter_mut().enumerate() {
            let start = Instant::now();
            let report = solver.solve(&matrix, load, &mut x, 1e-3)?;
            times.push(since(start));
            rebuilt |= k == 0 && report.rebuilt;
        }
    }
    // every other bound node is let go, and bound again: the first time a node is free its rows are made, later they are there
    let every_other = body.constraints.mask().iter().enumerate().map(|(n, held)| *held && n % 2 == 0).collect();
    let fewer = DofConstraints::from_mask(every_other);
    for round in 0..=ROUNDS {
        let start = Instant::now();
        solver.prepare(&body.pattern, &fewer)?;
        solver.prepare(&body.pattern, &body.constraints)?;
        if round > 0 {
            times[2].push(0.5 * since(start));
        }
    }
    let [first, second, change] = times.map(|t| Time::of(t).median);
    Ok((rebuilt.then_some((first - second).max(0.0)), Some(change)))
}

impl Time {
    /// Of so many measurements [ms]; at least one.
    pub fn of(mut t: Vec<f64>) -> Self {
        t.sort_by(f64::total_cmp);
        let rounded = |ms: f64| (ms * 1e4).round() / 1e4;
        Self { median: rounded(t[t.len() / 2]), min: rounded(t[0]) }
    }
}

fn mean_displacement(tip: &[usize], rest: &[[f64; 3]], now: &[[f64; 3]]) -> [f64; 3] {
    std::array::from_fn(|c| tip.iter().map(|i| now[*i][c] - rest[*i][c]).sum::<f64>() / tip.len().max(1) as f64)
}

/// Hash of the bits of all positions.
pub fn hash(position: &[[f64; 3]]) -> String {
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
        pool.install(|| measure(bar("bar_s", [16, 4, 8]), SolverKind::Multigrid)).unwrap()
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
            "solves_by",
            "galerkin_ms",
            "constraints_ms",
            "traffic",
        ] {
            assert!(json.get(key).is_some(), "{key} is missing");
        }
    }
}
