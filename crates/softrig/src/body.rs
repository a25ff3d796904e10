//! A body: a volume mesh with materials, mass, a force model and prescribed nodes.

use crate::force::{
    ElasticModel, ForceModel, Increment, LONGEST_ROW, Rotations, StVenantKirchhoff, corotated, hex_points,
    tet_gradients,
};
use crate::material::{MaterialError, MaterialMap};
use crate::mesh::{CellKind, VolumeMesh};
use softrig_linalg::{BlockCsr, BlockPattern, DofConstraints, Scalar, par};
use std::sync::Arc;

/// Least part of a cell that has mass: cells that hold only a crumb of flesh would otherwise be light and stiff, and turn
/// inside out in creases (numerics: worst cell −.07 without, .47 with).
pub const LEAST_FILL: f64 = 0.3;

/// Everything about flesh that does not change from step to step, and the force model's history.
pub struct Body<R> {
    /// Rest shape.
    pub mesh: VolumeMesh,
    /// Lumped mass of each node [kg]; zero for nodes without a cell.
    pub mass: Vec<R>,
    /// Mass-proportional damping of each node by the materials of its cells, a M [kg/s].
    pub drag: Vec<R>,
    /// Mass-proportional damping added to that of the materials, everywhere [1/s]; 0 by default. A damped pre-roll raises it.
    pub mass_damping: R,
    /// Stiffness-proportional damping added to that of the materials, everywhere [s]; 0 by default.
    pub stiffness_damping: R,
    /// Used instead of the lumped mass in the equation of motion when present: for checks against the literature.
    pub consistent_mass: Option<BlockCsr<R>>,
    /// Internal forces and stiffness. Each cell is damped with its own material's b.
    pub model: Box<dyn ForceModel<R>>,
    /// Which nodes are prescribed. Nodes without a cell always are: they stay where they are.
    pub constraints: DofConstraints,
    /// Where the blocks of the stiffness matrix are.
    pub pattern: Arc<BlockPattern>,
}

/// Why a mesh with materials is no body.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum BodyError {
    /// There is nothing to compute with.
    #[error("the volume mesh has no cells")]
    Empty,
    /// A cell names a node that does not exist.
    #[error("cell {cell} names node {node}, the mesh has {node_count} nodes")]
    MissingNode {
        /// Which cell.
        cell: usize,
        /// The node it names.
        node: u32,
        /// How many there are.
        node_count: usize,
    },
    /// A node is not at a finite place.
    #[error("node {node} of the volume mesh is not at a finite position")]
    NotFinite {
        /// Which node.
        node: usize,
    },
    /// A cell is flat, folded or inside out in its rest shape.
    #[error(
        "cell {cell} has no positive volume in the rest shape ({volume:.3e} m3 at its worst point); repair the mesh or build it from the surface"
    )]
    BadCell {
        /// Which cell.
        cell: usize,
        /// Smallest volume found [m3].
        volume: f64,
    },
    /// More cells meet at a node than the assembly counts.
    #[error("node {node} shares cells with {count} others, more than {LONGEST_ROW}; remesh around it")]
    Crowded {
        /// Which node.
        node: usize,
        /// How many others.
        count: usize,
    },
    /// The material map does not fit the mesh.
    #[error("the material map has {found} {what}, the mesh has {expected} cells")]
    MaterialCount {
        /// Which list.
        what: &'static str,
        /// Its length.
        found: usize,
        /// Number of cells.
        expected: usize,
    },
    /// A cell names a material that does not exist.
    #[error("cell {cell} names material {material}, the map has {count}")]
    MissingMaterial {
        /// Which cell.
        cell: usize,
        /// The material it names.
        material: usize,
        /// How many there are.
        count: usize,
    },
    /// A material is outside the range of the model.
    #[error("cell {cell}: {source}")]
    Material {
        /// First cell that has the material.
        cell: usize,
        /// What is wrong with it.
        source: MaterialError,
    },
    /// The list of prescribed nodes does not fit the mesh.
    #[error("constraints are given for {found} nodes, the mesh has {expected}")]
    ConstraintCount {
        /// Length of the list.
        found: usize,
        /// Number of nodes.
        expected: usize,
    },
}

impl<R: Scalar> Body<R> {
    /// A body in its rest shape. Each cell's mass is that of its filled part (at least [`LEAST_FILL`]), its stiffness that of
    /// the whole cell.
    ///
    /// # Errors
    /// [`BodyError`] when a cell, a material or the constraints do not fit.
    pub fn new(
        mut mesh: VolumeMesh,
        materials: &MaterialMap,
        model: ElasticModel,
        constraints: DofConstraints,
    ) -> Result<Self, BodyError> {
        check(&mesh, materials)?;
        // lists that grew have room for half as many again
        mesh.nodes.shrink_to_fit();
        mesh.tets.shrink_to_fit();
        mesh.hexes.shrink_to_fit();
        let n = mesh.node_count();
        let (mut mass, mut drag) = (vec![0.0; n], vec![0.0; n]);
        for i in 0..mesh.cell_count() {
            let m = materials.get(i);
            let density = m.density * filled(&mesh, i);
            for (node, volume) in corner_volumes(&mesh, i) {
                mass[node as usize] += density * volume;
                drag[node as usize] += m.mass_damping * density * volume;
            }
        }
        let pattern = Arc::new(BlockPattern::from_cells(n, mesh.cells()));
        if let Some(node) = (0..n).find(|i| pattern.row(*i).len() > LONGEST_ROW) {
            return Err(BodyError::Crowded { node, count: pattern.row(node).len() - 1 });
        }
        let model: Box<dyn ForceModel<R>> = match model {
            ElasticModel::Corotated => corotated(&mesh, materials, pattern.clone(), Rotations::Follow),
            ElasticModel::Linear => corotated(&mesh, materials, pattern.clone(), Rotations::Fixed),
            ElasticModel::StVenantKirchhoff => Box::new(StVenantKirchhoff::new(&mesh, materials)),
        };
        let cast = |v: Vec<f64>| v.into_iter().map(R::from_f64).collect();
        let mut body = Self {
            mesh,
            mass: cast(mass),
            drag: cast(drag),
            mass_damping: R::zero(),
            stiffness_damping: R::zero(),
            consistent_mass: None,
            model,
            constraints: DofConstraints::none(n),
            pattern,
        };
        body.set_constraints(constraints)?;
        Ok(body)
    }

    /// Replaces the set of prescribed nodes. Nodes without a cell are added to it.
    ///
    /// # Errors
    /// [`BodyError::ConstraintCount`] when there is not one flag per node.
    pub fn set_constraints(&mut self, constraints: DofConstraints) -> Result<(), BodyError> {
        if constraints.node_count() != self.mass.len() {
            return Err(BodyError::ConstraintCount { found: constraints.node_count(), expected: self.mass.len() });
        }
        let flags = constraints.mask().iter().zip(&self.mass);
        self.constraints = DofConstraints::from_mask(flags.map(|(c, m)| *c || *m == R::zero()).collect());
        Ok(())
    }

    /// `K + s M` with the stiffness of the model's last linearisation and lumped masses [N/m]; `inertia` is s [1/s2].
    pub fn system_matrix(&mut self, inertia: f64) -> BlockCsr<R> {
        let mut matrix = BlockCsr::zero(self.pattern.clone());
        self.model.stiffness(R::zero(), R::zero(), &mut matrix);
        for (at, m) in self.pattern.diagonal().iter().zip(&self.mass) {
            let added = R::from_f64(inertia * m.to_f64());
            (0..3).for_each(|k| matrix.values[*at as usize][4 * k] += added);
        }
        matrix
    }

    /// What a displacement and a velocity add to the internal force; a velocity adds nothing, at no cost, where nothing is damped.
    pub(crate) fn increment<'a>(&self, displacement: Option<&'a [[R; 3]]>, velocity: &'a [[R; 3]]) -> Increment<'a, R> {
        Increment { displacement, velocity: self.is_damped().then_some(velocity), damping: self.stiffness_damping }
    }

    /// Does any cell have a damping proportional to its stiffness?
    pub(crate) fn is_damped(&self) -> bool {
        self.model.is_damped() || self.stiffness_damping != R::zero()
    }

    /// Kinetic energy of lumped masses [J].
    pub(crate) fn kinetic_energy(&self, velocity: &[[R; 3]]) -> f64 {
        let of = |i: usize| {
            let v = velocity[i].map(Scalar::to_f64);
            0.5 * self.mass[i].to_f64() * (v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
        };
        par::sum(velocity.len(), |range| range.map(of).sum())
    }

    /// Sum of the nodes' masses [kg].
    #[must_use]
    pub fn total_mass(&self) -> f64 {
        self.mass.iter().map(|m| m.to_f64()).sum()
    }

    /// Gravity on every node, m g [N]; `gravity` in m/s2.
    #[must_use]
    pub fn weight(&self, gravity: [f64; 3]) -> Vec<[R; 3]> {
        self.mass.iter().map(|m| gravity.map(|g| R::from_f64(g * m.to_f64()))).collect()
    }
}

/// Consistent mass matrix ∫ rho N_a N_b [kg], on the pattern of the mesh's cells.
///
/// # Errors
/// As [`Body::new`].
pub fn consistent_mass<R: Scalar>(
    mesh: &VolumeMesh,
    materials: &MaterialMap,
    pattern: &Arc<BlockPattern>,
) -> Result<BlockCsr<R>, BodyError> {
    check(mesh, materials)?;
    let mut values = vec![0.0; pattern.block_count()];
    for i in 0..mesh.cell_count() {
        let density = materials.get(i).density * filled(mesh, i);
        let nodes = mesh.cell(i);
        let at = |k: usize| mesh.nodes[nodes[k] as usize];
        let points = match mesh.kind(i) {
            CellKind::Tet4 => Vec::new(),
            CellKind::Hex8 => hex_points(std::array::from_fn(at)).to_vec(),
        };
        for a in 0..nodes.len() {
            for b in 0..nodes.len() {
                let m = match mesh.kind(i) {
                    CellKind::Tet4 => tet_gradients(std::array::from_fn(at)).1 / if a == b { 10.0 } else { 20.0 },
                    CellKind::Hex8 => points.iter().map(|p| p.volume * p.value[a] * p.value[b]).sum(),
                };
                let k =
                    pattern.find(nodes[a] as usize, nodes[b] as usize).expect("the pattern was made from these cells");
                values[k] += density * m;
            }
        }
    }
    let mut matrix = BlockCsr::zero(pattern.clone());
    for (block, m) in matrix.values.iter_mut().zip(values) {
        (0..3).for_each(|c| block[4 * c] = R::from_f64(m));
    }
    Ok(matrix)
}

fn filled(mesh: &VolumeMesh, i: usize) -> f64 {
    f64::from(mesh.fill(i)).clamp(LEAST_FILL, 1.0)
}

/// The share of a cell's volume that each of its nodes gets [m3].
fn corner_volumes(mesh: &VolumeMesh, i: usize) -> impl Iterator<Item = (u32, f64)> + '_ {
    let nodes = mesh.cell(i);
    let at = |k: usize| mesh.nodes[nodes[k] as usize];
    let mut share = [0.0; 8];
    match mesh.kind(i) {
        CellKind::Tet4 => share[..4].fill(tet_gradients(std::array::from_fn(at)).1 / 4.0),
        CellKind::Hex8 => {
            for p in hex_points(std::array::from_fn(at)) {
                (0..8).for_each(|a| share[a] += p.volume * p.value[a]);
            }
        }
    }
    nodes.iter().copied().zip(share)
}

fn check(mesh: &VolumeMesh, materials: &MaterialMap) -> Result<(), BodyError> {
    let cells = mesh.cell_count();
    if cells == 0 {
        return Err(BodyError::Empty);
    }
    if let Some(node) = mesh.nodes.iter().position(|p| !p.iter().all(|c| c.is_finite())) {
        return Err(BodyError::NotFinite { node });
    }
    let lists = [
        ("material indices", materials.of_cell.len()),
        ("stiffness factors", materials.stiffness_factor.len()),
        ("fill values", mesh.fill.len()),
    ];
    for (what, found) in lists {
        if found != 0 && found != cells {
            return Err(BodyError::MaterialCount { what, found, expected: cells });
        }
    }
    let node_count = mesh.node_count();
    for (cell, nodes) in mesh.cells().enumerate() {
        if let Some(&node) = nodes.iter().find(|n| **n as usize >= node_count) {
            return Err(BodyError::MissingNode { cell, node, node_count });
        }
        let material = materials.of_cell.get(cell).map_or(0, |k| *k as usize);
        let count = materials.materials.len();
        if material >= count {
            return Err(BodyError::MissingMaterial { cell, material, count });
        }
        materials.get(cell).check().map_err(|source| BodyError::Material { cell, source })?;
        let at = |k: usize| mesh.nodes[nodes[k] as usize];
        let volume = match mesh.kind(cell) {
            CellKind::Tet4 => tet_gradients(std::array::from_fn(at)).1,
            CellKind::Hex8 => hex_points(std::array::from_fn(at)).iter().fold(f64::INFINITY, |v, p| v.min(p.volume)),
        };
        let size = nodes.iter().flat_map(|n| mesh.nodes[*n as usize]).zip(at(0).into_iter().cycle());
        let size = size.fold(0.0f64, |m, (x, x0)| m.max((x - x0).abs()));
        if volume.is_nan() || volume <= 1e-12 * size * size * size {
            return Err(BodyError::BadCell { cell, volume });
        }
    }
    Ok(())
}
