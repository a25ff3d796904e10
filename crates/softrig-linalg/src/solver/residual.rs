//! The true residual of a solution, from the matrix as the caller gave it.

use super::free::FreePattern;
use crate::{BlockCsr, Scalar, par};

/// `|b - A x|²` over the free nodes, in f64 whatever `R` is. With `residual`, the vector `b - A x` is also written there, one
/// entry per free row. Everything is multiplied by `scale` first. Rows marked in `identity` count as rows of the identity matrix.
pub(super) fn squared<R: Scalar>(
    free: &FreePattern,
    identity: &[bool],
    scale: f64,
    matrix: &BlockCsr<R>,
    rhs: &[[R; 3]],
    x: &(impl Fn(usize) -> [f64; 3] + Sync),
    residual: Option<&mut [[f64; 3]]>,
) -> f64 {
    let row = |i: usize| -> [f64; 3] {
        let mut r = free.of_row(rhs, i);
        if identity[i] {
            let x = x(i);
            return [(r[0] - x[0]) * scale, (r[1] - x[1]) * scale, (r[2] - x[2]) * scale];
        }
        for k in free.row(i) {
            let Some(source) = free.source(k) else { continue };
            let a = matrix.values[source].map(Scalar::to_f64);
            let x = x(free.column[k] as usize);
            for c in 0..3 {
                r[c] -= a[3 * c] * x[0] + a[3 * c + 1] * x[1] + a[3 * c + 2] * x[2];
            }
        }
        r.map(|r| r * scale)
    };
    match residual {
        None => par::sum(free.row_count(), |range| {
            range.fold(0.0, |sum, i| {
                let r = row(i);
                sum + (r[0] * r[0] + r[1] * r[1] + r[2] * r[2])
            })
        }),
        Some(out) => {
            use rayon::prelude::*;
            out.par_chunks_mut(par::CHUNK).enumerate().for_each(|(c, out)| {
                for (k, r) in out.iter_mut().enumerate() {
                    *r = row(c * par::CHUNK + k);
                }
            });
            let out = &*out;
            par::sum(out.len(), |range| out[range].iter().map(|r| r[0] * r[0] + r[1] * r[1] + r[2] * r[2]).sum())
        }
    }
}
