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

/// (1 / rest size, k / rest size) of the edges, triangles and the volume of a cell; k_d / k; k is zero for what another cell has.
pub(super) struct CellConstants {
    edge: [[f64; 2]; 6],
    face: [[f64; 2]; 4],
    volume: [f64; 2],
    damping: f64,
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
    let of = |size: f64, k: f64| [1.0 / size, k / size];
    CellConstants {
        edge: EDGES.map(|[a, b]| {
            let own = edges[&sorted([t[a], t[b]])] == i;
            of((at(b) - at(a)).norm(), if own { energies.distance } else { 0.0 })
        }),
        face: FACES.map(|[a, b, c]| {
            let (_, count) = faces[&sorted([t[a], t[b], t[c]])];
            let area = 0.5 * (at(b) - at(a)).cross(at(c) - at(a)).norm();
            of(area, if count == 1 { energies.area } else { 0.0 })
        }),
        volume: of(tet_gradients(t.map(|n| mesh.nodes[n as usize])).1, energies.volume),
        damping: energies.damping,
    }
}

pub(super) fn group<R: Scalar>(part: &Part, four: &[u32], cells: &[[u32; 4]], constants: &[CellConstants]) -> Group<R> {
    let at = |l: usize| four[l.min(four.len() - 1)] as usize;
    // lanes beyond the last cell repeat it without stiffness
    let pair = |f: &dyn Fn(&CellConstants) -> [f64; 2]| -> [[R; LANES]; 2] {
        std::array::from_fn(|k| {
            std::array::from_fn(|l| {
                let value = f(&constants[at(l)])[k];
                R::from_f64(if k == 1 && l >= four.len() { 0.0 } else { value })
            })
        })
    };
    Group {
        node: std::array::from_fn(|a| {
            std::array::from_fn(|l| part.local(cells[at(l)][a]).expect("a part has the nodes of its cells"))
        }),
        edge: std::array::from_fn(|e| pair(&|c| c.edge[e])),
        face: std::array::from_fn(|f| pair(&|c| c.face[f])),
        volume: pair(&|c| c.volume),
        damping: [R::from_f64(constants[at(0)].damping); LANES],
        surface: std::array::from_fn(|f| (0..four.len()).any(|l| constants[at(l)].face[f][1] != 0.0)),
    }
}
