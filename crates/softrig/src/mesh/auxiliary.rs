//! A lattice under any body, for multigrid: coarser meshes made independently of the body, grown so that they contain it.
//!
//! Each node hangs on the voxel it is in, by trilinear weights. Nodes of one voxel that no cell connects get voxels of their own,
//! and voxels share corners only where a cell reaches from one into the other, so that what lies close but does not touch stays
//! apart on every level.

use super::hierarchy::{CORNERS, HierarchyOptions, Level, Prolongation, coarser};
use super::sets::Sets;
use super::volume::{CellKind, VolumeMesh};
use std::collections::BTreeMap;

/// Spacing of the lattice in lengths of a cell: the cube root of six times the mean tetrahedron's volume (the edge of the cube
/// that it is a sixth of), or of the mean hexahedron's volume. With 2 the cow's second level has three times as many blocks, for
/// one iteration less; with 3 it takes one more.
const WIDTH: f64 = 2.5;

/// Interpolations to the nodes of the mesh from a lattice, and from level to level below it. Empty for a mesh of few nodes, or
/// without extent.
pub(super) fn auxiliary_hierarchy(mesh: &VolumeMesh, options: &HierarchyOptions) -> Vec<Prolongation> {
    // voxels of tetrahedra are cut into tetrahedra, or the coarse rows would be longer than the fine ones
    let cells = options.cells.unwrap_or(if mesh.tets.is_empty() { CellKind::Hex8 } else { CellKind::Tet4 });
    let spacing = WIDTH * cell_length(mesh);
    let Some((low, high)) = mesh.bounds() else { return Vec::new() };
    let fits = spacing > 0.0 && spacing.is_finite() && (0..3).all(|k| high[k] - low[k] < 1e6 * spacing);
    if mesh.node_count() <= options.coarsest || !fits {
        return Vec::new();
    }
    // nodes are off the walls between voxels, where rounding would choose for them
    let origin: [f64; 3] = std::array::from_fn(|k| low[k] - 0.01 * spacing);
    #[allow(clippy::cast_possible_truncation, reason = "below a million")]
    let voxel_of = |p: [f64; 3]| -> [i32; 3] { std::array::from_fn(|k| ((p[k] - origin[k]) / spacing).floor() as i32) };
    let place: Vec<[i32; 3]> = mesh.nodes.iter().map(|p| voxel_of(*p)).collect();

    // coarse cells: the nodes of a voxel, joined by the cells
    let mut group = Sets::new(mesh.node_count());
    let mut used = vec![false; mesh.node_count()];
    for (a, b) in pairs(mesh) {
        (used[a], used[b]) = (true, true);
        if place[a] == place[b] {
            group.join(a as u32, b as u32);
        }
    }
    let (cell_of, count) = group.labels();
    let mut voxel = vec![[0; 3]; count];
    for (cell, place) in cell_of.iter().zip(&place) {
        voxel[*cell as usize] = *place;
    }

    // coarse nodes: corners joined where a cell reaches from one voxel into the next
    let mut corner = Sets::new(8 * voxel.len());
    let mut joined = BTreeMap::new();
    for (a, b) in pairs(mesh) {
        let (ca, cb) = (cell_of[a] as usize, cell_of[b] as usize);
        let step: [i32; 3] = std::array::from_fn(|k| place[b][k] - place[a][k]);
        if ca == cb || step.iter().any(|d| d.abs() > 1) || joined.insert((ca, cb), ()).is_some() {
            continue;
        }
        for (i, oa) in CORNERS.iter().enumerate() {
            let ob: [i32; 3] = std::array::from_fn(|k| oa[k] - step[k]);
            if let Some(j) = CORNERS.iter().position(|c| *c == ob) {
                corner.join((8 * ca + i) as u32, (8 * cb + j) as u32);
            }
        }
    }
    let level = Level::of_corners(voxel, corner);

    let mut first = Prolongation { coarse_count: level.node_count, start: vec![0], ..Prolongation::empty() };
    for (n, p) in mesh.nodes.iter().enumerate() {
        if used[n] {
            let t: [f64; 3] = std::array::from_fn(|k| (p[k] - origin[k]) / spacing - f64::from(place[n][k]));
            first.push_weights(&level.cells[cell_of[n] as usize], t, cells);
        }
        first.start.push(first.column.len() as u32);
    }
    if 4 * level.node_count > 3 * mesh.node_count() {
        return Vec::new();
    }
    let mut levels = vec![first];
    levels.extend(coarser(level, options.coarsest, cells));
    levels
}

/// Pairs of nodes with a cell in common, each once for every such cell.
fn pairs(mesh: &VolumeMesh) -> impl Iterator<Item = (usize, usize)> + '_ {
    mesh.cells().flat_map(|cell| {
        (0..cell.len()).flat_map(move |i| (i + 1..cell.len()).map(move |j| (cell[i] as usize, cell[j] as usize)))
    })
}

fn cell_length(mesh: &VolumeMesh) -> f64 {
    let at = |n: u32| glam::DVec3::from(mesh.nodes[n as usize]);
    let tets: f64 = mesh
        .tets
        .iter()
        .map(|t| {
            let [a, b, c, d] = t.map(at);
            (b - a).cross(c - a).dot(d - a).abs()
        })
        .sum();
    // the edges of a hexahedron that is nearly a box
    let hexes: f64 = mesh
        .hexes
        .iter()
        .map(|h| {
            let [a, b, d, e] = [h[0], h[1], h[3], h[4]].map(at);
            (b - a).cross(d - a).dot(e - a).abs()
        })
        .sum();
    ((tets + hexes) / mesh.cell_count().max(1) as f64).cbrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::bar;

    fn row(p: &Prolongation, n: usize) -> std::ops::Range<usize> {
        p.start[n] as usize..p.start[n + 1] as usize
    }

    /// Two bars of tetrahedra a hair apart share no coarse node on any level; weights are positive and sum to 1.
    #[test]
    fn bodies_that_do_not_touch_stay_apart() {
        let one = bar([16, 4, 4], [1.6, 0.4, 0.4], CellKind::Tet4);
        let mut two = one.clone();
        let n = one.node_count() as u32;
        two.nodes.extend(one.nodes.iter().map(|p| [p[0], p[1] + 0.401, p[2]]));
        two.tets.extend(one.tets.iter().map(|t| t.map(|v| v + n)));
        for cells in [CellKind::Hex8, CellKind::Tet4] {
            stay_apart(&two, n as usize, cells);
        }
    }

    fn stay_apart(two: &VolumeMesh, n: usize, cells: CellKind) {
        let levels = auxiliary_hierarchy(two, &HierarchyOptions { coarsest: 30, levels: None, cells: Some(cells) });
        assert!(levels.len() >= 2, "{} levels", levels.len());
        let mut side: Vec<usize> = (0..two.node_count()).map(|i| usize::from(i >= n)).collect();
        for p in &levels {
            let mut coarse = vec![usize::MAX; p.coarse_count];
            for (i, side) in side.iter().enumerate() {
                let sum: f64 = p.weight[row(p, i)].iter().sum();
                assert!((sum - 1.0).abs() < 1e-12 && p.weight[row(p, i)].iter().all(|w| *w >= 0.0));
                // no finer node may hang on a corner of a voxel cut into tetrahedra
                for &c in p.column[row(p, i)].iter().filter(|_| *side != usize::MAX) {
                    assert!(coarse[c as usize] == usize::MAX || coarse[c as usize] == *side);
                    coarse[c as usize] = *side;
                }
            }
            side = coarse;
        }
    }

    #[test]
    fn a_few_nodes_need_no_hierarchy() {
        let options = HierarchyOptions { coarsest: 100, ..HierarchyOptions::default() };
        assert!(auxiliary_hierarchy(&VolumeMesh::default(), &options).is_empty());
        let small = bar([2, 1, 1], [0.2, 0.1, 0.1], CellKind::Tet4);
        assert!(auxiliary_hierarchy(&small, &options).is_empty());
    }
}
