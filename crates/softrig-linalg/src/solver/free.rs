//! The free part of a system: constrained nodes taken out, free nodes numbered in order.
//!
//! When other nodes become constrained while a body moves, the pattern stays: rows that are held for now are masked, their blocks
//! read as zero and their right-hand sides too, and all that was made for the pattern is filled with new numbers.

use super::SolveError;
use super::sliced::Fault;
use crate::par::Each;
use crate::{BlockPattern, DofConstraints, Scalar, par};
use rayon::prelude::*;
use std::ops::{Deref, Range};
use std::sync::Arc;

/// No block: its row or column is held.
const NOTHING: u32 = u32::MAX;

/// How many blocks each row has. "Row" is a row of this pattern, "node" one of the system it was taken from.
#[derive(Debug, Default)]
pub(super) struct BlockRows {
    /// Node of each row.
    pub node: Vec<u32>,
    /// First block of each row, and one past the last.
    pub row_start: Vec<u32>,
    /// Index of the diagonal block of each row.
    pub diagonal: Vec<u32>,
}

impl BlockRows {
    pub fn row_count(&self) -> usize {
        self.node.len()
    }

    pub fn block_count(&self) -> usize {
        self.row_start.last().map_or(0, |end| *end as usize)
    }

    #[inline(always)]
    pub fn row(&self, i: usize) -> Range<usize> {
        self.row_start[i] as usize..self.row_start[i + 1] as usize
    }
}

/// Compressed rows of blocks. Needed to make a matrix, which keeps columns in an order of its own.
#[derive(Debug, Default)]
pub(super) struct Blocks {
    /// Shared by all that have a matrix on it.
    pub rows: Arc<BlockRows>,
    /// Row of each block's column, in the order of their nodes.
    pub column: Vec<u32>,
}

impl Deref for Blocks {
    type Target = BlockRows;
    fn deref(&self) -> &BlockRows {
        &self.rows
    }
}

/// Rows of the nodes that are free, and maybe of some that have been and are held for now.
#[derive(Debug, Default)]
pub(super) struct FreePattern {
    rows: Arc<BlockRows>,
    /// Row of each node of the whole system; [`NOTHING`] where it has none.
    row_of: Vec<u32>,
    /// Which rows are held; empty when none are.
    held: Vec<bool>,
}

impl Deref for FreePattern {
    type Target = BlockRows;
    fn deref(&self) -> &BlockRows {
        &self.rows
    }
}

impl FreePattern {
    /// Free rows in the order of their nodes.
    pub fn new(pattern: &BlockPattern, constraints: &DofConstraints) -> Self {
        Self::in_order(pattern, constraints.free_nodes())
    }

    /// One row for each of `node`, in that order.
    pub fn in_order(pattern: &BlockPattern, node: Vec<u32>) -> Self {
        let row_of = inverse(&node, pattern.row_count());
        let n = node.len();
        let mut rows = BlockRows { node, row_start: vec![0; n + 1], diagonal: vec![0; n] };
        let mut blocks = 0;
        for (row, node) in rows.node.iter().enumerate() {
            for k in pattern.row(*node as usize) {
                let column = row_of[pattern.column()[k] as usize];
                if column == row as u32 {
                    rows.diagonal[row] = blocks;
                }
                blocks += u32::from(column != NOTHING);
            }
            rows.row_start[row + 1] = blocks;
        }
        Self { rows: Arc::new(rows), row_of, held: Vec::new() }
    }

    /// The rows with their columns; `pattern` is that of the whole system.
    pub fn blocks(&self, pattern: &BlockPattern) -> Blocks {
        let columns = |node: &u32| pattern.column()[pattern.row(*node as usize)].iter();
        let rows = self.node.iter().flat_map(columns).map(|node| self.row_of[*node as usize]);
        Blocks { rows: self.rows.clone(), column: rows.filter(|row| *row != NOTHING).collect() }
    }

    /// Rows without entries: a numbering of nodes only.
    pub fn numbering(node: Vec<u32>) -> Self {
        let n = node.len();
        let row_of = inverse(&node, n);
        let rows = BlockRows { node, row_start: vec![0; n + 1], diagonal: vec![0; n] };
        Self { rows: Arc::new(rows), row_of, held: Vec::new() }
    }

    /// The same rows when other nodes are constrained; `None` when a free node has no row.
    pub fn exchanged(&self, constraints: &DofConstraints) -> Option<Self> {
        let held: Vec<bool> = self.node.iter().map(|n| constraints.is_constrained(*n as usize)).collect();
        let free = held.iter().filter(|h| !**h).count();
        if free + constraints.constrained_count() != constraints.node_count() {
            return None;
        }
        let held = if free == held.len() { Vec::new() } else { held };
        Some(Self { rows: self.rows.clone(), row_of: self.row_of.clone(), held })
    }

    /// The nodes of these rows and those free by `constraints`, ascending; `None` when more than half of them would be held.
    pub fn united(&self, constraints: &DofConstraints) -> Option<Vec<u32>> {
        let mut here: Vec<bool> = constraints.mask().iter().map(|held| !held).collect();
        self.node.iter().for_each(|n| here[*n as usize] = true);
        let node: Vec<u32> = (0..here.len() as u32).filter(|n| here[*n as usize]).collect();
        let free = constraints.node_count() - constraints.constrained_count();
        (2 * free >= node.len()).then_some(node)
    }

    /// Is any row held?
    pub fn is_masked(&self) -> bool {
        !self.held.is_empty()
    }

    /// Is that row held?
    #[inline(always)]
    pub fn is_held(&self, row: usize) -> bool {
        self.held.get(row).is_some_and(|held| *held)
    }

    /// Nodes of the rows that are free now.
    pub fn free_nodes(&self) -> Vec<u32> {
        (0..self.row_count()).filter(|row| !self.is_held(*row)).map(|row| self.node[row]).collect()
    }

    /// The row of a node of the whole system.
    #[inline(always)]
    pub fn row_of(&self, node: usize) -> Option<usize> {
        self.row_of.get(node).filter(|row| **row != NOTHING).map(|row| *row as usize)
    }

    /// The blocks of a row among those that its node has in the whole system, by their place in the pattern; zero where row or column
    /// are held. `columns` are the nodes of `blocks`.
    #[inline(always)]
    pub fn blocks_of<'a, R: Scalar, A: Scalar>(
        &'a self,
        row: usize,
        columns: &'a [u32],
        blocks: &'a [[R; 9]],
    ) -> impl Iterator<Item = [A; 9]> + 'a {
        let held = self.is_held(row);
        columns.iter().zip(blocks).filter_map(move |(node, block)| {
            let column = self.row_of(*node as usize)?;
            Some(if held || self.is_held(column) { [A::zero(); 9] } else { block.map(|v| A::from_f64(v.to_f64())) })
        })
    }

    /// Where each block is in the matrix of the whole system, whichever rows are held.
    pub fn sources(&self, whole: &BlockPattern) -> Vec<u32> {
        let of_node = |n: &u32| whole.row(*n as usize).filter(|k| self.row_of(whole.column()[*k] as usize).is_some());
        self.node.iter().flat_map(of_node).map(|k| k as u32).collect()
    }

    /// The right-hand side of a row, in f64.
    #[inline(always)]
    pub fn of_row<R: Scalar>(&self, rhs: &[[R; 3]], row: usize) -> [f64; 3] {
        if self.is_held(row) { [0.0; 3] } else { rhs[self.node[row] as usize].map(Scalar::to_f64) }
    }

    /// What is wrong with a row, said of its node.
    pub fn blame(&self, fault: &Fault) -> SolveError {
        match *fault {
            Fault::NotFinite { row } => SolveError::NotFinite { node: self.node[row] as usize },
            Fault::NotPositiveDefinite { row } => SolveError::NotPositiveDefinite { node: self.node[row] as usize },
            Fault::Missing { .. } => SolveError::NotPrepared,
        }
    }

    /// A power of two that brings the largest free entry of the right-hand side to [1, 2), so that no square over- or
    /// underflows; `None` when all are zero.
    pub fn scale_of<R: Scalar>(&self, rhs: &[[R; 3]]) -> Result<Option<f64>, SolveError> {
        let bad = |row: usize| self.of_row(rhs, row).iter().any(|b| !b.is_finite());
        if let Some(row) = par::first(self.row_count(), bad) {
            return Err(SolveError::NotFinite { node: self.node[row] as usize });
        }
        let largest = par::max(self.row_count(), |row| self.of_row(rhs, row).iter().fold(0.0, |m, b| b.abs().max(m)));
        // below 2^-1000 there is nothing left to solve for
        let exponent = largest.log2().floor().clamp(-1000.0, 1000.0);
        Ok((largest > 0.0).then(|| (-exponent).exp2()))
    }

    /// Writes a vector of free rows to the nodes, zero to constrained ones.
    pub fn scatter<A: Scalar, R: Scalar, const N: usize>(&self, free: &[[A; N]], nodes: &mut [[R; 3]]) {
        nodes.par_iter_mut().enumerate().with_min_len(par::CHUNK).each(|(node, out)| {
            *out = match self.row_of(node).and_then(|row| free.get(row)) {
                Some(x) => std::array::from_fn(|k| R::from_f64(x[k].to_f64())),
                None => [R::zero(); 3],
            };
        });
    }
}

/// The row of each of so many nodes, [`NOTHING`] for those that have none.
fn inverse(node: &[u32], count: usize) -> Vec<u32> {
    let mut row_of = vec![NOTHING; count];
    for (row, n) in node.iter().enumerate() {
        row_of[*n as usize] = row as u32;
    }
    row_of
}
