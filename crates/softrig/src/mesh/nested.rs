//! Hierarchies of tetrahedral meshes: refined from a coarse one, or made independently of each other [Georgii2010 §3.2].

use super::shape::tet_volume6;
use super::{Embedding, MeshError, Prolongation, VolumeMesh, renumbered};
use glam::DVec3;
use std::collections::BTreeMap;

/// Cuts every tetrahedron into eight: four at its corners, and four around the shortest diagonal of the octahedron between
/// them. Nodes of the mesh keep their numbers, midpoints of edges follow. Returns the fine mesh and the interpolation to it.
///
/// # Errors
/// [`MeshError::NoCells`] without tetrahedra, [`MeshError::CellIndex`] when one names a node that is not there.
pub fn refined(mesh: &VolumeMesh) -> Result<(VolumeMesh, Prolongation), MeshError> {
    let count = mesh.node_count();
    if mesh.tets.is_empty() {
        return Err(MeshError::NoCells);
    }
    for (cell, nodes) in mesh.tets.iter().enumerate() {
        if let Some(&node) = nodes.iter().find(|n| **n as usize >= count) {
            return Err(MeshError::CellIndex { cell, node, count });
        }
    }
    let mut fine =
        VolumeMesh { nodes: mesh.nodes.clone(), region_names: mesh.region_names.clone(), ..VolumeMesh::default() };
    let mut p = Prolongation { coarse_count: count, start: vec![0], column: Vec::new(), weight: Vec::new() };
    for n in 0..count as u32 {
        p.column.push(n);
        p.weight.push(1.0);
        p.start.push(p.column.len() as u32);
    }
    let mut middle: BTreeMap<(u32, u32), u32> = BTreeMap::new();
    for (cell, tet) in mesh.tets.iter().enumerate() {
        let mut between = |a: usize, b: usize| {
            let (a, b) = (tet[a].min(tet[b]), tet[a].max(tet[b]));
            *middle.entry((a, b)).or_insert_with(|| {
                let (x, y) = (mesh.nodes[a as usize], mesh.nodes[b as usize]);
                fine.nodes.push(std::array::from_fn(|k| 0.5 * (x[k] + y[k])));
                p.column.extend([a, b]);
                p.weight.extend([0.5, 0.5]);
                p.start.push(p.column.len() as u32);
                fine.nodes.len() as u32 - 1
            })
        };
        let [e01, e02, e03] = [between(0, 1), between(0, 2), between(0, 3)];
        let [e12, e13, e23] = [between(1, 2), between(1, 3), between(2, 3)];
        let mut children =
            vec![[tet[0], e01, e02, e03], [e01, tet[1], e12, e13], [e02, e12, tet[2], e23], [e03, e13, e23, tet[3]]];
        let at = |n: u32| DVec3::from(fine.nodes[n as usize]);
        // a diagonal, and the four nodes around it
        let ways =
            [(e01, e23, [e02, e03, e13, e12]), (e02, e13, [e01, e03, e23, e12]), (e03, e12, [e01, e02, e23, e13])];
        let length = |w: &(u32, u32, [u32; 4])| at(w.0).distance_squared(at(w.1));
        // of equals the first, whatever rounding says
        let mut best = ways[0];
        for way in &ways[1..] {
            if length(way) < (1.0 - 1e-9) * length(&best) {
                best = *way;
            }
        }
        let (a, b, ring) = best;
        children.extend((0..4).map(|k| [a, b, ring[k], ring[(k + 1) % 4]]));
        for mut child in children {
            if tet_volume6(&child.map(at)) < 0.0 {
                child.swap(2, 3);
            }
            fine.tets.push(child);
            fine.region.extend(mesh.region.get(cell));
            fine.fill.extend(mesh.fill.get(cell));
        }
    }
    Ok((fine, p))
}

/// A mesh refined some times, numbered along a space-filling curve on every level ([`renumbered`]), and the interpolations between
/// its levels, finest first.
///
/// # Errors
/// As [`refined`].
pub fn nested_hierarchy(
    coarsest: &VolumeMesh,
    refinements: usize,
) -> Result<(VolumeMesh, Vec<Prolongation>), MeshError> {
    let mut mesh = renumbered(coarsest).0;
    let mut levels = Vec::new();
    for _ in 0..refinements {
        let (fine, p) = refined(&mesh)?;
        let (ordered, old) = renumbered(&fine);
        let mut sorted = Prolongation { start: vec![0], ..Prolongation::empty() };
        sorted.coarse_count = p.coarse_count;
        for n in old {
            let row = p.start[n as usize] as usize..p.start[n as usize + 1] as usize;
            sorted.column.extend_from_slice(&p.column[row.clone()]);
            sorted.weight.extend_from_slice(&p.weight[row]);
            sorted.start.push(sorted.column.len() as u32);
        }
        levels.insert(0, sorted);
        mesh = ordered;
    }
    Ok((mesh, levels))
}

/// Interpolations between meshes made independently of each other, finest first: each node of a mesh hangs on the cell of the next
/// one it is in, or by extrapolation on the nearest (weights below zero are kept: they reproduce rotations). Best when every mesh
/// contains the one before.
///
/// # Errors
/// [`MeshError`] when a mesh has no usable cell.
pub fn embedded_hierarchy(mesh: &VolumeMesh, coarser: &[VolumeMesh]) -> Result<Vec<Prolongation>, MeshError> {
    let finer = std::iter::once(mesh).chain(coarser);
    finer
        .zip(coarser)
        .map(|(fine, coarse)| {
            let e = Embedding::embed(coarse, &fine.nodes, None)?;
            Ok(Prolongation { coarse_count: coarse.node_count(), start: e.start, column: e.node, weight: e.weight })
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::{CellKind, bar, boundary_faces, check};

    fn volume(mesh: &VolumeMesh) -> f64 {
        mesh.tets.iter().map(|t| tet_volume6(&t.map(|n| DVec3::from(mesh.nodes[n as usize]))) / 6.0).sum()
    }

    /// The standard bar is its coarsest level refined three times.
    #[test]
    fn refining_cuts_into_eight_and_keeps_volume_and_conformity() {
        let mut mesh = bar([4, 1, 2], [0.4, 0.1, 0.2], CellKind::Tet4);
        for level in 1..=3 {
            let (fine, p) = refined(&mesh).unwrap();
            assert_eq!(fine.tets.len(), 8 * mesh.tets.len());
            assert_eq!((p.coarse_count, p.start.len()), (mesh.node_count(), fine.node_count() + 1));
            assert!((volume(&fine) - 0.008).abs() < 1e-12, "level {level}");
            for n in 0..fine.node_count() {
                let row = p.start[n] as usize..p.start[n + 1] as usize;
                for k in 0..3 {
                    let x: f64 = row.clone().map(|e| p.weight[e] * mesh.nodes[p.column[e] as usize][k]).sum();
                    assert!((x - fine.nodes[n][k]).abs() < 1e-12);
                }
            }
            mesh = fine;
        }
        assert_eq!((mesh.node_count(), mesh.tets.len()), (5049, 24_576));
        let report = check(&mut mesh).unwrap();
        assert!(report.flipped == 0 && report.degenerate.is_empty() && report.unused_nodes == 0, "{report:?}");
        // two triangles for every square of the bar's skin: no face is left alone inside
        assert_eq!(boundary_faces(&mesh).triangles.len(), 4 * (32 * 8 + 8 * 16 + 16 * 32));
    }

    /// Nodes outside the coarser mesh too keep linear functions.
    #[test]
    fn independent_meshes_reproduce_linear_functions() {
        let fine = bar([8, 4, 4], [0.8, 0.4, 0.4], CellKind::Tet4);
        let mut coarse = bar([3, 2, 2], [0.7, 0.4, 0.4], CellKind::Tet4);
        coarse.nodes.iter_mut().for_each(|x| x[1] += 0.03);
        let p = &embedded_hierarchy(&fine, std::slice::from_ref(&coarse)).unwrap()[0];
        let f = |x: &[f64; 3]| 1.0 + 2.0 * x[0] - x[1] + 0.5 * x[2];
        for n in 0..fine.node_count() {
            let row = p.start[n] as usize..p.start[n + 1] as usize;
            let value: f64 = row.map(|e| p.weight[e] * f(&coarse.nodes[p.column[e] as usize])).sum();
            assert!((value - f(&fine.nodes[n])).abs() < 1e-9, "node {n}");
        }
        assert!(p.weight.iter().any(|w| *w < 0.0));
    }

    #[test]
    fn meshes_without_tetrahedra_are_refused() {
        assert_eq!(refined(&VolumeMesh::default()).unwrap_err(), MeshError::NoCells);
        assert!(embedded_hierarchy(&bar([1; 3], [1.0; 3], CellKind::Tet4), &[VolumeMesh::default()]).is_err());
    }
}
