//! Sparse matrices of 3x3 blocks.

use crate::scalar::Scalar;
use std::sync::Arc;

/// Where the 3x3 blocks of a symmetric-pattern sparse matrix are: compressed rows, columns ascending, every diagonal present.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BlockPattern {
    row_start: Vec<u32>,
    column: Vec<u32>,
    diagonal: Vec<u32>,
}

impl BlockPattern {
    /// The pattern in which two nodes are coupled when some cell has both. `cells` yields the nodes of each cell.
    ///
    /// # Panics
    /// When a cell names a node outside `0..node_count`.
    #[must_use]
    pub fn from_cells<'a>(node_count: usize, cells: impl Iterator<Item = &'a [u32]> + Clone) -> Self {
        // node -> cells, as compressed rows
        let mut start = vec![0u32; node_count + 1];
        for cell in cells.clone() {
            for &n in cell {
                start[n as usize + 1] += 1;
            }
        }
        for i in 0..node_count {
            start[i + 1] += start[i];
        }
        let mut fill = start.clone();
        let mut incident: Vec<&[u32]> = vec![&[]; start[node_count] as usize];
        for cell in cells {
            for &n in cell {
                incident[fill[n as usize] as usize] = cell;
                fill[n as usize] += 1;
            }
        }
        let mut row_start = Vec::with_capacity(node_count + 1);
        let mut diagonal = Vec::with_capacity(node_count);
        let mut column = Vec::new();
        let mut row: Vec<u32> = Vec::new();
        row_start.push(0);
        for i in 0..node_count {
            row.clear();
            row.push(i as u32);
            for cell in &incident[start[i] as usize..start[i + 1] as usize] {
                row.extend_from_slice(cell);
            }
            row.sort_unstable();
            row.dedup();
            let at = row.binary_search(&(i as u32)).expect("the row's own node was pushed above");
            diagonal.push((column.len() + at) as u32);
            column.extend_from_slice(&row);
            row_start.push(column.len() as u32);
        }
        column.shrink_to_fit();
        Self { row_start, column, diagonal }
    }

    /// Number of block rows (nodes).
    #[must_use]
    pub fn row_count(&self) -> usize {
        self.diagonal.len()
    }

    /// Number of stored blocks.
    #[must_use]
    pub fn block_count(&self) -> usize {
        self.column.len()
    }

    /// First block of each row, and one past the last: `row_count() + 1` entries.
    #[must_use]
    pub fn row_start(&self) -> &[u32] {
        &self.row_start
    }

    /// Column (node) of each block.
    #[must_use]
    pub fn column(&self) -> &[u32] {
        &self.column
    }

    /// Index of the diagonal block of each row.
    #[must_use]
    pub fn diagonal(&self) -> &[u32] {
        &self.diagonal
    }

    /// The blocks of row `i`, as a range of indices.
    #[inline(always)]
    #[must_use]
    pub fn row(&self, i: usize) -> std::ops::Range<usize> {
        self.row_start[i] as usize..self.row_start[i + 1] as usize
    }

    /// Index of block (`row`, `column`), when it is in the pattern.
    #[must_use]
    pub fn find(&self, row: usize, column: usize) -> Option<usize> {
        let range = self.row(row);
        self.column[range.clone()].binary_search(&(column as u32)).ok().map(|k| range.start + k)
    }
}

/// A sparse matrix of 3x3 blocks (row-major inside a block) on a shared [`BlockPattern`].
#[derive(Clone, Debug)]
pub struct BlockCsr<R> {
    /// Where the blocks are.
    pub pattern: Arc<BlockPattern>,
    /// The blocks, in pattern order; `values.len() == pattern.block_count()`.
    pub values: Vec<[R; 9]>,
}

impl<R: Scalar> BlockCsr<R> {
    /// All blocks zero.
    #[must_use]
    pub fn zero(pattern: Arc<BlockPattern>) -> Self {
        let values = vec![[R::zero(); 9]; pattern.block_count()];
        Self { pattern, values }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pattern_of_two_tetrahedra_couples_nodes_of_a_cell_only() {
        let cells = [[0u32, 1, 2, 3], [1, 2, 3, 4]];
        let p = BlockPattern::from_cells(6, cells.iter().map(|c| &c[..]));
        assert_eq!(p.row_count(), 6);
        assert_eq!(p.block_count(), 4 + 5 + 5 + 5 + 4 + 1);
        assert!(p.find(0, 4).is_none());
        assert_eq!(p.find(5, 5), Some(p.diagonal()[5] as usize));
        assert_eq!(&p.column()[p.row(0)], &[0, 1, 2, 3]);
    }
}
