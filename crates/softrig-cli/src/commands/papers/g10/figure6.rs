//! Figure 6: residual over cycles with eliminated and with adapted equations, on the bar with a skeleton.

use super::bodies::{bar, flesh, system};
use super::{Curve, Job, Plot, Results, failed};
use crate::failure::Outcome;
use softrig::simulation::interpolations;
use softrig_linalg::LinearSolver;
use softrig_linalg::solver::{Adapted, Marking, Multigrid, MultigridSettings, Outer, Rebuild, Smoother};

/// Diagonals of the constrained rows in units of the mean diagonal: what the difference depends on.
const ALPHAS: [f64; 3] = [1.0, 100.0, 1e4];
/// V(1,1) cycles.
const CYCLES: usize = 20;

/// Static and dynamic, as CSV and as plots.
pub fn run(job: &Job, results: &Results) -> Outcome {
    let body = bar(if job.quick { 2 } else { 3 })?;
    let mut rows = Vec::new();
    for (regime, dt) in [("dynamic", Some(1.0 / 30.0)), ("static", None)] {
        let mut flesh = flesh::<f64>(&body, 0.3)?;
        let matrix = system(&mut flesh, dt);
        let load = flesh.weight([0.0, -9.81, 0.0]);
        let multigrid = |count, marking| {
            let smoother = Smoother::GaussSeidel { before: 1, after: 1 };
            let outer = Outer::Cycles { count: Some(count) };
            let settings = MultigridSettings { outer, smoother, marking, rebuild: Rebuild::EverySolve };
            Multigrid::with_settings(interpolations(body.levels.clone()), settings)
        };
        let names = ["eliminated".to_owned()].into_iter().chain(ALPHAS.map(|a| format!("adapted; alpha {a:e}")));
        let names: Vec<String> = names.collect();
        let mut curves = Vec::new();
        for (k, name) in names.iter().enumerate() {
            let mut points = vec![(0.0, 1.0)];
            for count in 1..=CYCLES {
                let mut solver: Box<dyn LinearSolver<f64>> = match k.checked_sub(1) {
                    None => Box::new(multigrid(count, Marking::Greedy)),
                    Some(a) => Box::new(Adapted::new(ALPHAS[a], multigrid(count, Marking::EmptyColumns))),
                };
                let mut x = vec![[0.0; 3]; load.len()];
                solver.prepare(&flesh.pattern, &flesh.constraints).map_err(|e| failed("figure 6", &e))?;
                let report = solver.solve(&matrix, &load, &mut x, 1e-12).map_err(|e| failed("figure 6", &e))?;
                rows.push(vec![regime.into(), name.clone(), count.to_string(), format!("{:.4e}", report.residual)]);
                points.push((count as f64, report.residual));
            }
            // the mean over the second half, where the slowest error is left
            let (half, last) = (points[CYCLES / 2].1, points[CYCLES].1);
            let rate = (last / half).powf(1.0 / (CYCLES - CYCLES / 2) as f64);
            rows.push(vec![regime.into(), name.clone(), "rate".into(), format!("{rate:.4}")]);
            curves.push(Curve { name, points });
        }
        let title = format!("{} tetrahedra, {regime}: residual over V(1,1) cycles", body.mesh.tets.len());
        let plot = Plot { title: &title, x: "cycles", y: "relative residual [-]", log: true, curves };
        results.plot(&format!("figure6-{regime}"), &plot)?;
    }
    results.table("figure6", &["regime", "boundary_conditions", "cycles", "residual"], &rows)
}
