//! Geometric multigrid on eliminated systems, as a preconditioner of conjugate gradients [Georgii2010 §3.2].
//!
//! One symmetric V-cycle per iteration: Chebyshev smoothing, Galerkin coarse operators, dense Cholesky on the coarsest level.
//! Constrained nodes take no part: their rows of the interpolation are left out, and coarse nodes that only they interpolate
//! from are dropped (mode "empty columns"). The cycle runs in f32; residuals and the iteration are those of the caller's
//! precision, and what is reported is the true residual.
//!
//! Coarse operators are rebuilt when the iteration count has grown by half since the last rebuild; nothing depends on a clock.

mod cycle;
mod galerkin;
mod interpolation;
mod level;

pub use interpolation::Interpolation;

pub(super) use cycle::Cycle;

use super::pcg::Pcg;
use super::{LinearSolver, SolveError, SolveReport};
use crate::{BlockCsr, BlockPattern, DofConstraints, Scalar};
use std::sync::Arc;

/// Conjugate gradients preconditioned by one multigrid V-cycle.
#[derive(Debug)]
pub struct Multigrid<R> {
    /// Interpolations from level to level of the unconstrained body, finest first.
    hierarchy: Arc<[Interpolation]>,
    pcg: Pcg<R>,
    cycle: Option<Cycle>,
    /// Iterations of the first solve after the last rebuild of the coarse operators, and of the last solve.
    fresh: Option<usize>,
}

impl<R: Scalar> Multigrid<R> {
    /// `hierarchy[0].start` has one row per node of the systems to come. An empty hierarchy makes this plain [`Pcg`].
    #[must_use]
    pub fn new(hierarchy: Vec<Interpolation>) -> Self {
        Self { hierarchy: hierarchy.into(), pcg: Pcg::new(), cycle: None, fresh: None }
    }
}

impl<R: Scalar> LinearSolver<R> for Multigrid<R> {
    fn name(&self) -> &'static str {
        "mgpcg"
    }

    fn prepare(&mut self, pattern: &Arc<BlockPattern>, constraints: &DofConstraints) -> Result<(), SolveError> {
        self.pcg.prepare(pattern, constraints)?;
        self.cycle = Cycle::new(&self.hierarchy, self.pcg.free());
        self.fresh = None;
        Ok(())
    }

    fn solve(
        &mut self,
        matrix: &BlockCsr<R>,
        rhs: &[[R; 3]],
        solution: &mut [[R; 3]],
        tolerance: f64,
    ) -> Result<SolveReport, SolveError> {
        let Some(cycle) = &mut self.cycle else { return self.pcg.solve(matrix, rhs, solution, tolerance) };
        let rebuild = self.fresh.is_none();
        cycle.load(matrix, self.pcg.free(), rebuild);
        let report = self.pcg.solve_with(matrix, rhs, solution, tolerance, Some(cycle));
        match &report {
            Ok(r) => {
                let fresh = *self.fresh.get_or_insert(r.iterations.max(1));
                // half as many again, and two: small counts jitter
                if r.iterations > fresh + fresh / 2 + 2 {
                    self.fresh = None;
                }
                Ok(SolveReport { solver: "mgpcg", ..r.clone() })
            }
            Err(_) => {
                self.fresh = None;
                if rebuild {
                    report
                } else {
                    // stale coarse operators must not fail a solve
                    self.solve(matrix, rhs, solution, tolerance)
                }
            }
        }
    }

    fn forget(&mut self) {
        self.fresh = None;
    }
}
