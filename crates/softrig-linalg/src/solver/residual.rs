//! The true residual of a solution, from the matrix as the caller gave it.

use super::free::FreePattern;
use crate::{BlockCsr, Kernel, Lane, Scalar, Wide, par, run_wide};
use rayon::prelude::*;

/// Writes `b - A x` over the free rows to `out`, in f64 whatever `R` is, and returns its square norm. Everything is multiplied by
/// `scale` first. Rows marked in `identity` count as rows of the identity matrix.
pub(super) fn squared<R: Scalar, X: Scalar>(
    free: &FreePattern,
    identity: &[bool],
    scale: f64,
    matrix: &BlockCsr<R>,
    rhs: &[[R; 3]],
    x: &[[X; 3]],
    out: &mut [[f64; 3]],
) -> f64 {
    out.par_chunks_mut(par::CHUNK).enumerate().for_each(|(c, out)| {
        run_wide::<f64, _>(Rows { free, identity, scale, matrix, rhs, x, first: c * par::CHUNK, out });
    });
    let out = &*out;
    par::sum(out.len(), |range| out[range].iter().map(|r| r[0] * r[0] + r[1] * r[1] + r[2] * r[2]).sum())
}

/// Some rows of it.
struct Rows<'a, R, X> {
    free: &'a FreePattern,
    identity: &'a [bool],
    scale: f64,
    matrix: &'a BlockCsr<R>,
    rhs: &'a [[R; 3]],
    x: &'a [[X; 3]],
    first: usize,
    out: &'a mut [[f64; 3]],
}

impl<R: Scalar, X: Scalar> Kernel for Rows<'_, R, X> {
    type Output = ();
    /// Rows of a block as four lanes, what is too much of a load times zero: the width of the machine does not matter here.
    #[inline(always)]
    fn run<const W: usize>(self) {
        let Self { free, identity, scale, matrix, rhs, x, first, out } = self;
        for (k, out) in out.iter_mut().enumerate() {
            let i = first + k;
            let b = free.of_row(rhs, i);
            let mut product = [x[i][0].to_f64(), x[i][1].to_f64(), x[i][2].to_f64()];
            if !identity[i] {
                let mut sums = [Wide::<f64, 4>::zero(); 3];
                for k in free.row(i) {
                    let Some(source) = free.source(k) else { continue };
                    let a = &matrix.values[source];
                    let [p, q, r] = x[free.column[k] as usize];
                    let (p, q, r) = (p.to_f64(), q.to_f64(), r.to_f64());
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
            for c in 0..3 {
                out[c] = (b[c] - product[c]) * scale;
            }
        }
    }
}

/// Four numbers of a block from the `first` on.
#[inline(always)]
fn four<R: Scalar>(a: &[R; 9], first: usize) -> Wide<f64, 4> {
    Wide([a[first].to_f64(), a[first + 1].to_f64(), a[first + 2].to_f64(), a[first + 3].to_f64()])
}
