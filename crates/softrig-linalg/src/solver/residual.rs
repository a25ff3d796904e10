//! The true residual of a solution: `b - A x` over the free rows, in f64 whatever the numbers are.
//!
//! From the caller's entries, from an iteration's own matrix where that has the same numbers, or from a product with the whole system.
//! Everything is multiplied by a scale; rows marked as those of the identity count as such.

use super::free::FreePattern;
use super::sliced::{RowWork, Sliced};
use crate::par::Each;
use crate::{BlockCsr, Kernel, Lane, Scalar, Wide, par, run_wide};
use rayon::prelude::*;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

/// A residual on its way from products to `out`, which has three numbers a row and maybe a zero.
pub(super) struct Target<'a, B, A, const N: usize> {
    pub free: &'a FreePattern,
    pub rhs: &'a [[B; 3]],
    pub scale: f64,
    pub out: &'a mut [[A; N]],
    pub squares: &'a mut Squares,
}

/// Square norms of the chunks of a residual, before it is rounded to the numbers of `out`. Threads write different ones.
#[derive(Debug, Default)]
pub(super) struct Squares(Vec<AtomicU64>);

impl Squares {
    /// Room for so many chunks.
    fn of(&mut self, chunks: usize) -> &[AtomicU64] {
        self.0.resize_with(chunks, AtomicU64::default);
        &self.0
    }

    /// The sum, always in the same order.
    fn sum(&self) -> f64 {
        self.0.iter().map(|s| f64::from_bits(s.load(Relaxed))).sum()
    }
}

impl<B: Scalar, A: Scalar, const N: usize> Target<'_, B, A, N> {
    /// From the product of each row with the solution; returns the square norm.
    pub fn of_rows(self, product: impl Fn(usize) -> [f64; 3] + Sync) -> f64 {
        let Self { free, rhs, scale, out, squares } = self;
        let sums = squares.of(out.len().div_ceil(par::CHUNK));
        out.par_chunks_mut(par::CHUNK).zip(sums).enumerate().each(|(c, (out, sum))| {
            let mut square = 0.0;
            for (k, out) in out.iter_mut().enumerate() {
                let row = c * par::CHUNK + k;
                square += write(out, free.of_row(rhs, row), product(row), scale);
            }
            sum.store(square.to_bits(), Relaxed);
        });
        squares.sum()
    }

    /// From the entries of the whole system; returns the square norm.
    pub fn of_entries<R: Scalar, X: Scalar, const M: usize>(
        self,
        matrix: &BlockCsr<R>,
        identity: &[bool],
        x: &[[X; M]],
    ) -> f64 {
        let Self { free, rhs, scale, out, squares } = self;
        let sums = squares.of(out.len().div_ceil(par::CHUNK));
        out.par_chunks_mut(par::CHUNK).zip(sums).enumerate().each(|(c, (out, sum))| {
            let first = c * par::CHUNK;
            let square = run_wide::<f64, _>(Entries { free, identity, scale, matrix, rhs, x, first, out });
            sum.store(square.to_bits(), Relaxed);
        });
        squares.sum()
    }

    /// From the matrix of the free rows, which has the caller's numbers; returns the square norm.
    pub fn of_own<M: Scalar>(self, matrix: &Sliced<M>, x: &[[f64; 4]]) -> f64 {
        let Self { free, rhs, scale, out, squares } = self;
        let sums = squares.of(matrix.chunk_count());
        let start = |c: usize| matrix.chunk_rows(c).start;
        par::divide(0..matrix.chunk_count(), 1, &start, out, &|chunks, out| {
            let from = start(chunks.start);
            for c in chunks {
                let rows = matrix.chunk_rows(c);
                let out = &mut out[rows.start - from..rows.end - from];
                let rest = Rest { free, rhs, scale, first: rows.start, out, square: 0.0 };
                sums[c].store(run_wide::<f64, _>(Own { matrix, x, c, rest }).to_bits(), Relaxed);
            }
        });
        squares.sum()
    }
}

/// Returns the square norm.
#[inline(always)]
fn write<A: Scalar, const N: usize>(out: &mut [A; N], b: [f64; 3], product: [f64; 3], scale: f64) -> f64 {
    let mut square = 0.0;
    for c in 0..3 {
        let r = (b[c] - product[c]) * scale;
        square += r * r;
        out[c] = A::from_f64(r);
    }
    square
}

/// The rows of a chunk of a matrix of the free rows.
struct Own<'a, M, B, A, const N: usize> {
    matrix: &'a Sliced<M>,
    x: &'a [[f64; 4]],
    c: usize,
    rest: Rest<'a, B, A, N>,
}

/// Where they go.
struct Rest<'a, B, A, const N: usize> {
    free: &'a FreePattern,
    rhs: &'a [[B; 3]],
    scale: f64,
    first: usize,
    out: &'a mut [[A; N]],
    square: f64,
}

impl<M: Scalar, B: Scalar, A: Scalar, const N: usize> Kernel for Own<'_, M, B, A, N> {
    type Output = f64;
    #[inline(always)]
    fn run<const W: usize>(mut self) -> f64 {
        self.matrix.for_rows_in_double(self.c, self.x, &mut self.rest);
        self.rest.square
    }
}

impl<B: Scalar, A: Scalar, const N: usize> RowWork<f64> for Rest<'_, B, A, N> {
    #[inline(always)]
    fn row(&mut self, row: usize, q: Wide<f64, 4>) {
        let b = self.free.of_row(self.rhs, self.first + row);
        self.square += write(&mut self.out[row], b, [q.0[0], q.0[1], q.0[2]], self.scale);
    }
}

/// Some rows from the entries of the whole system.
struct Entries<'a, R, X, B, A, const M: usize, const N: usize> {
    free: &'a FreePattern,
    identity: &'a [bool],
    scale: f64,
    matrix: &'a BlockCsr<R>,
    rhs: &'a [[B; 3]],
    x: &'a [[X; M]],
    first: usize,
    out: &'a mut [[A; N]],
}

impl<R: Scalar, X: Scalar, B: Scalar, A: Scalar, const M: usize, const N: usize> Kernel
    for Entries<'_, R, X, B, A, M, N>
{
    type Output = f64;
    /// Rows of a block as four lanes, what is too much of a load times zero: the width of the machine does not matter here.
    #[inline(always)]
    fn run<const W: usize>(self) -> f64 {
        let Self { free, identity, scale, matrix, rhs, x, first, out } = self;
        let mut square = 0.0;
        for (k, out) in out.iter_mut().enumerate() {
            let i = first + k;
            let mut product = [x[i][0].to_f64(), x[i][1].to_f64(), x[i][2].to_f64()];
            if !identity[i] {
                let mut sums = [Wide::<f64, 4>::zero(); 3];
                for k in matrix.pattern.row(free.node[i] as usize) {
                    let Some(column) = free.row_of(matrix.pattern.column()[k] as usize) else { continue };
                    if free.is_held(column) {
                        continue;
                    }
                    let a = &matrix.values[k];
                    let (p, q, r) = (x[column][0].to_f64(), x[column][1].to_f64(), x[column][2].to_f64());
                    let (x, late) = (Wide([p, q, r, 0.0]), Wide([0.0, p, q, r]));
                    sums[0] += four(a, 0) * x;
                    sums[1] += four(a, 3) * x;
                    sums[2] += four(a, 5) * late;
                }
                for c in 0..3 {
                    let [p, q, r, s] = sums[c].0;
                    product[c] = (p + q) + (r + s);
                }
            }
            square += write(out, free.of_row(rhs, i), product, scale);
        }
        square
    }
}

/// Four numbers of a block from the `first` on.
#[inline(always)]
fn four<R: Scalar>(a: &[R; 9], first: usize) -> Wide<f64, 4> {
    Wide([a[first].to_f64(), a[first + 1].to_f64(), a[first + 2].to_f64(), a[first + 3].to_f64()])
}
