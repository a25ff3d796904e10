//! Sparse matrices with eight rows side by side: every number of a register belongs to another row, so that a product is
//! multiplications and additions only and no row has to be summed up across a register.
//!
//! Rows are cut into chunks; within a chunk they are sorted by their number of blocks and taken eight at a time. Shorter rows of
//! a slice are filled up with blocks of zeros. Each row adds its blocks in the order of the pattern, whatever the machine's width.

mod fill;
mod times;

pub(crate) use times::slice_times;
#[cfg(all(target_arch = "x86_64", not(miri)))]
pub(crate) use times::{slice_times_avx2, slice_times_avx2_f64};

use fill::Fill;

use super::free::{BlockRows, Blocks, FreePattern};
use super::pcg::kernel::Inverse;
use crate::par::Each;
use crate::{Lane, Rows, Scalar, Wide};
use rayon::prelude::*;
use std::ops::Range;
use std::sync::atomic::AtomicBool;

/// Rows of a slice.
pub(crate) const SLICE: usize = 8;
/// Rows per chunk: the unit of work of a thread, and of the order of summation.
pub(super) const ROWS: usize = super::cubes::ROWS;
/// One step through a slice: the blocks of eight rows, number by number.
pub(crate) type Step<A> = [[A; SLICE]; 9];

/// Square matrix of 3x3 blocks on the pattern it was made for.
#[derive(Debug, Default)]
pub(super) struct Sliced<A> {
    layout: Layout,
    values: Vec<Step<A>>,
    /// Rows that have come in while they do.
    taken: Vec<AtomicBool>,
}

/// Where which block is.
#[derive(Debug, Default)]
struct Layout {
    /// Rows of each slice, counted from the first of its chunk.
    row: Vec<[u16; SLICE]>,
    /// How many of them there are: fewer than [`SLICE`] only in the last slice of a chunk.
    filled: Vec<u8>,
    /// First step of each slice, and one past the last.
    start: Vec<u32>,
    /// First slice of each chunk, and one past the last.
    chunk: Vec<u32>,
    /// First row of each chunk, and one past the last.
    first_row: Vec<u32>,
    column: Vec<[u32; SLICE]>,
    /// Slice of each row times [`SLICE`], and its number in it.
    place: Vec<u32>,
}

/// What is done with the rows of a product, one after the other. A trait and not a closure, because these must be part of the
/// loop's code to be compiled for the machine's instructions.
pub(super) trait RowWork<A> {
    /// Row `row` of the product, counted from the first of its chunk. Must be `#[inline(always)]`.
    fn row(&mut self, row: usize, product: Wide<A, 4>);
}

/// What is wrong with a row of a matrix.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Fault {
    /// A number is not finite.
    NotFinite { row: usize },
    /// The diagonal block is not positive definite.
    NotPositiveDefinite { row: usize },
    /// It never came.
    Missing { row: usize },
}

/// Rows of the chunks of a matrix.
fn chunks(breaks: &[u32]) -> impl Iterator<Item = Range<usize>> + '_ {
    let part = |part: &[u32]| {
        let end = part[1] as usize;
        (part[0] as usize..end).step_by(ROWS).map(move |first| first..(first + ROWS).min(end))
    };
    breaks.windows(2).flat_map(part)
}

/// The order in which a chunk has its rows.
fn sort(pattern: &Blocks, rows: &mut [u32]) {
    rows.sort_by_key(|row| std::cmp::Reverse(pattern.row(*row as usize).len()));
}

/// Sorts rows in such an order that a matrix with the same breaks, of rows in that order, takes them one after the other: what belongs to
/// them is then read as it lies in memory.
pub(super) fn sort_rows(pattern: &Blocks, breaks: &[u32], order: &mut [u32]) {
    chunks(breaks).for_each(|chunk| sort(pattern, &mut order[chunk]));
}

impl<A: Scalar> Sliced<A> {
    /// A matrix on that pattern, all zero. Chunks also end at the rows of `breaks` (ascending, from 0 to the number of rows).
    pub fn new(pattern: &Blocks, breaks: &[u32]) -> Self {
        let place = vec![0; pattern.row_count()];
        let mut layout = Layout { start: vec![0], chunk: vec![0], first_row: vec![0], place, ..Layout::default() };
        let mut order: Vec<u32> = (0..pattern.row_count() as u32).collect();
        for chunk in chunks(breaks) {
            let (first, order) = (chunk.start, &mut order[chunk.clone()]);
            sort(pattern, order);
            order.chunks(SLICE).for_each(|slice| layout.push(pattern, first, slice));
            layout.chunk.push(layout.row.len() as u32);
            layout.first_row.push(chunk.end as u32);
        }
        layout.column.shrink_to_fit();
        layout.row.shrink_to_fit();
        let values = vec![[[A::zero(); SLICE]; 9]; layout.column.len()];
        let taken = (0..pattern.row_count()).map(|_| AtomicBool::new(false)).collect();
        Self { layout, values, taken }
    }

    /// What a product reads of the matrix [bytes].
    pub fn bytes(&self) -> usize {
        self.values.len() * (size_of::<Step<A>>() + size_of::<[u32; SLICE]>())
    }

    /// Number of chunks.
    pub fn chunk_count(&self) -> usize {
        self.layout.chunk.len() - 1
    }

    /// Takes the rows of a matrix of the whole system and inverts the diagonal blocks. A row without a single entry becomes one of
    /// the identity, and is marked.
    ///
    /// # Errors
    /// What is wrong with the first row something is wrong with.
    pub fn load<R: Scalar>(
        &mut self,
        free: &FreePattern,
        rows: &dyn Rows<R>,
        inverse: &mut [Inverse<A>],
        identity: &mut [bool],
    ) -> Result<(), Fault> {
        let fill = Fill::new(self, free, inverse, identity);
        let columns = |node: usize| &rows.pattern().column()[rows.pattern().row(node)];
        (0..rows.part_count()).into_par_iter().each(|part| {
            if A::NAME == f32::NAME {
                rows.for_rows_in_single(part, &mut |node, blocks| fill.take_node(free, node, columns(node), blocks));
            } else {
                rows.for_rows(part, &mut |node, blocks| fill.take_node(free, node, columns(node), blocks));
            }
        });
        fill.finish()
    }

    /// As [`Self::load`], from the blocks of the pattern, by row and place.
    ///
    /// # Errors
    /// As [`Self::load`].
    pub fn load_blocks(
        &mut self,
        pattern: &BlockRows,
        block_of: &(impl Fn(usize, usize) -> [A; 9] + Sync),
        inverse: &mut [Inverse<A>],
        identity: &mut [bool],
    ) -> Result<(), Fault> {
        let fill = Fill::new(self, pattern, inverse, identity);
        let rows = (0..pattern.row_count()).into_par_iter().with_min_len(ROWS);
        rows.each(|row| fill.take(row, pattern.row(row).map(|k| block_of(row, k))));
        fill.finish()
    }

    /// A number by which rows that lie close together in memory are neighbours.
    pub fn place(&self, row: usize) -> u32 {
        self.layout.place[row]
    }

    /// The blocks of a row with their columns, in the order of the pattern; then those that it is filled up with.
    #[inline(always)]
    pub fn blocks(&self, row: usize) -> impl Iterator<Item = (u32, [A; 9])> + '_ {
        let (steps, lane) = self.layout.place(row);
        let both = self.layout.column[steps.clone()].iter().zip(&self.values[steps]);
        // the remainder tells the compiler that there are so many lanes
        both.map(move |(column, step)| (column[lane % SLICE], std::array::from_fn(|i| step[i][lane % SLICE])))
    }

    /// Rows of chunk `c`.
    pub fn chunk_rows(&self, c: usize) -> Range<usize> {
        self.layout.first_row[c] as usize..self.layout.first_row[c + 1] as usize
    }

    /// As [`Self::for_rows`], in f64 whatever the numbers of the matrix are.
    #[inline(always)]
    pub fn for_rows_in_double(&self, c: usize, x: &[[f64; 4]], work: &mut impl RowWork<f64>) {
        let layout = &self.layout;
        let (quad, zero) =
            (|v: &[A; SLICE], half: usize| Wide(v.as_chunks::<4>().0[half].map(Scalar::to_f64)), [0.0; 4]);
        for slice in layout.chunk[c] as usize..layout.chunk[c + 1] as usize {
            let mut sum = [[Wide::<f64, 4>::zero(); 3]; 2];
            let steps = layout.steps(slice);
            for (m, column) in self.values[steps.clone()].iter().zip(&layout.column[steps]) {
                for (half, sum) in sum.iter_mut().enumerate() {
                    let at = |l: usize| &x[column[4 * half + l] as usize];
                    let v = f64::transposed([at(0), at(1), at(2), at(3)]);
                    for r in 0..3 {
                        let part = |c: usize| quad(&m[3 * r + c], half) * Wide(v[c]);
                        sum[r] += (part(0) + part(1)) + part(2);
                    }
                }
            }
            for (sum, rows) in sum.iter().zip(layout.rows(slice).chunks(4)) {
                let quads = f64::transposed([&sum[0].0, &sum[1].0, &sum[2].0, &zero]);
                for (quad, row) in quads.iter().zip(rows) {
                    work.row(*row as usize, Wide(*quad));
                }
            }
        }
    }

    /// Hands all rows of chunk `c` of the product with `x` to `work`; their fourth number is zero.
    #[inline(always)]
    pub fn for_rows(&self, c: usize, x: &[[A; 4]], work: &mut impl RowWork<A>) {
        let layout = &self.layout;
        assert!(x.len() >= layout.first_row[layout.first_row.len() - 1] as usize);
        let zero = [A::zero(); 4];
        for slice in layout.chunk[c] as usize..layout.chunk[c + 1] as usize {
            let steps = layout.steps(slice);
            // SAFETY: columns are those of `BlockRows`, below its row count, and `x` is that long (asserted above).
            let q = unsafe { A::slice_times(&self.values[steps.clone()], &layout.column[steps], x) };
            for (half, rows) in layout.rows(slice).chunks(4).enumerate() {
                let part = |k: usize| &q[k].as_chunks::<4>().0[half];
                let quads = A::transposed([part(0), part(1), part(2), &zero]);
                for (l, row) in rows.iter().enumerate() {
                    work.row(*row as usize, Wide(quads[l]));
                }
            }
        }
    }
}

impl Layout {
    fn push(&mut self, pattern: &Blocks, first: usize, slice: &[u32]) {
        let first_place = self.row.len() * SLICE;
        slice.iter().enumerate().for_each(|(l, row)| self.place[*row as usize] = (first_place + l) as u32);
        self.row.push(std::array::from_fn(|l| slice.get(l).map_or(0, |r| (*r as usize - first) as u16)));
        self.filled.push(slice.len() as u8);
        for step in 0..pattern.row(slice[0] as usize).len() {
            let block = |l: usize| slice.get(l).and_then(|r| pattern.row(*r as usize).nth(step));
            // filled up with the row itself, which is in the cache
            let own = |l: usize| *slice.get(l).unwrap_or(&slice[0]);
            self.column.push(std::array::from_fn(|l| block(l).map_or(own(l), |k| pattern.column[k])));
        }
        self.start.push(self.column.len() as u32);
    }

    #[inline(always)]
    fn steps(&self, slice: usize) -> Range<usize> {
        self.start[slice] as usize..self.start[slice + 1] as usize
    }

    /// Rows of a slice, counted from the first of its chunk.
    #[inline(always)]
    fn rows(&self, slice: usize) -> &[u16] {
        &self.row[slice][..self.filled[slice] as usize]
    }

    /// Steps of a row, and its number among the rows of its slice.
    #[inline(always)]
    fn place(&self, row: usize) -> (Range<usize>, usize) {
        let place = self.place[row] as usize;
        (self.steps(place / SLICE), place % SLICE)
    }
}

impl Fault {
    fn row(&self) -> usize {
        match self {
            Self::NotFinite { row } | Self::NotPositiveDefinite { row } | Self::Missing { row } => *row,
        }
    }
}

#[cfg(test)]
mod tests;
