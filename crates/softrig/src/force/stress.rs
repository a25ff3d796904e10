//! Stress and strain of each cell, for pictures and files.
#![allow(non_snake_case, reason = "symbols of the continuum mechanics literature")]

use super::hex::hex_points;
use super::polar::{polar_cold, rotation, symmetric};
use super::tet::tet_gradients;
use crate::material::MaterialMap;
use crate::mesh::{CellKind, VolumeMesh};
use rayon::prelude::*;
use softrig_linalg::{Mat3, Scalar, Vec3};

/// Stress and strain at the centre of a cell, in world axes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CellStress {
    /// Cauchy stress of the corotated law, R (2 mu e + lam tr(e) I) Rᵀ [Pa]: xx, yy, zz, xy, yz, zx. Equal to the true stress to
    /// first order in the strain, and finite in inverted cells.
    pub stress: [f64; 6],
    /// Corotated strain R (S − I) Rᵀ [-]: xx, yy, zz, xy, yz, zx (tensor components, not the doubled engineering shear).
    pub strain: [f64; 6],
    /// Von Mises equivalent stress [Pa].
    pub von_mises: f64,
    /// Volume over rest volume at the centre, det F [-]; not positive where the cell is inverted.
    pub volume_ratio: f64,
}

/// Stress and strain of every cell with the nodes at `position` [m].
///
/// # Panics
/// When `position` or `materials` do not fit the mesh.
#[must_use]
pub fn cell_stress<R: Scalar>(mesh: &VolumeMesh, materials: &MaterialMap, position: &[[R; 3]]) -> Vec<CellStress> {
    assert_eq!(position.len(), mesh.node_count(), "one position per node");
    (0..mesh.cell_count())
        .into_par_iter()
        .map(|i| {
            let nodes = mesh.cell(i);
            let X = |k: usize| mesh.nodes[nodes[k] as usize];
            let x = |k: usize| Vec3(position[nodes[k] as usize].map(Scalar::to_f64));
            let mut F = Mat3::<f64>::zero();
            match mesh.kind(i) {
                CellKind::Tet4 => {
                    let (g, _) = tet_gradients(std::array::from_fn(X));
                    (1..4).for_each(|k| F += (x(k) - x(0)).outer(Vec3(g[k - 1])));
                }
                CellKind::Hex8 => {
                    let points = hex_points(std::array::from_fn(X));
                    let volume: f64 = points.iter().map(|p| p.volume).sum();
                    for p in &points {
                        (1..8).for_each(|k| F += (x(k) - x(0)).outer(Vec3(p.gradient[k])).scale(p.volume / volume));
                    }
                }
            }
            let Some(q) = polar_cold(F.0, [0.0, 0.0, 0.0, 1.0]) else {
                return CellStress { volume_ratio: F.determinant(), ..CellStress::default() };
            };
            let m = materials.get(i);
            let R = rotation(q);
            let e = symmetric(R.transpose() * F) - Mat3::identity();
            let s = e.scale(2.0 * m.shear_modulus()) + Mat3::diagonal(m.lambda() * e.trace());
            let world = |t: Mat3<f64>| {
                let t = (R * t * R.transpose()).0;
                [t[0][0], t[1][1], t[2][2], t[0][1], t[1][2], t[2][0]]
            };
            let t = world(s);
            let square = |x: f64| x * x;
            let normal = square(t[0] - t[1]) + square(t[1] - t[2]) + square(t[2] - t[0]);
            let shear = square(t[3]) + square(t[4]) + square(t[5]);
            CellStress {
                stress: t,
                strain: world(e),
                von_mises: (0.5 * normal + 3.0 * shear).sqrt(),
                volume_ratio: F.determinant(),
            }
        })
        .collect()
}
