//! What the cells of a mesh are at rest, checked and sorted into groups of four.

use super::{EDGES, Energies, FACES, Group, MassPointError};
use crate::lanes::LANES;
use crate::part::Part;
use softrig::force::tet_gradients;
use softrig::mesh::VolumeMesh;
use softrig_linalg::{Scalar, Vec3};
use std::collections::BTreeMap;

pub(super) fn sorted<const N: usize>(mut a: [u32; N]) -> [u32; N] {
    a.sort_unstable();
    a
}

pub(super) fn check(mesh: &VolumeMesh, energies: &Energies) -> Result<(), MassPointError> {
    if !mesh.hexes.is_empty() {
        return Err(MassPointError::Hexahedra(mesh.hexes.len()));
    }
    if mesh.tets.is_empty() {
        return Err(MassPointError::Empty);
    }
    let node_count = mesh.node_count();
    for (cell, t) in mesh.tets.iter().enumerate() {
        if let Some(node) = t.iter().copied().find(|n| *n as usize >= node_count) {
            return Err(MassPointError::MissingNode { cell, node, node_count });
        }
        let (_, volume) = tet_gradients(t.map(|n| mesh.nodes[n as usize]));
        if !(volume.is_finite() && volume > 0.0) {
            return Err(MassPointError::BadCell { cell, volume });
        }
    }
    let e = energies;
    let range = [
        ("distance", e.distance, false),
        ("area", e.area, false),
        ("volume", e.volume, false),
        ("damping", e.damping, false),
        ("density", e.density, true),
    ];
    for (field, value, positive) in range {
        if !value.is_finite() || value < 0.0 || (positive && value == 0.0) {
            let expected = if positive { "positive" } else { "not negative" };
            return Err(MassPointError::OutOfRange { field, value, expected });
        }
    }
    Ok(())
}

/// k / rest size of the edges, triangles and the volume of a cell; zero for what another cell has.
pub(super) struct CellConstants {
    edge: [f64; 6],
    face: [f64; 4],
    volume: f64,
}

impl CellConstants {
    /// Which edges and triangles it has, as bits.
    pub fn signature(&self) -> u32 {
        self.edge.iter().chain(&self.face).fold(0, |bits, k| 2 * bits + u32::from(*k > 0.0))
    }
}

pub(super) fn cell_constants(
    mesh: &VolumeMesh,
    i: usize,
    energies: &Energies,
    edges: &BTreeMap<[u32; 2], usize>,
    faces: &BTreeMap<[u32; 3], (usize, usize)>,
) -> CellConstants {
    let t = mesh.tets[i];
    let at = |c: usize| Vec3(mesh.nodes[t[c] as usize]);
    CellConstants {
        edge: EDGES.map(|[a, b]| {
            let own = edges[&sorted([t[a], t[b]])] == i;
            if own { energies.distance / (at(b) - at(a)).norm() } else { 0.0 }
        }),
        face: FACES.map(|[a, b, c]| {
            let (_, count) = faces[&sorted([t[a], t[b], t[c]])];
            let area = 0.5 * (at(b) - at(a)).cross(at(c) - at(a)).norm();
            if count == 1 { energies.area / area } else { 0.0 }
        }),
        volume: energies.volume / tet_gradients(t.map(|n| mesh.nodes[n as usize])).1,
    }
}

pub(super) fn group<R: Scalar>(part: &Part, four: &[u32], cells: &[[u32; 4]], constants: &[CellConstants]) -> Group<R> {
    let at = |l: usize| four[l.min(four.len() - 1)] as usize;
    // lanes beyond the last cell repeat it without stiffness
    let fill = |f: &dyn Fn(&CellConstants) -> f64| -> [R; LANES] {
        std::array::from_fn(|l| if l < four.len() { R::from_f64(f(&constants[at(l)])) } else { R::zero() })
    };
    let any = |f: &dyn Fn(&CellConstants) -> f64| four.iter().any(|c| f(&constants[*c as usize]) > 0.0);
    let (edges, edge_count) = first(std::array::from_fn(|e| any(&|c| c.edge[e])));
    let (faces, face_count) = first(std::array::from_fn(|f| any(&|c| c.face[f])));
    Group {
        node: std::array::from_fn(|a| {
            std::array::from_fn(|l| part.local(cells[at(l)][a]).expect("a part has the nodes of its cells"))
        }),
        edge: std::array::from_fn(|e| fill(&|c| c.edge[e])),
        face: std::array::from_fn(|f| fill(&|c| c.face[f])),
        volume: fill(&|c| c.volume),
        edges,
        edge_count,
        faces,
        face_count,
    }
}

/// The numbers of those that are there, then the others, and how many are there.
fn first<const N: usize>(there: [bool; N]) -> ([u8; N], usize) {
    let mut order: [u8; N] = std::array::from_fn(|k| k as u8);
    order.sort_by_key(|k| !there[usize::from(*k)]);
    (order, there.iter().filter(|t| **t).count())
}
