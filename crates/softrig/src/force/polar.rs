//! The rotation of a deformation gradient: R in SO(3) with the largest tr(Rᵀ F).
//!
//! Warm start: three steps of the analytic polar decomposition [Kugelstadt2018], a Newton iteration on a quaternion that is
//! exact to rounding when the rotation has turned by some degrees since the last step. From far away it may land on a saddle,
//! so its result is accepted only where tr(S) I − S, S = sym(Rᵀ F), is positive definite and the gradient is gone: that is the
//! maximum. Elsewhere: the polar factor from the singular value decomposition, the smallest singular value signed as det F.
//!
//! Terms: F deformation gradient [-]; q quaternion (x, y, z, w); B = Rᵀ F; g gradient and H Hessian of −tr(Rᵀ F) in the angle.
#![allow(non_snake_case, reason = "symbols of the continuum mechanics literature")]

use softrig_linalg::{Lane, Mat3, Scalar, Vec3};

/// Steps of the warm-started iteration: three are exact to rounding at 5 degrees a step and to 3e-14 at 30.
const STEPS: usize = 3;

/// Rotation matrix of a unit quaternion (x, y, z, w).
#[inline(always)]
#[must_use]
pub fn rotation<S: Lane>(q: [S; 4]) -> Mat3<S> {
    let [x, y, z, w] = q;
    let (one, two) = (S::one(), S::constant(2.0));
    Mat3([
        [one - two * (y * y + z * z), two * (x * y - z * w), two * (x * z + y * w)],
        [two * (x * y + z * w), one - two * (x * x + z * z), two * (y * z - x * w)],
        [two * (x * z - y * w), two * (y * z + x * w), one - two * (x * x + y * y)],
    ])
}

/// Symmetric part.
#[inline(always)]
#[must_use]
pub fn symmetric<S: Lane>(m: Mat3<S>) -> Mat3<S> {
    (m + m.transpose()).scale(S::constant(0.5))
}

/// Up to three steps from `q` towards the rotation of `F`; a `q` that is there already stays as it is, bit for bit. The second
/// value is 1 where the result is known to be the rotation and 0 where only [`polar_cold`] can tell.
#[inline(always)]
#[must_use]
pub fn polar_warm<S: Lane>(F: Mat3<S>, q: [S; 4]) -> ([S; 4], S) {
    // sizes of order one, so that thresholds mean the same for every cell
    let F = F.scale(S::one() / F.frobenius_norm());
    let epsilon = S::Scalar::EPSILON.to_f64();
    // there: what rounding leaves of the gradient
    let there = S::constant(256.0 * epsilon * epsilon);
    let mut q = q;
    let mut B = rotation(q).transpose() * F;
    // hidden from the optimiser: one loop body instead of three copies in every kernel
    for _ in 0..std::hint::black_box(STEPS) {
        let g = gradient(B);
        let square = g.dot(g);
        let mut moving = false;
        for lane in 0..S::WIDTH {
            moving |= square.get(lane) > there.get(lane);
        }
        if !moving {
            break;
        }
        // lane by lane, so that neighbours do not show in the result
        let next = newton_step(B, g, q);
        for c in 0..4 {
            q[c] = S::select_lt(there, square, next[c], q[c]);
        }
        B = rotation(q).transpose() * F;
    }
    let g = gradient(B);
    let s = symmetric(B);
    let trace = s.trace();
    let G = Mat3::diagonal(trace) - s;
    // positive definite: all leading minors, with a margin for rounding
    let margin = S::constant(16.0 * epsilon);
    let minor = G.0[0][0] * G.0[1][1] - G.0[0][1] * G.0[1][0];
    let (yes, no) = (S::one(), S::zero());
    let mut accepted = S::select_lt(margin, G.0[0][0], yes, no);
    accepted = S::select_lt(margin, minor, accepted, no);
    accepted = S::select_lt(margin, G.determinant(), accepted, no);
    // what is left of the angle ends up as a net torque of the cell: allow little more than rounding
    let tolerance = (32.0 * epsilon).max(1e-9);
    accepted = S::select_lt(g.dot(g), S::constant(tolerance * tolerance), accepted, no);
    (q, accepted)
}

/// One step from `q` towards the rotation of `F`, unchecked: for callers that step so often that cells turn by little between, and
/// call [`polar`] now and then. What is left of an angle θ is of order θ³. Entries of `F` must be of order one.
#[inline(always)]
#[must_use]
pub fn polar_step<S: Lane>(F: Mat3<S>, q: [S; 4]) -> [S; 4] {
    let B = rotation(q).transpose() * F;
    newton_step(B, gradient(B), q)
}

/// Gradient of −tr(Rᵀ F) in a rotation of R, from B = Rᵀ F.
#[inline(always)]
fn gradient<S: Lane>(B: Mat3<S>) -> Vec3<S> {
    let b = B.0;
    Vec3([b[1][2] - b[2][1], b[2][0] - b[0][2], b[0][1] - b[1][0]])
}

/// One Newton step on the quaternion, through the Cayley map.
#[inline(always)]
fn newton_step<S: Lane>(B: Mat3<S>, g: Vec3<S>, q: [S; 4]) -> [S; 4] {
    let b = B.0;
    let half = S::constant(0.5);
    let (h01, h02, h12) = (-(b[0][1] + b[1][0]) * half, -(b[0][2] + b[2][0]) * half, -(b[1][2] + b[2][1]) * half);
    let H = Mat3([[b[1][1] + b[2][2], h01, h02], [h01, b[0][0] + b[2][2], h12], [h02, h12, b[0][0] + b[1][1]]]);
    let C = H.cofactors();
    let det = H.row(0).dot(C.row(0));
    // Newton, or a plain gradient step where the Hessian says nothing or points uphill
    let tiny = S::constant(1e-9);
    let newton = (C * g).scale(S::constant(-0.25) / det);
    let one = S::one();
    let flat = S::select_lt(det.abs(), tiny, one, S::zero());
    let uphill = S::select_lt(S::zero(), newton.dot(g), one, S::zero());
    let mut w = newton;
    for k in 0..3 {
        w.0[k] = S::select_lt(half, uphill, -g.0[k] * S::constant(0.125), w.0[k]);
        w.0[k] = S::select_lt(half, flat, -g.0[k], w.0[k]);
    }
    let ww = w.dot(w);
    let inverse = one / (one + ww);
    let (dw, dv) = ((one - ww) * inverse, w.scale((one + one) * inverse));
    // q <- normalised q * dq
    let v = Vec3([q[0], q[1], q[2]]);
    let u = dv.scale(q[3]) + v.scale(dw) + v.cross(dv);
    let r = q[3] * dw - v.dot(dv);
    let scale = one / (u.dot(u) + r * r).sqrt();
    [u.0[0] * scale, u.0[1] * scale, u.0[2] * scale, r * scale]
}

/// The rotation of `F` from nothing, in f64. `None` when `F` is zero or not finite: keep the previous rotation then.
/// Where the rotation is not unique (one singular direction left) it stays close to `previous`.
#[must_use]
pub fn polar_cold(F: [[f64; 3]; 3], previous: [f64; 4]) -> Option<[f64; 4]> {
    let norm = Mat3(F).frobenius_norm();
    if !(norm > 1e-150 && norm < 1e150) {
        return None;
    }
    let F = Mat3(F).scale(1.0 / norm);
    let (values, vectors) = eigen_symmetric(F.transpose() * F);
    // two largest singular directions; the third follows from both bases being right-handed
    let order = {
        let mut o = [0, 1, 2];
        o.sort_by(|a, b| values[*b].total_cmp(&values[*a]));
        o
    };
    let (v1, v2) = (vectors.column(order[0]), vectors.column(order[1]));
    let v3 = v1.cross(v2);
    let fv1 = F * v1;
    let u1 = fv1.scale(1.0 / fv1.norm());
    let across = |c: Vec3<f64>| c - u1.scale(u1.dot(c));
    let mut u2 = across(F * v2);
    if u2.norm() < 1e-13 {
        u2 = across(rotation(previous) * v2);
        if u2.norm().is_nan() || u2.norm() < 1e-3 {
            let a = u1.0.map(f64::abs);
            let k = (0..3).fold(0, |k, i| if a[i] < a[k] { i } else { k });
            u2 = across(Mat3::identity().row(k));
        }
    }
    let u2 = u2.scale(1.0 / u2.norm());
    let u3 = u1.cross(u2);
    let R = Mat3::from_columns(u1, u2, u3) * Mat3::from_columns(v1, v2, v3).transpose();
    let q = quaternion(R);
    // squaring F has cost digits for thin cells: give them back
    let (polished, accepted) = polar_warm(F, q);
    Some(if accepted > 0.5 { polished } else { q })
}

/// Unit quaternion (x, y, z, w) of a rotation matrix.
fn quaternion(R: Mat3<f64>) -> [f64; 4] {
    let r = R.0;
    let t = [r[0][0] - r[1][1] - r[2][2], r[1][1] - r[0][0] - r[2][2], r[2][2] - r[0][0] - r[1][1], R.trace()];
    let k = (0..4).fold(0, |k, i| if t[i] > t[k] { i } else { k });
    let (x, y, z) = (r[2][1] - r[1][2], r[0][2] - r[2][0], r[1][0] - r[0][1]);
    let (xy, xz, yz) = (r[1][0] + r[0][1], r[0][2] + r[2][0], r[2][1] + r[1][2]);
    let big = 1.0 + t[k];
    let q = match k {
        0 => [big, xy, xz, x],
        1 => [xy, big, yz, y],
        2 => [xz, yz, big, z],
        _ => [x, y, z, big],
    };
    let norm = q.iter().map(|c| c * c).sum::<f64>().sqrt();
    q.map(|c| c / norm)
}

/// Eigenvalues and eigenvectors (columns) of a symmetric matrix, by cyclic Jacobi rotations.
#[must_use]
pub fn eigen_symmetric(m: Mat3<f64>) -> ([f64; 3], Mat3<f64>) {
    let mut a = m.0;
    let mut v = Mat3::<f64>::identity().0;
    // converges quadratically: 3x3 matrices need about five sweeps
    for _ in 0..16 {
        let off = a[0][1] * a[0][1] + a[0][2] * a[0][2] + a[1][2] * a[1][2];
        let on = a[0][0] * a[0][0] + a[1][1] * a[1][1] + a[2][2] * a[2][2];
        if off <= 1e-34 * on || !off.is_finite() {
            break;
        }
        for (p, q) in [(0, 1), (0, 2), (1, 2)] {
            if a[p][q] == 0.0 {
                continue;
            }
            let theta = (a[q][q] - a[p][p]) / (2.0 * a[p][q]);
            let t = theta.signum() / (theta.abs() + (theta * theta + 1.0).sqrt());
            let t = if theta == 0.0 { 1.0 } else { t };
            let c = 1.0 / (t * t + 1.0).sqrt();
            let s = t * c;
            for k in 0..3 {
                let (kp, kq) = (a[k][p], a[k][q]);
                a[k][p] = c * kp - s * kq;
                a[k][q] = s * kp + c * kq;
            }
            for k in 0..3 {
                let (pk, qk) = (a[p][k], a[q][k]);
                a[p][k] = c * pk - s * qk;
                a[q][k] = s * pk + c * qk;
            }
            for row in &mut v {
                let (kp, kq) = (row[p], row[q]);
                row[p] = c * kp - s * kq;
                row[q] = s * kp + c * kq;
            }
        }
    }
    ([a[0][0], a[1][1], a[2][2]], Mat3(v))
}

/// Rotations of several cells side by side: warm start, and the cold route for the lanes that need it.
#[inline(always)]
#[must_use]
pub fn polar<S: Lane>(F: Mat3<S>, q: [S; 4]) -> [S; 4] {
    let (mut out, accepted) = polar_warm(F, q);
    let mut rejected = false;
    for lane in 0..S::WIDTH {
        rejected |= accepted.get(lane) < S::Scalar::from_f64(0.5);
    }
    if rejected {
        rescue(&F, &q, &mut out, &accepted);
    }
    out
}

/// The cold route, lane by lane. Kept out of the hot loop's code.
#[cold]
#[inline(never)]
fn rescue<S: Lane>(F: &Mat3<S>, previous: &[S; 4], out: &mut [S; 4], accepted: &S) {
    for lane in (0..S::WIDTH).filter(|l| accepted.get(*l) < S::Scalar::from_f64(0.5)) {
        let before = previous.map(|c| c.get(lane).to_f64());
        let q = polar_cold(F.0.map(|r| r.map(|x| x.get(lane).to_f64())), before).unwrap_or(before);
        for (o, c) in out.iter_mut().zip(q) {
            o.set(lane, S::Scalar::from_f64(c));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use softrig_linalg::Wide;

    fn turn(axis: [f64; 3], angle: f64) -> [f64; 4] {
        let n = Vec3(axis).norm();
        let s = (angle / 2.0).sin() / n;
        [axis[0] * s, axis[1] * s, axis[2] * s, (angle / 2.0).cos()]
    }

    /// A start on the far side must not be believed: half a turn away is a saddle of the iteration.
    #[test]
    fn far_starts_still_end_at_the_rotation() {
        for angle in [0.1, 1.0, 2.0, 3.0, 3.1] {
            for stretch in [[1.0, 1.1, 0.9], [0.1, 2.0, 1.0], [-0.3, 1.0, 1.2]] {
                let truth = turn([1.0, 2.0, -0.5], angle);
                let s = Mat3([[stretch[0], 0.0, 0.0], [0.0, stretch[1], 0.0], [0.0, 0.0, stretch[2]]]);
                let F = rotation(truth) * s;
                let R = rotation(polar(F, [0.0, 0.0, 0.0, 1.0]));
                assert!((R - rotation(truth)).frobenius_norm() < 1e-12, "{angle} {stretch:?}");
            }
        }
    }

    /// What makes a second linearisation at the same place cheap, and harmless to a restored history.
    #[test]
    fn a_rotation_that_is_found_stays_bit_for_bit() {
        for k in 0..50 {
            let F = Mat3(std::array::from_fn(|i| std::array::from_fn(|j| f64::from(k * 9 + (i * 3 + j) as i32).sin())));
            let q = polar(F, [0.0, 0.0, 0.0, 1.0]);
            let q = polar(F, q);
            assert_eq!(polar(F, q), q);
        }
    }

    #[test]
    fn zero_and_nan_keep_the_previous_rotation() {
        let q = turn([0.0, 1.0, 0.0], 0.7);
        assert_eq!(polar(Mat3::zero(), q), q);
        assert_eq!(polar(Mat3::diagonal(f64::NAN), q), q);
        assert_eq!(polar(Mat3::diagonal(f64::INFINITY), q), q);
    }

    /// Lanes that need the cold route do not disturb their neighbours.
    #[test]
    fn wide_rotations_have_the_bits_of_scalar_ones() {
        let f: Vec<[[f64; 3]; 3]> = (0..4)
            .map(|k| std::array::from_fn(|i| std::array::from_fn(|j| ((k * 9 + i * 3 + j) as f64 * 1.7).sin())))
            .collect();
        let wide =
            Mat3(std::array::from_fn(|i| std::array::from_fn(|j| Wide::<f64, 4>(std::array::from_fn(|l| f[l][i][j])))));
        let identity = [0.0, 0.0, 0.0, 1.0];
        let q = polar(wide, identity.map(Wide::<f64, 4>::splat));
        for l in 0..4 {
            assert_eq!(q.map(|c| c.get(l)), polar(Mat3(f[l]), identity), "lane {l}");
        }
    }
}
