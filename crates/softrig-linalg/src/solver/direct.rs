//! Sparse Cholesky factorisation: exact up to rounding, for small bodies, ill-conditioned systems and as a reference.
//!
//! The nodes are ordered once by approximate minimum degree on the graph of nodes; faer factorises `P A Pᵀ = L Lᵀ` in f64 for
//! either precision of the data. Runs on one thread, so results do not depend on how many there are; they may differ in the
//! last bits between machines, because faer fuses multiplications and additions where the machine can.

use super::free::FreePattern;
use super::{LinearSolver, SolveError, SolveReport, residual};
use crate::{BlockCsr, BlockPattern, DofConstraints, Scalar};
use faer::dyn_stack::{MemBuffer, MemStack, StackReq};
use faer::linalg::cholesky::llt::factor::LltError;
use faer::perm::PermRef;
use faer::sparse::linalg::cholesky::{
    CholeskySymbolicParams, LltRef, SymbolicCholesky, SymmetricOrdering, factorize_symbolic_cholesky,
};
use faer::sparse::{SparseColMatRef, SymbolicSparseColMatRef};
use faer::{Conj, MatMut, Par, Side};
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
    /// `None` without free nodes.
    factor: Option<Factor>,
    identity: Vec<bool>,
    x: Vec<f64>,
    correction: Vec<f64>,
    candidate: Vec<[R; 3]>,
    true_residual: Vec<[f64; 3]>,
}

/// The upper triangle of the free unknowns, column by column, and its factor.
struct Factor {
    column_start: Vec<usize>,
    row: Vec<usize>,
    upper: Vec<f64>,
    symbolic: SymbolicCholesky<usize>,
    lower: Vec<f64>,
    scratch: MemBuffer,
}

impl<R: Scalar> Direct<R> {
    /// A solver to be prepared.
    #[must_use]
    pub fn new() -> Self {
        Self { prepared: None }
    }
}

impl Factor {
    fn new(pattern: &FreePattern) -> Result<Self, SolveError> {
        let unknowns = 3 * pattern.row_count();
        let out_of_memory = SolveError::OutOfMemory { unknowns };
        let node_order = order_of_nodes(pattern).ok_or_else(|| out_of_memory.clone())?;
        let forward: Vec<usize> = node_order.iter().flat_map(|n| [3 * n, 3 * n + 1, 3 * n + 2]).collect();
        let mut backward = vec![0; unknowns];
        for (new, old) in forward.iter().enumerate() {
            backward[*old] = new;
        }
        let mut column_start = Vec::with_capacity(unknowns + 1);
        let mut row = Vec::new();
        column_start.push(0);
        for i in 0..pattern.row_count() {
            for c in 0..3 {
                for k in pattern.row(i) {
                    let j = pattern.column[k] as usize;
                    if j <= i {
                        let last = if j == i { c + 1 } else { 3 };
                        row.extend((0..last).map(|d| 3 * j + d));
                    }
                }
                column_start.push(row.len());
            }
        }
        let shape = SymbolicSparseColMatRef::new_checked(unknowns, unknowns, &column_start, None, &row);
        let order = SymmetricOrdering::Custom(PermRef::new_checked(&forward, &backward, unknowns));
        let symbolic = factorize_symbolic_cholesky(shape, Side::Upper, order, CholeskySymbolicParams::default())
            .map_err(|_| out_of_memory.clone())?;
        let mut lower = Vec::new();
        lower.try_reserve_exact(symbolic.len_val()).map_err(|_| out_of_memory.clone())?;
        lower.resize(symbolic.len_val(), 0.0);
        let need = StackReq::any_of(&[
            symbolic.factorize_numeric_llt_scratch::<f64>(Par::Seq, Default::default()),
            symbolic.solve_in_place_scratch::<f64>(1, Par::Seq),
        ]);
        let scratch = MemBuffer::try_new(need).map_err(|_| out_of_memory)?;
        let upper = vec![0.0; row.len()];
        Ok(Self { column_start, row, upper, symbolic, lower, scratch })
    }

    /// Reads the matrix; rows without a single entry become rows of the identity.
    fn load<R: Scalar>(
        &mut self,
        pattern: &FreePattern,
        matrix: &BlockCsr<R>,
        identity: &mut [bool],
    ) -> Result<(), SolveError> {
        let mut at = 0;
        for i in 0..pattern.row_count() {
            let block = pattern.block_of::<R, f64>(matrix);
            let values = || pattern.row(i).flat_map(&block);
            if values().any(|v| !v.is_finite()) {
                return Err(SolveError::NotFinite { node: pattern.node[i] as usize });
            }
            identity[i] = values().all(|v| v == 0.0);
            for c in 0..3 {
                for k in pattern.row(i) {
                    let j = pattern.column[k] as usize;
                    if j <= i {
                        // the entries (3 i + c, 3 j + d) of the lower triangle are column 3 i + c of the upper one
                        let last = if j == i { c + 1 } else { 3 };
                        for d in 0..last {
                            let one = identity[i] && j == i && d == c;
                            self.upper[at] = if one { 1.0 } else { block(k)[3 * c + d] };
                            at += 1;
                        }
                    }
                }
            }
        }
        Ok(())
    }

    /// `A = L Lᵀ`.
    fn factorise(&mut self, pattern: &FreePattern) -> Result<(), SolveError> {
        let n = self.column_start.len() - 1;
        let shape = SymbolicSparseColMatRef::new_checked(n, n, &self.column_start, None, &self.row);
        self.symbolic
            .factorize_numeric_llt(
                &mut self.lower,
                SparseColMatRef::new(shape, &self.upper),
                Side::Upper,
                Default::default(),
                Par::Seq,
                MemStack::new(&mut self.scratch),
                Default::default(),
            )
            .map(|_| ())
            .map_err(|LltError::NonPositivePivot { index }| {
                // pivots are counted in the new order
                let old = self.symbolic.perm().map_or(index, |p| p.arrays().0.get(index).copied().unwrap_or(0));
                SolveError::NotPositiveDefinite { node: pattern.node.get(old / 3).map_or(0, |n| *n as usize) }
            })
    }

    /// Replaces the right-hand side by the solution.
    fn solve_in_place(&mut self, b: &mut [f64]) {
        let n = b.len();
        LltRef::new(&self.symbolic, &self.lower).solve_in_place_with_conj(
            Conj::No,
            MatMut::from_column_major_slice_mut(b, n, 1),
            Par::Seq,
            MemStack::new(&mut self.scratch),
        );
    }
}

/// Free rows in elimination order: minimum degree on the graph of nodes, a third of the unknowns. `None` out of memory.
fn order_of_nodes(pattern: &FreePattern) -> Option<Vec<usize>> {
    let n = pattern.row_count();
    let start: Vec<usize> = pattern.row_start.iter().map(|s| *s as usize).collect();
    let column: Vec<usize> = pattern.column.iter().map(|c| *c as usize).collect();
    let shape = SymbolicSparseColMatRef::new_checked(n, n, &start, None, &column);
    let symbolic =
        factorize_symbolic_cholesky(shape, Side::Upper, SymmetricOrdering::Amd, CholeskySymbolicParams::default())
            .ok()?;
    Some(symbolic.perm().map_or_else(|| (0..n).collect(), |p| p.arrays().0.to_vec()))
}

impl<R: Scalar> LinearSolver<R> for Direct<R> {
    fn name(&self) -> &'static str {
        "direct"
    }

    fn prepare(&mut self, pattern: &Arc<BlockPattern>, constraints: &DofConstraints) -> Result<(), SolveError> {
        let free = FreePattern::new(pattern, constraints);
        let n = free.row_count();
        let factor = if n == 0 { None } else { Some(Factor::new(&free)?) };
        self.prepared = Some(Prepared {
            whole: Arc::clone(pattern),
            pattern: free,
            factor,
            identity: vec![false; n],
            x: vec![0.0; 3 * n],
            correction: vec![0.0; 3 * n],
            candidate: vec![[R::zero(); 3]; n],
            true_residual: vec![[0.0; 3]; n],
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
        let report =
            |residual| SolveReport { solver: "direct", iterations: 0, residual, converged: true, rebuilt: false };
        let scale = self.pattern.scale_of(rhs)?;
        let (Some(factor), Some(scale)) = (&mut self.factor, scale) else {
            solution.fill([R::zero(); 3]);
            return Ok(report(0.0));
        };
        factor.load(&self.pattern, matrix, &mut self.identity)?;
        factor.factorise(&self.pattern)?;
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
            let x = |row: usize| self.candidate[row].map(Scalar::to_f64);
            let out = Some(&mut self.true_residual[..]);
            let sum = residual::squared(&self.pattern, &self.identity, scale, matrix, rhs, &x, out);
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
