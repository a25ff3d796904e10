//! Where the time of a step goes: a force model and a solver that pass everything on and look at the clock.

use softrig::force::{Diagonal, ForceModel, Increment};
use softrig_linalg::{
    BlockCsr, BlockPattern, CubeMatrix, CubePattern, DofConstraints, LinearSolver, LinearSystem, Scalar, SolveError,
    SolveReport, Traffic,
};
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Instant;

/// Nanoseconds spent in each stage, and what the solver did, since the last [`Clocks::take`].
#[derive(Debug, Default)]
pub struct Clocks {
    /// Rotations and internal forces, which come from one pass over the cells.
    forces: AtomicU64,
    assembly: AtomicU64,
    solve: AtomicU64,
    rebuilds: AtomicU64,
    solves: Mutex<BTreeMap<&'static str, usize>>,
}

/// What [`Clocks::take`] gives.
#[derive(Clone, Copy, Debug, Default)]
pub struct Taken {
    /// Rotations and forces, assembly, solve [ms].
    pub times: [f64; 3],
    /// Rebuilds of coarse operators.
    pub rebuilds: usize,
}

impl Clocks {
    /// What was counted since the last call, and starts again from zero.
    pub fn take(&self) -> Taken {
        let clocks = [&self.forces, &self.assembly, &self.solve];
        Taken {
            times: clocks.map(|c| c.swap(0, Ordering::Relaxed) as f64 * 1e-6),
            rebuilds: usize::try_from(self.rebuilds.swap(0, Ordering::Relaxed)).unwrap_or(usize::MAX),
        }
    }

    /// Solves by each solver since the beginning.
    pub fn solves(&self) -> BTreeMap<&'static str, usize> {
        self.solves.lock().map(|s| s.clone()).unwrap_or_default()
    }

    fn note(&self, report: &Result<SolveReport, SolveError>) {
        if let Ok(report) = report {
            self.rebuilds.fetch_add(u64::from(report.rebuilt), Ordering::Relaxed);
            if let Ok(mut solves) = self.solves.lock() {
                *solves.entry(report.solver).or_default() += 1;
            }
        }
    }
}

fn timed<T>(clock: &AtomicU64, work: impl FnOnce() -> T) -> T {
    let start = Instant::now();
    let result = work();
    clock.fetch_add(u64::try_from(start.elapsed().as_nanos()).unwrap_or(u64::MAX), Ordering::Relaxed);
    result
}

/// For parts that are made on all threads: each counts for its share of the time that passes.
fn share(clock: &AtomicU64, work: impl FnOnce()) {
    let start = Instant::now();
    work();
    let share = start.elapsed().as_nanos() / rayon::current_num_threads().max(1) as u128;
    clock.fetch_add(u64::try_from(share).unwrap_or(u64::MAX), Ordering::Relaxed);
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
        timed(&self.clocks.forces, || self.inner.linearise(position));
    }

    fn linearise_and_force(&mut self, position: &[[R; 3]], increment: Increment<'_, R>, force: &mut [[R; 3]]) -> f64 {
        timed(&self.clocks.forces, || self.inner.linearise_and_force(position, increment, force))
    }

    fn force(&mut self, position: &[[R; 3]], increment: Increment<'_, R>, force: &mut [[R; 3]]) -> f64 {
        timed(&self.clocks.forces, || self.inner.force(position, increment, force))
    }

    fn is_damped(&self) -> bool {
        self.inner.is_damped()
    }

    fn stiffness(&mut self, rate: R, damping: R, matrix: &mut BlockCsr<R>) {
        timed(&self.clocks.assembly, || self.inner.stiffness(rate, damping, matrix));
    }

    fn product(&mut self, rate: R, damping: R, diagonal: Diagonal<'_, R>, x: &mut [[R; 3]]) -> bool {
        self.inner.product(rate, damping, diagonal, x)
    }

    fn row_parts(&self) -> usize {
        self.inner.row_parts()
    }

    /// What is done with the rows counts too.
    fn stiffness_rows(&self, rate: R, damping: R, part: usize, take: &mut dyn FnMut(usize, &mut [[R; 9]])) {
        share(&self.clocks.assembly, || self.inner.stiffness_rows(rate, damping, part, take));
    }

    fn stiffness_rows_in_single(&self, rate: R, damping: R, part: usize, take: &mut dyn FnMut(usize, &mut [[f32; 9]])) {
        share(&self.clocks.assembly, || self.inner.stiffness_rows_in_single(rate, damping, part, take));
    }

    fn cube_pattern(&self) -> Option<Arc<CubePattern>> {
        self.inner.cube_pattern()
    }

    fn cubes(&self, rate: R, damping: R, matrix: &mut CubeMatrix<R>) {
        timed(&self.clocks.assembly, || self.inner.cubes(rate, damping, matrix));
    }

    fn rotations(&self, node: &[u32], out: &mut [[f32; 4]]) -> bool {
        self.inner.rotations(node, out)
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

    fn write_history(&self, out: &mut Vec<[R; 4]>) {
        self.inner.write_history(out);
    }

    fn restore(&mut self, history: &[[R; 4]]) {
        self.inner.restore(history);
    }
}

/// Stands where a model was while that is being put under the clock.
pub struct Absent;

impl<R: Scalar> ForceModel<R> for Absent {
    fn linearise(&mut self, _: &[[R; 3]]) {}
    fn force(&mut self, _: &[[R; 3]], _: Increment<'_, R>, _: &mut [[R; 3]]) -> f64 {
        0.0
    }
    fn stiffness(&mut self, _: R, _: R, _: &mut BlockCsr<R>) {}
    fn save(&mut self) {}
    fn roll_back(&mut self) {}
    fn history(&self) -> Vec<[R; 4]> {
        Vec::new()
    }
    fn restore(&mut self, _: &[[R; 4]]) {}
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

    fn traffic(&self) -> Option<Traffic> {
        self.inner.traffic()
    }

    fn solve(
        &mut self,
        matrix: &BlockCsr<R>,
        rhs: &[[R; 3]],
        solution: &mut [[R; 3]],
        tolerance: f64,
    ) -> Result<SolveReport, SolveError> {
        let result = timed(&self.clocks.solve, || self.inner.solve(matrix, rhs, solution, tolerance));
        self.clocks.note(&result);
        result
    }

    fn solve_system(
        &mut self,
        system: &mut dyn LinearSystem<R>,
        rhs: &[[R; 3]],
        solution: &mut [[R; 3]],
        tolerance: f64,
    ) -> Result<SolveReport, SolveError> {
        // the solver asks for the matrix while it is under the clock: that time is the matrix's
        let before = self.clocks.assembly.load(Ordering::Relaxed);
        let result = timed(&self.clocks.solve, || self.inner.solve_system(system, rhs, solution, tolerance));
        let matrix = self.clocks.assembly.load(Ordering::Relaxed) - before;
        self.clocks.solve.fetch_sub(matrix, Ordering::Relaxed);
        self.clocks.note(&result);
        result
    }
}
