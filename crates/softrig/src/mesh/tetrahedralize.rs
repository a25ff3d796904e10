//! Tetrahedra from hexahedra.

use super::VolumeMesh;
use super::boundary::HEX_FACES;
use super::shape::tet_volume6;
use glam::DVec3;

/// Cuts every hexahedron into tetrahedra whose faces match those of its neighbours; tetrahedra stay as they are. Voxels of a lattice are
/// cut into the six of [Kuhn1960] along the diagonal from their lowest to their highest corner. Other hexahedra are cut from their
/// lowest-numbered node to every triangle of the faces opposite, faces at their own lowest-numbered nodes, so that neighbours agree whatever
/// their orientation. Tetrahedra without volume are left out.
/// Regions and fill go from each hexahedron to its tetrahedra. Indices must be valid.
#[must_use]
pub fn tetrahedralize(mesh: &VolumeMesh) -> VolumeMesh {
    let mut out = VolumeMesh {
        nodes: mesh.nodes.clone(),
        tets: mesh.tets.clone(),
        region_names: mesh.region_names.clone(),
        region: mesh.region.iter().take(mesh.tets.len()).copied().collect(),
        fill: mesh.fill.iter().take(mesh.tets.len()).copied().collect(),
        ..VolumeMesh::default()
    };
    let voxels = mesh.lattice.is_some();
    for (h, hex) in mesh.hexes.iter().enumerate() {
        let first = out.tets.len();
        if voxels {
            kuhn(hex, &mut out.tets)
        } else {
            from_lowest(hex, &mesh.nodes, &mut out.tets)
        }
        let cell = mesh.tets.len() + h;
        let made = out.tets.len() - first;
        if let Some(r) = mesh.region.get(cell) {
            out.region.extend(std::iter::repeat_n(*r, made));
        }
        if let Some(f) = mesh.fill.get(cell) {
            out.fill.extend(std::iter::repeat_n(*f, made));
        }
    }
    out
}

/// Six tetrahedra around the diagonal 0-6, all of positive volume in a cube.
pub(super) fn kuhn(hex: &[u32; 8], out: &mut Vec<[u32; 4]>) {
    // paths along the three axes from corner 0 to 6; middle nodes swapped for odd permutations
    const PATHS: [[usize; 4]; 6] = [[0, 1, 2, 6], [0, 5, 1, 6], [0, 2, 3, 6], [0, 3, 7, 6], [0, 4, 5, 6], [0, 7, 4, 6]];
    out.extend(PATHS.iter().map(|p| p.map(|k| hex[k])));
}

fn from_lowest(hex: &[u32; 8], nodes: &[[f64; 3]], out: &mut Vec<[u32; 4]>) {
    let low = *hex.iter().min().expect("a hexahedron has nodes");
    let at = |n: u32| DVec3::from_array(nodes[n as usize]);
    for face in &HEX_FACES {
        let f = face.map(|k| hex[k]);
        if f.contains(&low) {
            continue;
        }
        let start = (0..4).min_by_key(|k| f[*k]).unwrap_or(0);
        let n = |k: usize| f[(start + k) % 4];
        for t in [[n(0), n(1), n(2)], [n(0), n(2), n(3)]] {
            // outward faces see the fourth node behind them
            let tet = [t[0], t[2], t[1], low];
            if tet[0] != tet[1] && tet[1] != tet[2] && tet[2] != tet[0] && tet_volume6(&tet.map(at)) != 0.0 {
                out.push(tet);
            }
        }
    }
}
