//! Is a volume mesh fit to compute with?

use super::shape::{hex_point_volumes, tet_volume6};
use super::{MeshError, VolumeMesh};
use glam::DVec3;

/// What [`check`] found and repaired.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MeshReport {
    /// Tetrahedra and hexahedra that were turned over.
    pub flipped: usize,
    /// Whether only some cells had to be turned: the file mixes orientations.
    pub mixed_orientation: bool,
    /// Cells without volume, or with a node used twice.
    pub degenerate: Vec<u32>,
    /// Hexahedra that are partly inside out: their corners are listed in a wrong order, or they are folded.
    pub folded: Vec<u32>,
    /// Nodes that no cell uses.
    pub unused_nodes: usize,
    /// Sum of the volumes of all cells [m^3].
    pub volume: f64,
}

/// Checks a volume mesh, turning over cells that are inside out as a whole.
///
/// # Errors
/// Node indices out of range, coordinates that are not finite, lists of a wrong length. The mesh is unchanged then.
pub fn check(mesh: &mut VolumeMesh) -> Result<MeshReport, MeshError> {
    let count = mesh.node_count();
    for (cell, nodes) in mesh.cells().enumerate() {
        if let Some(&node) = nodes.iter().find(|n| **n as usize >= count) {
            return Err(MeshError::CellIndex { cell, node, count });
        }
    }
    if let Some(index) = mesh.nodes.iter().position(|p| !p.iter().all(|x| x.is_finite())) {
        return Err(MeshError::NonFinite { what: "node", index });
    }
    let (cells, hexes) = (mesh.cell_count(), mesh.hexes.len());
    let lattice = mesh.lattice.as_ref().map_or((hexes, hexes), |l| (l.voxel.len(), l.piece.len()));
    let lists = [
        ("region", mesh.region.len(), cells, true),
        ("fill", mesh.fill.len(), cells, true),
        ("lattice.voxel", lattice.0, hexes, false),
        ("lattice.piece", lattice.1, hexes, false),
    ];
    for (list, found, expected, may_be_empty) in lists {
        if found != expected && !(may_be_empty && found == 0) {
            return Err(MeshError::ListLength { list, found, expected });
        }
    }

    let mut report = MeshReport::default();
    let mut used = vec![false; count];
    mesh.cells().flatten().for_each(|n| used[*n as usize] = true);
    report.unused_nodes = used.iter().filter(|u| !**u).count();
    let at = |n: u32| DVec3::from_array(mesh.nodes[n as usize]);
    let mut good = 0;
    let mut shapes = Vec::with_capacity(cells);
    for (i, nodes) in mesh.cells().enumerate() {
        let (volume, smallest, largest) = if let &[a, b, c, d] = nodes {
            let v = tet_volume6(&[at(a), at(b), at(c), at(d)]) / 6.0;
            (v, v, v)
        } else {
            let parts = hex_point_volumes(&std::array::from_fn(|k| at(nodes[k])));
            (
                parts.iter().sum(),
                parts.iter().copied().fold(f64::MAX, f64::min),
                parts.iter().copied().fold(f64::MIN, f64::max),
            )
        };
        let corners = || nodes.iter().map(|n| at(*n));
        let (lo, hi) = corners().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(l, h), p| (l.min(p), h.max(p)));
        let twice = nodes.iter().enumerate().any(|(k, n)| nodes[..k].contains(n));
        if twice || volume.abs() <= 1e-12 * (hi - lo).length().powi(3) {
            report.degenerate.push(i as u32);
            shapes.push(Shape::Keep);
        } else if smallest > 0.0 {
            good += 1;
            shapes.push(Shape::Keep);
        } else if largest < 0.0 {
            shapes.push(Shape::Flip);
        } else {
            report.folded.push(i as u32);
            shapes.push(if volume < 0.0 { Shape::Flip } else { Shape::Keep });
        }
        report.volume += volume.abs();
    }
    let tets = mesh.tets.len();
    for (i, _) in shapes.iter().enumerate().filter(|(_, s)| **s == Shape::Flip) {
        report.flipped += 1;
        match i.checked_sub(tets) {
            None => mesh.tets[i].swap(2, 3),
            // bottom and top change places
            Some(h) => (0..4).for_each(|k| mesh.hexes[h].swap(k, k + 4)),
        }
    }
    report.mixed_orientation = report.flipped > 0 && good > 0;
    Ok(report)
}

#[derive(Clone, Copy, PartialEq)]
enum Shape {
    Keep,
    Flip,
}
