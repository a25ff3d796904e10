//! Patterns of sparse products.

use std::ops::Range;

/// Compressed rows, columns ascending.
#[derive(Debug, Default)]
pub(super) struct Pattern {
    pub start: Vec<u32>,
    pub column: Vec<u32>,
}

impl Pattern {
    pub fn row_count(&self) -> usize {
        self.start.len() - 1
    }

    pub fn row(&self, i: usize) -> Range<usize> {
        self.start[i] as usize..self.start[i + 1] as usize
    }

    pub fn columns(&self, i: usize) -> &[u32] {
        &self.column[self.row(i)]
    }

    /// A sparse product row by row; `visit(row, add)` names the columns of all contributions of a row.
    pub fn of_product(rows: usize, columns: usize, visit: impl Fn(usize, &mut dyn FnMut(u32))) -> Self {
        let mut out = Self { start: vec![0], ..Self::default() };
        let mut seen = vec![false; columns];
        for i in 0..rows {
            let first = out.column.len();
            visit(i, &mut |c| {
                if !std::mem::replace(&mut seen[c as usize], true) {
                    out.column.push(c);
                }
            });
            out.column[first..].sort_unstable();
            out.column[first..].iter().for_each(|c| seen[*c as usize] = false);
            out.start.push(out.column.len() as u32);
        }
        out.column.shrink_to_fit();
        out
    }

    /// The part of a square pattern from the diagonal on.
    pub fn upper(&self) -> Self {
        let mut out = Self { start: vec![0], ..Self::default() };
        for i in 0..self.row_count() {
            out.column.extend(self.columns(i).iter().filter(|c| **c as usize >= i));
            out.start.push(out.column.len() as u32);
        }
        out.column.shrink_to_fit();
        out
    }

    /// For every block of this square, symmetric pattern: its place in its row of the upper part, or that of its mirror image.
    pub fn places(&self, upper: &Self) -> Vec<u16> {
        let mut out = Vec::with_capacity(self.column.len());
        for i in 0..self.row_count() {
            for &j in self.columns(i) {
                let (row, column) = (i.min(j as usize), i.max(j as usize) as u32);
                out.push(upper.columns(row).binary_search(&column).expect("the pattern is symmetric") as u16);
            }
        }
        out
    }
}
