//! Bodies to measure with: those of the table of [Tang2009] and of figures 1 and 2 of [Gissler2006], on lattices whose cubes are cut
//! into five tetrahedra.
//!
//! The paper gives counts of nodes and tetrahedra only; these come close (see each shape).

use crate::constraint::Constraint;
use crate::skeleton::{Reach, SkeletonConstraints};
use softrig::character::Character;
use softrig::mesh::{LatticeOptions, Resolution, SurfaceMesh, VolumeMesh, tetrahedralize, voxelize};
use softrig::rig::JointId;

/// The shapes of the table of [Tang2009].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shape {
    /// A ball of radius 0.5 m: 343 nodes, 1,080 tetrahedra (paper: 376 and 1,091).
    Sphere,
    /// A cube of edge 1 m: 392 nodes, 1,260 tetrahedra (paper: 453 and 1,198).
    Cube,
    /// A torus around Y, radii 0.5 m and 0.2 m: 640 nodes, 1,800 tetrahedra (paper: 609 and 1,823).
    Torus,
}

impl Shape {
    /// All shapes, in the order of the table.
    pub const ALL: [Self; 3] = [Self::Sphere, Self::Cube, Self::Torus];

    /// Name as in the table.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Sphere => "sphere",
            Self::Cube => "cube",
            Self::Torus => "torus",
        }
    }

    /// The body at rest.
    #[must_use]
    pub fn mesh(self) -> VolumeMesh {
        match self {
            Self::Cube => five_tets([6, 6, 7], false, |p| p.map(|x| x - 0.5)),
            Self::Sphere => five_tets([6, 6, 6], false, |p| {
                let [x, y, z] = p.map(|x| 2.0 * x - 1.0);
                // a cube blown up to a ball, corners rounded a little less so that no cell is flat
                let ball = |a: f64, b: f64, c: f64| {
                    let round = (1.0 - b * b / 2.0 - c * c / 2.0 + b * b * c * c / 3.0).sqrt();
                    0.5 * a * (0.85 * round + 0.15 * 0.7)
                };
                [ball(x, y, z), ball(y, z, x), ball(z, x, y)]
            }),
            Self::Torus => five_tets([40, 3, 3], true, |p| {
                let angle = p[0] * std::f64::consts::TAU;
                let [a, b] = [p[1], p[2]].map(|x| 2.0 * x - 1.0);
                let disc = |a: f64, b: f64| 0.2 * a * (0.85 * (1.0 - b * b / 2.0).sqrt() + 0.15 * 0.7);
                let r = 0.5 + disc(a, b);
                [r * angle.cos(), disc(b, a), r * angle.sin()]
            }),
        }
    }
}

/// A lattice of cubes, each cut into five tetrahedra, mirrored from one to the next; `map` places the nodes from the unit cube. With
/// `closed` the first axis runs in a ring and needs an even number of cubes.
#[must_use]
pub fn five_tets(count: [usize; 3], closed: bool, map: impl Fn([f64; 3]) -> [f64; 3]) -> VolumeMesh {
    let [nx, ny, nz] = count;
    let rings = if closed { nx } else { nx + 1 };
    let id = |i: usize, j: usize, k: usize| (((i % rings) * (ny + 1) + j) * (nz + 1) + k) as u32;
    let mut mesh = VolumeMesh::default();
    for i in 0..rings {
        for j in 0..=ny {
            for k in 0..=nz {
                mesh.nodes.push(map([i as f64 / nx as f64, j as f64 / ny as f64, k as f64 / nz as f64]));
            }
        }
    }
    /// Corners x + 2 y + 4 z of the tetrahedra: four at every other corner, one between.
    const TETS: [[usize; 4]; 5] = [[0, 1, 2, 4], [3, 1, 2, 7], [5, 1, 4, 7], [6, 2, 4, 7], [1, 2, 4, 7]];
    for i in 0..nx {
        for j in 0..ny {
            for k in 0..nz {
                let odd = (i + j + k) % 2;
                for tet in TETS {
                    let mut tet = tet.map(|c| {
                        // mirrored in x for every other cube
                        let c = c ^ odd;
                        id(i + (c & 1), j + (c >> 1 & 1), k + (c >> 2))
                    });
                    let [a, b, c, d] = tet.map(|n| glam::DVec3::from(mesh.nodes[n as usize]));
                    if (b - a).cross(c - a).dot(d - a) < 0.0 {
                        tet.swap(1, 2);
                    }
                    mesh.tets.push(tet);
                }
            }
        }
    }
    mesh
}

/// The scene of [Gissler2006 figures 1 and 2]: `count` cubes of five tetrahedra in 40 hanging columns, the top cube of each on four
/// nails, each cube joined to the one above at its corners. 36 joints hold three corners instead of four, which gives the paper's
/// counts: 160 nails, and 4 (count - 9) constraints in all. Edges of 0.1 m, columns 0.15 m apart, the mesh hung ready to be stepped.
#[must_use]
pub fn hanging_cubes(count: usize) -> (VolumeMesh, Vec<Constraint>) {
    const COLUMNS: usize = 40;
    const EDGE: f64 = 0.1;
    let cube = five_tets([1, 1, 1], false, |p| p);
    let (mut mesh, mut joints) = (VolumeMesh::default(), Vec::new());
    let mut nails = Vec::new();
    let mut above = vec![None::<u32>; COLUMNS];
    let mut short = 36;
    for i in 0..count {
        let (column, row) = (i % COLUMNS, i / COLUMNS);
        let first = mesh.nodes.len() as u32;
        let origin = [0.15 * column as f64, -EDGE * (row + 1) as f64, 0.0];
        mesh.nodes.extend(cube.nodes.iter().map(|p| std::array::from_fn(|k| origin[k] + EDGE * p[k])));
        mesh.tets.extend(cube.tets.iter().map(|t| t.map(|n| n + first)));
        // corner numbers are 4 x + 2 y + z
        let top = [2, 3, 6, 7];
        match above[column] {
            None => nails.extend(top.map(|c| {
                let node = first + c;
                Constraint::Nail { node, goal: mesh.nodes[node as usize] }
            })),
            Some(upper) => {
                let held = if short > 0 { 3 } else { 4 };
                short -= usize::from(short > 0);
                joints.extend(
                    top[..held].iter().map(|c| Constraint::PointsToPoint { nodes: vec![first + c, upper + c - 2] }),
                );
            }
        }
        above[column] = Some(first);
    }
    nails.extend(joints);
    (mesh, nails)
}

/// The sample character of softrig as the jelly man of [Tang2009 figure 1]: about 4,800 tetrahedra around its skin (paper: 4,822), its
/// skeleton inside, nodes within 7 cm of the bones bound. The skeleton has 21 joints, 63 rotations (paper: 48 degrees of freedom).
///
/// # Errors
/// [`softrig::mesh::MeshError`] when the skin cannot be filled.
pub fn jelly_man() -> Result<(Character, VolumeMesh, SkeletonConstraints), softrig::mesh::MeshError> {
    let character = softrig::sample::character();
    let skin = SurfaceMesh {
        positions: character.meshes[0].positions.clone(),
        triangles: character.meshes[0].triangles.clone(),
    };
    // six tetrahedra a cube
    let options = LatticeOptions { resolution: Resolution::Cells(4822 / 6), ..LatticeOptions::default() };
    let mesh = tetrahedralize(&voxelize(&skin, &options)?);
    let joints: Vec<JointId> = (0..character.skeleton.joint_count() as u32).map(JointId).collect();
    let bound = SkeletonConstraints::bind(&character.skeleton, &mesh, &joints, Reach::Line(0.07));
    Ok((character, mesh, bound))
}

#[cfg(test)]
mod tests {
    use super::*;
    use softrig::force::tet_gradients;

    /// The counts that the documentation states, and bodies without a hole: volumes are those of the shapes.
    #[test]
    fn shapes_have_the_counts_and_volumes_they_say() {
        let volume = |m: &VolumeMesh| -> f64 {
            let parts = m.tets.iter().map(|t| tet_gradients(t.map(|n| m.nodes[n as usize])).1);
            parts.inspect(|v| assert!(*v > 0.0)).sum()
        };
        let pi = std::f64::consts::PI;
        let expect = [
            (Shape::Sphere, 343, 1080, pi / 6.0, 0.25),
            (Shape::Cube, 392, 1260, 1.0, 1e-12),
            (Shape::Torus, 640, 1800, 2.0 * pi * pi * 0.5 * 0.04, 0.25),
        ];
        for (shape, nodes, tets, v, slack) in expect {
            let m = shape.mesh();
            assert_eq!((m.node_count(), m.tets.len()), (nodes, tets), "{shape:?}");
            assert!((volume(&m) - v).abs() <= slack * v, "{shape:?} {} {v}", volume(&m));
        }
    }

    /// The counts of [Gissler2006 figures 1 and 2], and a set without conflicts.
    #[test]
    fn hanging_cubes_have_the_counts_of_the_paper() {
        for (cubes, tets, constraints) in [(790, 3950, 160 + 2964), (2990, 14950, 11924), (9990, 49950, 39924)] {
            let (mesh, list) = hanging_cubes(cubes);
            assert_eq!((mesh.tets.len(), list.len()), (tets, constraints));
            let mut set = crate::constraint::Constraints::new(mesh.node_count());
            list.into_iter().for_each(|c| _ = set.add(c).unwrap());
        }
    }
}
