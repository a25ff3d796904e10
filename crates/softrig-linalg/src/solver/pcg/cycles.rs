//! Multigrid cycles without conjugate gradients: the same true residual, another iteration.

use super::{Asked, Iteration};
use crate::Scalar;
use crate::solver::multigrid::Cycle;
use crate::solver::{SolveError, SolveReport};

/// Cycles to a tolerance give up after so many: at a rate of .98 for each they have gained three digits.
const MOST_CYCLES: usize = 400;
/// A residual that has grown by this is not coming back; the first cycles of a smooth load may raise it 40 times.
const DIVERGED: f64 = 1e6;

impl<R: Scalar> Iteration<R> {
    /// Improves a zero start by `count` cycles, or as many as the tolerance needs; the cycle has been given the system. After
    /// each, the residual is that of the caller's system in f64.
    pub(in crate::solver) fn cycle_with<B: Scalar>(
        &mut self,
        asked: &mut Asked<'_, B>,
        rhs: &[[B; 3]],
        solution: &mut [[B; 3]],
        tolerance: f64,
        cycle: &mut Cycle,
        count: Option<usize>,
    ) -> Result<SolveReport, SolveError> {
        self.check(asked.system, rhs, solution)?;
        self.load(asked.system, false, false)?;
        let report = |iterations, residual| SolveReport {
            solver: "multigrid",
            iterations,
            residual,
            converged: residual <= tolerance,
            rebuilt: false,
            start: 1.0,
        };
        let Some(scale) = self.pattern.scale_of(rhs)? else {
            solution.fill([B::zero(); 3]);
            return Ok(report(0, 0.0));
        };
        let norm = self.begin(rhs, scale).sqrt();
        let (mut residual, mut iterations) = (1.0, 0);
        while count.map_or(residual > tolerance, |n| iterations < n) {
            cycle.apply(self.r.get(), self.x.get_mut());
            residual = self.examine(asked, rhs, scale, 1.0, Some(cycle.finest())).sqrt() / norm;
            iterations += 1;
            let hopeless = residual.is_nan() || residual > DIVERGED;
            if hopeless || (count.is_none() && iterations == MOST_CYCLES && residual > tolerance) {
                return Err(SolveError::NotConverged { solver: "multigrid", residual, iterations, tolerance });
            }
        }
        self.pattern.scatter(self.candidate.get(), solution);
        Ok(report(iterations, residual))
    }
}
