//! The forces of the cells of one part, four at a time.
#![allow(non_snake_case, reason = "symbols of the continuum mechanics literature")]

use super::{Cells, Group};
use crate::lanes::{LANES, Quad, corner, gather, scatter};
use softrig::force::polar::{polar, polar_step, rotation};
use softrig_linalg::{Kernel, Lane, Mat3, Scalar, Vec3, Wide};

/// What forces are computed from.
#[derive(Clone, Copy)]
pub(super) struct Input<'a, R> {
    pub position: &'a [[R; 3]],
    pub velocity: &'a [[R; 3]],
    pub damping: R,
    /// b of all cells.
    pub uniform: Option<R>,
}

/// Σ d_a g_aᵀ over corners 1, 2, 3.
#[inline(always)]
fn gradient_of<R: Scalar>(d: [Vec3<Quad<R>>; 3], g: &[[[R; LANES]; 3]; 3]) -> Mat3<Quad<R>> {
    let g = shape(g);
    d[0].outer(g[0]) + d[1].outer(g[1]) + d[2].outer(g[2])
}

#[inline(always)]
fn shape<R: Scalar>(g: &[[[R; LANES]; 3]; 3]) -> [Vec3<Quad<R>>; 3] {
    [
        Vec3([Wide(g[0][0]), Wide(g[0][1]), Wide(g[0][2])]),
        Vec3([Wide(g[1][0]), Wide(g[1][1]), Wide(g[1][2])]),
        Vec3([Wide(g[2][0]), Wide(g[2][1]), Wide(g[2][2])]),
    ]
}

/// Differences of the corners to the first.
#[inline(always)]
fn edges<R: Scalar>(from: &[[R; 4]], node: &[[u32; LANES]; 4]) -> [Vec3<Quad<R>>; 3] {
    let origin = corner(from, &node[0]);
    [corner(from, &node[1]) - origin, corner(from, &node[2]) - origin, corner(from, &node[3]) - origin]
}

/// 2 mu E + lam tr(E) I with E the symmetric part of G.
#[inline(always)]
fn stress<R: Scalar>(G: Mat3<Quad<R>>, lambda: Quad<R>, two_mu: Quad<R>) -> Mat3<Quad<R>> {
    let mu = two_mu * Wide::constant(0.5);
    let g = G.0;
    let t = lambda * (g[0][0] + g[1][1] + g[2][2]);
    let (xy, yz, zx) = (mu * (g[0][1] + g[1][0]), mu * (g[1][2] + g[2][1]), mu * (g[2][0] + g[0][2]));
    Mat3([[two_mu * g[0][0] + t, xy, zx], [xy, two_mu * g[1][1] + t, yz], [zx, yz, two_mu * g[2][2] + t]])
}

#[inline(always)]
fn scatter_all<R: Scalar>(P: Mat3<Quad<R>>, group: &Group<R>, to: &mut [[R; 4]]) {
    let g = shape(&group.gradient);
    let f = [P * g[0], P * g[1], P * g[2]];
    scatter(-(f[0] + f[1] + f[2]), &group.node[0], to);
    scatter(f[0], &group.node[1], to);
    scatter(f[1], &group.node[2], to);
    scatter(f[2], &group.node[3], to);
}

#[inline(always)]
fn write<R: Scalar>(f: &[[R; 4]], out: &mut [[R; 3]]) {
    for (o, f) in out.iter_mut().zip(f) {
        *o = [f[0], f[1], f[2]];
    }
}

/// Linear strain, all cells damped alike: one strain of u + b v.
pub(super) struct Linear<'a, R> {
    pub cells: &'a mut Cells<R>,
    pub input: Input<'a, R>,
    pub factor: R,
    pub out: &'a mut [[R; 3]],
}

impl<R: Scalar> Kernel for Linear<'_, R> {
    type Output = ();
    #[inline(always)]
    fn run<const W: usize>(self) {
        let Self { cells, input, factor, out } = self;
        let own = cells.part.own.clone();
        let (u_own, u_copies) = cells.u.split_at_mut(own.len());
        let (x, v) = (&input.position[own.clone()], &input.velocity[own.clone()]);
        for (((u, x), v), rest) in u_own.iter_mut().zip(x).zip(v).zip(&cells.rest) {
            for k in 0..3 {
                u[k] = (x[k] - rest[k]) + factor * v[k];
            }
        }
        for ((u, n), rest) in u_copies.iter_mut().zip(&cells.part.copies).zip(&cells.rest[own.len()..]) {
            let (x, v) = (input.position[*n as usize], input.velocity[*n as usize]);
            for k in 0..3 {
                u[k] = (x[k] - rest[k]) + factor * v[k];
            }
        }
        cells.f.fill([R::zero(); 4]);
        for group in &cells.groups {
            let G = gradient_of(edges(&cells.u, &group.node), &group.gradient);
            let P = stress(G, Wide(group.lambda), Wide(group.mu));
            scatter_all(P, group, &mut cells.f);
        }
        write(&cells.f, out);
    }
}

/// Linear strain, each cell with its own damping.
pub(super) struct LinearTwice<'a, R> {
    pub cells: &'a mut Cells<R>,
    pub input: Input<'a, R>,
    pub out: &'a mut [[R; 3]],
}

impl<R: Scalar> Kernel for LinearTwice<'_, R> {
    type Output = ();
    #[inline(always)]
    fn run<const W: usize>(self) {
        let Self { cells, input, out } = self;
        gather(&cells.part, input.position, &mut cells.u);
        gather(&cells.part, input.velocity, &mut cells.v);
        for (u, rest) in cells.u.iter_mut().zip(&cells.rest) {
            for k in 0..3 {
                u[k] -= rest[k];
            }
        }
        cells.f.fill([R::zero(); 4]);
        for group in &cells.groups {
            let b = Wide(group.damping) + Wide::splat(input.damping);
            let G = gradient_of(edges(&cells.u, &group.node), &group.gradient)
                + gradient_of(edges(&cells.v, &group.node), &group.gradient).scale(b);
            let P = stress(G, Wide(group.lambda), Wide(group.mu));
            scatter_all(P, group, &mut cells.f);
        }
        write(&cells.f, out);
    }
}

/// How rotations follow the positions: a type, so that a loop holds the code of one way only and keeps its numbers in registers.
pub(super) trait Rotations: Copy + Send + Sync {
    /// The rotation of F, from that of the last force.
    fn follow<R: Scalar>(self, F: Mat3<Quad<R>>, q: [Quad<R>; 4]) -> [Quad<R>; 4];
}

/// To rounding.
#[derive(Clone, Copy)]
pub(super) struct Exactly;

/// By one step of the iteration.
#[derive(Clone, Copy)]
pub(super) struct OneStep;

/// Not: those of the last force stay.
#[derive(Clone, Copy)]
pub(super) struct Still;

impl Rotations for Exactly {
    #[inline(always)]
    fn follow<R: Scalar>(self, F: Mat3<Quad<R>>, q: [Quad<R>; 4]) -> [Quad<R>; 4] {
        polar(F, q)
    }
}

impl Rotations for OneStep {
    #[inline(always)]
    fn follow<R: Scalar>(self, F: Mat3<Quad<R>>, q: [Quad<R>; 4]) -> [Quad<R>; 4] {
        polar_step(F, q)
    }
}

impl Rotations for Still {
    #[inline(always)]
    fn follow<R: Scalar>(self, _: Mat3<Quad<R>>, q: [Quad<R>; 4]) -> [Quad<R>; 4] {
        q
    }
}

/// Stiffness warping: rotations and forces in one pass over the cells.
pub(super) struct Warped<'a, R, Q> {
    pub cells: &'a mut Cells<R>,
    pub input: Input<'a, R>,
    pub rotations: Q,
    /// There is damping.
    pub damped: bool,
    pub out: &'a mut [[R; 3]],
}

impl<R: Scalar, Q: Rotations> Kernel for Warped<'_, R, Q> {
    type Output = ();
    #[inline(always)]
    fn run<const W: usize>(self) {
        let Self { cells, input, rotations, damped, out } = self;
        gather(&cells.part, input.position, &mut cells.u);
        if damped {
            gather(&cells.part, input.velocity, &mut cells.v);
        }
        cells.f.fill([R::zero(); 4]);
        for (group, stored) in cells.groups.iter().zip(&mut cells.q) {
            let mut F = gradient_of(edges(&cells.u, &group.node), &group.gradient);
            let q = rotations.follow(F, [Wide(stored[0]), Wide(stored[1]), Wide(stored[2]), Wide(stored[3])]);
            for c in 0..4 {
                stored[c] = q[c].0;
            }
            let rot = rotation(q);
            if damped {
                let b = Wide(group.damping) + Wide::splat(input.damping);
                F += gradient_of(edges(&cells.v, &group.node), &group.gradient).scale(b);
            }
            // strain S - I, and its rate times b, in the cell's own axes
            let E = rot.transpose() * F - Mat3::identity();
            let P = rot * stress(E, Wide(group.lambda), Wide(group.mu));
            scatter_all(P, group, &mut cells.f);
        }
        write(&cells.f, out);
    }
}
