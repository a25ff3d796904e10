//! Where the time of a step goes: a force model and a solver that pass everything on and look at the clock.

use softrig::force::{ForceModel, Increment};
use softrig_linalg::{
    BlockCsr, BlockPattern, CubeMatrix, CubePattern, DofConstraints, LinearSolver, LinearSystem, Scalar, SolveError,
    SolveReport,
};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

/// Nanoseconds spent in each stage since the last [`Clocks::take`].
#[derive(Debug, Default)]
pub struct Clocks {
    force: AtomicU64,
    matrix: AtomicU64,
    solve: AtomicU64,
}

impl Clocks {
    /// Milliseconds in (rotations and forces, matrix, solve), and starts again from zero.
    pub fn take(&self) -> [f64; 3] {
        [&self.force, &self.matrix, &self.solve].map(|c| c.swap(0, Ordering::Relaxed) as f64 * 1e-6)
    }
}

fn timed<T>(clock: &AtomicU64, work: impl FnOnce() -> T) -> T {
    let start = Instant::now();
    let result = work();
    clock.fetch_add(u64::try_from(start.elapsed().as_nanos()).unwrap_or(u64::MAX), Ordering::Relaxed);
    result
}

/// A force model under the clock.
pub struct TimedModel<R> {
    /// The model that does the work.
    pub inner: Box<dyn ForceModel<R>>,
    /// Where its time is added.
    pub clocks: Arc<Clocks>,
}

impl<R: Scalar> ForceModel<R> for TimedModel<R> {
    fn linearise(&mut self, position: &[[R; 3]]) {
        timed(&self.clocks.force, || self.inner.linearise(position));
    }

    fn force(&mut self, position: &[[R; 3]], increment: Increment<'_, R>, force: &mut [[R; 3]]) -> f64 {
        timed(&self.clocks.force, || self.inner.force(position, increment, force))
    }

    fn stiffness(&mut self, rate: R, damping: R, matrix: &mut BlockCsr<R>) {
        timed(&self.clocks.matrix, || self.inner.stiffness(rate, damping, matrix));
    }

    fn cube_pattern(&self) -> Option<Arc<CubePattern>> {
        self.inner.cube_pattern()
    }

    fn cubes(&self, rate: R, damping: R, matrix: &mut CubeMatrix<R>) {
        timed(&self.clocks.matrix, || self.inner.cubes(rate, damping, matrix));
    }

    fn save(&mut self) {
        self.inner.save();
    }

    fn roll_back(&mut self) {
        self.inner.roll_back();
    }

    fn history(&self) -> Vec<[R; 4]> {
        self.inner.history()
    }

    fn restore(&mut self, history: &[[R; 4]]) {
        self.inner.restore(history);
    }
}

/// A linear solver under the clock.
pub struct TimedSolver<R> {
    /// The solver that does the work.
    pub inner: Box<dyn LinearSolver<R>>,
    /// Where its time is added.
    pub clocks: Arc<Clocks>,
}

impl<R: Scalar> LinearSolver<R> for TimedSolver<R> {
    fn name(&self) -> &'static str {
        self.inner.name()
    }

    fn prepare(&mut self, pattern: &Arc<BlockPattern>, constraints: &DofConstraints) -> Result<(), SolveError> {
        self.inner.prepare(pattern, constraints)
    }

    fn forget(&mut self) {
        self.inner.forget();
    }

    fn solve(
        &mut self,
        matrix: &BlockCsr<R>,
        rhs: &[[R; 3]],
        solution: &mut [[R; 3]],
        tolerance: f64,
    ) -> Result<SolveReport, SolveError> {
        timed(&self.clocks.solve, || self.inner.solve(matrix, rhs, solution, tolerance))
    }

    fn solve_system(
        &mut self,
        system: &mut dyn LinearSystem<R>,
        rhs: &[[R; 3]],
        solution: &mut [[R; 3]],
        tolerance: f64,
    ) -> Result<SolveReport, SolveError> {
        // the solver asks for the matrix while it is under the clock: that time is the matrix's
        let before = self.clocks.matrix.load(Ordering::Relaxed);
        let result = timed(&self.clocks.solve, || self.inner.solve_system(system, rhs, solution, tolerance));
        let matrix = self.clocks.matrix.load(Ordering::Relaxed) - before;
        self.clocks.solve.fetch_sub(matrix, Ordering::Relaxed);
        result
    }
}
