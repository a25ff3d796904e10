//! How deep inside the body each node lies.

use super::weight::{Rows, neighbours};
use crate::mesh::{VolumeMesh, boundary_faces};
use glam::DVec3;
use std::collections::VecDeque;

/// Distance from each node to about the nearest node on the outside [m]: nearest sources are handed from node to node over the
/// cells, which is exact to a fraction of a cell.
pub(super) fn depth(mesh: &VolumeMesh) -> Vec<f64> {
    let near: Rows = neighbours(mesh);
    let at = |n: u32| DVec3::from(mesh.nodes[n as usize]);
    let mut source = vec![u32::MAX; mesh.node_count()];
    let mut queue = VecDeque::new();
    for n in boundary_faces(mesh).triangles.iter().flatten() {
        if source[*n as usize] == u32::MAX {
            source[*n as usize] = *n;
            queue.push_back(*n);
        }
    }
    let mut depth: Vec<f64> = source.iter().map(|s| if *s == u32::MAX { f64::INFINITY } else { 0.0 }).collect();
    while let Some(n) = queue.pop_front() {
        for &m in near.of(n as usize) {
            let distance = at(m).distance(at(source[n as usize]));
            if distance < depth[m as usize] {
                depth[m as usize] = distance;
                source[m as usize] = source[n as usize];
                queue.push_back(m);
            }
        }
    }
    // nodes of no cell are nowhere
    depth.iter_mut().filter(|d| !d.is_finite()).for_each(|d| *d = 0.0);
    depth
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::{CellKind, bar};

    #[test]
    fn depth_of_a_block_is_the_distance_to_its_nearest_face() {
        let size = [1.0, 0.8, 0.6];
        let mesh = bar([10, 8, 6], size, CellKind::Hex8);
        for (p, d) in mesh.nodes.iter().zip(depth(&mesh)) {
            let exact = (0..3).map(|k| p[k].min(size[k] - p[k])).fold(f64::INFINITY, f64::min);
            assert!((d - exact).abs() < 1e-9, "{p:?}: {d}, {exact}");
        }
    }
}
