//! Bodies of mass points whose tetrahedra keep distances, areas and volumes.
//!
//! Implements [Teschner2004] as [Gissler2006 §5] uses it. Each constraint C = (size - rest size) / rest size, for the length of an edge, the
//! area of a triangle of the surface and the volume of a tetrahedron, has the energy k C²/2 and the damped force
//! F_i = -(k C + k_d dC/dt) dC/dx_i. Four tetrahedra at once: an edge or a triangle belongs to the first tetrahedron that has it, and those
//! that have the same ones go together, so that little is computed for nothing.
//! Terms: x positions [m]; v velocities [m/s]; d edge; l its length; n normal of a triangle, twice its area long.

mod kernel;
mod setup;

use crate::lanes::LANES;
use crate::part::{self, Part};
use crate::stepper::ForceLaw;
use kernel::{Force, Scale};
use setup::{CellConstants, cell_constants, check, group, sorted};
use softrig::force::tet_gradients;
use softrig::mesh::VolumeMesh;
use softrig_linalg::{Scalar, run_wide};
use std::collections::BTreeMap;

/// Corners of the edges of a tetrahedron.
const EDGES: [[usize; 2]; 6] = [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]];
/// Cells that may change places, so that those side by side have the same edges.
const NEAR: usize = 512;
/// Corners of its triangles.
const FACES: [[usize; 3]; 4] = [[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]];

/// Energies of one tetrahedral mesh, all the same in every cell.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Energies {
    /// k of every edge [J]: a spring of k / l0² [N/m].
    pub distance: f64,
    /// k of every triangle of the surface [J].
    pub area: f64,
    /// k of every tetrahedron [J].
    pub volume: f64,
    /// k_d / k [s]. Default 0.002: jelly that swings a few times.
    pub damping: f64,
    /// Mass of a cubic metre [kg/m3].
    pub density: f64,
}

impl Default for Energies {
    /// About as stiff as soft rubber at cells of 10 cm.
    fn default() -> Self {
        Self { distance: 5.0, area: 1.0, volume: 5.0, damping: 0.002, density: 1000.0 }
    }
}

/// Why a mesh with energies is no body.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum MassPointError {
    /// Some cells are not tetrahedra.
    #[error("the mesh has {0} hexahedra; cut them into tetrahedra first (`tetrahedralize`)")]
    Hexahedra(usize),
    /// There is nothing to compute with.
    #[error("the mesh has no tetrahedra")]
    Empty,
    /// A cell names a node that does not exist.
    #[error("tetrahedron {cell} names node {node}, the mesh has {node_count} nodes")]
    MissingNode {
        /// Which cell.
        cell: usize,
        /// The node it names.
        node: u32,
        /// How many there are.
        node_count: usize,
    },
    /// A cell has no volume at rest.
    #[error("tetrahedron {cell} has the volume {volume:.3e} m3 at rest; it must be positive: turn or remove it")]
    BadCell {
        /// Which cell.
        cell: usize,
        /// Its volume [m3].
        volume: f64,
    },
    /// A coefficient is out of range.
    #[error("{field} is {value}, it must be finite and {expected}")]
    OutOfRange {
        /// Which one.
        field: &'static str,
        /// Its value.
        value: f64,
        /// What it must be.
        expected: &'static str,
    },
}

/// A body, or several, of mass points.
pub struct MassPoints<R> {
    /// Acceleration of everything [m/s2]; zero at first.
    pub gravity: [f64; 3],
    /// Drag on the velocity [1/s]; zero at first.
    pub drag: f64,
    mass: Vec<R>,
    scale: Scale<R>,
    parts: Vec<Cells<R>>,
    edge_count: usize,
    triangle_count: usize,
}

struct Group<R> {
    node: [[u32; LANES]; 4],
    /// k / l0 of each edge; zero where another cell has it. Here and below.
    edge: [[R; LANES]; 6],
    /// k / A0 of each triangle.
    face: [[R; LANES]; 4],
    /// k / V0.
    volume: [R; LANES],
    /// Edges and triangles that have a stiffness in any lane come first.
    edges: [u8; 6],
    edge_count: usize,
    faces: [u8; 4],
    face_count: usize,
}

struct Cells<R> {
    part: Part,
    groups: Vec<Group<R>>,
    x: Vec<[R; 4]>,
    v: Vec<[R; 4]>,
    f: Vec<[R; 4]>,
}

impl<R: Scalar> MassPoints<R> {
    /// A body at rest in its mesh.
    ///
    /// # Errors
    /// [`MassPointError`] when the mesh or a coefficient is not usable.
    pub fn new(mesh: &VolumeMesh, energies: &Energies) -> Result<Self, MassPointError> {
        check(mesh, energies)?;
        let node_count = mesh.node_count();
        let mut mass = vec![0.0; node_count];
        for t in &mesh.tets {
            let (_, volume) = tet_gradients(t.map(|n| mesh.nodes[n as usize]));
            t.iter().for_each(|n| mass[*n as usize] += energies.density * volume / 4.0);
        }
        // the first cell of each edge, and of each triangle that only one cell has
        let mut edges = BTreeMap::<[u32; 2], usize>::new();
        let mut faces = BTreeMap::<[u32; 3], (usize, usize)>::new();
        for (i, t) in mesh.tets.iter().enumerate() {
            for e in EDGES {
                edges.entry(sorted(e.map(|c| t[c]))).or_insert(i);
            }
            for f in FACES {
                faces.entry(sorted(f.map(|c| t[c]))).or_insert((i, 0)).1 += 1;
            }
        }
        let mut order: Vec<u32> = (0..mesh.tets.len() as u32).collect();
        order.sort_by_key(|i| mesh.tets[*i as usize].iter().min());
        let cells: Vec<[u32; 4]> = order.iter().map(|i| mesh.tets[*i as usize]).collect();
        let constants: Vec<CellConstants> =
            order.iter().map(|i| cell_constants(mesh, *i as usize, energies, &edges, &faces)).collect();
        let parts = part::parts(node_count, &cells)
            .into_iter()
            .map(|(part, mut own)| {
                // cells that have the same edges and triangles side by side, and still near one another
                own.sort_by_key(|k| (*k as usize / NEAR, constants[*k as usize].signature(), *k));
                let groups = own.chunks(LANES).map(|four| group(&part, four, &cells, &constants)).collect();
                let quads = vec![[R::zero(); 4]; part.len()];
                Cells { part, groups, x: quads.clone(), v: quads.clone(), f: quads }
            })
            .collect();
        let inverse = [energies.distance, energies.area, energies.volume]
            .map(|k| R::from_f64(if k > 0.0 { 1.0 / k } else { 0.0 }));
        Ok(Self {
            gravity: [0.0; 3],
            drag: 0.0,
            scale: Scale { inverse, damping: R::from_f64(energies.damping) },
            mass: mass.into_iter().map(R::from_f64).collect(),
            parts,
            edge_count: edges.len(),
            triangle_count: faces.values().filter(|f| f.1 == 1).count(),
        })
    }

    /// Mass of each node [kg].
    #[must_use]
    pub fn mass(&self) -> &[R] {
        &self.mass
    }

    /// How many edges and surface triangles have an energy.
    #[must_use]
    pub fn energy_counts(&self) -> (usize, usize) {
        (self.edge_count, self.triangle_count)
    }
}

impl<R: Scalar> ForceLaw<R> for MassPoints<R> {
    fn force(&mut self, position: &[[R; 3]], velocity: &[[R; 3]], force: &mut [[R; 3]]) {
        let gravity = self.gravity.map(R::from_f64);
        let (drag, scale, mass) = (R::from_f64(self.drag), self.scale, &self.mass);
        part::run(
            &mut self.parts,
            |c| c.part.own.clone(),
            force,
            |cells, out| {
                let own = cells.part.own.clone();
                run_wide::<R, _>(Force { cells, position, velocity, gravity, drag, scale, mass: &mass[own], out });
            },
        );
    }
}
