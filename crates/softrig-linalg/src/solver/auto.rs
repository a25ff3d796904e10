//! The cheaper of two solvers, by counted work.

use super::multigrid::SINGLE;
use super::{
    BELOW_SINGLE, LinearSolver, LinearSystem, Multigrid, Pcg, Preconditioner, SolveError, SolveReport, Traffic,
};
use crate::{BlockCsr, BlockPattern, DofConstraints, Scalar};
use std::sync::Arc;

/// Loading a system and its true residual [products in f64].
const SETUP_WORK: f64 = 2.0;
/// Solves before the other solver is tried again, doubled each time it loses.
const FIRST_TRIAL: u32 = 8;
/// The longest pause between two trials.
const LAST_TRIAL: u32 = 256;
/// The other solver has to be this much cheaper to be taken.
const MARGIN: f64 = 0.9;

/// Multigrid or block-Jacobi conjugate gradients, whichever does less: multigrid wins where a residual takes many iterations
/// (large steps, fine meshes, many digits), and only costs where a few do.
///
/// Work is counted, never timed: products with the matrix of the finest level per iteration, what a cycle adds, and rebuilds. The
/// choice is a function of the systems alone, so that results do not depend on the machine. Systems asked for with different
/// tolerances are judged apart.
#[derive(Debug)]
pub struct Auto<R> {
    multigrid: Multigrid<R>,
    pcg: Pcg<R>,
    limit: usize,
    classes: Vec<Class>,
}

/// What is known of the systems of one tolerance.
#[derive(Clone, Copy, Debug)]
struct Class {
    tolerance: f64,
    plain: bool,
    /// Work of the last solve by the one in use [products].
    work: f64,
    until_trial: u32,
    pause: u32,
}

impl<R: Scalar> Auto<R> {
    /// Chooses between that solver and [`Pcg`].
    #[must_use]
    pub fn new(multigrid: Multigrid<R>) -> Self {
        let pcg = Pcg::<R>::new();
        Self { multigrid, limit: pcg.iteration_limit, pcg, classes: Vec::new() }
    }

    fn class(&mut self, tolerance: f64) -> usize {
        let known = self.classes.iter().position(|c| c.tolerance == tolerance);
        known.unwrap_or_else(|| {
            let class = Class { tolerance, plain: false, work: f64::INFINITY, until_trial: 1, pause: FIRST_TRIAL };
            self.classes.push(class);
            self.classes.len() - 1
        })
    }

    /// By plain conjugate gradients, but no further than `budget` products; `None` when these are not enough.
    fn plain(
        &mut self,
        system: &mut dyn LinearSystem<R>,
        rhs: &[[R; 3]],
        solution: &mut [[R; 3]],
        tolerance: f64,
        budget: f64,
    ) -> Option<Result<SolveReport, SolveError>> {
        let iterations = (budget - SETUP_WORK) / product_work(tolerance);
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped before")]
        let limit = iterations.clamp(1.0, self.limit as f64) as usize;
        self.pcg.iteration_limit = limit;
        match self.pcg.solve_system(system, rhs, solution, tolerance) {
            Err(SolveError::NotConverged { .. }) if limit < self.limit => None,
            result => Some(result),
        }
    }
}

impl<R: Scalar> LinearSolver<R> for Auto<R> {
    fn name(&self) -> &'static str {
        "auto"
    }

    fn prepare(&mut self, pattern: &Arc<BlockPattern>, constraints: &DofConstraints) -> Result<(), SolveError> {
        self.multigrid.prepare(pattern, constraints)?;
        self.pcg.prepare(pattern, constraints)?;
        self.classes.clear();
        Ok(())
    }

    fn traffic(&self) -> Option<Traffic> {
        if self.classes.iter().any(|c| c.plain) { self.pcg.traffic() } else { self.multigrid.traffic() }
    }

    fn forget(&mut self) {
        self.multigrid.forget();
        self.classes.clear();
    }

    fn preconditioner(&mut self) -> Option<&mut dyn Preconditioner<R>> {
        self.multigrid.preconditioner()
    }

    fn solve(
        &mut self,
        matrix: &BlockCsr<R>,
        rhs: &[[R; 3]],
        solution: &mut [[R; 3]],
        tolerance: f64,
    ) -> Result<SolveReport, SolveError> {
        self.solve_system(&mut super::Stored(matrix), rhs, solution, tolerance)
    }

    fn solve_system(
        &mut self,
        system: &mut dyn LinearSystem<R>,
        rhs: &[[R; 3]],
        solution: &mut [[R; 3]],
        tolerance: f64,
    ) -> Result<SolveReport, SolveError> {
        let at = self.class(tolerance);
        let class = self.classes[at];
        let trial = class.until_trial == 0;
        if class.plain != trial {
            // plain iterations: they are in use and may take what they took and half as much again, or they are tried and may
            // take what the cycles took
            let budget = class.work * if trial { MARGIN } else { 1.5 };
            match self.plain(system, rhs, solution, tolerance, budget) {
                Some(Ok(report)) => {
                    self.classes[at] = if trial {
                        Class {
                            plain: true,
                            work: plain_work(&report, tolerance),
                            until_trial: FIRST_TRIAL,
                            pause: FIRST_TRIAL,
                            ..class
                        }
                    } else {
                        Class { work: plain_work(&report, tolerance), until_trial: class.until_trial - 1, ..class }
                    };
                    return Ok(report);
                }
                Some(Err(e)) => return Err(e),
                // not worth it: cycles take over, the next trial comes later
                None => {}
            }
        }
        let report = self.multigrid.solve_system(system, rhs, solution, tolerance)?;
        let work = self.multigrid.work(report.iterations);
        let later = (2 * class.pause).min(LAST_TRIAL);
        self.classes[at] = match (class.plain, trial) {
            // tried the cycles: they have to win clearly
            (true, true) if work < MARGIN * class.work => {
                Class { plain: false, work, until_trial: FIRST_TRIAL, pause: FIRST_TRIAL, ..class }
            }
            (true, true) => Class { until_trial: later, pause: later, ..class },
            (false, true) => Class { work, until_trial: later, pause: later, ..class },
            // plain iterations ran out of what they were given
            (true, false) => Class { plain: false, work, until_trial: later, pause: later, ..class },
            (false, false) => Class { work, until_trial: class.until_trial - 1, ..class },
        };
        Ok(report)
    }
}

/// What a solve by plain conjugate gradients cost [products in f64].
fn plain_work(report: &SolveReport, tolerance: f64) -> f64 {
    SETUP_WORK + product_work(tolerance) * report.iterations as f64
}

/// What an iteration of theirs costs [products in f64].
fn product_work(tolerance: f64) -> f64 {
    if tolerance >= BELOW_SINGLE { SINGLE } else { 1.0 }
}
