//! In which vectors a hexahedron computes: what lies at its eight corners, but for a common part, as seven others.
#![allow(non_snake_case, reason = "symbols of the continuum mechanics literature")]

use super::shape::{Cube, HexShape};
use softrig_linalg::{Lane, Mat3, Scalar, Vec3, cubes};

/// Seven vectors y for eight at the corners, relative to corner 0, and what the cell's mechanics are in them. Forces are dual: those at
/// the corners do as much work as `Σ f_n · y_n`.
pub(in crate::force) trait Basis<R: Scalar> {
    /// From those at the corners 1 to 7 relative to corner 0.
    fn of<S: Lane<Scalar = R>>(&self, corner: [Vec3<S>; 7]) -> [Vec3<S>; 7];

    /// Σ x_a ḡ_aᵀ, with the mean shape gradients.
    fn gradient<S: Lane<Scalar = R>>(&self, x: &[Vec3<S>; 7]) -> Mat3<S>;

    /// Displacements: positions less those of the rest shape.
    fn displaced<S: Lane<Scalar = R>>(&self, x: [Vec3<S>; 7]) -> [Vec3<S>; 7];

    /// Forces of the rest shape's stiffness, for a Young's modulus of 1 Pa.
    fn stiffness<S: Lane<Scalar = R>>(&self, u: [Vec3<S>; 7]) -> [Vec3<S>; 7];

    /// Takes the forces b × ḡ_a off.
    fn less_turning<S: Lane<Scalar = R>>(&self, b: Vec3<S>, f: &mut [Vec3<S>; 7]);

    /// Forces at the corners.
    fn at_corners<S: Lane<Scalar = R>>(&self, f: [Vec3<S>; 7]) -> [Vec3<S>; 8];
}

/// The corners 1 to 7 themselves, for any shape.
impl<R: Scalar> Basis<R> for HexShape<R> {
    #[inline(always)]
    fn of<S: Lane<Scalar = R>>(&self, corner: [Vec3<S>; 7]) -> [Vec3<S>; 7] {
        corner
    }

    #[inline(always)]
    fn gradient<S: Lane<Scalar = R>>(&self, x: &[Vec3<S>; 7]) -> Mat3<S> {
        let mut F = Mat3::zero();
        for n in 0..7 {
            F += x[n].outer(Vec3::splat(self.gradient[n + 1]));
        }
        F
    }

    #[inline(always)]
    fn displaced<S: Lane<Scalar = R>>(&self, mut x: [Vec3<S>; 7]) -> [Vec3<S>; 7] {
        for n in 0..7 {
            x[n] -= Vec3::splat(self.offset[n + 1]);
        }
        x
    }

    #[inline(always)]
    fn stiffness<S: Lane<Scalar = R>>(&self, u: [Vec3<S>; 7]) -> [Vec3<S>; 7] {
        let mut f = [Vec3::zero(); 7];
        // (a vector of rows, which the compiler leaves a loop)
        for (f, row) in f.iter_mut().zip(&self.stiffness[1..]) {
            for n in 0..7 {
                *f += Mat3::splat(row[n + 1]) * u[n];
            }
        }
        f
    }

    #[inline(always)]
    fn less_turning<S: Lane<Scalar = R>>(&self, b: Vec3<S>, f: &mut [Vec3<S>; 7]) {
        for n in 0..7 {
            f[n] -= b.cross(Vec3::splat(self.gradient[n + 1]));
        }
    }

    #[inline(always)]
    fn at_corners<S: Lane<Scalar = R>>(&self, f: [Vec3<S>; 7]) -> [Vec3<S>; 8] {
        let mut out = [Vec3::zero(); 8];
        out[1..].copy_from_slice(&f);
        for f in f {
            out[0] -= f;
        }
        out
    }
}

/// The modes of a cube, on which its stiffness is almost diagonal: an eighth of the work. The first three are the columns of the mean
/// gradient, and the rest shape is nothing else.
impl<R: Scalar> Basis<R> for Cube<R> {
    #[inline(always)]
    fn of<S: Lane<Scalar = R>>(&self, corner: [Vec3<S>; 7]) -> [Vec3<S>; 7] {
        let mut all = [Vec3::zero(); 8];
        all[1..].copy_from_slice(&corner);
        cubes::modes(all)
    }

    #[inline(always)]
    fn gradient<S: Lane<Scalar = R>>(&self, x: &[Vec3<S>; 7]) -> Mat3<S> {
        Mat3::from_columns(x[0], x[1], x[2]).scale(S::splat(self.to_gradient))
    }

    #[inline(always)]
    fn displaced<S: Lane<Scalar = R>>(&self, mut x: [Vec3<S>; 7]) -> [Vec3<S>; 7] {
        for n in 0..3 {
            x[n].0[n] -= S::splat(self.rest);
        }
        x
    }

    #[inline(always)]
    fn stiffness<S: Lane<Scalar = R>>(&self, u: [Vec3<S>; 7]) -> [Vec3<S>; 7] {
        let [lambda, mu] = self.on_modes;
        cubes::stiffness(S::splat(lambda), S::splat(mu), u)
    }

    #[inline(always)]
    fn less_turning<S: Lane<Scalar = R>>(&self, b: Vec3<S>, f: &mut [Vec3<S>; 7]) {
        let [x, y, z] = b.scale(S::splat(self.to_gradient)).0;
        f[0] -= Vec3([S::zero(), z, -y]);
        f[1] -= Vec3([-z, S::zero(), x]);
        f[2] -= Vec3([y, -x, S::zero()]);
    }

    #[inline(always)]
    fn at_corners<S: Lane<Scalar = R>>(&self, f: [Vec3<S>; 7]) -> [Vec3<S>; 8] {
        cubes::corners(f)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Modes of a cube say the same as its corners, which know nothing of modes.
    #[test]
    fn a_cube_is_a_hexahedron() {
        let edge = 0.3;
        let X = cubes::CORNER.map(|s| s.map(|s| 0.5 * edge * s + 0.1));
        let shape = HexShape::<f64>::new(X, 0.4);
        let cube = shape.cube.as_ref().expect("it is one");
        let x: [Vec3<f64>; 7] = std::array::from_fn(|n| {
            let y: [f64; 3] = std::array::from_fn(|i| X[n + 1][i] - X[0][i]);
            Vec3([0.9 * y[0] + 2.0 * y[1] * y[2], y[1] - 0.3 * y[0], 1.1 * y[2] + y[0] * y[1] * y[2] / edge])
        });
        let close = |a: &[[f64; 3]], b: &[[f64; 3]]| {
            let size = b.as_flattened().iter().fold(0.0f64, |m, v| m.max(v.abs()));
            let error = a.as_flattened().iter().zip(b.as_flattened()).fold(0.0f64, |m, (a, b)| m.max((a - b).abs()));
            assert!(size > 0.0 && error < 1e-13 * size, "{a:?} {b:?}");
        };
        let (c, y) = (cube.of(x), shape.of(x));
        close(&cube.gradient(&c).0, &shape.gradient(&y).0);
        let (u, v) = (cube.displaced(c), shape.displaced(y));
        let (mut f, mut g) = (cube.stiffness(u), shape.stiffness(v));
        let work = |u: &[Vec3<f64>; 7], f: &[Vec3<f64>; 7]| (0..7).map(|n| u[n].dot(f[n])).sum::<f64>();
        assert!((work(&u, &f) / work(&v, &g) - 1.0).abs() < 1e-13);
        let b = Vec3([0.2, -0.7, 0.4]);
        cube.less_turning(b, &mut f);
        shape.less_turning(b, &mut g);
        close(&cube.at_corners(f).map(|f| f.0), &shape.at_corners(g).map(|f| f.0));
        let torque = |x: &[Vec3<f64>; 7], f: &[Vec3<f64>; 7]| (0..7).fold(Vec3::zero(), |t, n| t + x[n].cross(f[n])).0;
        close(&[torque(&c, &f)], &[torque(&y, &g)]);
    }
}
