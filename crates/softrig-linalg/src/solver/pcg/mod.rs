//! Conjugate gradients preconditioned by the inverted diagonal blocks.

mod cycles;
mod iteration;
pub(super) mod kernel;
mod load;

pub(super) use iteration::Iteration;
pub(super) use load::Asked;

use super::free::FreePattern;
use super::{BELOW_SINGLE, LinearSolver, LinearSystem, SolveError, SolveReport, Stored, Traffic};
use crate::{BlockCsr, BlockPattern, DofConstraints, Scalar};
use std::sync::Arc;

/// Iterations after which a solver gives up: a time step of the bench bodies needs about a hundred, a static system with stiffness
/// contrasts of 1000 a few thousand.
pub(super) const ITERATION_LIMIT: usize = 10_000;

/// Block-Jacobi preconditioned conjugate gradients: in f32 on what is left to solve for, in the caller's numbers where many
/// digits are asked for or f32 fails. Bitwise equal results for any thread count and machine.
#[derive(Debug)]
pub struct Pcg<R> {
    /// Gives up with [`SolveError::NotConverged`] after so many iterations. Default 10 000.
    pub iteration_limit: usize,
    single: Iteration<f32>,
    /// Made when a system comes that f32 is not enough for.
    exact: Option<Iteration<R>>,
    memory: Vec<[R; 3]>,
}

impl<R: Scalar> Default for Pcg<R> {
    fn default() -> Self {
        Self::new()
    }
}

impl<R: Scalar> Pcg<R> {
    /// With the default iteration limit.
    #[must_use]
    pub fn new() -> Self {
        let single = Iteration::new(ITERATION_LIMIT);
        Self { iteration_limit: ITERATION_LIMIT, single, exact: None, memory: Vec::new() }
    }
}

impl<R: Scalar> LinearSolver<R> for Pcg<R> {
    fn name(&self) -> &'static str {
        "pcg"
    }

    fn traffic(&self) -> Option<Traffic> {
        Some(self.exact.as_ref().map_or_else(|| self.single.traffic(), Iteration::traffic))
    }

    fn prepare(&mut self, pattern: &Arc<BlockPattern>, constraints: &DofConstraints) -> Result<(), SolveError> {
        self.single.prepare(pattern, Arc::new(FreePattern::new(pattern, constraints)));
        self.exact = None;
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
        let asked = &mut Asked { system, memory: &mut self.memory };
        if tolerance >= BELOW_SINGLE {
            self.single.iteration_limit = self.iteration_limit;
            match self.single.solve_with(asked, rhs, solution, tolerance, None, true) {
                Err(SolveError::NotConverged { iterations, .. }) if iterations < self.iteration_limit => {}
                Err(SolveError::NotFinite { .. } | SolveError::NotPositiveDefinite { .. }) => {}
                other => return other,
            }
        }
        let exact = self.single.beside(&mut self.exact)?;
        exact.iteration_limit = self.iteration_limit;
        exact.solve_with(asked, rhs, solution, tolerance, None, true)
    }
}
