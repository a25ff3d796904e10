//! Structured bars for benches and tests.

use super::{CellKind, VolumeMesh};

/// A box of `count` cells along each axis from the origin to `size` [m]; as [`CellKind::Tet4`] each is cut into six tetrahedra. Node
/// `(i (ny + 1) + j) (nz + 1) + k` is at step (i, j, k). Tetrahedra run along the permutations of the axes from corner
/// 000 to 111, in lexicographic order [Kuhn1960].
#[must_use]
pub fn bar(count: [usize; 3], size: [f64; 3], kind: CellKind) -> VolumeMesh {
    let [nx, ny, nz] = count;
    let id = |c: [usize; 3]| ((c[0] * (ny + 1) + c[1]) * (nz + 1) + c[2]) as u32;
    let mut mesh = VolumeMesh::default();
    for i in 0..=nx {
        for j in 0..=ny {
            for k in 0..=nz {
                let at = |s: usize, axis: usize| size[axis] * s as f64 / count[axis].max(1) as f64;
                mesh.nodes.push([at(i, 0), at(j, 1), at(k, 2)]);
            }
        }
    }
    /// Order of axes, and whether the permutation is odd.
    const PATHS: [([usize; 3], bool); 6] = [
        ([0, 1, 2], false),
        ([0, 2, 1], true),
        ([1, 0, 2], true),
        ([1, 2, 0], false),
        ([2, 0, 1], false),
        ([2, 1, 0], true),
    ];
    for i in 0..nx {
        for j in 0..ny {
            for k in 0..nz {
                let c = |x: usize, y: usize, z: usize| id([i + x, j + y, k + z]);
                if kind == CellKind::Hex8 {
                    mesh.hexes.push([
                        c(0, 0, 0),
                        c(1, 0, 0),
                        c(1, 1, 0),
                        c(0, 1, 0),
                        c(0, 0, 1),
                        c(1, 0, 1),
                        c(1, 1, 1),
                        c(0, 1, 1),
                    ]);
                    continue;
                }
                for (axes, odd) in PATHS {
                    let mut at = [i, j, k];
                    let mut tet = [id(at); 4];
                    for (step, axis) in axes.into_iter().enumerate() {
                        at[axis] += 1;
                        tet[step + 1] = id(at);
                    }
                    if odd {
                        tet.swap(1, 2);
                    }
                    mesh.tets.push(tet);
                }
            }
        }
    }
    mesh
}
