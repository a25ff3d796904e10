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
}
