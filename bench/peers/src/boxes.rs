//! The body of the comparison: a box of tetrahedra around a straight bone.

use rapier3d::prelude::{SoftBodyBuilder, Vector};
use softrig::mesh::VolumeMesh;

/// Edge of a cube, five tetrahedra each [m].
pub const CUBE: f32 = 0.025;

/// A box lying along x. The nodes on and next to its axis belong to a bone that fills four fifths of its length; the rest overhangs.
pub struct FleshBox {
    /// Node positions [m], as both engines get them.
    pub nodes: Vec<[f32; 3]>,
    /// Four nodes each, positively oriented.
    pub tets: Vec<[u32; 4]>,
    /// Volume of each [m3].
    volume: Vec<f64>,
    /// Nodes of the bone.
    pub bone: Vec<u32>,
    /// Where the bone begins and ends along the axis [m].
    pub extent: [f32; 2],
    /// Nodes of the free end.
    pub tip: Vec<usize>,
}

impl FleshBox {
    /// A box of so many cubes; `y` and `z` even, so that there are nodes on the axis.
    pub fn new(cubes: [usize; 3]) -> Self {
        let half = cubes.map(|n| 0.5 * CUBE * n as f32);
        let [nx, ny, nz] = cubes.map(|n| n + 1);
        // the peer's own mesh, so that it is not told to be slow on ours
        let made = SoftBodyBuilder::cuboid(Vector::ZERO, Vector::new(half[0], half[1], half[2]), nx, ny, nz);
        let nodes: Vec<[f32; 3]> = made.positions.iter().map(|p| [p.x, p.y, p.z]).collect();
        let layers = nx * 4 / 5;
        let at = |n: usize| [n / (ny * nz), n / nz % ny, n % nz];
        let on_bone = |n: &usize| {
            let [i, j, k] = at(*n);
            i < layers && j.abs_diff(ny / 2) <= 1 && k.abs_diff(nz / 2) <= 1
        };
        let bone = (0..nodes.len()).filter(on_bone).map(|n| n as u32).collect();
        let tip = (0..nodes.len()).filter(|n| at(*n)[0] == nx - 1).collect();
        let mut tets = made.cells;
        let mut volume = Vec::with_capacity(tets.len());
        for t in &mut tets {
            let v = signed_volume(t.map(|n| nodes[n as usize].map(f64::from)));
            if v < 0.0 {
                t.swap(2, 3);
            }
            volume.push(v.abs());
        }
        let extent = [-half[0], -half[0] + CUBE * (layers - 1) as f32];
        Self { nodes, tets, volume, bone, extent, tip }
    }

    /// The same as a softrig mesh.
    pub fn mesh(&self) -> VolumeMesh {
        let nodes = self.nodes.iter().map(|x| x.map(f64::from)).collect();
        VolumeMesh { nodes, tets: self.tets.clone(), ..VolumeMesh::default() }
    }

    /// Mass of each node: a quarter of each of its tetrahedra [kg].
    pub fn masses(&self, density: f64) -> Vec<f32> {
        let mut mass = vec![0.0; self.nodes.len()];
        for (tet, volume) in self.tets.iter().zip(&self.volume) {
            tet.iter().for_each(|n| mass[*n as usize] += 0.25 * density * volume);
        }
        mass.into_iter().map(|m| m as f32).collect()
    }

    /// Mean height that the tip lost [m].
    pub fn sag(&self, height: impl Fn(usize) -> f64) -> f64 {
        self.tip.iter().map(|n| f64::from(self.nodes[*n][1]) - height(*n)).sum::<f64>() / self.tip.len() as f64
    }
}

fn signed_volume([a, b, c, d]: [[f64; 3]; 4]) -> f64 {
    let from_a = |p: [f64; 3]| [p[0] - a[0], p[1] - a[1], p[2] - a[2]];
    let (u, v, w) = (from_a(b), from_a(c), from_a(d));
    (u[0] * (v[1] * w[2] - v[2] * w[1]) + u[1] * (v[2] * w[0] - v[0] * w[2]) + u[2] * (v[0] * w[1] - v[1] * w[0])) / 6.0
}
