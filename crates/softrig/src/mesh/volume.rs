//! Volume meshes of tetrahedra and hexahedra.

/// The two cells softrig computes with.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum CellKind {
    /// Four-node tetrahedron; nodes ordered so that its volume is positive.
    Tet4,
    /// Eight-node hexahedron in VTK order: bottom face 0-1-2-3 counter-clockwise seen from above, top face 4-5-6-7 over it.
    Hex8,
}

/// Where the hexahedra of a voxel body sit on their lattice. Several cells may share one voxel: material that lies close but
/// does not touch gets cells of its own.
#[derive(Clone, Debug, PartialEq)]
pub struct Lattice {
    /// Corner of voxel (0, 0, 0) [m].
    pub origin: [f64; 3],
    /// Edge of a voxel [m].
    pub spacing: f64,
    /// Voxel of each hexahedron; `voxel.len() == hexes.len()`.
    pub voxel: Vec<[i32; 3]>,
    /// Which of the 4x4x4 sub-voxels of its voxel each hexahedron owns: bit `x + 4 y + 16 z`. Tells cells that share a voxel apart.
    pub piece: Vec<u64>,
}

/// A volume mesh in its rest shape. Cells are numbered tetrahedra first, then hexahedra.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct VolumeMesh {
    /// Rest positions of the nodes [m].
    pub nodes: Vec<[f64; 3]>,
    /// Nodes of each [`CellKind::Tet4`].
    pub tets: Vec<[u32; 4]>,
    /// Nodes of each [`CellKind::Hex8`].
    pub hexes: Vec<[u32; 8]>,
    /// Region of each cell, an index into `region_names`; empty when the mesh has no regions.
    pub region: Vec<u32>,
    /// Names of the regions.
    pub region_names: Vec<String>,
    /// Part of each cell that is inside the skin, in (0, 1]; empty when every cell is full.
    pub fill: Vec<f32>,
    /// Present when the hexahedra are voxels.
    pub lattice: Option<Lattice>,
}

impl VolumeMesh {
    /// Number of nodes.
    #[must_use]
    pub fn node_count(&self) -> usize {
        self.nodes.len()
    }

    /// Number of cells of both kinds.
    #[must_use]
    pub fn cell_count(&self) -> usize {
        self.tets.len() + self.hexes.len()
    }

    /// Kind of cell `i`.
    #[must_use]
    pub fn kind(&self, i: usize) -> CellKind {
        if i < self.tets.len() { CellKind::Tet4 } else { CellKind::Hex8 }
    }

    /// Nodes of cell `i`.
    #[must_use]
    pub fn cell(&self, i: usize) -> &[u32] {
        match i.checked_sub(self.tets.len()) {
            None => &self.tets[i],
            Some(h) => &self.hexes[h],
        }
    }

    /// The nodes of every cell, tetrahedra first.
    pub fn cells(&self) -> impl ExactSizeIterator<Item = &[u32]> + Clone {
        (0..self.cell_count()).map(|i| self.cell(i))
    }

    /// Part of cell `i` that is inside the skin.
    #[must_use]
    pub fn fill(&self, i: usize) -> f32 {
        self.fill.get(i).copied().unwrap_or(1.0)
    }

    /// Smallest box around all nodes, as (lowest corner, highest corner) [m]; `None` without nodes.
    #[must_use]
    pub fn bounds(&self) -> Option<([f64; 3], [f64; 3])> {
        super::surface::bounds(&self.nodes)
    }
}
