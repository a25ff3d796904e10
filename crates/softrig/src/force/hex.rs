//! Corotated linear hexahedra: trilinear, stiffness by 8-point quadrature, one rotation per cell.
//!
//! The rotation is that of the mean deformation gradient. With g_a = Σ_b Ke_ab u_b, u = Rᵀ x − X, the plain corotated force R g
//! is not quite the gradient of W = ½ uᵀ Ke u, and leaves a net torque, because R moves with x. The exact gradient is
//! f_a = R (g_a − b × ḡ_a) with b = (tr(S) I − S)⁻¹ Σ_a (Rᵀ x_a) × g_a and ḡ_a the mean shape gradient; directions in which
//! tr(S) I − S is nearly singular (the rotation about them is about to jump) are left out. All of it is linear in what lies at the
//! corners, and computed in the vectors of a [`Basis`]: the modes of a cube, or the corners of any other shape.
//!
//! Terms: X, x rest and current positions [m]; F = Σ x_a ḡ_aᵀ; S = sym(Rᵀ F); Ke rest stiffness [N/m].
#![allow(non_snake_case, reason = "symbols of the continuum mechanics literature")]

mod basis;
mod shape;

use basis::Basis;
pub(super) use shape::HexShape;
pub use shape::{QuadraturePoint, hex_points, hex_stiffness};

use super::assembly::Increment;
use super::load::{Internal, Load, Near, Product, Vectors, corner, gather};
use super::polar::{eigen_symmetric, polar, rotation, symmetric};
use super::tet::{BLOCK, Corners, load, load_q, store};
use softrig_linalg::{CELLS, Kernel, Lane, Mat3, Scalar, Vec3, Wide};

/// Eigenvalues of tr(S) I − S below this are left out of the exact gradient: 2 at rest, 0 where the rotation is undetermined.
const SINGULAR: f64 = 0.05;

/// Most nodes of a chunk.
const PARTS: usize = 8 * CELLS;

/// Factors of [`BLOCK`] hexahedra. The last block repeats its last cell.
#[derive(Clone, Debug)]
pub(super) struct HexBlock<R> {
    shape: [u32; BLOCK],
    /// E [Pa].
    scale: [R; BLOCK],
    /// b [s].
    damping: [R; BLOCK],
}

/// What one hexahedron brings to the block.
#[derive(Clone, Copy, Debug)]
pub(super) struct HexConstants {
    pub shape: u32,
    pub scale: f64,
    pub damping: f64,
}

impl<R: Scalar> HexBlock<R> {
    pub(super) fn new(cells: &[HexConstants]) -> Self {
        let at = |l: usize| &cells[l.min(cells.len() - 1)];
        Self {
            shape: std::array::from_fn(|l| at(l).shape),
            scale: std::array::from_fn(|l| R::from_f64(at(l).scale)),
            damping: std::array::from_fn(|l| R::from_f64(at(l).damping)),
        }
    }

    #[inline(always)]
    fn same(&self, first: usize, width: usize) -> bool {
        (1..width).all(|i| self.shape[first + i] == self.shape[first])
    }
}

/// Vectors at the corners 1 to 7 of `W` cells relative to corner 0, so that f32 is not spent on the distance to the origin.
#[inline(always)]
fn corners<R: Scalar, const W: usize>(from: &[[R; 4]], local: &[[u16; 8]], first: usize) -> [Vec3<Wide<R, W>>; 7] {
    let x0 = corner::<R, W, 8>(from, local, first, 0);
    let mut x = [Vec3::zero(); 7];
    for n in 0..7 {
        x[n] = corner::<R, W, 8>(from, local, first, n + 1) - x0;
    }
    x
}

/// Rotations of a chunk's cells.
pub(super) struct Rotate<'a, R> {
    pub blocks: &'a [HexBlock<R>],
    pub shapes: &'a [HexShape<R>],
    /// Nodes of the chunk, and which of them each corner is.
    pub nodes: &'a [u32],
    pub local: &'a [[u16; 8]],
    pub position: &'a [[R; 3]],
    pub q: &'a mut [[[R; BLOCK]; 4]],
}

impl<R: Scalar> Kernel for Rotate<'_, R> {
    type Output = ();
    #[inline(always)]
    fn run<const W: usize>(mut self) {
        let mut x = Vectors::<R, PARTS>::new();
        gather(self.nodes, self.position, &mut x);
        for k in 0..self.blocks.len() {
            for first in (0..BLOCK).step_by(W) {
                if k * BLOCK + first >= self.local.len() {
                    break;
                }
                // cells of different shapes are done one by one
                if self.blocks[k].same(first, W) {
                    self.cells::<W>(&x, k, first);
                } else {
                    self.one_by_one(&x, k, first, W);
                }
            }
        }
    }
}

impl<R: Scalar> Rotate<'_, R> {
    /// Out of line: compiled once and not again for every instruction set.
    #[inline(never)]
    fn one_by_one(&mut self, x: &Vectors<R, PARTS>, k: usize, first: usize, width: usize) {
        for lane in 0..width {
            self.cells::<1>(x, k, first + lane);
        }
    }

    #[inline(always)]
    fn cells<const W: usize>(&mut self, x: &Vectors<R, PARTS>, k: usize, first: usize) {
        let shape = &self.shapes[self.blocks[k].shape[first] as usize];
        let x = corners::<R, W>(x, self.local, k * BLOCK + first);
        let F = match &shape.cube {
            Some(cube) => cube.gradient(&cube.of(x)),
            None => shape.gradient(&shape.of(x)),
        };
        let q = polar(F, load_q::<R, W>(&self.q[k], first));
        for c in 0..4 {
            store(&mut self.q[k][c], first, q[c]);
        }
    }
}

/// What matrices are made of for one cell: the columns of R with E and b in their fourth places, and the number of its shape.
#[inline(always)]
pub(super) fn columns<R: Scalar>(blocks: &[HexBlock<R>], q: &[[[R; BLOCK]; 4]], cell: usize) -> ([[R; 4]; 3], u32) {
    let (block, q, lane) = (&blocks[cell / BLOCK], &q[cell / BLOCK], cell % BLOCK);
    let r = rotation([Wide([q[0][lane]]), Wide([q[1][lane]]), Wide([q[2][lane]]), Wide([q[3][lane]])]).0;
    let fourth = [block.scale[lane], block.damping[lane], R::zero()];
    let mut out = [[R::zero(); 4]; 3];
    for j in 0..3 {
        out[j] = [r[0][j].0[0], r[1][j].0[0], r[2][j].0[0], fourth[j]];
    }
    (out, block.shape[lane])
}

/// What the forces of `W` cells of one shape are made of.
pub(super) struct HexCells<'a, R: Scalar, B, const W: usize> {
    basis: &'a B,
    near: &'a Near<R, PARTS>,
    local: &'a [[u16; 8]],
    first: usize,
    rotation: Mat3<Wide<R, W>>,
    damping: Wide<R, W>,
}

impl<R: Scalar, B: Basis<R>, const W: usize> HexCells<'_, R, B, W> {
    /// Vectors at the corners, in the frame of the cell.
    #[inline(always)]
    fn turned(&self, from: &Vectors<R, PARTS>) -> [Vec3<Wide<R, W>>; 7] {
        let mut y = self.basis.of(corners(from, self.local, self.first));
        for y in &mut y {
            *y = self.rotation.transpose_mul(*y);
        }
        y
    }
}

/// Forces that hexahedra are asked for.
pub(super) trait HexLoad<R: Scalar>: Load<R> {
    /// Forces of `W` cells in their own frames for a Young's modulus of 1 Pa, and their energies.
    fn hexes<B: Basis<R>, const W: usize>(&self, cells: HexCells<'_, R, B, W>) -> ([Vec3<Wide<R, W>>; 7], Wide<R, W>);
}

impl<R: Scalar> HexLoad<R> for Internal<'_, R> {
    #[inline(always)]
    fn hexes<B: Basis<R>, const W: usize>(&self, cells: HexCells<'_, R, B, W>) -> ([Vec3<Wide<R, W>>; 7], Wide<R, W>) {
        let basis = cells.basis;
        let x = cells.turned(&cells.near.x);
        let u = basis.displaced(x);
        let mut f = basis.stiffness(u);
        let mut energy = Wide([R::zero(); W]);
        for n in 0..7 {
            energy += u[n].dot(f[n]);
        }
        if self.rotate {
            correct(basis, &x, &mut f);
        }
        let Increment { displacement, velocity, damping } = self.increment;
        if displacement.is_some() || velocity.is_some() {
            let mut y = [Vec3::zero(); 7];
            if displacement.is_some() {
                y = cells.turned(&cells.near.d);
            }
            if velocity.is_some() {
                let b = cells.damping + Wide::splat(damping);
                let v = cells.turned(&cells.near.v);
                for n in 0..7 {
                    y[n] += v[n].scale(b);
                }
            }
            let added = basis.stiffness(y);
            for n in 0..7 {
                f[n] += added[n];
            }
        }
        (f, energy * Wide::constant(0.5))
    }
}

impl<R: Scalar> HexLoad<R> for Product<'_, R> {
    #[inline(always)]
    fn hexes<B: Basis<R>, const W: usize>(&self, cells: HexCells<'_, R, B, W>) -> ([Vec3<Wide<R, W>>; 7], Wide<R, W>) {
        let factor = Wide::splat(R::one()) + Wide::splat(self.rate) * (cells.damping + Wide::splat(self.damping));
        let mut f = cells.basis.stiffness(cells.turned(&cells.near.x));
        for f in &mut f {
            *f = f.scale(factor);
        }
        (f, Wide::splat(R::zero()))
    }
}

/// Forces of a chunk's cells, added to the parts of their nodes; the fourth numbers add up to their energies.
pub(super) struct Forces<'a, R, L> {
    pub blocks: &'a [HexBlock<R>],
    pub shapes: &'a [HexShape<R>],
    pub q: &'a [[[R; BLOCK]; 4]],
    pub load: L,
    /// Nodes of the chunk, and which of them each corner is.
    pub nodes: &'a [u32],
    pub local: &'a [[u16; 8]],
    pub parts: &'a mut [[R; 4]],
}

impl<R: Scalar, L: HexLoad<R>> Kernel for Forces<'_, R, L> {
    type Output = ();
    #[inline(always)]
    fn run<const W: usize>(self) {
        let mut near = Near::<R, PARTS>::new();
        self.load.gather(self.nodes, &mut near);
        self.parts.fill([R::zero(); 4]);
        let mut out = Corners::<R, 8>::zero();
        for k in 0..self.blocks.len() {
            for first in (0..BLOCK).step_by(W) {
                if k * BLOCK + first >= self.local.len() {
                    break;
                }
                if self.blocks[k].same(first, W) {
                    self.cells::<W>(&near, k, first, &mut out);
                } else {
                    self.one_by_one(&near, k, first, W, &mut out);
                }
            }
            out.add(&self.local[k * BLOCK..], self.parts);
        }
    }
}

impl<R: Scalar, L: HexLoad<R>> Forces<'_, R, L> {
    /// Out of line: compiled once and not again for every instruction set.
    #[inline(never)]
    fn one_by_one(&self, near: &Near<R, PARTS>, k: usize, first: usize, width: usize, out: &mut Corners<R, 8>) {
        for lane in 0..width {
            self.cells::<1>(near, k, first + lane, out);
        }
    }

    #[inline(always)]
    fn cells<const W: usize>(&self, near: &Near<R, PARTS>, k: usize, first: usize, out: &mut Corners<R, 8>) {
        let shape = &self.shapes[self.blocks[k].shape[first] as usize];
        match &shape.cube {
            Some(cube) => self.cells_in::<_, W>(cube, near, k, first, out),
            None => self.cells_in::<_, W>(shape, near, k, first, out),
        }
    }

    #[inline(always)]
    fn cells_in<B: Basis<R>, const W: usize>(
        &self,
        basis: &B,
        near: &Near<R, PARTS>,
        k: usize,
        first: usize,
        out: &mut Corners<R, 8>,
    ) {
        let block = &self.blocks[k];
        let rotation = rotation(load_q(&self.q[k], first));
        let (mut f, energy) = self.load.hexes(HexCells::<R, B, W> {
            basis,
            near,
            local: self.local,
            first: k * BLOCK + first,
            rotation,
            damping: load(&block.damping, first),
        });
        let scale = load(&block.scale, first);
        for f in &mut f {
            *f = (rotation * *f).scale(scale);
        }
        out.set(first, basis.at_corners(f), energy * scale);
    }
}

/// Takes off what the turning of R adds: f_a −= b × ḡ_a.
#[inline(always)]
fn correct<S: Lane, B: Basis<S::Scalar>>(basis: &B, x: &[Vec3<S>; 7], f: &mut [Vec3<S>; 7]) {
    let mut T = Vec3::zero();
    for n in 0..7 {
        T += x[n].cross(f[n]);
    }
    // x is in the cell's frame already, so this is Rᵀ F
    let S = symmetric(basis.gradient(x));
    let G = Mat3::diagonal(S.trace()) - S;
    let C = G.cofactors();
    let mut b = (C * T).scale(S::one() / G.row(0).dot(C.row(0)));
    // are all eigenvalues of G above the limit?
    let H = G - Mat3::diagonal(S::constant(SINGULAR));
    let minor = H.0[0][0] * H.0[1][1] - H.0[0][1] * H.0[1][0];
    let smallest = H.0[0][0].min(minor).min(H.determinant());
    let regular = S::select_lt(S::zero(), smallest, S::select_lt(S::zero(), H.0[0][0], S::one(), S::zero()), S::zero());
    let mut all = true;
    for lane in 0..S::WIDTH {
        all &= regular.get(lane) > S::Scalar::zero();
    }
    if !all {
        leave_out(&G, &T, &regular, &mut b);
    }
    basis.less_turning(b, f);
}

/// b = G⁻¹ T on the eigenvectors of G that are well above zero, for the lanes that are not `regular`.
#[cold]
#[inline(never)]
fn leave_out<S: Lane>(G: &Mat3<S>, T: &Vec3<S>, regular: &S, b: &mut Vec3<S>) {
    for lane in (0..S::WIDTH).filter(|l| regular.get(*l) == S::Scalar::zero()) {
        let (values, vectors) = eigen_symmetric(Mat3(G.0.map(|r| r.map(|x| x.get(lane).to_f64()))));
        let t = Vec3(T.0.map(|x| x.get(lane).to_f64()));
        let mut sum = Vec3::zero();
        for i in (0..3).filter(|i| values[*i] > SINGULAR) {
            let v = vectors.column(i);
            sum += v.scale(v.dot(t) / values[i]);
        }
        for c in 0..3 {
            b.0[c].set(lane, S::Scalar::from_f64(sum.0[c]));
        }
    }
}
