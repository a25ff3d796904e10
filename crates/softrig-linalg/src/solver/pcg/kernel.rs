//! The loops of one conjugate-gradient iteration, each over the rows of one chunk.
//!
//! A node is four lanes (x, y, z, 0) whatever the machine's width, so sums have one order everywhere. The fourth lane always adds
//! a zero; it is added all the same, because a compiler that sees it unused takes the other three apart. Dot products are added
//! in f64 also for f32 vectors.

use crate::par::Each;
use crate::solver::cubes::ROWS;
use crate::solver::sliced::{RowWork, Sliced};
use crate::{Kernel, Lane, Mat3, Scalar, Vec3, Wide};
use rayon::prelude::*;

/// Inverse of a diagonal block; rows end in a zero.
pub(in crate::solver) type Inverse<A> = [[A; 4]; 3];

#[inline(always)]
fn add_dot<A: Scalar>(sum: &mut Wide<f64, 4>, a: Wide<A, 4>, b: Wide<A, 4>) {
    *sum += Wide(a.0.map(Scalar::to_f64)) * Wide(b.0.map(Scalar::to_f64));
}

#[inline(always)]
fn total(sum: Wide<f64, 4>) -> f64 {
    (sum.0[0] + sum.0[1]) + (sum.0[2] + sum.0[3])
}

/// Rows of chunk `chunk` of `y = A x`; returns `xᵀ y` over them.
pub(in crate::solver) struct Product<'a, A> {
    pub matrix: &'a Sliced<A>,
    pub chunk: usize,
    pub x: &'a [[A; 4]],
    /// The rows of the chunk in `x`.
    pub own: &'a [[A; 4]],
    pub y: &'a mut [[A; 4]],
}

impl<A: Scalar> Kernel for Product<'_, A> {
    type Output = f64;

    #[inline(always)]
    fn run<const W: usize>(self) -> f64 {
        let Self { matrix, chunk, x, own, y } = self;
        let mut work = StoreAndDot { own, y, dot: Wide::<f64, 4>::zero() };
        matrix.for_rows(chunk, x, &mut work);
        work.total()
    }
}

/// Keeps the rows of a product, and adds up their products with `own`.
pub(in crate::solver) struct StoreAndDot<'a, A> {
    /// The rows of the chunk in the vector that is multiplied.
    pub own: &'a [[A; 4]],
    pub y: &'a mut [[A; 4]],
    pub dot: Wide<f64, 4>,
}

impl<A> StoreAndDot<'_, A> {
    /// The sum, always in the same order.
    #[inline(always)]
    pub fn total(self) -> f64 {
        total(self.dot)
    }
}

impl<A: Scalar> RowWork<A> for StoreAndDot<'_, A> {
    #[inline(always)]
    fn row(&mut self, row: usize, q: Wide<A, 4>) {
        self.y[row] = q.0;
        add_dot(&mut self.dot, q, Wide(self.own[row]));
    }
}

/// `x += alpha p; r -= alpha q; z = D r`; returns `(rᵀ z, rᵀ r)`. Where no `inverse` is given `z` stays, and `rᵀ z` is zero.
pub(super) struct Update<'a, A> {
    pub alpha: A,
    pub p: &'a [[A; 4]],
    pub q: &'a [[A; 4]],
    pub inverse: &'a [Inverse<A>],
    pub x: &'a mut [[A; 4]],
    pub r: &'a mut [[A; 4]],
    pub z: &'a mut [[A; 4]],
}

impl<A: Scalar> Kernel for Update<'_, A> {
    type Output = [f64; 2];

    #[inline(always)]
    fn run<const W: usize>(self) -> [f64; 2] {
        let Self { alpha, p, q, inverse, x, r, z } = self;
        let alpha = Wide::<A, 4>::splat(alpha);
        let n = p.len();
        let (q, x, r, z) = (&q[..n], &mut x[..n], &mut r[..n], &mut z[..n]);
        let (mut rz, mut rr) = (Wide::<f64, 4>::zero(), Wide::<f64, 4>::zero());
        for i in 0..n {
            x[i] = (Wide(x[i]) + alpha * Wide(p[i])).0;
            let ri = Wide(r[i]) - alpha * Wide(q[i]);
            r[i] = ri.0;
            add_dot(&mut rr, ri, ri);
            if let Some(d) = inverse.get(i) {
                // the inverse is symmetric: its rows are its columns
                let zi = (Wide(d[0]) * Wide::splat(ri.0[0]) + Wide(d[1]) * Wide::splat(ri.0[1]))
                    + Wide(d[2]) * Wide::splat(ri.0[2]);
                z[i] = zi.0;
                add_dot(&mut rz, ri, zi);
            }
        }
        [total(rz), total(rr)]
    }
}

/// Products of a vector with two others, over chunks of rows and always in the same order.
pub(super) fn dots<R: Scalar>(z: &[[R; 4]], with: [&[[R; 4]]; 2], partial: &mut [[f64; 2]]) -> (f64, f64) {
    partial.par_iter_mut().enumerate().each(|(c, partial)| {
        let rows = c * ROWS..((c + 1) * ROWS).min(z.len());
        *partial = rows.fold([0.0; 2], |sum, i| {
            let dot = |a: &[R; 4]| (0..3).map(|k| a[k].to_f64() * z[i][k].to_f64()).sum::<f64>();
            [sum[0] + dot(&with[0][i]), sum[1] + dot(&with[1][i])]
        });
    });
    partial.iter().fold((0.0, 0.0), |sum, p| (sum.0 + p[0], sum.1 + p[1]))
}

/// `p = z + beta p`.
pub(super) struct Direction<'a, A> {
    pub beta: A,
    pub z: &'a [[A; 4]],
    pub p: &'a mut [[A; 4]],
}

impl<A: Scalar> Kernel for Direction<'_, A> {
    type Output = ();

    #[inline(always)]
    fn run<const W: usize>(self) {
        let beta = Wide::<A, 4>::splat(self.beta);
        for (p, z) in self.p.iter_mut().zip(self.z) {
            *p = (Wide(*z) + beta * Wide(*p)).0;
        }
    }
}

/// Inverse of a symmetric positive definite block, in f64; `None` when it is not one.
pub(in crate::solver) fn inverse_of_block<A: Scalar>(m: [f64; 9]) -> Option<Inverse<A>> {
    // leading minors decide; on a block scaled to 1 they cannot overflow
    let scale = m[0].max(m[4]).max(m[8]);
    if !(m[0] > 0.0 && m[4] > 0.0 && m[8] > 0.0 && scale.is_finite()) {
        return None;
    }
    let m = m.map(|v| v / scale);
    let (b, c, f) = (0.5 * (m[1] + m[3]), 0.5 * (m[2] + m[6]), 0.5 * (m[5] + m[7]));
    let symmetric = Mat3([[m[0], b, c], [b, m[4], f], [c, f, m[8]]]);
    let (minor, det) = (m[0] * m[4] - b * b, symmetric.determinant());
    if !(minor > 0.0 && det > 0.0) {
        return None;
    }
    let inverse = symmetric.inverse();
    let out = inverse.0.map(|row| {
        let Vec3(row) = Vec3(row).scale(1.0 / scale);
        [A::from_f64(row[0]), A::from_f64(row[1]), A::from_f64(row[2]), A::zero()]
    });
    out.as_flattened().iter().all(|v| v.is_finite()).then_some(out)
}
