//! Geometric multigrid on eliminated systems, as a preconditioner of conjugate gradients [Georgii2010 §3.2].
//!
//! One symmetric V-cycle per iteration: Chebyshev smoothing, Galerkin coarse operators, dense Cholesky on the coarsest level.
//! Constrained nodes take no part: their rows of the interpolation are left out, and coarse nodes that only they interpolate
//! from are dropped (mode "empty columns"). Cycle and iteration run in f32 on what is left to solve for (the iteration in
//! the caller's numbers where many digits are asked for); residuals are those of the caller's system in f64, and what is
//! reported is the true residual.
//!
//! Coarse operators are rebuilt when the iteration count has grown by half since the last rebuild; nothing depends on a clock.

mod cycle;
mod galerkin;
mod interpolation;
mod level;

pub use interpolation::Interpolation;

pub(super) use cycle::Cycle;

use super::pcg::{Pcg, Source};
use super::{LinearSolver, LinearSystem, SolveError, SolveReport};
use crate::{BlockCsr, BlockPattern, DofConstraints, Scalar};
use std::sync::Arc;

/// Below this tolerance the iteration runs in the caller's numbers: f32 would have to start again too often.
const BELOW_SINGLE: f64 = 1e-5;

/// Conjugate gradients preconditioned by one multigrid V-cycle.
#[derive(Debug)]
pub struct Multigrid<R> {
    /// Interpolations from level to level of the unconstrained body, finest first.
    hierarchy: Arc<[Interpolation]>,
    pcg: Pcg<f32>,
    /// For systems f32 cannot hold; made when one comes.
    exact: Option<Pcg<R>>,
    prepared: Option<Prepared>,
    cycle: Option<Cycle>,
    /// Iterations of the first solve after the last rebuild of the coarse operators, and of the last solve.
    fresh: Option<usize>,
}

impl<R: Scalar> Multigrid<R> {
    /// `hierarchy[0].start` has one row per node of the systems to come. An empty hierarchy makes this plain [`Pcg`].
    #[must_use]
    pub fn new(hierarchy: Vec<Interpolation>) -> Self {
        Self { hierarchy: hierarchy.into(), pcg: Pcg::new(), exact: None, prepared: None, cycle: None, fresh: None }
    }
}

impl<R: Scalar> Multigrid<R> {
    /// In the caller's numbers: where there is nothing to coarsen, and where f32 has failed.
    fn solve_exactly(
        &mut self,
        system: &mut dyn LinearSystem<R>,
        rhs: &[[R; 3]],
        solution: &mut [[R; 3]],
        tolerance: f64,
    ) -> Result<SolveReport, SolveError> {
        let exact = exact_solver(&mut self.exact, self.prepared.as_ref())?;
        exact.solve_with(Source::of(system), rhs, solution, tolerance, self.cycle.as_mut(), true)
    }
}

impl<R: Scalar> LinearSolver<R> for Multigrid<R> {
    fn name(&self) -> &'static str {
        "mgpcg"
    }

    fn prepare(&mut self, pattern: &Arc<BlockPattern>, constraints: &DofConstraints) -> Result<(), SolveError> {
        self.pcg.prepare(pattern, constraints)?;
        self.exact = None;
        self.prepared = Some((pattern.clone(), constraints.clone()));
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
        self.solve_system(&mut Stored(matrix), rhs, solution, tolerance)
    }

    fn solve_system(
        &mut self,
        system: &mut dyn LinearSystem<R>,
        rhs: &[[R; 3]],
        solution: &mut [[R; 3]],
        tolerance: f64,
    ) -> Result<SolveReport, SolveError> {
        let Some(cycle) = &mut self.cycle else {
            return self.solve_exactly(system, rhs, solution, tolerance);
        };
        let rebuild = self.fresh.is_none();
        let cubes = system.cubes().is_some();
        if rebuild || !cubes {
            let matrix = system.assembled();
            self.pcg.check(matrix, rhs, solution)?;
            cycle.forget_cubes();
            self.pcg.load_cycle(matrix, cycle)?;
        }
        let source = Source::of(system);
        if let Source::Cubes(matrix) = source {
            cycle.load_cubes(matrix);
        }
        if rebuild {
            cycle.rebuild();
        }
        let report = if tolerance < BELOW_SINGLE {
            let exact = exact_solver(&mut self.exact, self.prepared.as_ref())?;
            exact.solve_with(source, rhs, solution, tolerance, Some(cycle), true)
        } else {
            self.pcg.solve_with(source, rhs, solution, tolerance, Some(cycle), false)
        };
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
                    self.solve_exactly(system, rhs, solution, tolerance)
                } else {
                    // stale coarse operators must not fail a solve
                    self.solve_system(system, rhs, solution, tolerance)
                }
            }
        }
    }

    fn forget(&mut self) {
        self.fresh = None;
    }
}

/// What the system was prepared for.
type Prepared = (Arc<BlockPattern>, DofConstraints);

/// The iteration in the caller's numbers, made on first use.
fn exact_solver<'a, R: Scalar>(
    exact: &'a mut Option<Pcg<R>>,
    prepared: Option<&Prepared>,
) -> Result<&'a mut Pcg<R>, SolveError> {
    let (pattern, constraints) = prepared.ok_or(SolveError::NotPrepared)?;
    if exact.is_none() {
        let mut made = Pcg::new();
        made.prepare(pattern, constraints)?;
        *exact = Some(made);
    }
    exact.as_mut().ok_or(SolveError::NotPrepared)
}

/// A matrix that is there already.
struct Stored<'a, R>(&'a BlockCsr<R>);

impl<R> LinearSystem<R> for Stored<'_, R> {
    fn assembled(&mut self) -> &BlockCsr<R> {
        self.0
    }
}
