//! Affine maps, and the translation-rotation-scale form that files and clips use.

use glam::{DMat3, DQuat, DVec3};

/// An affine map `x -> linear x + translation`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Affine {
    /// Row-major 3x3 matrix [-].
    pub linear: [[f64; 3]; 3],
    /// Image of the origin [m].
    pub translation: [f64; 3],
}

impl Default for Affine {
    fn default() -> Self {
        Self::IDENTITY
    }
}

impl Affine {
    /// The map that changes nothing.
    pub const IDENTITY: Self =
        Self { linear: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], translation: [0.0; 3] };

    /// A uniform scale about the origin.
    #[must_use]
    pub fn from_scale(s: f64) -> Self {
        Self { linear: [[s, 0.0, 0.0], [0.0, s, 0.0], [0.0, 0.0, s]], translation: [0.0; 3] }
    }

    /// A translation.
    #[must_use]
    pub fn from_translation(t: [f64; 3]) -> Self {
        Self { translation: t, ..Self::IDENTITY }
    }

    /// A rotation by the unit quaternion (x, y, z, w).
    #[must_use]
    pub fn from_rotation(q: [f64; 4]) -> Self {
        Self { linear: rows(DMat3::from_quat(DQuat::from_array(q).normalize())), translation: [0.0; 3] }
    }

    /// From sixteen numbers, column-major, as glTF stores matrices; the last row is ignored.
    #[must_use]
    pub fn from_columns(m: &[f64; 16]) -> Self {
        Self {
            linear: [[m[0], m[4], m[8]], [m[1], m[5], m[9]], [m[2], m[6], m[10]]],
            translation: [m[12], m[13], m[14]],
        }
    }

    /// Image of a point.
    #[must_use]
    pub fn point(&self, p: [f64; 3]) -> [f64; 3] {
        let v = self.vector(p);
        [v[0] + self.translation[0], v[1] + self.translation[1], v[2] + self.translation[2]]
    }

    /// Image of a direction: without the translation.
    #[must_use]
    pub fn vector(&self, v: [f64; 3]) -> [f64; 3] {
        let r = |i: usize| self.linear[i][0] * v[0] + self.linear[i][1] * v[1] + self.linear[i][2] * v[2];
        [r(0), r(1), r(2)]
    }

    /// `self` after `first`: `x -> self(first(x))`.
    #[must_use]
    pub fn after(&self, first: &Self) -> Self {
        let mut linear = [[0.0; 3]; 3];
        for (i, row) in linear.iter_mut().enumerate() {
            for (j, v) in row.iter_mut().enumerate() {
                *v = (0..3).map(|k| self.linear[i][k] * first.linear[k][j]).sum();
            }
        }
        Self { linear, translation: self.point(first.translation) }
    }

    /// Determinant of the linear part: the factor by which volumes change.
    #[must_use]
    pub fn determinant(&self) -> f64 {
        matrix(&self.linear).determinant()
    }

    /// The inverse map; `None` when the linear part is singular or not finite.
    #[must_use]
    pub fn inverse(&self) -> Option<Self> {
        let m = matrix(&self.linear);
        // relative to the size of the columns: a scale of 1e-3 is no reason to call a map singular
        let size = (m.x_axis.length() * m.y_axis.length() * m.z_axis.length()).abs();
        let det = m.determinant();
        if !(det.is_finite() && size.is_finite() && det.abs() > 1e-12 * size) {
            return None;
        }
        let inv = Self { linear: rows(m.inverse()), translation: [0.0; 3] };
        let t = inv.vector(self.translation);
        Some(Self { translation: [-t[0], -t[1], -t[2]], ..inv })
    }

    /// All entries are finite numbers.
    #[must_use]
    pub fn is_finite(&self) -> bool {
        self.linear.iter().flatten().chain(&self.translation).all(|v| v.is_finite())
    }
}

fn matrix(rows: &[[f64; 3]; 3]) -> DMat3 {
    DMat3::from_cols_array_2d(rows).transpose()
}

fn rows(m: DMat3) -> [[f64; 3]; 3] {
    m.transpose().to_cols_array_2d()
}

/// Translation, rotation and scale, applied as `x -> T R S x`: what nodes of a file store and clips animate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Transform {
    /// In the unit of the file.
    pub translation: [f64; 3],
    /// Unit quaternion (x, y, z, w).
    pub rotation: [f64; 4],
    /// Factor along each axis [-].
    pub scale: [f64; 3],
}

impl Default for Transform {
    fn default() -> Self {
        Self { translation: [0.0; 3], rotation: [0.0, 0.0, 0.0, 1.0], scale: [1.0; 3] }
    }
}

impl Transform {
    /// As one affine map. A rotation of length zero counts as none.
    #[must_use]
    pub fn to_affine(&self) -> Affine {
        let q = DQuat::from_array(self.rotation);
        let q = if q.length_squared() > 0.0 { q.normalize() } else { DQuat::IDENTITY };
        let m = DMat3::from_quat(q) * DMat3::from_diagonal(DVec3::from_array(self.scale));
        Affine { linear: rows(m), translation: self.translation }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn inverse_undoes_the_map() {
        let t = Transform { translation: [1.0, -2.0, 3.0], rotation: [0.1, 0.7, -0.2, 0.6], scale: [100.0, 50.0, 0.1] };
        let a = t.to_affine();
        let p = [0.3, -0.4, 0.5];
        let q = a.inverse().unwrap().after(&a).point(p);
        assert!((0..3).all(|k| (p[k] - q[k]).abs() < 1e-12), "{q:?}");
        assert!(Affine::from_scale(0.0).inverse().is_none());
    }
}
