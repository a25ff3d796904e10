//! Corotated linear tetrahedra: f_a = V R (2 mu (S − I) + lam tr(S − I) I) g_a.
//!
//! Implements [Mueller2004]; equal to the exact gradient of W = V (mu |S − I|² + lam/2 tr(S − I)²).
//! Terms: x current positions [m]; F = Σ x_a g_aᵀ [-]; g_a shape gradients [1/m]; R rotation of F; S = sym(Rᵀ F);
//! V rest volume [m3]; lam, mu Lamé constants [Pa]; b stiffness damping [s].
#![allow(non_snake_case, reason = "symbols of the continuum mechanics literature")]

use super::assembly::Increment;
use super::polar::{polar, rotation, symmetric};
use softrig_linalg::{Kernel, Lane, Mat3, Scalar, Vec3, Wide};

/// Cells of a block lie side by side in memory: a multiple of every lane count.
pub(super) const BLOCK: usize = 16;
/// Blocks per task handed to a thread.
pub(super) const TASK: usize = 16;

/// Constants of [`BLOCK`] tetrahedra. The last block repeats its last cell.
#[derive(Clone, Debug)]
pub(super) struct TetBlock<R> {
    /// Rows of the inverse edge matrix: the gradients of nodes 1, 2, 3 [1/m].
    gradient: [[[R; BLOCK]; 3]; 3],
    /// V lam and V mu [N m].
    lambda: [R; BLOCK],
    mu: [R; BLOCK],
    /// b [s].
    damping: [R; BLOCK],
}

/// What one tetrahedron brings to the block, in f64.
#[derive(Clone, Copy, Debug)]
pub(super) struct TetConstants {
    pub gradient: [[f64; 3]; 3],
    pub volume: f64,
    pub lambda: f64,
    pub mu: f64,
    pub damping: f64,
}

/// Shape gradients of nodes 1, 2, 3 [1/m] and volume [m3] of a tetrahedron; node 0 has minus their sum.
#[must_use]
pub fn tet_gradients(X: [[f64; 3]; 4]) -> ([[f64; 3]; 3], f64) {
    let e = |k: usize| Vec3(X[k]) - Vec3(X[0]);
    let Dm = Mat3::from_columns(e(1), e(2), e(3));
    (Dm.inverse().0, Dm.determinant() / 6.0)
}

impl<R: Scalar> TetBlock<R> {
    pub(super) fn new(cells: &[TetConstants]) -> Self {
        let at = |l: usize| &cells[l.min(cells.len() - 1)];
        let fill = |f: &dyn Fn(&TetConstants) -> f64| std::array::from_fn(|l| R::from_f64(f(at(l))));
        Self {
            gradient: std::array::from_fn(|a| std::array::from_fn(|i| fill(&|c| c.gradient[a][i]))),
            lambda: fill(&|c| c.volume * c.lambda),
            mu: fill(&|c| c.volume * c.mu),
            damping: fill(&|c| c.damping),
        }
    }
}

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

/// Quaternions of `W` cells.
#[inline(always)]
pub(super) fn load_q<R: Scalar, const W: usize>(q: &[[R; BLOCK]; 4], first: usize) -> [Wide<R, W>; 4] {
    [load(&q[0], first), load(&q[1], first), load(&q[2], first), load(&q[3], first)]
}

/// Vectors of one corner of `W` cells.
#[inline(always)]
pub(super) fn gather<R: Scalar, const W: usize, const N: usize>(
    from: &[[R; 3]],
    nodes: &[[u32; N]],
    first: usize,
    corner: usize,
) -> Vec3<Wide<R, W>> {
    let mut out = Vec3([Wide([R::zero(); W]); 3]);
    let last = nodes.len() - 1;
    for i in 0..W {
        let p = from[nodes[(first + i).min(last)][corner] as usize];
        out.0[0].0[i] = p[0];
        out.0[1].0[i] = p[1];
        out.0[2].0[i] = p[2];
    }
    out
}

/// Vectors of the four corners of `W` cells.
#[inline(always)]
fn corners<R: Scalar, const W: usize>(from: &[[R; 3]], nodes: &[[u32; 4]], first: usize) -> [Vec3<Wide<R, W>>; 4] {
    let at = nodes;
    [gather(from, at, first, 0), gather(from, at, first, 1), gather(from, at, first, 2), gather(from, at, first, 3)]
}

/// Σ y_a g_aᵀ of `W` cells for the corner vectors `y`, from differences inside the cell, so that f32 is not spent on the
/// distance to the origin.
#[inline(always)]
fn gradient_of<S: Lane>(y: [Vec3<S>; 4], g: [Vec3<S>; 3]) -> Mat3<S> {
    (y[1] - y[0]).outer(g[0]) + (y[2] - y[0]).outer(g[1]) + (y[3] - y[0]).outer(g[2])
}

#[inline(always)]
fn gradients<R: Scalar, const W: usize>(block: &TetBlock<R>, first: usize) -> [Vec3<Wide<R, W>>; 3] {
    let b = &block.gradient;
    [
        Vec3([load(&b[0][0], first), load(&b[0][1], first), load(&b[0][2], first)]),
        Vec3([load(&b[1][0], first), load(&b[1][1], first), load(&b[1][2], first)]),
        Vec3([load(&b[2][0], first), load(&b[2][1], first), load(&b[2][2], first)]),
    ]
}

/// Rotations of a task's cells.
pub(super) struct Rotate<'a, R> {
    pub blocks: &'a [TetBlock<R>],
    pub nodes: &'a [[u32; 4]],
    pub position: &'a [[R; 3]],
    pub q: &'a mut [[[R; BLOCK]; 4]],
}

impl<R: Scalar> Kernel for Rotate<'_, R> {
    type Output = ();
    #[inline(always)]
    fn run<const W: usize>(self) {
        for (k, block) in self.blocks.iter().enumerate() {
            for first in (0..BLOCK).step_by(W) {
                let cell = k * BLOCK + first;
                if cell >= self.nodes.len() {
                    break;
                }
                let F = gradient_of(corners(self.position, self.nodes, cell), gradients::<R, W>(block, first));
                let q = polar(F, load_q::<R, W>(&self.q[k], first));
                for c in 0..4 {
                    store(&mut self.q[k][c], first, q[c]);
                }
            }
        }
    }
}

/// What the assembly reads: the rotated gradients R g_a of corners 1, 2, 3 of a task's cells, with V lam, V mu, b in their fourth
/// places.
pub(super) struct Warp<'a, R> {
    pub blocks: &'a [TetBlock<R>],
    pub q: &'a [[[R; BLOCK]; 4]],
    pub warped: &'a mut [[[R; 4]; 3]],
}

impl<R: Scalar> Kernel for Warp<'_, R> {
    type Output = ();
    #[inline(always)]
    fn run<const W: usize>(self) {
        for (k, block) in self.blocks.iter().enumerate() {
            for first in (0..BLOCK).step_by(W) {
                let rot = rotation(load_q::<R, W>(&self.q[k], first));
                let g = gradients::<R, W>(block, first);
                let w = [rot * g[0], rot * g[1], rot * g[2]];
                let constants =
                    [load::<R, W>(&block.lambda, first), load(&block.mu, first), load(&block.damping, first)];
                for (i, out) in self.warped.iter_mut().skip(k * BLOCK + first).take(W).enumerate() {
                    for a in 0..3 {
                        out[a] = [w[a].0[0].0[i], w[a].0[1].0[i], w[a].0[2].0[i], constants[a].0[i]];
                    }
                }
            }
        }
    }
}

/// Forces of a task's cells on their corners, and their energies.
pub(super) struct Force<'a, R> {
    pub blocks: &'a [TetBlock<R>],
    pub nodes: &'a [[u32; 4]],
    pub position: &'a [[R; 3]],
    pub increment: Increment<'a, R>,
    pub q: &'a [[[R; BLOCK]; 4]],
    pub force: &'a mut [[[R; 3]; 4]],
    pub energy: &'a mut [R],
}

impl<R: Scalar> Kernel for Force<'_, R> {
    type Output = ();
    #[inline(always)]
    fn run<const W: usize>(self) {
        for (k, block) in self.blocks.iter().enumerate() {
            for first in (0..BLOCK).step_by(W) {
                let cell = k * BLOCK + first;
                if cell >= self.nodes.len() {
                    break;
                }
                let g = gradients::<R, W>(block, first);
                let rot = rotation(load_q::<R, W>(&self.q[k], first));
                let (lambda, mu) = (load::<R, W>(&block.lambda, first), load::<R, W>(&block.mu, first));
                let two = Wide::constant(2.0);
                let F = gradient_of(corners(self.position, self.nodes, cell), g);
                // corotated strain and the energy in it
                let mut E = symmetric(rot.transpose() * F) - Mat3::identity();
                let t = E.trace();
                let square = E.row(0).dot(E.row(0)) + E.row(1).dot(E.row(1)) + E.row(2).dot(E.row(2));
                let energy = mu * square + lambda * t * t * Wide::constant(0.5);
                // K y is linear in the strain of y = d + b v
                if self.increment.displacement.is_some() || self.increment.velocity.is_some() {
                    let mut y = [Vec3::zero(); 4];
                    if let Some(d) = self.increment.displacement {
                        y = corners(d, self.nodes, cell);
                    }
                    if let Some(v) = self.increment.velocity {
                        let b = load::<R, W>(&block.damping, first) + Wide::splat(self.increment.damping);
                        let v = corners(v, self.nodes, cell);
                        for a in 0..4 {
                            y[a] += v[a].scale(b);
                        }
                    }
                    E += symmetric(rot.transpose() * gradient_of(y, g));
                }
                let P = rot * (E.scale(two * mu) + Mat3::diagonal(lambda * E.trace()));
                let f = [P * g[0], P * g[1], P * g[2]];
                let f = [-(f[0] + f[1] + f[2]), f[0], f[1], f[2]];
                for (i, out) in self.force[cell..].iter_mut().take(W).enumerate() {
                    for a in 0..4 {
                        out[a] = [f[a].0[0].0[i], f[a].0[1].0[i], f[a].0[2].0[i]];
                    }
                }
                for (i, out) in self.energy[cell..].iter_mut().take(W).enumerate() {
                    *out = energy.0[i];
                }
            }
        }
    }
}
