//! The true residual of a solution: `b - A x` over the free rows, in f64 whatever the numbers are.
//!
//! From the caller's entries, from an iteration's own matrix where that has the same numbers, or from a product with the whole system.
//! Everything is multiplied by a scale; rows marked as those of the identity count as such.

use super::free::FreePattern;
use super::sliced::{RowWork, Sliced};
use crate::{BlockCsr, Kernel, Lane, Scalar, Wide, par, run_wide};
use rayon::prelude::*;

/// A residual on its way from products to `out`, which has three numbers a row and maybe a zero.
pub(super) struct Target<'a, B, A, const N: usize> {
    pub free: &'a FreePattern,
    pub rhs: &'a [[B; 3]],
    pub scale: f64,
    pub out: &'a mut [[A; N]],
}

impl<B: Scalar, A: Scalar, const N: usize> Target<'_, B, A, N> {
    /// The square norm of what has been written.
    fn square(&self) -> f64 {
        let out = &*self.out;
        let square = |r: &[A; N]| r.iter().map(|v| v.to_f64() * v.to_f64()).sum::<f64>();
        par::sum(out.len(), |range| out[range].iter().map(square).sum())
    }

    /// From the product of each row with the solution; returns the square norm.
    pub fn from_rows(self, product: impl Fn(usize) -> [f64; 3] + Sync) -> f64 {
        let Self { free, rhs, scale, .. } = self;
        self.out.par_iter_mut().enumerate().with_min_len(par::CHUNK).for_each(|(row, out)| {
            write(out, free.of_row(rhs, row), product(row), scale);
        });
        self.square()
    }

    /// From the entries of the whole system; returns the square norm.
    pub fn from_entries<R: Scalar, X: Scalar, const M: usize>(
        self,
        matrix: &BlockCsr<R>,
        identity: &[bool],
        x: &[[X; M]],
    ) -> f64 {
        let Self { free, rhs, scale, .. } = self;
        self.out.par_chunks_mut(par::CHUNK).enumerate().for_each(|(c, out)| {
            run_wide::<f64, _>(Entries { free, identity, scale, matrix, rhs, x, first: c * par::CHUNK, out });
        });
        self.square()
    }

    /// From the matrix of the free rows, which has the caller's numbers; returns the square norm.
    pub fn from_own<M: Scalar>(self, matrix: &Sliced<M>, x: &[[f64; 4]]) -> f64 {
        let Self { free, rhs, scale, .. } = self;
        let start = |c: usize| matrix.chunk_rows(c).start;
        par::divide(0..matrix.chunk_count(), 1, &start, &mut *self.out, &|chunks, mut out| {
            for c in chunks {
                let rows = matrix.chunk_rows(c);
                let (here, after) = std::mem::take(&mut out).split_at_mut(rows.len());
                run_wide::<f64, _>(Own { matrix, x, c, rest: Rest { free, rhs, scale, first: rows.start, out: here } });
                out = after;
            }
        });
        self.square()
    }
}

#[inline(always)]
fn write<A: Scalar, const N: usize>(out: &mut [A; N], b: [f64; 3], product: [f64; 3], scale: f64) {
    for c in 0..3 {
        out[c] = A::from_f64((b[c] - product[c]) * scale);
    }
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
}

impl<M: Scalar, B: Scalar, A: Scalar, const N: usize> Kernel for Own<'_, M, B, A, N> {
    type Output = ();
    #[inline(always)]
    fn run<const W: usize>(mut self) {
        self.matrix.for_rows_in_double(self.c, self.x, &mut self.rest);
    }
}

impl<B: Scalar, A: Scalar, const N: usize> RowWork<f64> for Rest<'_, B, A, N> {
    #[inline(always)]
    fn row(&mut self, row: usize, q: Wide<f64, 4>) {
        let b = self.free.of_row(self.rhs, self.first + row);
        write(&mut self.out[row], b, [q.0[0], q.0[1], q.0[2]], self.scale);
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
    type Output = ();
    /// Rows of a block as four lanes, what is too much of a load times zero: the width of the machine does not matter here.
    #[inline(always)]
    fn run<const W: usize>(self) {
        let Self { free, identity, scale, matrix, rhs, x, first, out } = self;
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
            write(out, free.of_row(rhs, i), product, scale);
        }
    }
}

/// Four numbers of a block from the `first` on.
#[inline(always)]
fn four<R: Scalar>(a: &[R; 9], first: usize) -> Wide<f64, 4> {
    Wide([a[first].to_f64(), a[first + 1].to_f64(), a[first + 2].to_f64(), a[first + 3].to_f64()])
}
