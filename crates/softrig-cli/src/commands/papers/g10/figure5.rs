//! Figure 5: residual over time of multigrid and of conjugate gradients, on the bar.

use super::bodies::{bar, flesh, system};
use super::{Curve, Job, Plot, Results, failed};
use crate::failure::{Failure, Outcome};
use softrig::simulation::interpolations;
use softrig_linalg::solver::{Multigrid, MultigridSettings, Outer, Pcg, Rebuild};
use softrig_linalg::{BlockCsr, LinearSolver, SolveError};
use std::time::Instant;

/// Rounds, the fastest of which counts: what else the machine does only adds.
const ROUNDS: usize = 7;

/// Static and dynamic, as CSV and as plots.
pub fn run(job: &Job, results: &Results) -> Outcome {
    let body = bar(if job.quick { 2 } else { 3 })?;
    let mut rows = Vec::new();
    for (regime, dt) in [("dynamic", Some(1.0 / 30.0)), ("static", None)] {
        let mut flesh = flesh::<f64>(&body, 0.3)?;
        let matrix = system(&mut flesh, dt);
        let load = flesh.weight([0.0, -9.81, 0.0]);
        let paper = MultigridSettings { rebuild: Rebuild::WhenSlower, ..MultigridSettings::paper() };
        let cycles = |count| MultigridSettings { outer: Outer::Cycles { count: Some(count) }, ..paper };
        let mut solvers: Vec<(&str, Vec<(Box<dyn LinearSolver<f64>>, f64)>)> = vec![
            ("multigrid V(2;1)", Vec::new()),
            ("Jacobi conjugate gradients", Vec::new()),
            ("multigrid conjugate gradients (default)", Vec::new()),
        ];
        for step in 1..=12u32 {
            let levels = || interpolations(body.levels.clone());
            let tolerance = 10f64.powf(-0.5 * f64::from(step));
            solvers[0].1.push((Box::new(Multigrid::with_settings(levels(), cycles(step as usize))), tolerance));
            solvers[1].1.push((Box::new(Pcg::new()), tolerance));
            solvers[2].1.push((Box::new(Multigrid::new(levels())), tolerance));
        }
        let mut curves = Vec::new();
        for (name, runs) in solvers {
            let mut points = vec![(0.0, 1.0)];
            for (mut solver, tolerance) in runs {
                solver.prepare(&flesh.pattern, &flesh.constraints).map_err(|e| failed("figure 5", &e))?;
                let (time, residual, iterations) = timed(&mut *solver, &matrix, &load, tolerance)?;
                rows.push(
                    [regime, name]
                        .map(String::from)
                        .into_iter()
                        .chain([iterations.to_string(), format!("{time:.4}"), format!("{residual:.3e}")])
                        .collect(),
                );
                points.push((time, residual));
            }
            curves.push(Curve { name, points });
        }
        let title = format!("{} tetrahedra, {regime}: true residual over time", body.mesh.tets.len());
        let plot = Plot { title: &title, x: "time of the solve [ms]", y: "relative residual [-]", log: true, curves };
        results.plot(&format!("figure5-{regime}"), &plot)?;
    }
    results.table("figure5", &["regime", "solver", "iterations", "time_ms", "residual"], &rows)
}

/// Least time [ms] of some solves with everything prepared, the residual reached, and the iterations.
fn timed(
    solver: &mut dyn LinearSolver<f64>,
    matrix: &BlockCsr<f64>,
    load: &[[f64; 3]],
    tolerance: f64,
) -> Result<(f64, f64, usize), Failure> {
    let mut x = vec![[0.0; 3]; load.len()];
    let mut solve = || match solver.solve(matrix, load, &mut x, tolerance) {
        Ok(report) => Ok((report.residual, report.iterations)),
        Err(SolveError::NotConverged { residual, iterations, .. }) => Ok((residual, iterations)),
        Err(e) => Err(failed("figure 5", &e)),
    };
    solve()?; // makes the coarse operators
    let mut best = f64::INFINITY;
    let mut reached = (0.0, 0);
    for _ in 0..ROUNDS {
        let start = Instant::now();
        reached = solve()?;
        best = best.min(start.elapsed().as_secs_f64() * 1e3);
    }
    Ok((best, reached.0, reached.1))
}
