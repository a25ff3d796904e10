//! The free part of a system: constrained nodes taken out, free nodes numbered in order.

use super::SolveError;
use super::sliced::Fault;
use crate::{BlockCsr, BlockPattern, DofConstraints, Scalar};

/// Compressed rows of the free-free blocks. "Free row" is a row of this pattern, "node" one of the whole system.
#[derive(Debug, Default)]
pub(super) struct FreePattern {
    /// Node of each free row.
    pub node: Vec<u32>,
    /// First block of each free row, and one past the last.
    pub row_start: Vec<u32>,
    /// Free row of each block's column, in the order of their nodes.
    pub column: Vec<u32>,
    /// Where each block is in the matrix of the whole system.
    pub source: Vec<u32>,
    /// Index of the diagonal block of each free row.
    pub diagonal: Vec<u32>,
}

impl FreePattern {
    /// Free rows in the order of their nodes.
    pub fn new(pattern: &BlockPattern, constraints: &DofConstraints) -> Self {
        let free = |i: &u32| !constraints.is_constrained(*i as usize);
        Self::in_order(pattern, (0..pattern.row_count() as u32).filter(free).collect())
    }

    /// One row for each of `node`, the free ones, in that order.
    pub fn in_order(pattern: &BlockPattern, node: Vec<u32>) -> Self {
        let mut free_row = vec![u32::MAX; pattern.row_count()];
        for (row, n) in node.iter().enumerate() {
            free_row[*n as usize] = row as u32;
        }
        let mut free = Self { node, ..Self::default() };
        free.row_start.push(0);
        for (row, &n) in free.node.iter().enumerate() {
            for k in pattern.row(n as usize) {
                let column = free_row[pattern.column()[k] as usize];
                if column == u32::MAX {
                    continue;
                }
                if column == row as u32 {
                    free.diagonal.push(free.column.len() as u32);
                }
                free.column.push(column);
                free.source.push(k as u32);
            }
            free.row_start.push(free.column.len() as u32);
        }
        free
    }

    /// The blocks of a matrix of the whole system, by their place in this pattern.
    pub fn block_of<'a, R: Scalar, A: Scalar>(
        &'a self,
        matrix: &'a BlockCsr<R>,
    ) -> impl Fn(usize) -> [A; 9] + Sync + 'a {
        |k| matrix.values[self.source[k] as usize].map(|v| A::from_f64(v.to_f64()))
    }

    /// What is wrong with a row, said of its node.
    pub fn blame(&self, fault: &Fault) -> SolveError {
        match *fault {
            Fault::NotFinite { row } => SolveError::NotFinite { node: self.node[row] as usize },
            Fault::NotPositiveDefinite { row } => SolveError::NotPositiveDefinite { node: self.node[row] as usize },
        }
    }

    /// The same pattern, for a matrix of its own.
    pub fn clone_structure(&self) -> Self {
        Self {
            node: self.node.clone(),
            row_start: self.row_start.clone(),
            column: self.column.clone(),
            diagonal: self.diagonal.clone(),
            ..Self::default()
        }
    }

    pub fn row_count(&self) -> usize {
        self.node.len()
    }

    #[inline(always)]
    pub fn row(&self, i: usize) -> std::ops::Range<usize> {
        self.row_start[i] as usize..self.row_start[i + 1] as usize
    }

    /// A power of two that brings the largest free entry of the right-hand side to [1, 2), so that no square over- or
    /// underflows; `None` when all are zero.
    pub fn scale_of<R: Scalar>(&self, rhs: &[[R; 3]]) -> Result<Option<f64>, SolveError> {
        let mut largest = 0.0_f64;
        for &node in &self.node {
            for b in rhs[node as usize] {
                if !b.is_finite() {
                    return Err(SolveError::NotFinite { node: node as usize });
                }
                largest = largest.max(b.to_f64().abs());
            }
        }
        // below 2^-1000 there is nothing left to solve for
        let exponent = largest.log2().floor().clamp(-1000.0, 1000.0);
        Ok((largest > 0.0).then(|| (-exponent).exp2()))
    }

    /// Writes a vector of free rows to the nodes, zero to constrained ones.
    pub fn scatter<A: Scalar, R: Scalar>(&self, free: &[[A; 3]], nodes: &mut [[R; 3]]) {
        nodes.fill([R::zero(); 3]);
        for (node, x) in self.node.iter().zip(free) {
            nodes[*node as usize] = x.map(|x| R::from_f64(x.to_f64()));
        }
    }
}
