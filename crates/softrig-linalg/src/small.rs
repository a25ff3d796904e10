//! Three-vectors and 3x3 matrices over lanes.

use crate::lane::Lane;
use std::ops::{Add, AddAssign, Mul, Neg, Sub, SubAssign};

/// A vector of three lanes, laid out as `[S; 3]`.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(transparent)]
pub struct Vec3<S>(pub [S; 3]);

/// A 3x3 matrix, row-major: `m.0[row][column]`.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(transparent)]
pub struct Mat3<S>(pub [[S; 3]; 3]);

impl<S: Lane> Vec3<S> {
    /// From components.
    #[inline(always)]
    pub fn new(x: S, y: S, z: S) -> Self {
        Self([x, y, z])
    }
    /// (0, 0, 0).
    #[inline(always)]
    pub fn zero() -> Self {
        Self([S::zero(); 3])
    }
    /// The same vector in every lane.
    #[inline(always)]
    pub fn splat(v: [S::Scalar; 3]) -> Self {
        Self(v.map(S::splat))
    }
    /// Scalar product.
    #[inline(always)]
    pub fn dot(self, o: Self) -> S {
        self.0[0] * o.0[0] + self.0[1] * o.0[1] + self.0[2] * o.0[2]
    }
    /// Vector product.
    #[inline(always)]
    pub fn cross(self, o: Self) -> Self {
        let (a, b) = (self.0, o.0);
        Self([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])
    }
    /// Euclidean length.
    #[inline(always)]
    pub fn norm(self) -> S {
        self.dot(self).sqrt()
    }
    /// Each component times `s`.
    #[inline(always)]
    pub fn scale(self, s: S) -> Self {
        Self([self.0[0] * s, self.0[1] * s, self.0[2] * s])
    }
    /// Tensor product `a bᵀ`.
    #[inline(always)]
    pub fn outer(self, o: Self) -> Mat3<S> {
        Mat3([o.scale(self.0[0]).0, o.scale(self.0[1]).0, o.scale(self.0[2]).0])
    }
}

impl<S: Lane> Add for Vec3<S> {
    type Output = Self;
    #[inline(always)]
    fn add(self, o: Self) -> Self {
        Self([self.0[0] + o.0[0], self.0[1] + o.0[1], self.0[2] + o.0[2]])
    }
}
impl<S: Lane> Sub for Vec3<S> {
    type Output = Self;
    #[inline(always)]
    fn sub(self, o: Self) -> Self {
        Self([self.0[0] - o.0[0], self.0[1] - o.0[1], self.0[2] - o.0[2]])
    }
}
impl<S: Lane> Neg for Vec3<S> {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        Self([-self.0[0], -self.0[1], -self.0[2]])
    }
}
impl<S: Lane> AddAssign for Vec3<S> {
    #[inline(always)]
    fn add_assign(&mut self, o: Self) {
        *self = *self + o;
    }
}
impl<S: Lane> SubAssign for Vec3<S> {
    #[inline(always)]
    fn sub_assign(&mut self, o: Self) {
        *self = *self - o;
    }
}

impl<S: Lane> Mat3<S> {
    /// All entries zero.
    #[inline(always)]
    pub fn zero() -> Self {
        Self([[S::zero(); 3]; 3])
    }
    /// Ones on the diagonal.
    #[inline(always)]
    pub fn identity() -> Self {
        Self::diagonal(S::one())
    }
    /// `s` on the diagonal.
    #[inline(always)]
    pub fn diagonal(s: S) -> Self {
        let z = S::zero();
        Self([[s, z, z], [z, s, z], [z, z, s]])
    }
    /// The same matrix in every lane.
    #[inline(always)]
    pub fn splat(m: [[S::Scalar; 3]; 3]) -> Self {
        Self(m.map(|r| r.map(S::splat)))
    }
    /// From three columns.
    #[inline(always)]
    pub fn from_columns(a: Vec3<S>, b: Vec3<S>, c: Vec3<S>) -> Self {
        Self([[a.0[0], b.0[0], c.0[0]], [a.0[1], b.0[1], c.0[1]], [a.0[2], b.0[2], c.0[2]]])
    }
    /// Row `i`.
    #[inline(always)]
    pub fn row(self, i: usize) -> Vec3<S> {
        Vec3(self.0[i])
    }
    /// Column `j`.
    #[inline(always)]
    pub fn column(self, j: usize) -> Vec3<S> {
        Vec3([self.0[0][j], self.0[1][j], self.0[2][j]])
    }
    /// Transposed matrix.
    #[inline(always)]
    pub fn transpose(self) -> Self {
        Self::from_columns(self.row(0), self.row(1), self.row(2))
    }
    /// Sum of the diagonal.
    #[inline(always)]
    pub fn trace(self) -> S {
        self.0[0][0] + self.0[1][1] + self.0[2][2]
    }
    /// Determinant.
    #[inline(always)]
    pub fn determinant(self) -> S {
        self.row(0).dot(self.row(1).cross(self.row(2)))
    }
    /// Matrix of cofactors: `inverse = cofactors ᵀ / determinant`.
    #[inline(always)]
    pub fn cofactors(self) -> Self {
        let (a, b, c) = (self.row(0), self.row(1), self.row(2));
        Self([b.cross(c).0, c.cross(a).0, a.cross(b).0])
    }
    /// Inverse; infinite or NaN where the matrix is singular.
    #[inline(always)]
    pub fn inverse(self) -> Self {
        let c = self.cofactors();
        let det = self.row(0).dot(c.row(0));
        c.transpose().scale(S::one() / det)
    }
    /// Each entry times `s`.
    #[inline(always)]
    pub fn scale(self, s: S) -> Self {
        Self([self.row(0).scale(s).0, self.row(1).scale(s).0, self.row(2).scale(s).0])
    }
    /// `selfᵀ v`.
    #[inline(always)]
    pub fn transpose_mul(self, v: Vec3<S>) -> Vec3<S> {
        self.row(0).scale(v.0[0]) + self.row(1).scale(v.0[1]) + self.row(2).scale(v.0[2])
    }
    /// Square root of the sum of squared entries.
    #[inline(always)]
    pub fn frobenius_norm(self) -> S {
        (self.row(0).dot(self.row(0)) + self.row(1).dot(self.row(1)) + self.row(2).dot(self.row(2))).sqrt()
    }
}

impl<S: Lane> Add for Mat3<S> {
    type Output = Self;
    #[inline(always)]
    fn add(self, o: Self) -> Self {
        Self([(self.row(0) + o.row(0)).0, (self.row(1) + o.row(1)).0, (self.row(2) + o.row(2)).0])
    }
}
impl<S: Lane> Sub for Mat3<S> {
    type Output = Self;
    #[inline(always)]
    fn sub(self, o: Self) -> Self {
        Self([(self.row(0) - o.row(0)).0, (self.row(1) - o.row(1)).0, (self.row(2) - o.row(2)).0])
    }
}
impl<S: Lane> AddAssign for Mat3<S> {
    #[inline(always)]
    fn add_assign(&mut self, o: Self) {
        *self = *self + o;
    }
}
impl<S: Lane> Mul<Vec3<S>> for Mat3<S> {
    type Output = Vec3<S>;
    #[inline(always)]
    fn mul(self, v: Vec3<S>) -> Vec3<S> {
        Vec3([self.row(0).dot(v), self.row(1).dot(v), self.row(2).dot(v)])
    }
}
impl<S: Lane> Mul for Mat3<S> {
    type Output = Self;
    #[inline(always)]
    fn mul(self, o: Self) -> Self {
        // no closure: one that is not inlined would be compiled without the wide instructions of its caller
        Self([o.transpose_mul(self.row(0)).0, o.transpose_mul(self.row(1)).0, o.transpose_mul(self.row(2)).0])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn inverse_times_matrix_is_identity() {
        let m = Mat3::<f64>([[2.0, -1.0, 0.5], [0.3, 1.5, -0.7], [-0.2, 0.4, 3.0]]);
        let e = m * m.inverse() - Mat3::identity();
        assert!(e.frobenius_norm() < 1e-15, "{e:?}");
        let v = Vec3([1.0, 2.0, 3.0]);
        assert!((m.transpose() * v - m.transpose_mul(v)).norm() < 1e-15);
    }
}
