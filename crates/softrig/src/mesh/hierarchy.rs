//! Coarser and coarser lattices under a voxel body, for multigrid.
//!
//! Every level doubles the spacing. Cells of a coarse voxel are the face-connected groups of fine cells in it, and coarse cells
//! share corners only across faces that fine cells share, so what is separate on the body stays separate on every level
//! [Georgii2010 §3.2, nested grids].

use super::auxiliary::auxiliary_hierarchy;
use super::sets::Sets;
use super::volume::{CellKind, VolumeMesh};
use std::collections::BTreeMap;

/// How many levels a hierarchy has, and what is between them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HierarchyOptions {
    /// Coarsening ends at so many nodes: few enough to factorise the rest densely in a few milliseconds. Default 150.
    pub coarsest: usize,
    /// Most levels, the body's own among them; `None` (default): as many as it takes.
    pub levels: Option<usize>,
    /// Cells of the coarse levels: voxels with trilinear weights, or each voxel cut into six tetrahedra, with linear ones. Both
    /// contain the body. `None` (default): those of the body, so that coarse rows are no longer than fine ones.
    pub cells: Option<CellKind>,
}

impl Default for HierarchyOptions {
    fn default() -> Self {
        Self { coarsest: 150, levels: None, cells: None }
    }
}

/// Interpolations from level to level, finest first: on the body's own lattice if it has one, otherwise on one laid under it.
/// Empty for bodies of a few nodes.
#[must_use]
pub fn hierarchy(mesh: &VolumeMesh, options: &HierarchyOptions) -> Vec<Prolongation> {
    let mut levels = lattice_hierarchy(mesh, options);
    if levels.is_empty() {
        levels = auxiliary_hierarchy(mesh, options);
    }
    levels.truncate(options.levels.map_or(usize::MAX, |n| n.saturating_sub(1)));
    levels
}

/// Interpolation from a coarse level to the next finer one: compressed rows, one per fine node.
#[derive(Clone, Debug, PartialEq)]
pub struct Prolongation {
    /// Number of coarse nodes.
    pub coarse_count: usize,
    /// First entry of each fine node, and one past the last.
    pub start: Vec<u32>,
    /// Coarse node of each entry, ascending within a row.
    pub column: Vec<u32>,
    /// Its weight [-]; the weights of a row sum to 1.
    pub weight: Vec<f64>,
}

impl Prolongation {
    pub(super) fn empty() -> Self {
        Self { coarse_count: 0, start: Vec::new(), column: Vec::new(), weight: Vec::new() }
    }

    /// Appends the weights of a point at `t` (0 to 1 along each edge) of a voxel: on its corners, or on those of the tetrahedron
    /// of [Kuhn1960] it is in. The row is not ended.
    pub(super) fn push_weights(&mut self, voxel: &[u32; 8], t: [f64; 3], cells: CellKind) {
        let weights: [f64; 8] = match cells {
            CellKind::Hex8 => {
                CORNERS.map(|corner| (0..3).map(|k| if corner[k] == 1 { t[k] } else { 1.0 - t[k] }).product::<f64>())
            }
            CellKind::Tet4 => {
                // from the lowest corner along the axes, the longest way first
                let mut axes = [0, 1, 2];
                axes.sort_by(|a, b| t[*b].total_cmp(&t[*a]));
                let way = [1.0, t[axes[0]], t[axes[1]], t[axes[2]], 0.0];
                let mut weights = [0.0; 8];
                let mut corner = [0; 3];
                for step in 0..4 {
                    let at = CORNERS.iter().position(|c| *c == corner).expect("a corner of the voxel");
                    weights[at] = way[step] - way[step + 1];
                    if step < 3 {
                        corner[axes[step]] = 1;
                    }
                }
                weights
            }
        };
        let mut row: Vec<(u32, f64)> = Vec::with_capacity(8);
        for (w, &node) in weights.into_iter().zip(voxel).filter(|(w, _)| *w > 0.0) {
            match row.iter_mut().find(|e| e.0 == node) {
                Some(e) => e.1 += w,
                None => row.push((node, w)),
            }
        }
        row.sort_by_key(|e| e.0);
        self.column.extend(row.iter().map(|e| e.0));
        self.weight.extend(row.iter().map(|e| e.1));
    }
}

/// Offsets of the corners of a voxel, in the node order of [`super::CellKind::Hex8`].
pub(super) const CORNERS: [[i32; 3]; 8] =
    [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]];

pub(super) struct Level {
    pub voxel: Vec<[i32; 3]>,
    pub cells: Vec<[u32; 8]>,
    pub node_count: usize,
}

impl Level {
    /// Cells in the given voxels; corner `i` of cell `c` is number `8 c + i` of the sets, and each set one node.
    pub fn of_corners(voxel: Vec<[i32; 3]>, corners: Sets) -> Self {
        let (label, node_count) = corners.labels();
        Self { voxel, cells: label.as_chunks().0.to_vec(), node_count }
    }
}

/// Levels of the body's own lattice, down to the coarsest or until coarsening stops helping. Empty for bodies without a lattice,
/// or with tetrahedra.
fn lattice_hierarchy(mesh: &VolumeMesh, options: &HierarchyOptions) -> Vec<Prolongation> {
    let Some(lattice) = mesh.lattice.as_ref().filter(|l| mesh.tets.is_empty() && l.voxel.len() == mesh.hexes.len())
    else {
        return Vec::new();
    };
    let level = Level { voxel: lattice.voxel.clone(), cells: mesh.hexes.clone(), node_count: mesh.node_count() };
    coarser(level, options.coarsest, options.cells.unwrap_or(CellKind::Hex8))
}

/// The levels below a lattice.
pub(super) fn coarser(mut level: Level, coarsest: usize, cells: CellKind) -> Vec<Prolongation> {
    let mut prolongations = Vec::new();
    while level.node_count > coarsest {
        let (coarse, prolongation) = coarsen(&level, cells);
        // pieces one voxel thick cannot be thinned for ever
        if 4 * coarse.node_count > 3 * level.node_count {
            break;
        }
        prolongations.push(prolongation);
        level = coarse;
    }
    prolongations
}

fn coarsen(fine: &Level, cells: CellKind) -> (Level, Prolongation) {
    let parent = |v: [i32; 3]| v.map(|c| c.div_euclid(2));
    let faces = shared_faces(fine);

    // coarse cells: fine cells of one coarse voxel, joined across shared faces
    let mut group = Sets::new(fine.cells.len());
    for &(a, b, _) in &faces {
        if parent(fine.voxel[a]) == parent(fine.voxel[b]) {
            group.join(a as u32, b as u32);
        }
    }
    let (coarse_cell, count) = group.labels();
    let mut voxel = vec![[0; 3]; count];
    for (c, coarse) in coarse_cell.iter().enumerate() {
        voxel[*coarse as usize] = parent(fine.voxel[c]);
    }

    // coarse nodes: corners joined across faces that fine cells share
    let mut corner = Sets::new(8 * voxel.len());
    for &(a, b, axis) in &faces {
        let (ca, cb) = (coarse_cell[a] as usize, coarse_cell[b] as usize);
        if voxel[ca] != voxel[cb] {
            for (i, oa) in CORNERS.iter().enumerate().filter(|(_, o)| o[axis] == 1) {
                let j =
                    CORNERS.iter().position(|ob| (0..3).all(|k| if k == axis { ob[k] == 0 } else { ob[k] == oa[k] }));
                corner.join((8 * ca + i) as u32, (8 * cb + j.expect("the opposite corner is one of the eight")) as u32);
            }
        }
    }
    let coarse = Level::of_corners(voxel, corner);
    let prolongation = interpolate(fine, &coarse, &coarse_cell, cells);
    (coarse, prolongation)
}

/// Pairs of cells with a common face: (lower cell, upper cell, axis from one to the other).
fn shared_faces(level: &Level) -> Vec<(usize, usize, usize)> {
    let mut below: BTreeMap<(usize, [u32; 4]), usize> = BTreeMap::new();
    let face = |cell: &[u32; 8], axis: usize, side: i32| {
        let mut nodes = [0u32; 4];
        let on = (0..8).filter(|i| CORNERS[*i][axis] == side);
        nodes.iter_mut().zip(on).for_each(|(n, i)| *n = cell[i]);
        nodes.sort_unstable();
        nodes
    };
    for (c, cell) in level.cells.iter().enumerate() {
        for axis in 0..3 {
            below.insert((axis, face(cell, axis, 1)), c);
        }
    }
    let mut pairs = Vec::new();
    for (c, cell) in level.cells.iter().enumerate() {
        for axis in 0..3 {
            if let Some(&lower) = below.get(&(axis, face(cell, axis, 0))) {
                pairs.push((lower, c, axis));
            }
        }
    }
    pairs
}

fn interpolate(fine: &Level, coarse: &Level, coarse_cell: &[u32], cells: CellKind) -> Prolongation {
    // any cell of a node tells its place; the first one keeps the choice the same everywhere
    let mut home = vec![None; fine.node_count];
    for (c, cell) in fine.cells.iter().enumerate() {
        for (i, &n) in cell.iter().enumerate() {
            home[n as usize].get_or_insert((c, i));
        }
    }
    let mut p =
        Prolongation { coarse_count: coarse.node_count, start: vec![0], column: Vec::new(), weight: Vec::new() };
    for place in home {
        if let Some((c, i)) = place {
            let cc = coarse_cell[c] as usize;
            // coordinates in the coarse cell, in halves of its edge: 0, 1 or 2
            let t =
                std::array::from_fn(|k| 0.5 * f64::from(fine.voxel[c][k] + CORNERS[i][k] - 2 * coarse.voxel[cc][k]));
            p.push_weights(&coarse.cells[cc], t, cells);
        }
        p.start.push(p.column.len() as u32);
    }
    p
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::Lattice;

    /// Two bars of voxels side by side in the same coarse voxels, not touching.
    fn two_bars(length: i32) -> VolumeMesh {
        let mut mesh = VolumeMesh::default();
        let mut voxel = Vec::new();
        for bar in 0..2 {
            let mut index = BTreeMap::new();
            for x in 0..length {
                let v = [x, bar, 0];
                voxel.push(v);
                let cell = CORNERS.map(|o| {
                    let at = [v[0] + o[0], v[1] + o[1], v[2] + o[2]];
                    *index.entry(at).or_insert_with(|| {
                        mesh.nodes.push(at.map(f64::from));
                        mesh.nodes.len() as u32 - 1
                    })
                });
                mesh.hexes.push(cell);
            }
        }
        let piece = vec![u64::MAX; voxel.len()];
        mesh.lattice = Some(Lattice { origin: [0.0; 3], spacing: 1.0, voxel, piece });
        mesh
    }

    /// Interpolation reproduces linear functions, and never mixes bodies that do not touch.
    #[test]
    fn pieces_in_one_coarse_voxel_stay_apart_and_linear_functions_survive() {
        let mesh = two_bars(16);
        let options = HierarchyOptions { coarsest: 20, ..HierarchyOptions::default() };
        let levels = hierarchy(&mesh, &options);
        assert!(!levels.is_empty());
        let p = &levels[0];
        assert_eq!(p.start.len(), mesh.node_count() + 1);
        let half = mesh.node_count() / 2;
        let row = |n: usize| p.start[n] as usize..p.start[n + 1] as usize;
        let reached = |nodes: std::ops::Range<usize>| -> std::collections::BTreeSet<u32> {
            nodes.flat_map(|n| p.column[row(n)].to_vec()).collect()
        };
        assert!(reached(0..half).is_disjoint(&reached(half..2 * half)));
        // coarse x coordinates from the fine nodes that coincide with them
        let mut x = vec![f64::NAN; p.coarse_count];
        for n in 0..mesh.node_count() {
            if let [c] = p.column[row(n)] {
                x[c as usize] = mesh.nodes[n][0];
            }
        }
        for n in 0..mesh.node_count() {
            let sum: f64 = row(n).map(|k| p.weight[k]).sum();
            assert!((sum - 1.0).abs() < 1e-15);
            if row(n).all(|k| x[p.column[k] as usize].is_finite()) {
                let value: f64 = row(n).map(|k| p.weight[k] * x[p.column[k] as usize]).sum();
                assert!((value - mesh.nodes[n][0]).abs() < 1e-12);
            }
        }
    }
}
