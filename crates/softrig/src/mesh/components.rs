//! Connected components.

use super::sets::Sets;
use super::{SurfaceMesh, VolumeMesh};

/// Connected components of a mesh.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Components {
    /// Component of each cell (tetrahedra first) or triangle; numbered by their first ones.
    pub of_cell: Vec<u32>,
    /// Component of each node or vertex; `u32::MAX` for unused ones.
    pub of_node: Vec<u32>,
    /// How many there are.
    pub count: usize,
}

/// Components of a volume mesh: cells are connected when they share a node. Indices must be valid, see [`check`](super::check).
#[must_use]
pub fn components(mesh: &VolumeMesh) -> Components {
    connect(mesh.node_count(), mesh.cells())
}

/// Components of a surface: triangles are connected when they share a vertex. Weld seams first. Indices must be valid.
#[must_use]
pub fn surface_components(surface: &SurfaceMesh) -> Components {
    connect(surface.positions.len(), surface.triangles.iter().map(|t| t.as_slice()))
}

fn connect<'a>(node_count: usize, cells: impl Iterator<Item = &'a [u32]> + Clone) -> Components {
    let mut sets = Sets::new(node_count);
    for cell in cells.clone() {
        for n in &cell[1..] {
            sets.join(cell[0], *n);
        }
    }
    let (label, sets_count) = sets.labels();
    // number components by their first cells; nodes without a cell get none
    let mut number = vec![u32::MAX; sets_count];
    let mut count = 0;
    let mut out = Components { of_node: vec![u32::MAX; node_count], ..Components::default() };
    for cell in cells {
        let n = &mut number[label[cell[0] as usize] as usize];
        if *n == u32::MAX {
            *n = count;
            count += 1;
        }
        out.of_cell.push(*n);
        cell.iter().for_each(|v| out.of_node[*v as usize] = *n);
    }
    out.count = count as usize;
    out
}
