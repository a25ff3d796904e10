//! Matrices that make their rows when they are asked for.

use crate::{BlockCsr, BlockPattern, Scalar};
use std::sync::Arc;

/// Rows of a part of a stored matrix.
const PART: usize = 128;

/// A matrix on a [`BlockPattern`] that hands out its rows, so that whoever wants them in another layout or other numbers does not
/// need a copy of all of them.
pub trait Rows<R: Scalar>: Sync {
    /// Where its blocks are.
    fn pattern(&self) -> &Arc<BlockPattern>;

    /// How many parts the rows come in. Parts can be made on several threads at once.
    fn part_count(&self) -> usize;

    /// Hands the rows of a part to `take`, one after the other: which it is, and its blocks in the order of the pattern. Each row
    /// of the matrix is in one part.
    fn for_rows(&self, part: usize, take: &mut dyn FnMut(usize, &[[R; 9]]));

    /// As [`Self::for_rows`] for those who keep the blocks in f32, which may then also be made in f32.
    fn for_rows_in_single(&self, part: usize, take: &mut dyn FnMut(usize, &[[f32; 9]])) {
        let mut rounded = Vec::new();
        self.for_rows(part, &mut |row, blocks| {
            take(row, in_single(blocks, &mut rounded));
        });
    }
}

/// The blocks rounded to f32, in memory that is used again.
pub fn in_single<'a, R: Scalar>(blocks: &[[R; 9]], memory: &'a mut Vec<[f32; 9]>) -> &'a mut [[f32; 9]] {
    memory.clear();
    memory.extend(blocks.iter().map(|block| block.map(|v| v.to_f64() as f32)));
    memory
}

impl<R: Scalar> Rows<R> for BlockCsr<R> {
    fn pattern(&self) -> &Arc<BlockPattern> {
        &self.pattern
    }

    fn part_count(&self) -> usize {
        self.pattern.row_count().div_ceil(PART)
    }

    fn for_rows(&self, part: usize, take: &mut dyn FnMut(usize, &[[R; 9]])) {
        let end = ((part + 1) * PART).min(self.pattern.row_count());
        for row in part * PART..end {
            if let Some(blocks) = self.values.get(self.pattern.row(row)) {
                take(row, blocks);
            }
        }
    }
}
