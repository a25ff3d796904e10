//! The balance of a body that is twisted by a right angle and bent by half of one: one linear system without inertia.

use super::body::BenchBody;
use super::measure::{Time, since};
use crate::failure::Failure;
use serde::Serialize;
use softrig::body::Body;
use softrig::force::{ElasticModel, Increment};
use softrig::material::{Material, MaterialMap};
use softrig::simulation::SolverKind;
use softrig_linalg::DofConstraints;
use std::time::Instant;

/// Rounds whose median counts.
const ROUNDS: usize = 7;
/// Residual asked for [-].
const TOLERANCE: f64 = 1e-6;

/// What `softrig bench NAME --static --json` prints.
#[derive(Clone, Debug, Serialize)]
pub struct Static {
    /// Name of the body.
    name: &'static str,
    /// Number of cells.
    cells: usize,
    /// Threads used.
    threads: usize,
    /// The solver that did the work.
    solver: &'static str,
    /// Hierarchy, symbolic work and solve [ms].
    total_ms: Time,
    /// The solve alone, coarse operators included [ms].
    solve_ms: Time,
    /// Iterations.
    iterations: usize,
    /// True relative residual [-].
    residual: f64,
}

/// Solves `K d = f_ext - f_int` at the twisted and bent pose.
///
/// # Errors
/// [`Failure::Simulation`] when the body or the system cannot be computed with.
pub fn measure(bench: BenchBody, kind: SolverKind) -> Result<Static, Failure> {
    let failed = |e: &dyn std::error::Error| Failure::Simulation(format!("bench {}: {e}", bench.name));
    let material =
        Material { young_modulus: 1e5, poisson_ratio: 0.4, density: 1000.0, mass_damping: 0.0, stiffness_damping: 0.0 };
    let pose = twisted_and_bent(&bench.mesh.nodes);
    let constraints = DofConstraints::from_mask(bench.fixed.clone());
    let body = Body::<f64>::new(bench.mesh, &MaterialMap::uniform(material), ElasticModel::Corotated, constraints);
    let mut body = body.map_err(|e| failed(&e))?;
    body.model.linearise(&pose);
    let matrix = body.system_matrix(0.0);
    let mut force = vec![[0.0; 3]; pose.len()];
    body.model.force(&pose, Increment::none(), &mut force);
    let mut rhs = body.weight([0.0, -9.81, 0.0]);
    rhs.iter_mut().flatten().zip(force.as_flattened()).for_each(|(b, f)| *b -= f);

    let mut x = vec![[0.0; 3]; pose.len()];
    let (mut totals, mut solves) = (Vec::new(), Vec::new());
    let mut last = None;
    for _ in 0..ROUNDS {
        let start = Instant::now();
        let mut solver = kind.build::<f64>(&body.mesh);
        solver.prepare(&body.pattern, &body.constraints).map_err(|e| failed(&e))?;
        let prepared = Instant::now();
        last = Some(solver.solve(&matrix, &rhs, &mut x, TOLERANCE).map_err(|e| failed(&e))?);
        solves.push(since(prepared));
        totals.push(since(start));
    }
    let report = last.ok_or_else(|| Failure::Simulation("no round was made".into()))?;
    Ok(Static {
        name: bench.name,
        cells: body.mesh.cell_count(),
        threads: rayon::current_num_threads(),
        solver: report.solver,
        total_ms: Time::of(totals),
        solve_ms: Time::of(solves),
        iterations: report.iterations,
        residual: report.residual,
    })
}

impl Static {
    /// For people.
    pub fn sentence(&self) -> String {
        format!(
            "{}: {} cells, static, {} threads, {}\n  total     {:8.2} ms median, {:8.2} ms minimum\n  solve     {:8.2} ms \
             median, {:8.2} ms minimum\n  iterations {}, residual {:.1e}",
            self.name,
            self.cells,
            self.threads,
            self.solver,
            self.total_ms.median,
            self.total_ms.min,
            self.solve_ms.median,
            self.solve_ms.min,
            self.iterations,
            self.residual
        )
    }
}

/// Twisted by 90 degrees along x, or along y where the body is higher than wide, then bent by 45 with constant curvature.
fn twisted_and_bent(nodes: &[[f64; 3]]) -> Vec<[f64; 3]> {
    let (mut low, mut high) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
    for x in nodes {
        for k in 0..3 {
            (low[k], high[k]) = (low[k].min(x[k]), high[k].max(x[k]));
        }
    }
    let size: [f64; 3] = std::array::from_fn(|k| high[k] - low[k]);
    let along =
        if size[0] > size[1] { (0..3).fold(0, |best, k| if size[k] > size[best] { k } else { best }) } else { 1 };
    let [u, v] = [[1, 2], [0, 2], [0, 1]][along];
    let middle: [f64; 3] = std::array::from_fn(|k| 0.5 * (low[k] + high[k]));
    let bend = std::f64::consts::FRAC_PI_4;
    let radius = size[along] / bend;
    let moved = |x: &[f64; 3]| {
        let s = (x[along] - low[along]) / size[along];
        let (sin, cos) = (std::f64::consts::FRAC_PI_2 * s).sin_cos();
        let (a, b) = (x[u] - middle[u], x[v] - middle[v]);
        let (a, b) = (cos * a - sin * b, sin * a + cos * b);
        let (sin, cos) = (bend * s).sin_cos();
        let mut y = [0.0; 3];
        y[along] = low[along] + (radius + a) * sin;
        y[u] = middle[u] + (radius + a) * cos - radius;
        y[v] = middle[v] + b;
        y
    };
    nodes.iter().map(moved).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::commands::bench::body::bar;

    /// The first cross-section stays where it is, the last one is turned by both angles.
    #[test]
    fn the_pose_is_twisted_and_bent() {
        let y = twisted_and_bent(&[[0.0, 0.0, 0.0], [0.0, 0.2, 0.2], [1.0, 0.1, 0.2], [1.0, 0.1, 0.1]]);
        assert!((0..3).all(|k| y[0][k].abs() < 1e-12 && (y[1][k] - [0.0, 0.2, 0.2][k]).abs() < 1e-12));
        let (end, middle) = (y[2], y[3]);
        // what pointed along z points against y, in the plane of the bend
        let direction: [f64; 3] = std::array::from_fn(|k| (end[k] - middle[k]) / 0.1);
        let half = std::f64::consts::FRAC_1_SQRT_2;
        assert!((direction[0] + half).abs() < 1e-9 && (direction[1] + half).abs() < 1e-9, "{direction:?}");
    }

    #[test]
    fn a_static_bar_is_solved_to_six_digits() {
        let measured = measure(bar("bar_s", [16, 4, 8]), SolverKind::Multigrid).unwrap();
        assert!(measured.residual <= 1e-6 && measured.iterations > 2 && measured.iterations < 60, "{measured:?}");
        assert!(measured.total_ms.median >= measured.solve_ms.min && measured.sentence().contains("static"));
    }
}
