//! Sparse Cholesky factorisation: exact up to rounding, for small bodies, ill-conditioned systems and as a reference.
//!
//! One factorisation a solve, in f64 for either precision of the data, and refinement until the residual is small enough.

use super::factor::Factor;
use super::free::{Blocks, FreePattern};
use super::residual::{Squares, Target};
use super::{LinearSolver, LinearSystem, Preconditioner, SolveError, SolveReport};
use crate::{BlockCsr, BlockPattern, DofConstraints, Scalar};
use std::sync::Arc;

/// Refinement steps before the residual is taken as it is: each gains several digits or none.
const REFINEMENT_LIMIT: usize = 5;

/// Direct solver: sparse Cholesky with iterative refinement until the true residual is at most the tolerance.
#[derive(Default)]
pub struct Direct<R> {
    prepared: Option<Prepared<R>>,
}

/// Everything that depends on the pattern and the constraints only.
struct Prepared<R> {
    whole: Arc<BlockPattern>,
    pattern: FreePattern,
    blocks: Blocks,
    /// Where each of its blocks is in the whole system.
    source: Vec<u32>,
    /// `None` without free nodes.
    factor: Option<Factor>,
    identity: Vec<bool>,
    x: Vec<f64>,
    correction: Vec<f64>,
    candidate: Vec<[R; 3]>,
    true_residual: Vec<[f64; 3]>,
    squares: Squares,
}

impl<R: Scalar> Direct<R> {
    /// A solver to be prepared.
    #[must_use]
    pub fn new() -> Self {
        Self { prepared: None }
    }
}

/// The blocks of a matrix by their place among the free ones.
fn block_of<R: Scalar>(source: &[u32], matrix: &BlockCsr<R>) -> impl Fn(usize) -> [f64; 9] {
    |k| matrix.values[source[k] as usize].map(Scalar::to_f64)
}

impl<R: Scalar> Preconditioner<R> for Direct<R> {
    fn load(&mut self, system: &mut dyn LinearSystem<R>) -> Result<(), SolveError> {
        let Prepared { whole, pattern, blocks, source, factor, identity, .. } =
            self.prepared.as_mut().ok_or(SolveError::NotPrepared)?;
        let matrix = system.assembled();
        if *matrix.pattern != **whole {
            return Err(SolveError::NotPrepared);
        }
        let Some(factor) = factor else { return Ok(()) };
        let block_of = block_of(source, matrix);
        let made = factor.load(blocks, &|_, k| block_of(k), identity).and_then(|()| factor.factorise());
        made.map_err(|fault| pattern.blame(&fault))
    }

    fn free_nodes(&self) -> &[u32] {
        self.prepared.as_ref().map_or(&[], |p| &p.pattern.node)
    }

    fn apply(&mut self, r: &[[f32; 4]], z: &mut [[f32; 4]]) {
        let Some(Prepared { factor: Some(factor), correction, .. }) = &mut self.prepared else { return };
        for (to, r) in correction.as_chunks_mut::<3>().0.iter_mut().zip(r) {
            *to = [r[0], r[1], r[2]].map(f64::from);
        }
        factor.solve_in_place(correction);
        for (z, from) in z.iter_mut().zip(correction.as_chunks::<3>().0) {
            *z = [from[0] as f32, from[1] as f32, from[2] as f32, 0.0];
        }
    }
}

impl<R: Scalar> LinearSolver<R> for Direct<R> {
    fn name(&self) -> &'static str {
        "direct"
    }

    fn preconditioner(&mut self) -> Option<&mut dyn Preconditioner<R>> {
        Some(self)
    }

    fn prepare(&mut self, pattern: &Arc<BlockPattern>, constraints: &DofConstraints) -> Result<(), SolveError> {
        let free = FreePattern::new(pattern, constraints);
        let blocks = free.blocks(pattern);
        let n = free.row_count();
        let factor =
            if n == 0 { None } else { Some(Factor::new(&blocks).ok_or(SolveError::OutOfMemory { unknowns: 3 * n })?) };
        self.prepared = Some(Prepared {
            whole: Arc::clone(pattern),
            source: free.sources(pattern),
            blocks,
            pattern: free,
            factor,
            identity: vec![false; n],
            x: vec![0.0; 3 * n],
            correction: vec![0.0; 3 * n],
            candidate: vec![[R::zero(); 3]; n],
            true_residual: vec![[0.0; 3]; n],
            squares: Squares::default(),
        });
        Ok(())
    }

    fn solve(
        &mut self,
        matrix: &BlockCsr<R>,
        rhs: &[[R; 3]],
        solution: &mut [[R; 3]],
        tolerance: f64,
    ) -> Result<SolveReport, SolveError> {
        let prepared = self.prepared.as_mut().ok_or(SolveError::NotPrepared)?;
        super::check_system(&prepared.whole, matrix, rhs, solution)?;
        prepared.solve(matrix, rhs, solution, tolerance)
    }
}

impl<R: Scalar> Prepared<R> {
    fn solve(
        &mut self,
        matrix: &BlockCsr<R>,
        rhs: &[[R; 3]],
        solution: &mut [[R; 3]],
        tolerance: f64,
    ) -> Result<SolveReport, SolveError> {
        let report = |residual| SolveReport {
            solver: "direct",
            iterations: 0,
            residual,
            converged: true,
            rebuilt: false,
            start: 1.0,
        };
        let scale = self.pattern.scale_of(rhs)?;
        let (Some(factor), Some(scale)) = (&mut self.factor, scale) else {
            solution.fill([R::zero(); 3]);
            return Ok(report(0.0));
        };
        let block_of = block_of(&self.source, matrix);
        let made = factor.load(&self.blocks, &|_, k| block_of(k), &mut self.identity).and_then(|()| factor.factorise());
        made.map_err(|fault| self.pattern.blame(&fault))?;
        let mut square = 0.0;
        for (row, b) in self.true_residual.iter_mut().enumerate() {
            *b = self.pattern.of_row(rhs, row).map(|b| b * scale);
            square += b[0] * b[0] + b[1] * b[1] + b[2] * b[2];
        }
        self.x.fill(0.0);
        let mut before = f64::INFINITY;
        for _ in 0..=REFINEMENT_LIMIT {
            // a correction from the residual, which at first is the right-hand side
            self.correction.copy_from_slice(self.true_residual.as_flattened());
            factor.solve_in_place(&mut self.correction);
            for ((x, d), c) in self.x.iter_mut().zip(&self.correction).zip(self.candidate.as_flattened_mut()) {
                *x += d;
                *c = R::from_f64(*x / scale);
            }
            let (out, squares) = (&mut self.true_residual, &mut self.squares);
            let target = Target { free: &self.pattern, rhs, scale, out, squares };
            let sum = target.of_entries(matrix, &self.identity, &self.candidate);
            let residual = (sum / square).sqrt();
            if residual <= tolerance {
                self.pattern.scatter(&self.candidate, solution);
                return Ok(report(residual));
            }
            if residual.is_nan() || residual >= 0.5 * before {
                before = residual;
                break;
            }
            before = residual;
            // the residual belongs to the rounded solution
            for (x, c) in self.x.iter_mut().zip(self.candidate.as_flattened()) {
                *x = c.to_f64() * scale;
            }
        }
        Err(SolveError::NotConverged { solver: "direct", residual: before, iterations: 0, tolerance })
    }
}
