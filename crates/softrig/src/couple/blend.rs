//! Blended bone frames: where a node goes when its bones have moved.
//!
//! A bone's map is split into a rigid motion and a stretch about its joint. Rigid motions are blended as dual quaternions
//! [Kavan2008], stretches linearly. With one bone this is exactly that bone's map.

use crate::rig::Affine;
use glam::{DMat3, DQuat, DVec3};

/// One bone's map from the rest shape to the pose, split for blending.
#[derive(Clone, Copy, Debug)]
pub struct BoneMotion {
    real: DQuat,
    dual: DQuat,
    /// Stretch minus identity, about `centre`; zero for rigid motion.
    stretch: DMat3,
    centre: DVec3,
    is_rigid: bool,
    map: Affine,
}

impl BoneMotion {
    /// Splits the map of a bone whose joint rests at `joint` [m].
    #[must_use]
    pub fn new(map: &Affine, joint: [f64; 3]) -> Self {
        let linear = DMat3::from_cols_array_2d(&map.linear).transpose();
        let rotation = nearest_rotation(linear);
        let stretch = rotation.transpose() * linear - DMat3::IDENTITY;
        let is_rigid = stretch.to_cols_array().iter().all(|v| v.abs() < 1e-9);
        let centre = DVec3::from(joint);
        let real = DQuat::from_mat3(&rotation).normalize();
        // the rigid part takes the joint where the map takes it
        let t = DVec3::from(map.point(joint)) - real * centre;
        let dual = DQuat::from_xyzw(t.x, t.y, t.z, 0.0) * real * 0.5;
        Self { real, dual, stretch: if is_rigid { DMat3::ZERO } else { stretch }, centre, is_rigid, map: *map }
    }

    /// Rotation of the bone since the rest shape, a unit quaternion (x, y, z, w).
    #[must_use]
    pub fn rotation(&self) -> [f64; 4] {
        self.real.to_array()
    }
}

/// The polar rotation of a matrix by scaled Newton iteration; a mirrored or singular matrix gives its nearest sane rotation
/// as far as orthonormalised columns can tell.
fn nearest_rotation(m: DMat3) -> DMat3 {
    let det = m.determinant();
    if det.is_nan() || det <= 1e-12 * m.x_axis.length() * m.y_axis.length() * m.z_axis.length() {
        let x = m.x_axis.try_normalize().unwrap_or(DVec3::X);
        let y = (m.y_axis - x * x.dot(m.y_axis)).try_normalize().unwrap_or_else(|| x.any_orthonormal_vector());
        return DMat3::from_cols(x, y, x.cross(y));
    }
    let mut r = m * (1.0 / det.cbrt());
    for _ in 0..40 {
        let next = (r + r.inverse().transpose()) * 0.5;
        let step = (next - r).to_cols_array().iter().fold(0.0f64, |s, v| s.max(v.abs()));
        r = next;
        if step < 1e-15 {
            break;
        }
    }
    r
}

/// Where the bones take a point [m], given the motions of all bones and the point's (bone, weight) entries, heaviest first.
#[must_use]
pub fn blend_point(motions: &[BoneMotion], weights: &[(u32, f64)], p: [f64; 3]) -> [f64; 3] {
    let Some(&(first, _)) = weights.first() else { return p };
    let pivot = &motions[first as usize];
    if weights.len() == 1 {
        return pivot.map.point(p);
    }
    let x = DVec3::from(p);
    let mut stretched = x;
    let mut real = DQuat::from_xyzw(0.0, 0.0, 0.0, 0.0);
    let mut dual = real;
    for &(bone, w) in weights {
        let m = &motions[bone as usize];
        if !m.is_rigid {
            stretched += m.stretch * (x - m.centre) * w;
        }
        // the shorter way round
        let w = if m.real.dot(pivot.real) < 0.0 { -w } else { w };
        real += m.real * w;
        dual += m.dual * w;
    }
    let norm = real.length();
    let (real, dual) = (real * (1.0 / norm), dual * (1.0 / norm));
    let t = dual * real.conjugate() * 2.0;
    (real * stretched + DVec3::new(t.x, t.y, t.z)).into()
}

/// The blended rotation at a point, a unit quaternion (x, y, z, w).
#[must_use]
pub fn blend_rotation(motions: &[BoneMotion], weights: &[(u32, f64)]) -> [f64; 4] {
    let Some(&(first, _)) = weights.first() else { return DQuat::IDENTITY.to_array() };
    let pivot = motions[first as usize].real;
    let sum = weights.iter().fold(DQuat::from_xyzw(0.0, 0.0, 0.0, 0.0), |sum, &(bone, w)| {
        let q = motions[bone as usize].real;
        sum + q * if q.dot(pivot) < 0.0 { -w } else { w }
    });
    sum.normalize().to_array()
}

/// How a point moves with its bones: for every entry of `weights` the 3x6 matrix (rows one after the other) that takes the
/// bone's twist to the point's velocity. A twist is the angular velocity and the velocity of the bone at its `origin`, in
/// world axes. The derivative of [`blend_point`].
pub(crate) fn blend_derivative(
    motions: &[BoneMotion],
    weights: &[(u32, f64)],
    p: [f64; 3],
    origin: &[DVec3],
    out: &mut [[f64; 18]],
) {
    if let [(bone, _)] = weights {
        let r = DVec3::from(motions[*bone as usize].map.point(p)) - origin[*bone as usize];
        out[0] = [
            0.0, r.z, -r.y, 1.0, 0.0, 0.0, //
            -r.z, 0.0, r.x, 0.0, 1.0, 0.0, //
            r.y, -r.x, 0.0, 0.0, 0.0, 1.0,
        ];
        return;
    }
    let Some(&(first, _)) = weights.first() else { return };
    let pivot = motions[first as usize].real;
    let x = DVec3::from(p);
    let zero = DQuat::from_xyzw(0.0, 0.0, 0.0, 0.0);
    let (mut stretched, mut real, mut dual) = (x, zero, zero);
    let signed = |m: &BoneMotion, w: f64| if m.real.dot(pivot) < 0.0 { -w } else { w };
    for &(bone, w) in weights {
        let m = &motions[bone as usize];
        if !m.is_rigid {
            stretched += m.stretch * (x - m.centre) * w;
        }
        real += m.real * signed(m, w);
        dual += m.dual * signed(m, w);
    }
    let scale = 1.0 / real.length();
    let (real, dual) = (real * scale, dual * scale);
    let (back, arm) = (real.conjugate(), real * stretched);
    for (&(bone, w), out) in weights.iter().zip(out) {
        let m = &motions[bone as usize];
        let half = 0.5 * signed(m, w) * scale;
        for c in 0..6 {
            let axis = DVec3::AXES[c % 3];
            let (turn, velocity) = if c < 3 { (axis, origin[bone as usize].cross(axis)) } else { (DVec3::ZERO, axis) };
            let pure = |v: DVec3| DQuat::from_xyzw(v.x, v.y, v.z, 0.0);
            // of the weighted sums, then of the normalised ones
            let d_real = pure(turn) * m.real * half;
            let d_dual = (pure(turn) * m.dual + pure(velocity) * m.real) * half;
            let growth = d_real.dot(real);
            let (d_real, d_dual) = (d_real - real * growth, d_dual - dual * growth);
            let spin = d_real * back * 2.0;
            let shift = (d_dual * back + dual * d_real.conjugate()) * 2.0;
            let moved = DVec3::new(spin.x, spin.y, spin.z).cross(arm) + DVec3::new(shift.x, shift.y, shift.z);
            (0..3).for_each(|r| out[6 * r + c] = moved[r]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rig::Transform;

    fn map(rotation: [f64; 4], translation: [f64; 3], scale: [f64; 3]) -> Affine {
        let q = DQuat::from_array(rotation).normalize().to_array();
        Transform { translation, rotation: q, scale }.to_affine()
    }

    fn close(a: [f64; 3], b: [f64; 3]) -> bool {
        (0..3).all(|k| (a[k] - b[k]).abs() < 1e-12)
    }

    /// Far from joints the frame is exactly the bone's own, stretch included.
    #[test]
    fn one_bone_is_followed_exactly() {
        let m = map([0.2, -0.5, 0.1, 0.8], [1.0, 2.0, -3.0], [1.0, 1.3, 0.8]);
        let motion = [BoneMotion::new(&m, [0.3, 0.1, 0.0])];
        let p = [0.4, -0.2, 0.7];
        assert!(close(blend_point(&motion, &[(0, 1.0)], p), m.point(p)));
    }

    /// Two bones that moved alike leave nothing to blend.
    #[test]
    fn equal_bones_blend_to_themselves() {
        let m = map([0.2, -0.5, 0.1, 0.8], [1.0, 2.0, -3.0], [1.2, 1.2, 1.2]);
        let motions = [BoneMotion::new(&m, [0.0; 3]), BoneMotion::new(&m, [0.0; 3])];
        let p = [0.4, -0.2, 0.7];
        assert!(close(blend_point(&motions, &[(0, 0.6), (1, 0.4)], p), m.point(p)));
    }

    /// Half a twist of 170 degrees keeps the distance from the axis, where averaging matrices would shrink it to 9 %.
    #[test]
    fn twist_keeps_the_girth() {
        let a = 170f64.to_radians() / 2.0;
        let still = BoneMotion::new(&Affine::IDENTITY, [0.0; 3]);
        let twisted = BoneMotion::new(&map([a.sin(), 0.0, 0.0, a.cos()], [0.0; 3], [1.0; 3]), [0.0; 3]);
        let p = blend_point(&[still, twisted], &[(0, 0.5), (1, 0.5)], [0.1, 1.0, 0.0]);
        assert!((p[1].hypot(p[2]) - 1.0).abs() < 1e-12, "{p:?}");
    }

    /// Central differences of the blended position under a twist of each bone, for rigid and stretched bones and for nodes
    /// of one bone and of several.
    #[test]
    fn derivatives_are_those_of_the_blended_position() {
        let turned = |q: [f64; 4], t, s: f64| map(q, t, [s, s, 1.1 * s]);
        let maps = [
            turned([0.2, -0.5, 0.1, 0.8], [1.0, 2.0, -3.0], 1.0),
            turned([0.6, 0.1, 0.1, 0.7], [1.2, 1.7, -3.1], 1.2),
            turned([-0.1, -0.3, 0.4, -0.8], [0.9, 2.2, -2.8], 0.9),
        ];
        let joints = [[0.3, 0.1, 0.0], [0.1, 0.5, 0.2], [-0.2, 0.3, 0.6]];
        let motions = |maps: &[Affine; 3]| [0, 1, 2].map(|b| BoneMotion::new(&maps[b], joints[b]));
        let origin: Vec<DVec3> = (0..3).map(|b| DVec3::from(maps[b].point(joints[b]))).collect();
        let p = [0.4, -0.2, 0.7];
        for weights in [&[(1, 1.0)][..], &[(0, 0.5), (2, 0.3), (1, 0.2)]] {
            let mut matrix = vec![[0.0; 18]; weights.len()];
            blend_derivative(&motions(&maps), weights, p, &origin, &mut matrix);
            for (entry, (bone, _)) in weights.iter().enumerate() {
                for c in 0..6 {
                    let side = |h: f64| {
                        let mut maps = maps;
                        let (b, at) = (*bone as usize, origin[*bone as usize]);
                        let axis = DVec3::AXES[c % 3] * h;
                        let q = if c < 3 { DQuat::from_scaled_axis(axis) } else { DQuat::IDENTITY };
                        let turn = Affine::from_rotation(q.to_array());
                        let shift = at - q * at + if c < 3 { DVec3::ZERO } else { axis };
                        maps[b] = Affine { translation: shift.into(), ..turn }.after(&maps[b]);
                        DVec3::from(blend_point(&motions(&maps), weights, p))
                    };
                    let difference = (side(1e-5) - side(-1e-5)) / 2e-5;
                    let column = DVec3::new(matrix[entry][c], matrix[entry][6 + c], matrix[entry][12 + c]);
                    assert!((difference - column).length() < 1e-8, "{weights:?} {entry} {c} {difference} {column}");
                }
            }
        }
    }
}
