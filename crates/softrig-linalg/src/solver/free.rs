//! The free part of a system: constrained nodes taken out, free nodes numbered in order.

use super::SolveError;
use crate::{BlockPattern, DofConstraints, Scalar};

/// Compressed rows of the free-free blocks. "Free row" is a row of this pattern, "node" one of the whole system.
#[derive(Debug, Default)]
pub(super) struct FreePattern {
    /// Node of each free row, ascending.
    pub node: Vec<u32>,
    /// First block of each free row, and one past the last.
    pub row_start: Vec<u32>,
    /// Free row of each block's column, ascending within a row.
    pub column: Vec<u32>,
    /// Where each block is in the matrix of the whole system.
    pub source: Vec<u32>,
    /// Index of the diagonal block of each free row.
    pub diagonal: Vec<u32>,
}

impl FreePattern {
    pub fn new(pattern: &BlockPattern, constraints: &DofConstraints) -> Self {
        let node: Vec<u32> =
            (0..pattern.row_count()).filter(|i| !constraints.is_constrained(*i)).map(|i| i as u32).collect();
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

    pub fn block_count(&self) -> usize {
        self.column.len()
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
