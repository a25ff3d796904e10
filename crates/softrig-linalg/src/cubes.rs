//! Matrices that are sums over equal cubes of linear elasticity, each in a frame of its own: A = Σ G_cᵀ R_c K_c R_cᵀ G_c + D.
//!
//! Such a matrix need not be stored. With the corner vectors of a cube turned into amplitudes of the eight trilinear modes
//! 1, ξ, η, ζ, ξη, ηζ, ζξ, ξηζ, its stiffness falls apart into tiny blocks (the modes are orthogonal, and each component of a
//! mode meets only those of equal parity), so that a product takes some 500 operations per cube and reads 60 bytes where the
//! assembled rows read a thousand.

use crate::{Lane, Scalar, Vec3};
use std::ops::{Add, Neg, Sub};
use std::sync::Arc;

/// Corners of cubes, in VTK order, and what the cubes have in common.
#[derive(Clone, Debug, PartialEq)]
pub struct CubePattern {
    /// Corners of each cube.
    pub nodes: Vec<[u32; 8]>,
    /// Number of nodes of the body.
    pub node_count: usize,
    /// Edge of every cube [m].
    pub edge: f64,
}

/// The numbers that belong to a [`CubePattern`].
#[derive(Clone, Debug)]
pub struct CubeMatrix<R> {
    /// Where the cubes are.
    pub pattern: Arc<CubePattern>,
    /// Columns of the rotation of each cube; the fourth places are not read.
    pub rotation: Vec<[[R; 4]; 3]>,
    /// Lamé constants lambda and mu of each cube [Pa].
    pub lame: Vec<[R; 2]>,
    /// What is added to the diagonal at each node [N/m].
    pub diagonal: Vec<R>,
}

impl<R: Scalar> CubeMatrix<R> {
    /// All numbers zero.
    #[must_use]
    pub fn zero(pattern: Arc<CubePattern>) -> Self {
        let (cubes, nodes) = (pattern.nodes.len(), pattern.node_count);
        Self {
            rotation: vec![[[R::zero(); 4]; 3]; cubes],
            lame: vec![[R::zero(); 2]; cubes],
            diagonal: vec![R::zero(); nodes],
            pattern,
        }
    }
}

/// Signs of the corners of a hexahedron in VTK order.
pub const CORNER: [[f64; 3]; 8] = [
    [-1.0, -1.0, -1.0],
    [1.0, -1.0, -1.0],
    [1.0, 1.0, -1.0],
    [-1.0, 1.0, -1.0],
    [-1.0, -1.0, 1.0],
    [1.0, -1.0, 1.0],
    [1.0, 1.0, 1.0],
    [-1.0, 1.0, 1.0],
];

/// Factor from the Lamé constants to the stiffness on modes that are not normalised: edge/16 (the shape gradients are 2/edge,
/// the volume is edge³, and an amplitude is an eighth of the signed sum, on either side).
#[must_use]
pub fn mode_factor(edge: f64) -> f64 {
    edge / 16.0
}

/// Amplitudes (times eight) of ξ, η, ζ, ξη, ηζ, ζξ, ξηζ from what lies at the corners, numbers or vectors; the constant mode is left out.
#[inline(always)]
#[must_use]
pub fn modes<V: Copy + Add<Output = V> + Sub<Output = V>>(u: [V; 8]) -> [V; 7] {
    let (s0, s1, s2, s3) = (u[1] + u[0], u[2] + u[3], u[5] + u[4], u[6] + u[7]);
    let (d0, d1, d2, d3) = (u[1] - u[0], u[2] - u[3], u[5] - u[4], u[6] - u[7]);
    let (ss0, ss1, sd0, sd1) = (s1 + s0, s3 + s2, s1 - s0, s3 - s2);
    let (ds0, ds1, dd0, dd1) = (d1 + d0, d3 + d2, d1 - d0, d3 - d2);
    [ds1 + ds0, sd1 + sd0, ss1 - ss0, dd1 + dd0, sd1 - sd0, ds1 - ds0, dd1 - dd0]
}

/// The transpose of [`modes`].
#[inline(always)]
#[must_use]
pub fn corners<V: Copy + Add<Output = V> + Sub<Output = V> + Neg<Output = V>>(c: [V; 7]) -> [V; 8] {
    let [x, y, z, xy, yz, zx, xyz] = c;
    // below (z-) and above (z+)
    let (s_0, s_1) = (-z, z);
    let (y_0, y_1) = (y - yz, y + yz);
    let (x_0, x_1) = (x - zx, x + zx);
    let (d_0, d_1) = (xy - xyz, xy + xyz);
    // y- and y+
    let (a0, a1, b0, b1) = (s_0 - y_0, s_0 + y_0, x_0 - d_0, x_0 + d_0);
    let (a2, a3, b2, b3) = (s_1 - y_1, s_1 + y_1, x_1 - d_1, x_1 + d_1);
    [a0 - b0, a0 + b0, a1 + b1, a1 - b1, a2 - b2, a2 + b2, a3 + b3, a3 - b3]
}

/// Stiffness of a cube on the modes of its displacement, in its own frame. `lambda` and `mu` are multiplied by the
/// [`mode_factor`].
#[inline(always)]
#[must_use]
pub fn stiffness<S: Lane>(lambda: S, mu: S, c: [Vec3<S>; 7]) -> [Vec3<S>; 7] {
    let third = S::constant(1.0 / 3.0);
    let (l3, m3) = (lambda * third, mu * third);
    let g = [c[0].0, c[1].0, c[2].0];
    let mut out = c;
    // linear modes: a uniform strain
    let pressure = lambda * (g[0][0] + g[1][1] + g[2][2]);
    for i in 0..3 {
        for j in 0..3 {
            out[j].0[i] = mu * (g[j][i] + g[i][j]);
        }
        out[i].0[i] += pressure;
    }
    // bilinear modes: `b[k]` varies along the two axes other than k
    let b = [c[4].0, c[5].0, c[3].0];
    let place = [4, 5, 3];
    for (i, k) in [(0, 1), (1, 2), (2, 0)] {
        let volume = l3 * (b[k][i] + b[i][k]);
        out[place[k]].0[i] = mu * b[k][i] + volume;
        out[place[i]].0[k] = mu * b[i][k] + volume;
    }
    let twist = b[0][0] + b[1][1] + b[2][2];
    for k in 0..3 {
        out[place[k]].0[k] = m3 * (b[k][k] + twist);
    }
    // the trilinear mode
    let ninth = third * third;
    let factor = (lambda + mu * S::constant(4.0)) * ninth;
    out[6] = c[6].scale(factor);
    out
}

/// α and β of a corner's own block, R K_aa Rᵀ = α I + β (R s)(R s)ᵀ with the corner's signs s. `lambda` and `mu` as in
/// [`stiffness`].
#[inline(always)]
pub(crate) fn corner_factors<S: Lane>(lambda: S, mu: S) -> (S, S) {
    let beta = (lambda + mu) * S::constant(4.0 / 3.0);
    (lambda * S::constant(16.0 / 9.0) + mu * S::constant(64.0 / 9.0) - beta, beta)
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// K_ab of a cube by quadrature of its shape functions: nothing here knows of modes.
    pub(crate) fn by_quadrature(edge: f64, lambda: f64, mu: f64) -> [[[[f64; 3]; 3]; 8]; 8] {
        let mut k = [[[[0.0; 3]; 3]; 8]; 8];
        let p = 1.0 / 3f64.sqrt();
        for at in CORNER.map(|c| c.map(|c| c * p)) {
            let gradient = CORNER.map(|s| {
                let t: [f64; 3] = std::array::from_fn(|i| 1.0 + s[i] * at[i]);
                [s[0] * t[1] * t[2], s[1] * t[0] * t[2], s[2] * t[0] * t[1]].map(|g| g / 8.0 * 2.0 / edge)
            });
            for a in 0..8 {
                for b in 0..8 {
                    let dot: f64 = (0..3).map(|i| gradient[a][i] * gradient[b][i]).sum();
                    for i in 0..3 {
                        for j in 0..3 {
                            let (ga, gb) = (gradient[a], gradient[b]);
                            let unit = if i == j { mu * dot } else { 0.0 };
                            k[a][b][i][j] += edge.powi(3) / 8.0 * (lambda * ga[i] * gb[j] + mu * ga[j] * gb[i] + unit);
                        }
                    }
                }
            }
        }
        k
    }

    #[test]
    fn modes_give_the_stiffness_of_the_quadrature() {
        let (edge, lambda, mu) = (0.3, 1.7e4, 0.9e4);
        let k = by_quadrature(edge, lambda, mu);
        let factor = mode_factor(edge);
        for a in 0..8 {
            for i in 0..3 {
                let mut u = [[0.0; 8]; 3];
                u[i][a] = 1.0;
                let m = u.map(modes);
                let c = std::array::from_fn(|n| Vec3([m[0][n], m[1][n], m[2][n]]));
                let out = stiffness(lambda * factor, mu * factor, c);
                let f: [[f64; 8]; 3] = std::array::from_fn(|j| corners(out.map(|v| v.0[j])));
                for b in 0..8 {
                    for j in 0..3 {
                        let error = (f[j][b] - k[b][a][j][i]).abs();
                        assert!(error < 1e-12 * lambda, "{a}{i} {b}{j}: {} {}", f[j][b], k[b][a][j][i]);
                    }
                }
            }
            let (alpha, beta) = corner_factors(lambda * factor, mu * factor);
            for i in 0..3 {
                for j in 0..3 {
                    let own = if i == j { alpha } else { 0.0 } + beta * CORNER[a][i] * CORNER[a][j];
                    assert!((own - k[a][a][i][j]).abs() < 1e-12 * lambda, "{a} {i}{j}");
                }
            }
        }
    }
}
