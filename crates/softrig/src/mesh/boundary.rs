//! The outer surface of a volume mesh.

use super::VolumeMesh;

/// Triangles around a volume mesh, wound outward.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct BoundaryFaces {
    /// Nodes of each triangle; quadrilateral faces give two, cut at their lowest-numbered node.
    pub triangles: Vec<[u32; 3]>,
    /// Cell behind each triangle.
    pub cell: Vec<u32>,
}

/// Faces of a positive tetrahedron, wound outward.
const TET_FACES: [[usize; 3]; 4] = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]];
/// Faces of a hexahedron in VTK order, wound outward.
pub(super) const HEX_FACES: [[usize; 4]; 6] =
    [[0, 3, 2, 1], [4, 5, 6, 7], [0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]];

/// Faces that belong to one cell only, in the order of their cells. Indices must be valid.
#[must_use]
pub fn boundary_faces(mesh: &VolumeMesh) -> BoundaryFaces {
    /// Stands where a triangle has no fourth node.
    const NO_NODE: u32 = u32::MAX;
    let mut faces: Vec<([u32; 4], u32, [u32; 4])> = Vec::new();
    for (cell, nodes) in mesh.cells().enumerate() {
        let mut push = |face: [u32; 4]| {
            let mut key = face;
            key.sort_unstable();
            faces.push((key, cell as u32, face));
        };
        if nodes.len() == 4 {
            TET_FACES.iter().for_each(|f| push([nodes[f[0]], nodes[f[1]], nodes[f[2]], NO_NODE]));
        } else {
            HEX_FACES.iter().for_each(|f| push(f.map(|k| nodes[k])));
        }
    }
    faces.sort_unstable();
    let mut outer: Vec<(u32, [u32; 4])> =
        faces.chunk_by(|a, b| a.0 == b.0).filter(|c| c.len() == 1).map(|c| (c[0].1, c[0].2)).collect();
    outer.sort_unstable();
    let mut out = BoundaryFaces::default();
    for (cell, f) in outer {
        if f[3] == NO_NODE {
            out.triangles.push([f[0], f[1], f[2]]);
            out.cell.push(cell);
        } else {
            let low = (0..4).min_by_key(|k| f[*k]).unwrap_or(0);
            let n = |k: usize| f[(low + k) % 4];
            out.triangles.extend([[n(0), n(1), n(2)], [n(0), n(2), n(3)]]);
            out.cell.extend([cell, cell]);
        }
    }
    out
}
