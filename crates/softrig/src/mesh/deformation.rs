//! How much a volume mesh is squeezed and turned inside out.

use super::VolumeMesh;
use super::shape::{hex_centre_volume, hex_volume, tet_volume6};
use glam::DVec3;
use rayon::prelude::*;
use softrig_linalg::Scalar;

/// Volumes of cells against rest.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DeformationStats {
    /// Cells that are inside out, ascending: a tetrahedron of negative volume, a hexahedron whose middle is.
    pub inverted: Vec<u32>,
    /// Volume of all cells against rest, cells weighted by their fill [-].
    pub volume_ratio: f64,
    /// Smallest ratio of a cell's volume to its rest volume [-]; in the middle of a hexahedron.
    pub min: f64,
    /// 1st percentile of that ratio [-].
    pub p1: f64,
    /// 99th percentile [-].
    pub p99: f64,
    /// Largest [-].
    pub max: f64,
}

/// Compares node positions with the rest shape. Cells without volume at rest are left out. Indices must be valid.
///
/// # Panics
/// When there is not one position per node.
#[must_use]
pub fn deformation_stats<R: Scalar>(mesh: &VolumeMesh, position: &[[R; 3]]) -> DeformationStats {
    assert_eq!(position.len(), mesh.node_count(), "one position per node");
    let rest = |n: u32| DVec3::from_array(mesh.nodes[n as usize]);
    let now = |n: u32| DVec3::from_array(position[n as usize].map(|x| x.to_f64()));
    let local = |i: usize| -> (f64, f64, f64, f64) {
        if let &[a, b, c, d] = mesh.cell(i) {
            let t = [a, b, c, d];
            let (v0, v) = (tet_volume6(&t.map(rest)), tet_volume6(&t.map(now)));
            (v0, v, v0 / 6.0, v / 6.0)
        } else {
            let h = mesh.hexes[i - mesh.tets.len()];
            let (x0, x) = (h.map(rest), h.map(now));
            (hex_centre_volume(&x0), hex_centre_volume(&x), hex_volume(&x0), hex_volume(&x))
        }
    };
    let all: Vec<_> = (0..mesh.cell_count()).into_par_iter().with_min_len(256).map(local).collect();
    let mut out = DeformationStats::default();
    let (mut before, mut after) = (0.0, 0.0);
    let mut ratios = Vec::with_capacity(all.len());
    for (i, (v0, v, whole0, whole)) in all.into_iter().enumerate() {
        if v0 == 0.0 {
            continue;
        }
        let ratio = v / v0;
        // not a number counts as inverted too
        if ratio.is_nan() || ratio <= 0.0 {
            out.inverted.push(i as u32);
        }
        ratios.push(ratio);
        before += f64::from(mesh.fill(i)) * whole0;
        after += f64::from(mesh.fill(i)) * whole;
    }
    if ratios.is_empty() {
        return DeformationStats { volume_ratio: 1.0, min: 1.0, p1: 1.0, p99: 1.0, max: 1.0, ..out };
    }
    ratios.sort_unstable_by(f64::total_cmp);
    let rank = |p: f64| ratios[((ratios.len() - 1) as f64 * p).round() as usize];
    DeformationStats {
        volume_ratio: after / before,
        min: ratios[0],
        p1: rank(0.01),
        p99: rank(0.99),
        max: ratios[ratios.len() - 1],
        ..out
    }
}
