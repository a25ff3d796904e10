//! Corotated linear elasticity of a whole mesh: f_int = Σ R Ke (Rᵀ x − X).
//!
//! Implements [Mueller2004] with the rotations of `polar.rs`, tetrahedra of `tet.rs`, hexahedra of `hex.rs`. The stiffness
//! R Ke Rᵀ leaves out how R turns: positive semidefinite in every shape, and exact at rest. With rotations held at the
//! identity the same code is linear elasticity.

use super::ForceModel;
use super::assembly::{Diagonal, Increment, Rows, gather_forces};
use super::hex::{self, HexBlock, HexConstants, HexLoad, HexShape};
use super::incidence::{Incidence, Strips};
use super::load::{Internal, Product};
use super::tet::{self, BLOCK, TASK, TetConstants, TetLoad, Tets, tet_gradients};
use crate::material::MaterialMap;
use crate::mesh::VolumeMesh;
use crate::mesh::shape::hex_volume;
use rayon::prelude::*;
use softrig_linalg::par::Each;
use softrig_linalg::{BlockCsr, BlockPattern, CELLS, CubeMatrix, CubePattern, Scalar, Scatter, either, par, run_wide};
use std::collections::HashMap;
use std::sync::Arc;

/// Rotations of the cells.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rotations {
    /// Follow the deformation: corotated elasticity.
    Follow,
    /// Stay the identity: linear elasticity, right for small rotations only.
    Fixed,
}

/// Corotated (or linear) elasticity on tetrahedra and hexahedra.
pub struct Corotated<R> {
    rotations: Rotations,
    damped: bool,
    /// Cell of the mesh behind each of our tetrahedra: ours are in the order of their nodes, so that the cells that meet at a
    /// node lie close in memory, however the mesh was written. Empty where they are in the order of the mesh.
    tet_order: Vec<u32>,
    tets: Tets<R>,
    tet_q: Vec<[[R; BLOCK]; 4]>,
    /// lam / mu, where it is the same for all tetrahedra.
    ratio: Option<R>,
    hexes: Vec<HexBlock<R>>,
    hex_q: Vec<[[R; BLOCK]; 4]>,
    shapes: Vec<HexShape<R>>,
    // forces and energies of chunks of cells, on their way to the nodes
    tet_parts: Vec<[R; 4]>,
    hex_scatter: Scatter<8>,
    hex_parts: Vec<[R; 4]>,
    // nodes to cells
    pattern: Arc<BlockPattern>,
    strips: Strips,
    hex_incidence: Incidence<8>,
    cubes: Option<Arc<CubePattern>>,
    /// Rotations to go back to. In f32, because they only say where the next ones are looked for.
    saved: Vec<[[f32; BLOCK]; 4]>,
    /// The largest cell at each node, tetrahedra first.
    largest: Vec<u32>,
}

/// The largest cell of a node without any.
const NO_CELL: usize = u32::MAX as usize;

/// The cells as equal cubes along the axes, if that is what all of them are.
fn cube_pattern<R>(mesh: &VolumeMesh, shapes: &[HexShape<R>]) -> Option<Arc<CubePattern>> {
    let edge = shapes.first()?.cube.as_ref()?.edge;
    let equal = |s: &HexShape<R>| s.cube.as_ref().is_some_and(|c| (c.edge - edge).abs() <= 1e-9 * edge);
    (mesh.tets.is_empty() && shapes.iter().all(equal))
        .then(|| Arc::new(CubePattern { nodes: mesh.hexes.clone(), node_count: mesh.node_count(), edge }))
}

impl<R: Scalar> Corotated<R> {
    /// A model of cells that [`crate::body::Body::new`] has checked, with the pattern made from them.
    fn new(mesh: &VolumeMesh, materials: &MaterialMap, pattern: Arc<BlockPattern>, rotations: Rotations) -> Self {
        let at = |n: u32| mesh.nodes[n as usize];
        let mut tet_order: Vec<u32> = (0..mesh.tets.len() as u32).collect();
        tet_order.sort_by_key(|i| mesh.tets[*i as usize].iter().min());
        let tet_nodes: Vec<[u32; 4]> = tet_order.iter().map(|i| mesh.tets[*i as usize]).collect();
        let tets: Vec<TetConstants> = tet_order
            .iter()
            .zip(&tet_nodes)
            .map(|(i, cell)| {
                let m = materials.get(*i as usize);
                let (gradient, volume) = tet_gradients(cell.map(at));
                let (lambda, mu) = (m.lambda(), m.shear_modulus());
                TetConstants { gradient, volume, lambda, mu, damping: m.stiffness_damping }
            })
            .collect();
        let mut shapes = Vec::new();
        let mut index = HashMap::new();
        let hexes: Vec<HexConstants> = mesh
            .hexes
            .iter()
            .enumerate()
            .map(|(i, cell)| {
                let m = materials.get(mesh.tets.len() + i);
                let corners = cell.map(at);
                // cells of equal shape share their stiffness; the list keeps the order of first use
                let shape = *index.entry(shape_key(corners, m.poisson_ratio)).or_insert_with(|| {
                    shapes.push(HexShape::new(corners, m.poisson_ratio));
                    shapes.len() as u32 - 1
                });
                HexConstants { shape, scale: m.young_modulus, damping: m.stiffness_damping }
            })
            .collect();
        let identity = [[R::zero(); BLOCK], [R::zero(); BLOCK], [R::zero(); BLOCK], [R::one(); BLOCK]];
        let nodes = mesh.node_count();
        let (tet_scatter, hex_scatter) = (Scatter::new(nodes, &tet_nodes), Scatter::new(nodes, &mesh.hexes));
        let parts = |count: usize| vec![[R::zero(); 4]; count];
        let tet_parts = parts(tet_scatter.part_count());
        if tet_order.is_sorted() {
            tet_order = Vec::new();
        }
        let sized = tet_nodes.iter().zip(&tets).map(|(cell, tet)| (&cell[..], tet.volume));
        let sized_hexes = mesh.hexes.iter().map(|cell| (&cell[..], hex_volume(&cell.map(|n| at(n).into()))));
        let largest = largest(nodes, sized.chain(sized_hexes));
        let mut model = Self {
            rotations,
            damped: tets.iter().any(|t| t.damping != 0.0) || hexes.iter().any(|h| h.damping != 0.0),
            tet_q: vec![identity; tets.len().div_ceil(BLOCK)],
            ratio: ratio(&tets),
            tets: Tets::new(&tets, tet_scatter, &mesh.nodes),
            hexes: hexes.chunks(BLOCK).map(HexBlock::new).collect(),
            hex_q: vec![identity; hexes.len().div_ceil(BLOCK)],
            cubes: cube_pattern(mesh, &shapes),
            shapes,
            tet_parts,
            hex_parts: parts(hex_scatter.part_count()),
            hex_scatter,
            strips: Strips::new(&Incidence::new(nodes, &tet_nodes, &pattern), &pattern),
            hex_incidence: Incidence::new(nodes, &mesh.hexes, &pattern),
            tet_order,
            pattern,
            saved: Vec::new(),
            largest,
        };
        // the stiffness is that of the rest shape until the first linearisation
        let rest: Vec<[R; 3]> = mesh.nodes.iter().map(|p| p.map(R::from_f64)).collect();
        model.linearise(&rest);
        model.save();
        model
    }

    fn rows(&self, rate: R, damping: R) -> Rows<'_, R> {
        Rows {
            pattern: &self.pattern,
            strips: &self.strips,
            tets: &self.tets,
            tet_q: &self.tet_q,
            ratio: self.ratio,
            hexes: &self.hex_incidence,
            hex_blocks: &self.hexes,
            hex_q: &self.hex_q,
            shapes: &self.shapes,
            rate,
            damping,
        }
    }

    /// Number of distinct hexahedron shapes (shape and Poisson's ratio) that have a stiffness of their own.
    #[must_use]
    pub fn shape_count(&self) -> usize {
        self.shapes.len()
    }

    /// Makes the parts that the forces of tetrahedra are sums of.
    fn fill_tet_parts(&mut self, load: impl TetLoad<R>) {
        let Self { tets, tet_q, tet_parts, .. } = self;
        let tets = &*tets;
        tets.scatter.for_chunks(tet_parts, |chunk, _, parts| {
            run_wide::<R, _>(tet::Forces { tets, chunk, q: par::chunk(tet_q, chunk, TASK), load, parts });
        });
    }

    /// Those of hexahedra.
    fn fill_hex_parts(&mut self, load: impl HexLoad<R>) {
        let Self { hexes, hex_q, hex_parts, hex_scatter, shapes, .. } = self;
        hex_scatter.for_chunks(hex_parts, |c, local, parts| {
            let (blocks, q, nodes) = (par::chunk(hexes, c, TASK), par::chunk(hex_q, c, TASK), hex_scatter.nodes(c));
            run_wide::<R, _>(hex::Forces { blocks, shapes, q, load, nodes, local, parts });
        });
    }

    /// Rotations of the hexahedra.
    fn turn_hexes(&mut self, position: &[[R; 3]]) {
        let Self { hexes, shapes, hex_scatter, .. } = self;
        let hexes = hexes.par_chunks(TASK).zip(self.hex_q.par_chunks_mut(TASK)).enumerate();
        hexes.each(|(c, (blocks, q))| {
            let (nodes, local) = (hex_scatter.nodes(c), hex_scatter.local(c));
            run_wide::<R, _>(hex::Rotate { blocks, shapes, nodes, local, position, q });
        });
    }

    /// What the parts of the last internal forces have of energy [J].
    fn energy(&self) -> f64 {
        let of = |parts: &[[R; 4]]| par::sum(parts.len(), |range| parts[range].iter().map(|p| p[3].to_f64()).sum());
        of(&self.tet_parts) + of(&self.hex_parts)
    }

    /// Sums the parts up at the nodes.
    fn gather_parts(&self, diagonal: Option<Diagonal<'_, R>>, force: &mut [[R; 3]]) {
        let Self { tets, tet_parts, hex_scatter, hex_parts, .. } = self;
        gather_forces((&tets.scatter, tet_parts), (hex_scatter, hex_parts), diagonal, force);
    }
}

/// Cell of the mesh behind a tetrahedron of ours, by [`Corotated::tet_order`].
fn cell_of(tet_order: &[u32], tet: usize) -> usize {
    tet_order.get(tet).map_or(tet, |cell| *cell as usize)
}

/// The rotation of a cell.
#[inline(always)]
fn lane<R: Scalar>(blocks: &[[[R; BLOCK]; 4]], cell: usize) -> [R; 4] {
    blocks[cell / BLOCK].map(|c| c[cell % BLOCK])
}

/// For each node its largest cell, the first of equals; cells in the given order.
fn largest<'a>(node_count: usize, cells: impl Iterator<Item = (&'a [u32], f64)>) -> Vec<u32> {
    let mut largest = vec![(NO_CELL as u32, 0.0); node_count];
    for (i, (cell, volume)) in cells.enumerate() {
        for n in cell {
            let known = &mut largest[*n as usize];
            // volumes that differ by rounding are equal: which cell it is must not depend on the place of a body
            if volume > 1.0001 * known.1 {
                *known = (i as u32, volume);
            }
        }
    }
    largest.into_iter().map(|(cell, _)| cell).collect()
}

/// lam / mu, where it is the same for all tetrahedra.
fn ratio<R: Scalar>(tets: &[TetConstants]) -> Option<R> {
    let first = tets.first()?;
    // moduli differ by rounding where Poisson's ratio does not
    let same =
        |t: &TetConstants| (t.lambda * first.mu - first.lambda * t.mu).abs() <= 1e-14 * first.lambda.abs() * t.mu;
    tets.iter().all(same).then(|| R::from_f64(first.lambda / first.mu))
}

/// The model behind its trait.
pub(crate) fn corotated<R: Scalar>(
    mesh: &VolumeMesh,
    map: &MaterialMap,
    pattern: Arc<BlockPattern>,
    rotations: Rotations,
) -> Box<dyn ForceModel<R>> {
    either(|| single(mesh, map, pattern.clone(), rotations), || double(mesh, map, pattern.clone(), rotations))
}

fn single(m: &VolumeMesh, map: &MaterialMap, p: Arc<BlockPattern>, r: Rotations) -> Box<dyn ForceModel<f32>> {
    Box::new(Corotated::<f32>::new(m, map, p, r))
}

fn double(m: &VolumeMesh, map: &MaterialMap, p: Arc<BlockPattern>, r: Rotations) -> Box<dyn ForceModel<f64>> {
    Box::new(Corotated::<f64>::new(m, map, p, r))
}

/// Equal for cells whose corners lie equally around corner 0, to 1e-11 of their size, and whose Poisson's ratio is the same.
fn shape_key(corners: [[f64; 3]; 8], poisson_ratio: f64) -> ([[i64; 3]; 8], u64, i32) {
    let offset = corners.map(|c| std::array::from_fn::<f64, 3, _>(|i| c[i] - corners[0][i]));
    let size = offset.iter().flatten().fold(0.0f64, |m, c| m.max(c.abs()));
    let exponent = size.log2().floor() as i32;
    let quantum = 2f64.powi(exponent - 36);
    (offset.map(|o| o.map(|c| (c / quantum).round() as i64)), poisson_ratio.to_bits(), exponent)
}

impl<R: Scalar> ForceModel<R> for Corotated<R> {
    fn linearise(&mut self, position: &[[R; 3]]) {
        if self.rotations == Rotations::Fixed {
            return;
        }
        let Self { tets, .. } = self;
        self.tet_q.par_chunks_mut(TASK).enumerate().each(|(chunk, q)| {
            run_wide::<R, _>(tet::Rotate { tets, chunk, position, q });
        });
        self.turn_hexes(position);
    }

    fn force(&mut self, position: &[[R; 3]], increment: Increment<'_, R>, force: &mut [[R; 3]]) -> f64 {
        let load = Internal { position, increment, rotate: self.rotations == Rotations::Follow };
        self.fill_tet_parts(load);
        self.fill_hex_parts(load);
        self.gather_parts(None, force);
        self.energy()
    }

    fn linearise_and_force(&mut self, position: &[[R; 3]], increment: Increment<'_, R>, force: &mut [[R; 3]]) -> f64 {
        if self.rotations == Rotations::Fixed {
            return self.force(position, increment, force);
        }
        let load = Internal { position, increment, rotate: true };
        let Self { tets, tet_q, tet_parts, .. } = self;
        let tets = &*tets;
        tets.scatter.for_chunks_beside(tet_parts, tet_q, TASK, |chunk, parts, q| {
            run_wide::<R, _>(tet::Forces { tets, chunk, q, load, parts });
        });
        self.turn_hexes(position);
        self.fill_hex_parts(load);
        self.gather_parts(None, force);
        self.energy()
    }

    fn product(&mut self, rate: R, damping: R, diagonal: Diagonal<'_, R>, x: &mut [[R; 3]]) -> bool {
        let load = Product { x: &*x, rate, damping };
        self.fill_tet_parts(load);
        self.fill_hex_parts(load);
        self.gather_parts(Some(diagonal), x);
        true
    }

    fn is_damped(&self) -> bool {
        self.damped
    }

    fn stiffness(&mut self, rate: R, damping: R, matrix: &mut BlockCsr<R>) {
        self.rows(rate, damping).write(&mut matrix.values);
    }

    fn row_parts(&self) -> usize {
        self.strips.count()
    }

    fn stiffness_rows(&self, rate: R, damping: R, part: usize, take: &mut dyn FnMut(usize, &mut [[R; 9]])) {
        self.rows(rate, damping).hand_out(part, take);
    }

    fn stiffness_rows_in_single(&self, rate: R, damping: R, part: usize, take: &mut dyn FnMut(usize, &mut [[f32; 9]])) {
        self.rows(rate, damping).hand_out(part, take);
    }

    fn cube_pattern(&self) -> Option<Arc<CubePattern>> {
        self.cubes.clone()
    }

    fn cubes(&self, rate: R, damping: R, matrix: &mut CubeMatrix<R>) {
        if self.cubes.is_none() {
            return;
        }
        let cells = matrix.rotation.par_iter_mut().zip(&mut matrix.lame).enumerate().with_min_len(CELLS);
        cells.each(|(cell, (rotation, lame))| {
            let (columns, shape) = hex::columns(&self.hexes, &self.hex_q, cell);
            let (young_modulus, b) = (columns[0][3], columns[1][3]);
            let factor = young_modulus * (R::one() + rate * (b + damping));
            if let Some(cube) = &self.shapes[shape as usize].cube {
                *lame = [cube.lambda * factor, cube.mu * factor];
            }
            *rotation = columns;
        });
    }

    fn rotations(&self, node: &[u32], out: &mut [[f32; 4]]) -> bool {
        if self.rotations == Rotations::Fixed {
            return false;
        }
        let tets = self.tets.scatter.cell_count();
        out.par_iter_mut().zip(node).with_min_len(CELLS).each(|(out, node)| {
            *out = match self.largest[*node as usize] as usize {
                cell if cell < tets => lane(&self.tet_q, cell),
                NO_CELL => [R::zero(); 4],
                cell => lane(&self.hex_q, cell - tets),
            }
            .map(|v| v.to_f64() as f32);
        });
        true
    }

    fn save(&mut self) {
        self.saved.resize(self.tet_q.len() + self.hex_q.len(), [[0.0; BLOCK]; 4]);
        let all = self.saved.par_iter_mut().zip(self.tet_q.par_iter_mut().chain(&mut self.hex_q));
        all.with_min_len(TASK).each(|(saved, q)| {
            for (saved, q) in saved.as_flattened_mut().iter_mut().zip(q.as_flattened_mut()) {
                *saved = f32::from_f64(q.to_f64());
                *q = R::from_f64(saved.to_f64());
            }
        });
    }

    fn roll_back(&mut self) {
        for (saved, q) in self.saved.iter().zip(self.tet_q.iter_mut().chain(&mut self.hex_q)) {
            for (saved, q) in saved.as_flattened().iter().zip(q.as_flattened_mut()) {
                *q = R::from_f64(saved.to_f64());
            }
        }
    }

    fn history(&self) -> Vec<[R; 4]> {
        let mut out = Vec::new();
        self.write_history(&mut out);
        out
    }

    fn write_history(&self, out: &mut Vec<[R; 4]>) {
        out.clear();
        out.resize(self.tets.scatter.cell_count(), [R::zero(); 4]);
        if self.tet_order.is_empty() {
            out.par_iter_mut().enumerate().with_min_len(CELLS).each(|(i, out)| *out = lane(&self.tet_q, i));
        }
        for (i, cell) in self.tet_order.iter().enumerate() {
            out[*cell as usize] = lane(&self.tet_q, i);
        }
        out.extend((0..self.hex_scatter.cell_count()).map(|i| lane(&self.hex_q, i)));
    }

    fn restore(&mut self, history: &[[R; 4]]) {
        let (t, h) = (self.tets.scatter.cell_count(), self.hex_scatter.cell_count());
        let cold = [R::zero(), R::zero(), R::zero(), R::one()];
        let at = |i: usize| if history.len() == t + h { history[cell_of(&self.tet_order, i)] } else { cold };
        // the cells that fill up the last block do as the last cell does
        for (blocks, first, len) in [(&mut self.tet_q, 0, t), (&mut self.hex_q, t, h)] {
            for (k, block) in blocks.iter_mut().enumerate() {
                for l in 0..BLOCK {
                    let q = at(first + (k * BLOCK + l).min(len - 1));
                    (0..4).for_each(|c| block[c][l] = q[c]);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests;
