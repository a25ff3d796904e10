//! Corotated linear tetrahedra: f_a = V R (2 mu (S − I) + lam tr(S − I) I) g_a.
//!
//! Implements [Mueller2004]; equal to the exact gradient of W = V (mu |S − I|² + lam/2 tr(S − I)²).
//! Terms: x current positions [m]; F = Σ x_a g_aᵀ [-]; g_a shape gradients [1/m]; R rotation of F; S = sym(Rᵀ F);
//! V rest volume [m3]; lam, mu Lamé constants [Pa]; b stiffness damping [s].
#![allow(non_snake_case, reason = "symbols of the continuum mechanics literature")]

mod constants;
mod warp;

pub use constants::tet_gradients;
pub(super) use constants::{TetConstants, Tets};
pub(super) use warp::{Warped, warp};

use super::assembly::Increment;
use super::load::{Internal, Load, Near, Product, Vectors, corner, gather};
use super::polar::{polar, rotation, symmetric};
use softrig_linalg::{CELLS, Kernel, Lane, Mat3, Scalar, Vec3, Wide, add_four};

/// Cells of a block lie side by side in memory: a multiple of every lane count.
pub(super) const BLOCK: usize = 16;
/// Blocks per task handed to a thread.
pub(super) const TASK: usize = CELLS / BLOCK;
/// Most nodes of a chunk.
const PARTS: usize = 4 * CELLS;

// No closures below: one that is not inlined is compiled without the wide instructions of the kernel around it.

/// `W` numbers of a block, from lane `first`, a multiple of `W`.
#[inline(always)]
pub(super) fn load<R: Scalar, const W: usize>(block: &[R; BLOCK], first: usize) -> Wide<R, W> {
    Wide(block.as_chunks::<W>().0[first / W])
}

#[inline(always)]
pub(super) fn store<R: Scalar, const W: usize>(block: &mut [R; BLOCK], first: usize, value: Wide<R, W>) {
    block.as_chunks_mut::<W>().0[first / W] = value.0;
}

/// A number in the numbers of the assembly.
#[inline(always)]
pub(super) fn cast<R: Scalar, A: Scalar>(v: R) -> A {
    A::from_f64(v.to_f64())
}

/// Quaternions of `W` cells.
#[inline(always)]
pub(super) fn load_q<R: Scalar, const W: usize>(q: &[[R; BLOCK]; 4], first: usize) -> [Wide<R, W>; 4] {
    [load(&q[0], first), load(&q[1], first), load(&q[2], first), load(&q[3], first)]
}

/// Vectors of the four corners of `W` cells.
#[inline(always)]
fn corners<R: Scalar, const W: usize>(from: &[[R; 4]], local: &[[u16; 4]], first: usize) -> [Vec3<Wide<R, W>>; 4] {
    let at = local;
    [corner(from, at, first, 0), corner(from, at, first, 1), corner(from, at, first, 2), corner(from, at, first, 3)]
}

/// Σ y_a g_aᵀ of `W` cells for the corner vectors `y`, from differences inside the cell, so that f32 is not spent on the
/// distance to the origin.
#[inline(always)]
fn gradient_of<S: Lane>(y: [Vec3<S>; 4], g: [Vec3<S>; 3]) -> Mat3<S> {
    (y[1] - y[0]).outer(g[0]) + (y[2] - y[0]).outer(g[1]) + (y[3] - y[0]).outer(g[2])
}

/// Rotations of a chunk's cells.
pub(super) struct Rotate<'a, R> {
    pub tets: &'a Tets<R>,
    pub chunk: usize,
    pub position: &'a [[R; 3]],
    pub q: &'a mut [[[R; BLOCK]; 4]],
}

impl<R: Scalar> Kernel for Rotate<'_, R> {
    type Output = ();
    #[inline(always)]
    fn run<const W: usize>(mut self) {
        let (nodes, local) = (self.tets.scatter.nodes(self.chunk), self.tets.scatter.local(self.chunk));
        let mut x = Vectors::<R, PARTS>::new();
        gather(nodes, self.position, &mut x);
        for k in 0..self.q.len() {
            let block = self.chunk * TASK + k;
            for first in (0..BLOCK).step_by(W) {
                let cell = k * BLOCK + first;
                if cell >= local.len() {
                    break;
                }
                let F = gradient_of(corners(&x, local, cell), self.tets.gradients::<W>(block, first));
                self.q.turn(k, first, F);
            }
        }
    }
}

/// Rotations of a chunk's cells while their forces are made: lists that are shared stay, others follow.
pub(super) trait Turn<R: Scalar> {
    /// How many blocks there are.
    fn block_count(&self) -> usize;

    /// Those of `W` cells of block `k`, from lane `first`, with these deformation gradients.
    fn turn<const W: usize>(&mut self, k: usize, first: usize, F: Mat3<Wide<R, W>>) -> [Wide<R, W>; 4];
}

impl<R: Scalar> Turn<R> for &[[[R; BLOCK]; 4]] {
    #[inline(always)]
    fn block_count(&self) -> usize {
        self.len()
    }

    #[inline(always)]
    fn turn<const W: usize>(&mut self, k: usize, first: usize, _: Mat3<Wide<R, W>>) -> [Wide<R, W>; 4] {
        load_q(&self[k], first)
    }
}

impl<R: Scalar> Turn<R> for &mut [[[R; BLOCK]; 4]] {
    #[inline(always)]
    fn block_count(&self) -> usize {
        self.len()
    }

    #[inline(always)]
    fn turn<const W: usize>(&mut self, k: usize, first: usize, F: Mat3<Wide<R, W>>) -> [Wide<R, W>; 4] {
        let q = polar(F, load_q::<R, W>(&self[k], first));
        for c in 0..4 {
            store(&mut self[k][c], first, q[c]);
        }
        q
    }
}

/// Vectors at the corners of a block's cells, number by number, and one number more of each cell.
#[derive(Clone, Copy)]
pub(super) struct Corners<R, const N: usize> {
    vector: [[[R; BLOCK]; 3]; N],
    number: [R; BLOCK],
}

impl<R: Scalar, const N: usize> Corners<R, N> {
    #[inline(always)]
    pub(super) fn zero() -> Self {
        Self { vector: [[[R::zero(); BLOCK]; 3]; N], number: [R::zero(); BLOCK] }
    }

    /// Writes those of `W` cells.
    #[inline(always)]
    pub(super) fn set<const W: usize>(&mut self, first: usize, vector: [Vec3<Wide<R, W>>; N], number: Wide<R, W>) {
        for a in 0..N {
            for k in 0..3 {
                store(&mut self.vector[a][k], first, vector[a].0[k]);
            }
        }
        store(&mut self.number, first, number);
    }

    /// Adds the vectors to the parts of the corners, and the number to the fourth of corner 0. A whole block at once, so that the
    /// order does not depend on the width of registers. `local` ends with the cells there are.
    #[inline(always)]
    pub(super) fn add(&self, local: &[[u16; N]], parts: &mut [[R; 4]]) {
        let zero = [R::zero(); 4];
        for a in 0..N {
            for k in 0..BLOCK / 4 {
                let [x, y, z] = &self.vector[a];
                let (x, y, z) = (&x.as_chunks::<4>().0[k], &y.as_chunks::<4>().0[k], &z.as_chunks::<4>().0[k]);
                let number = if a == 0 { &self.number.as_chunks::<4>().0[k] } else { &zero };
                add_four([x, y, z, number], local.get(4 * k..).unwrap_or_default(), a, parts);
            }
        }
    }
}

/// What the forces of `W` cells are made of.
pub(super) struct TetCells<'a, R: Scalar, const W: usize> {
    near: &'a Near<R, PARTS>,
    local: &'a [[u16; 4]],
    first: usize,
    gradient: [Vec3<Wide<R, W>>; 3],
    /// Σ x_a g_aᵀ of positions, or of what is multiplied.
    F: Mat3<Wide<R, W>>,
    rotation: Mat3<Wide<R, W>>,
    lambda: Wide<R, W>,
    mu: Wide<R, W>,
    damping: Wide<R, W>,
}

impl<R: Scalar, const W: usize> TetCells<'_, R, W> {
    /// Σ y_a g_aᵀ of vectors at the nodes.
    #[inline(always)]
    fn gradient(&self, y: [Vec3<Wide<R, W>>; 4]) -> Mat3<Wide<R, W>> {
        gradient_of(y, self.gradient)
    }

    #[inline(always)]
    fn corners(&self, from: &Vectors<R, PARTS>) -> [Vec3<Wide<R, W>>; 4] {
        corners(from, self.local, self.first)
    }

    /// Forces at the corners for a corotated strain.
    #[inline(always)]
    fn forces(&self, E: Mat3<Wide<R, W>>) -> [Vec3<Wide<R, W>>; 4] {
        let (g, two) = (&self.gradient, Wide::constant(2.0));
        let P = self.rotation * (E.scale(two * self.mu) + Mat3::diagonal(self.lambda * E.trace()));
        let f = [P * g[0], P * g[1], P * g[2]];
        [-(f[0] + f[1] + f[2]), f[0], f[1], f[2]]
    }
}

/// Forces that tetrahedra are asked for.
pub(super) trait TetLoad<R: Scalar>: Load<R> {
    /// Forces at the corners of `W` cells, and their energies.
    fn tets<const W: usize>(&self, cells: TetCells<'_, R, W>) -> ([Vec3<Wide<R, W>>; 4], Wide<R, W>);
}

impl<R: Scalar> TetLoad<R> for Internal<'_, R> {
    #[inline(always)]
    fn tets<const W: usize>(&self, cells: TetCells<'_, R, W>) -> ([Vec3<Wide<R, W>>; 4], Wide<R, W>) {
        let inverse = cells.rotation.transpose();
        // corotated strain and the energy in it
        let mut E = symmetric(inverse * cells.F) - Mat3::identity();
        let t = E.trace();
        let square = E.row(0).dot(E.row(0)) + E.row(1).dot(E.row(1)) + E.row(2).dot(E.row(2));
        let energy = cells.mu * square + cells.lambda * t * t * Wide::constant(0.5);
        // K y is linear in the strain of y = d + b v
        let Increment { displacement, velocity, damping } = self.increment;
        if displacement.is_some() || velocity.is_some() {
            let mut y = [Vec3::zero(); 4];
            if displacement.is_some() {
                y = cells.corners(&cells.near.d);
            }
            if velocity.is_some() {
                let b = cells.damping + Wide::splat(damping);
                let v = cells.corners(&cells.near.v);
                for a in 0..4 {
                    y[a] += v[a].scale(b);
                }
            }
            E += symmetric(inverse * cells.gradient(y));
        }
        (cells.forces(E), energy)
    }
}

impl<R: Scalar> TetLoad<R> for Product<'_, R> {
    #[inline(always)]
    fn tets<const W: usize>(&self, cells: TetCells<'_, R, W>) -> ([Vec3<Wide<R, W>>; 4], Wide<R, W>) {
        let factor = Wide::splat(R::one()) + Wide::splat(self.rate) * (cells.damping + Wide::splat(self.damping));
        let E = symmetric(cells.rotation.transpose() * cells.F);
        (cells.forces(E.scale(factor)), Wide::splat(R::zero()))
    }
}

/// Forces of a chunk's cells, added to the parts of their nodes; the fourth numbers add up to their energies. Rotations that follow do so
/// in the same pass: gradients are made, and positions read, once.
pub(super) struct Forces<'a, R, Q, L> {
    pub tets: &'a Tets<R>,
    pub chunk: usize,
    pub q: Q,
    pub load: L,
    pub parts: &'a mut [[R; 4]],
}

impl<R: Scalar, Q: Turn<R>, L: TetLoad<R>> Kernel for Forces<'_, R, Q, L> {
    type Output = ();
    #[inline(always)]
    fn run<const W: usize>(mut self) {
        let (nodes, local) = (self.tets.scatter.nodes(self.chunk), self.tets.scatter.local(self.chunk));
        let mut near = Near::<R, PARTS>::new();
        self.load.gather(nodes, &mut near);
        self.parts.fill([R::zero(); 4]);
        let mut out = Corners::<R, 4>::zero();
        for k in 0..self.q.block_count() {
            let block = self.chunk * TASK + k;
            for first in (0..BLOCK).step_by(W) {
                let cell = k * BLOCK + first;
                if cell >= local.len() {
                    break;
                }
                let gradient = self.tets.gradients(block, first);
                let F = gradient_of(corners(&near.x, local, cell), gradient);
                let rotation = rotation(self.q.turn(k, first, F));
                let [lambda, mu, damping] = self.tets.moduli(block, first);
                let (f, energy) = self.load.tets(TetCells::<R, W> {
                    near: &near,
                    local,
                    first: cell,
                    gradient,
                    F,
                    rotation,
                    lambda,
                    mu,
                    damping,
                });
                out.set(first, f, energy);
            }
            out.add(&local[k * BLOCK..], self.parts);
        }
    }
}
