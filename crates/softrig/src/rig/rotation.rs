//! Rotations taken apart: rotation vectors, swing and twist, and the rotation inside a linear map.

use super::affine::Affine;
use glam::{DMat3, DQuat, DVec3};

/// The rotation by the vector's length about its direction.
pub(crate) fn exp(v: DVec3) -> DQuat {
    DQuat::from_scaled_axis(v)
}

/// The rotation vector of a unit quaternion, shorter than half a turn.
pub(crate) fn log(q: DQuat) -> DVec3 {
    let q = if q.w < 0.0 { -q } else { q };
    let v = DVec3::new(q.x, q.y, q.z);
    let sine = v.length();
    // below this the angle is twice the sine to all digits
    if sine < 1e-9 { v * 2.0 } else { v * (2.0 * sine.atan2(q.w) / sine) }
}

/// Angle of the part of `q` that turns about the unit `axis`, in (-π, π]: q = swing · twist, and also q = twist · swing'.
pub(crate) fn twist(q: DQuat, axis: DVec3) -> f64 {
    let along = DVec3::new(q.x, q.y, q.z).dot(axis);
    // a swing of half a turn has no twist to speak of
    if along.hypot(q.w) < 1e-12 {
        return 0.0;
    }
    let angle = 2.0 * along.atan2(q.w);
    if angle > std::f64::consts::PI {
        angle - std::f64::consts::TAU
    } else if angle <= -std::f64::consts::PI {
        angle + std::f64::consts::TAU
    } else {
        angle
    }
}

/// `q` as swing · twist about `axis`: the swing's rotation vector (at right angles to the axis) and the twist's angle.
pub(crate) fn swing_twist(q: DQuat, axis: DVec3) -> (DVec3, f64) {
    let angle = twist(q, axis);
    let swing = log(q * DQuat::from_axis_angle(axis, -angle));
    // rounding leaves a trace along the axis
    (swing - axis * swing.dot(axis), angle)
}

/// The nearest rotation that swings at most by `cone` and twists within `range`, in the sense of the one decomposition.
pub(crate) fn clamp_swing_twist(q: DQuat, axis: DVec3, cone: f64, range: [f64; 2]) -> DQuat {
    let (swing, angle) = swing_twist(q, axis);
    let length = swing.length();
    let inside = length <= cone && angle >= range[0] && angle <= range[1];
    if inside {
        return q;
    }
    let swing = if length > cone { swing * (cone / length) } else { swing };
    (exp(swing) * DQuat::from_axis_angle(axis, angle.clamp(range[0], range[1]))).normalize()
}

/// A rotation that a linear map contains: its first two columns, made orthonormal. What is left over is the map's stretch.
pub(crate) fn rotation_in(map: &Affine) -> DQuat {
    DQuat::from_mat3(&orthonormal(matrix(map))).normalize()
}

/// Axes of rotations seen through a map: orthonormal, and of a mirrored frame turned the other way round. A map turned in the
/// world has its axes turned just so, whatever it stretches.
pub(crate) fn axis_map(map: &Affine) -> DMat3 {
    let m = matrix(map);
    orthonormal(m * m.determinant().signum())
}

fn matrix(map: &Affine) -> DMat3 {
    DMat3::from_cols_array_2d(&map.linear).transpose()
}

fn orthonormal(m: DMat3) -> DMat3 {
    let x = m.x_axis.try_normalize().unwrap_or(DVec3::X);
    let y = (m.y_axis - x * x.dot(m.y_axis)).try_normalize().unwrap_or_else(|| x.any_orthonormal_vector());
    DMat3::from_cols(x, y, x.cross(y))
}

/// Whether a map turns and scales alike in all directions, so that lengths beyond it do not depend on direction.
pub(crate) fn keeps_angles(map: &Affine) -> bool {
    let m = matrix(map);
    let gram = m.transpose() * m;
    let mean = (gram.x_axis.x + gram.y_axis.y + gram.z_axis.z) / 3.0;
    let off = (gram - DMat3::from_diagonal(DVec3::splat(mean))).to_cols_array();
    mean > 0.0 && off.iter().all(|v| v.abs() < 1e-4 * mean)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn swing_and_twist_make_the_rotation_again() {
        let axis = DVec3::new(0.36, 0.48, 0.8);
        let q = exp(DVec3::new(1.1, -0.4, 2.2));
        let (swing, angle) = swing_twist(q, axis);
        assert!(swing.dot(axis).abs() < 1e-12);
        let back = exp(swing) * DQuat::from_axis_angle(axis, angle);
        assert!(back.dot(q).abs() > 1.0 - 1e-12);
        // the same twist taken off on the other side
        let rest = DQuat::from_axis_angle(axis, -angle) * q;
        assert!(twist(rest, axis).abs() < 1e-12);
    }

    #[test]
    fn logarithm_undoes_the_exponential() {
        for v in [DVec3::ZERO, DVec3::new(1e-12, 0.0, 0.0), DVec3::new(0.3, -2.0, 1.0), DVec3::new(0.0, 3.1, 0.0)] {
            assert!((log(exp(v)) - v).length() < 1e-12, "{v}");
        }
    }
}
