//! Cells from the material of voxels, and which of their corners are one node.

use super::grid::{Crossings, Grid, HAS_NEXT};
use super::region::{Inside, across, cuts, pieces};
use crate::mesh::sets::Sets;
use crate::mesh::{Lattice, VolumeMesh};

/// Corners of a voxel in VTK order.
pub(super) const CORNERS: [[usize; 3]; 8] =
    [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]];
/// Mass of a sub-voxel of mere skin, as part of a full one: skin has no thickness of its own.
const SHEET_FILL: f32 = 0.25;

/// Material of every voxel, split into pieces.
pub(super) struct Pieces {
    /// Voxel of each piece.
    pub voxel: Vec<u32>,
    /// Its sub-voxels.
    pub mask: Vec<u64>,
    /// Part of the voxel that it fills, in (0, 1].
    pub fill: Vec<f32>,
    /// First piece of each voxel, and one past the last.
    start: Vec<u32>,
}

/// Links between sub-voxels in direction `k` of one voxel that do not connect.
fn cut(voxel: usize, crossings: &Crossings, inside: &Inside, k: usize) -> u64 {
    let slot = crossings.slot[voxel];
    if slot == super::grid::NONE {
        return 0;
    }
    cuts(&crossings.walls[slot as usize], inside.mask[voxel], inside.deep[slot as usize], k)
}

impl Pieces {
    /// Splits the material, inside and sheets, into connected pieces.
    pub fn new(grid: &Grid, crossings: &Crossings, inside: &Inside, sheets: &[u64]) -> Self {
        let mut out = Self { voxel: Vec::new(), mask: Vec::new(), fill: Vec::new(), start: Vec::new() };
        let mut list = Vec::new();
        for voxel in 0..grid.voxel_count() {
            out.start.push(out.voxel.len() as u32);
            let sheet = sheets.get(voxel).copied().unwrap_or(0);
            let material = inside.mask[voxel] | sheet;
            if material == 0 {
                continue;
            }
            let walls: [u64; 3] = std::array::from_fn(|k| {
                let wall = cut(voxel, crossings, inside, k);
                // only between two solid sub-voxels: sheets touch whatever is next to them
                wall & !((sheet | (sheet >> super::grid::STEP[k])) & HAS_NEXT[k])
            });
            pieces(material, &walls, &mut list);
            for &mask in &list {
                out.voxel.push(voxel as u32);
                out.mask.push(mask);
                let solid = (mask & inside.mask[voxel]).count_ones() as f32;
                out.fill.push((solid + SHEET_FILL * ((mask & !inside.mask[voxel]).count_ones() as f32)) / 64.0);
            }
        }
        out.start.push(out.voxel.len() as u32);
        out
    }

    /// Hexahedra of all pieces; corners are one node where pieces of neighbouring voxels touch.
    pub fn build(self, grid: &Grid, crossings: &Crossings, inside: &Inside) -> VolumeMesh {
        let mut corners = Sets::new(self.voxel.len() * 8);
        let stride = grid.stride();
        for a in 0..self.voxel.len() {
            let voxel = self.voxel[a] as usize;
            let at = grid.voxel(voxel);
            for k in 0..3 {
                if at[k] + 1 == grid.size[k] {
                    continue;
                }
                let open = across(self.mask[a], cut(voxel, crossings, inside, k), k);
                let other = voxel + stride[k];
                for b in self.start[other] as usize..self.start[other + 1] as usize {
                    if open & self.mask[b] != 0 {
                        for (i, far) in CORNERS.iter().enumerate().filter(|(_, c)| c[k] == 1) {
                            let mut near = *far;
                            near[k] = 0;
                            let j = corner_index(near);
                            corners.join((a * 8 + i) as u32, (b * 8 + j) as u32);
                        }
                    }
                }
            }
        }
        let (label, node_count) = corners.labels();
        let mut nodes = vec![[0.0; 3]; node_count];
        let mut mesh = VolumeMesh::default();
        let mut lattice = Lattice {
            // voxel (0, 0, 0) is the first one behind the empty layer
            origin: (grid.origin + grid.spacing).to_array(),
            spacing: grid.spacing,
            voxel: Vec::with_capacity(self.voxel.len()),
            piece: Vec::with_capacity(self.voxel.len()),
        };
        for a in 0..self.voxel.len() {
            let at = grid.voxel(self.voxel[a] as usize).map(|x| x as i32 - 1);
            let hex: [u32; 8] = std::array::from_fn(|i| label[a * 8 + i]);
            // two pieces that share every node would be the same cell twice
            let first = mesh.hexes.len();
            let same = (0..first).rev().take_while(|c| lattice.voxel[*c] == at).find(|c| mesh.hexes[*c] == hex);
            if let Some(c) = same {
                lattice.piece[c] |= self.mask[a];
                mesh.fill[c] += self.fill[a];
                continue;
            }
            for (i, c) in CORNERS.iter().enumerate() {
                nodes[hex[i] as usize] =
                    std::array::from_fn(|k| lattice.origin[k] + f64::from(at[k] + c[k] as i32) * grid.spacing);
            }
            mesh.hexes.push(hex);
            mesh.fill.push(self.fill[a]);
            lattice.voxel.push(at);
            lattice.piece.push(self.mask[a]);
        }
        mesh.nodes = nodes;
        mesh.lattice = Some(lattice);
        mesh
    }
}

/// Position in VTK order of a corner.
pub(super) fn corner_index(c: [usize; 3]) -> usize {
    CORNERS.iter().position(|x| *x == c).expect("all eight corners are listed")
}

/// Position of a sub-voxel's bit within its voxel [sub-voxels].
pub(super) fn sub_at(bit: u32) -> [i32; 3] {
    [bit % 4, bit / 4 % 4, bit / 16].map(|x| x as i32)
}
