//! Sparse Cholesky factorisation of a matrix of blocks.
//!
//! The rows are ordered once by approximate minimum degree on the graph of blocks; faer factorises `P A Pᵀ = L Lᵀ` in f64. Runs on one
//! thread, so results do not depend on how many there are; they may differ in the last bits between machines, because faer fuses
//! multiplications and additions where the machine can.

use super::free::Blocks;
use super::sliced::Fault;
use faer::dyn_stack::{MemBuffer, MemStack, StackReq};
use faer::linalg::cholesky::llt::factor::LltError;
use faer::perm::PermRef;
use faer::sparse::linalg::SupernodalThreshold;
use faer::sparse::linalg::cholesky::{
    CholeskySymbolicParams, LltRef, SymbolicCholesky, SymmetricOrdering, factorize_symbolic_cholesky,
};
use faer::sparse::{SparseColMatRef, SymbolicSparseColMatRef};
use faer::{Conj, MatMut, Par, Side};

/// Rows of a matrix that is not small.
const DENSE_BLOCKS: usize = 400;

/// The upper triangle of a matrix, column by column, and its factor.
pub(super) struct Factor {
    column_start: Vec<usize>,
    row: Vec<usize>,
    upper: Vec<f64>,
    symbolic: SymbolicCholesky<usize>,
    lower: Vec<f64>,
    scratch: MemBuffer,
}

impl Factor {
    /// Symbolic work; `None` out of memory.
    pub fn new(pattern: &Blocks) -> Option<Self> {
        let unknowns = 3 * pattern.row_count();
        let node_order = order_of_nodes(pattern)?;
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
        let symbolic = factorize_symbolic_cholesky(shape, Side::Upper, order, parameters(pattern.row_count())).ok()?;
        let mut lower = Vec::new();
        lower.try_reserve_exact(symbolic.len_val()).ok()?;
        lower.resize(symbolic.len_val(), 0.0);
        let need = StackReq::any_of(&[
            symbolic.factorize_numeric_llt_scratch::<f64>(Par::Seq, Default::default()),
            symbolic.solve_in_place_scratch::<f64>(1, Par::Seq),
        ]);
        let scratch = MemBuffer::try_new(need).ok()?;
        let upper = vec![0.0; row.len()];
        Some(Self { column_start, row, upper, symbolic, lower, scratch })
    }

    /// Reads the blocks of the pattern, by row and place; rows without a single entry become rows of the identity, and are marked.
    ///
    /// # Errors
    /// The first row with a number that is none.
    pub fn load(
        &mut self,
        pattern: &Blocks,
        block_of: &impl Fn(usize, usize) -> [f64; 9],
        identity: &mut [bool],
    ) -> Result<(), Fault> {
        for i in 0..pattern.row_count() {
            let starts: [usize; 4] = std::array::from_fn(|c| self.column_start[3 * i + c]);
            let (mut finite, mut empty, mut before) = (true, true, 0);
            for k in pattern.row(i) {
                let block = block_of(i, k);
                finite &= block.iter().all(|v| v.is_finite());
                empty &= block.iter().all(|v| *v == 0.0);
                let j = pattern.column[k] as usize;
                if j <= i {
                    // the entries (3 i + c, 3 j + d) of the lower triangle are column 3 i + c of the upper one
                    for c in 0..3 {
                        let count = if j == i { c + 1 } else { 3 };
                        self.upper[starts[c] + before..][..count].copy_from_slice(&block[3 * c..3 * c + count]);
                    }
                    before += 3;
                }
            }
            if !finite {
                return Err(Fault::NotFinite { row: i });
            }
            identity[i] = empty;
            if empty {
                // the diagonal is the last of each column
                starts[1..].iter().for_each(|end| self.upper[end - 1] = 1.0);
            }
        }
        Ok(())
    }

    /// Adds to the diagonal: `shift` of itself, and at least `least` times `shift` of its largest entry.
    pub fn shift_diagonal(&mut self, shift: f64, least: f64) {
        let diagonal = |c: &[usize]| c[1] - 1;
        let largest = self.column_start.windows(2).map(|c| self.upper[diagonal(c)]).fold(0.0, f64::max);
        for c in self.column_start.windows(2) {
            let entry = &mut self.upper[diagonal(c)];
            *entry += shift * entry.max(least * largest);
        }
    }

    /// `A = L Lᵀ`.
    ///
    /// # Errors
    /// A row at which the matrix was found not to be positive definite.
    pub fn factorise(&mut self) -> Result<(), Fault> {
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
                Fault::NotPositiveDefinite { row: old / 3 }
            })
    }

    /// Replaces the right-hand side by the solution.
    pub fn solve_in_place(&mut self, b: &mut [f64]) {
        let n = b.len();
        LltRef::new(&self.symbolic, &self.lower).solve_in_place_with_conj(
            Conj::No,
            MatMut::from_column_major_slice_mut(b, n, 1),
            Par::Seq,
            MemStack::new(&mut self.scratch),
        );
    }
}

/// Large ones in dense blocks: columns of equal pattern together, at least the three of a node. Small ones as faer likes, because
/// its dense products keep 4 MB.
fn parameters(rows: usize) -> CholeskySymbolicParams<'static> {
    let mut out = CholeskySymbolicParams::default();
    if rows > DENSE_BLOCKS {
        out.supernodal_flop_ratio_threshold = SupernodalThreshold::FORCE_SUPERNODAL;
    }
    out
}

/// Free rows in elimination order: minimum degree on the graph of nodes, a third of the unknowns. `None` out of memory.
fn order_of_nodes(pattern: &Blocks) -> Option<Vec<usize>> {
    let n = pattern.row_count();
    let start: Vec<usize> = pattern.row_start.iter().map(|s| *s as usize).collect();
    let column: Vec<usize> = pattern.column.iter().map(|c| *c as usize).collect();
    let shape = SymbolicSparseColMatRef::new_checked(n, n, &start, None, &column);
    let symbolic =
        factorize_symbolic_cholesky(shape, Side::Upper, SymmetricOrdering::Amd, CholeskySymbolicParams::default())
            .ok()?;
    Some(symbolic.perm().map_or_else(|| (0..n).collect(), |p| p.arrays().0.to_vec()))
}
