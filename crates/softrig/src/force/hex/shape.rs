//! Shapes of hexahedra: what cells of equal shape share.
#![allow(non_snake_case, reason = "symbols of the continuum mechanics literature")]

use softrig_linalg::cubes::{self, CORNER};
use softrig_linalg::{Mat3, Scalar, Vec3};

/// One point of a quadrature over a cell.
#[derive(Clone, Debug)]
pub struct QuadraturePoint {
    /// Volume that belongs to the point [m3].
    pub volume: f64,
    /// Value of each node's shape function [-].
    pub value: [f64; 8],
    /// Gradient of each node's shape function [1/m].
    pub gradient: [[f64; 3]; 8],
}

/// The 2x2x2 Gauss points of a hexahedron, nodes in VTK order. A volume is not positive where the cell is folded.
#[must_use]
pub fn hex_points(X: [[f64; 3]; 8]) -> [QuadraturePoint; 8] {
    let at = 1.0 / 3f64.sqrt();
    CORNER.map(|p| {
        let s = p.map(|c| c * at);
        let term = |a: usize, k: usize| 1.0 + CORNER[a][k] * s[k];
        let value = std::array::from_fn(|a| term(a, 0) * term(a, 1) * term(a, 2) / 8.0);
        let local: [[f64; 3]; 8] = std::array::from_fn(|a| {
            let [x, y, z] = [term(a, 0), term(a, 1), term(a, 2)];
            [CORNER[a][0] * y * z / 8.0, CORNER[a][1] * x * z / 8.0, CORNER[a][2] * x * y / 8.0]
        });
        let mut J = Mat3::<f64>::zero();
        for a in 0..8 {
            J += (Vec3(X[a]) - Vec3(X[0])).outer(Vec3(local[a]));
        }
        let inverse = J.inverse();
        QuadraturePoint { volume: J.determinant(), value, gradient: local.map(|d| inverse.transpose_mul(Vec3(d)).0) }
    })
}

/// Stiffness of a hexahedron in its rest shape [N/m], `[a][b]` one 3x3 block, for the given Lamé constants [Pa].
#[must_use]
pub fn hex_stiffness(X: [[f64; 3]; 8], lambda: f64, mu: f64) -> [[[[f64; 3]; 3]; 8]; 8] {
    let mut K = [[[[0.0; 3]; 3]; 8]; 8];
    for p in hex_points(X) {
        for a in 0..8 {
            for b in 0..8 {
                let (ga, gb) = (Vec3(p.gradient[a]), Vec3(p.gradient[b]));
                let k = ga.outer(gb).scale(lambda) + gb.outer(ga).scale(mu) + Mat3::diagonal(mu * ga.dot(gb));
                for i in 0..3 {
                    for j in 0..3 {
                        K[a][b][i][j] += p.volume * k.0[i][j];
                    }
                }
            }
        }
    }
    K
}

/// One rest shape with its stiffness for a Young's modulus of 1 Pa: shared by all cells alike.
#[derive(Clone, Debug)]
pub(in crate::force) struct HexShape<R> {
    /// Ke_ab / E [m]. (A vector of rows, so that the compiler leaves the loop over them a loop.)
    pub stiffness: Vec<[[[R; 3]; 3]; 8]>,
    /// ḡ_a [1/m].
    pub gradient: [[R; 3]; 8],
    /// X_a − X_0 [m].
    pub offset: [[R; 3]; 8],
    /// Of a cube along the axes: its edge [m], and its Lamé constants for a Young's modulus of 1 Pa.
    pub cube: Option<Cube<R>>,
}

/// What makes a cube's stiffness.
#[derive(Clone, Copy, Debug)]
pub(in crate::force) struct Cube<R> {
    pub edge: f64,
    pub lambda: R,
    pub mu: R,
    /// Both constants times the factor of the modes.
    pub(super) on_modes: [R; 2],
    /// Of a linear mode's amplitude [m], the column of the mean gradient that it is [1/m].
    pub(super) to_gradient: R,
    /// Amplitude of the linear modes in the rest shape, each along its axis [m].
    pub(super) rest: R,
}

/// The edge of a cube along the axes, to 1e-9 of its size.
fn cube_edge(X: &[[f64; 3]; 8]) -> Option<f64> {
    let edge = X[1][0] - X[0][0];
    let fits = |a: usize, i: usize| {
        let offset = if CORNER[a][i] > 0.0 { edge } else { 0.0 };
        (X[a][i] - X[0][i] - offset).abs() <= 1e-9 * edge
    };
    (edge > 0.0 && (0..8).all(|a| (0..3).all(|i| fits(a, i)))).then_some(edge)
}

impl<R: Scalar> HexShape<R> {
    pub(in crate::force) fn new(X: [[f64; 3]; 8], poisson_ratio: f64) -> Self {
        let lambda = poisson_ratio / ((1.0 + poisson_ratio) * (1.0 - 2.0 * poisson_ratio));
        let mu = 0.5 / (1.0 + poisson_ratio);
        let cast = |m: [f64; 3]| m.map(R::from_f64);
        let factor = |edge: f64, c: f64| R::from_f64(c * cubes::mode_factor(edge));
        let cube = cube_edge(&X).map(|edge| Cube {
            edge,
            lambda: R::from_f64(lambda),
            mu: R::from_f64(mu),
            on_modes: [factor(edge, lambda), factor(edge, mu)],
            to_gradient: R::from_f64(0.25 / edge),
            rest: R::from_f64(4.0 * edge),
        });
        let points = hex_points(X);
        let volume: f64 = points.iter().map(|p| p.volume).sum();
        let mean = std::array::from_fn(|a| {
            std::array::from_fn(|i| {
                R::from_f64(points.iter().map(|p| p.gradient[a][i] * p.volume).sum::<f64>() / volume)
            })
        });
        Self {
            stiffness: hex_stiffness(X, lambda, mu).iter().map(|row| row.map(|k| k.map(cast))).collect(),
            gradient: mean,
            offset: std::array::from_fn(|a| cast(std::array::from_fn(|i| X[a][i] - X[0][i]))),
            cube,
        }
    }
}
