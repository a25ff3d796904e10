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

/// `W` numbers of a block, from lane `first`.
#[inline(always)]
pub(super) fn load<R: Scalar, const W: usize>(block: &[R; BLOCK], first: usize) -> Wide<R, W> {
    Wide(std::array::from_fn(|i| block[first + i]))
}

#[inline(always)]
pub(super) fn store<R: Scalar, const W: usize>(block: &mut [R; BLOCK], first: usize, value: Wide<R, W>) {
    block[first..first + W].copy_from_slice(&value.0);
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
        for c in 0..3 {
            out.0[c].0[i] = p[c];
        }
    }
    out
}

/// Σ y_a g_aᵀ of `W` cells for the corner vectors `y`, from differences inside the cell, so that f32 is not spent on the
/// distance to the origin.
#[inline(always)]
fn gradient_of<S: Lane>(y: impl Fn(usize) -> Vec3<S>, g: [Vec3<S>; 3]) -> Mat3<S> {
    let y0 = y(0);
    (y(1) - y0).outer(g[0]) + (y(2) - y0).outer(g[1]) + (y(3) - y0).outer(g[2])
}

#[inline(always)]
fn gradients<R: Scalar, const W: usize>(block: &TetBlock<R>, first: usize) -> [Vec3<Wide<R, W>>; 3] {
    std::array::from_fn(|a| Vec3(std::array::from_fn(|i| load(&block.gradient[a][i], first))))
}

/// Rotations of a task's cells, and what the assembly reads: the rotated gradients R g_a of each cell, with V lam, V mu, b in
/// their fourth places.
pub(super) struct Linearise<'a, R> {
    pub blocks: &'a [TetBlock<R>],
    pub nodes: &'a [[u32; 4]],
    pub position: &'a [[R; 3]],
    /// False for linear elasticity: rotations stay as they are.
    pub rotate: bool,
    pub q: &'a mut [[[R; BLOCK]; 4]],
    pub warped: &'a mut [[[R; 4]; 4]],
}

impl<R: Scalar> Kernel for Linearise<'_, R> {
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
                let mut q = std::array::from_fn(|c| load::<R, W>(&self.q[k][c], first));
                if self.rotate {
                    q = polar(gradient_of(|a| gather(self.position, self.nodes, cell, a), g), q);
                    for c in 0..4 {
                        store(&mut self.q[k][c], first, q[c]);
                    }
                }
                let rot = rotation(q);
                let w = g.map(|g| rot * g);
                let w = [-(w[0] + w[1] + w[2]), w[0], w[1], w[2]];
                let constants = [
                    load::<R, W>(&block.lambda, first),
                    load(&block.mu, first),
                    load(&block.damping, first),
                    Wide([R::zero(); W]),
                ];
                for (i, out) in self.warped[cell..].iter_mut().take(W).enumerate() {
                    for a in 0..4 {
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
                let rot = rotation(std::array::from_fn(|c| load::<R, W>(&self.q[k][c], first)));
                let (lambda, mu) = (load::<R, W>(&block.lambda, first), load::<R, W>(&block.mu, first));
                let two = Wide::constant(2.0);
                let F = gradient_of(|a| gather(self.position, self.nodes, cell, a), g);
                // corotated strain and the energy in it
                let mut E = symmetric(rot.transpose() * F) - Mat3::identity();
                let t = E.trace();
                let square = E.row(0).dot(E.row(0)) + E.row(1).dot(E.row(1)) + E.row(2).dot(E.row(2));
                let energy = mu * square + lambda * t * t * Wide::constant(0.5);
                // K y is linear in the strain of y = d + b v
                let b = load::<R, W>(&block.damping, first) + Wide::splat(self.increment.damping);
                let at = |y, a| gather::<R, W, 4>(y, self.nodes, cell, a);
                let dF = match (self.increment.displacement, self.increment.velocity) {
                    (Some(d), Some(v)) => Some(gradient_of(|a| at(d, a) + at(v, a).scale(b), g)),
                    (Some(d), None) => Some(gradient_of(|a| at(d, a), g)),
                    (None, Some(v)) => Some(gradient_of(|a| at(v, a).scale(b), g)),
                    (None, None) => None,
                };
                if let Some(dF) = dF {
                    E += symmetric(rot.transpose() * dF);
                }
                let P = rot * (E.scale(two * mu) + Mat3::diagonal(lambda * E.trace()));
                let f = g.map(|g| P * g);
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
