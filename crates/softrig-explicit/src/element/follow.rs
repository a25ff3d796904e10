//! Rotations that follow their cells by one step of the polar iteration, and forces from them.
//!
//! The step is [`softrig::force::polar::polar_step`] with fewer operations: the Hessian is symmetric, and (1 - w², 2 w) / (1 + w²) times a
//! unit quaternion has length one but for rounding, which the next search to rounding takes away.
//! Terms: F deformation gradient [-]; q quaternion of R; B = Rᵀ F; g gradient and H Hessian of -tr(Rᵀ F) in the angle; P stress of the
//! reference shape times the volume [N m].
#![allow(non_snake_case, reason = "symbols of the continuum mechanics literature")]

use crate::lanes::whole;
use softrig::force::polar::{polar, polar_step, rotation};
use softrig_linalg::{Lane, Mat3, Scalar, Vec3, Wide};

/// How rotations follow the positions: a type, so that a loop holds the code of one way only and keeps its numbers in registers.
pub(super) trait Rotations: Copy + Send + Sync {
    /// The rotation of F, from that of the last force.
    fn follow<R: Scalar, const N: usize>(self, F: Mat3<Wide<R, N>>, q: [Wide<R, N>; 4]) -> [Wide<R, N>; 4];
}

/// To rounding.
#[derive(Clone, Copy)]
pub(super) struct Exactly;

/// By one step of the iteration.
#[derive(Clone, Copy)]
pub(super) struct OneStep;

/// Not: those of the last force stay.
#[derive(Clone, Copy)]
pub(super) struct Still;

impl Rotations for Exactly {
    #[inline(always)]
    fn follow<R: Scalar, const N: usize>(self, F: Mat3<Wide<R, N>>, q: [Wide<R, N>; 4]) -> [Wide<R, N>; 4] {
        polar(F, q)
    }
}

impl Rotations for Still {
    #[inline(always)]
    fn follow<R: Scalar, const N: usize>(self, _: Mat3<Wide<R, N>>, q: [Wide<R, N>; 4]) -> [Wide<R, N>; 4] {
        q
    }
}

impl Rotations for OneStep {
    #[inline(always)]
    fn follow<R: Scalar, const N: usize>(self, F: Mat3<Wide<R, N>>, q: [Wide<R, N>; 4]) -> [Wide<R, N>; 4] {
        let b = whole(rotation(q).transpose() * F).0;
        let g = Vec3([b[1][2] - b[2][1], b[2][0] - b[0][2], b[0][1] - b[1][0]]);
        let half = Wide::<R, N>::constant(-0.5);
        let (d, e, f) = (half * (b[0][1] + b[1][0]), half * (b[0][2] + b[2][0]), half * (b[1][2] + b[2][1]));
        let (x, y, z) = (b[1][1] + b[2][2], b[0][0] + b[2][2], b[0][0] + b[1][1]);
        // cofactors of the symmetric Hessian [x d e; d y f; e f z]
        let (xx, yy, zz) = (y * z - f * f, x * z - e * e, x * y - d * d);
        let (xy, xz, yz) = (e * f - d * z, d * f - e * y, d * e - x * f);
        let det = x * xx + d * xy + e * xz;
        let n = Vec3([
            xx * g.0[0] + xy * g.0[1] + xz * g.0[2],
            xy * g.0[0] + yy * g.0[1] + yz * g.0[2],
            xz * g.0[0] + yz * g.0[1] + zz * g.0[2],
        ]);
        // a Hessian that says nothing or points uphill is left to the careful step
        let sense = whole(n.dot(g).min(det - Wide::<R, N>::constant(1e-9))).0;
        if !sense.iter().fold(true, |all, s| all & (*s >= R::zero())) {
            return by_care(&F, &q);
        }
        let one = Wide::<R, N>::one();
        let w = n.scale(Wide::<R, N>::constant(-0.25) / det);
        let ww = w.dot(w);
        let inverse = one / (one + ww);
        // q dq
        let (r, t) = ((one - ww) * inverse, w.scale(inverse + inverse));
        let v = Vec3([q[0], q[1], q[2]]);
        let u = t.scale(q[3]) + v.scale(r) + v.cross(t);
        [u.0[0], u.0[1], u.0[2], q[3] * r - v.dot(t)]
    }
}

#[cold]
#[inline(never)]
fn by_care<R: Scalar, const N: usize>(F: &Mat3<Wide<R, N>>, q: &[Wide<R, N>; 4]) -> [Wide<R, N>; 4] {
    polar_step(*F, *q)
}

/// P = 2 mu (F - R) + lam (tr(Rᵀ F) - 3) R: what R (2 mu (S - I) + lam tr(S - I) I) is, with S = Rᵀ F symmetric.
#[inline(always)]
pub(super) fn warped_stress<R: Scalar, const N: usize>(
    F: Mat3<Wide<R, N>>,
    rot: Mat3<Wide<R, N>>,
    lambda: Wide<R, N>,
    two_mu: Wide<R, N>,
) -> Mat3<Wide<R, N>> {
    let (f, r) = (F.0, rot.0);
    let trace = (f[0][0] * r[0][0] + f[0][1] * r[0][1] + f[0][2] * r[0][2])
        + (f[1][0] * r[1][0] + f[1][1] * r[1][1] + f[1][2] * r[1][2])
        + (f[2][0] * r[2][0] + f[2][1] * r[2][1] + f[2][2] * r[2][2]);
    let s = lambda * (trace - Wide::constant(3.0)) - two_mu;
    let mut P = F;
    for i in 0..3 {
        for j in 0..3 {
            P.0[i][j] = two_mu * f[i][j] + s * r[i][j];
        }
    }
    P
}
