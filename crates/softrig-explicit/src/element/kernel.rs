//! The forces of the cells of one part, four or eight at a time.
#![allow(non_snake_case, reason = "symbols of the continuum mechanics literature")]

use super::follow::{Rotations, warped_stress};
use super::{Cells, Group};
use crate::lanes::{corner, gather, scatter, whole};
use softrig::force::polar::rotation;
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
fn gradient_of<R: Scalar, const N: usize>(d: [Vec3<Wide<R, N>>; 3], g: &[[[R; N]; 3]; 3]) -> Mat3<Wide<R, N>> {
    let g = shape(g);
    d[0].outer(g[0]) + d[1].outer(g[1]) + d[2].outer(g[2])
}

#[inline(always)]
fn shape<R: Scalar, const N: usize>(g: &[[[R; N]; 3]; 3]) -> [Vec3<Wide<R, N>>; 3] {
    [
        Vec3([Wide(g[0][0]), Wide(g[0][1]), Wide(g[0][2])]),
        Vec3([Wide(g[1][0]), Wide(g[1][1]), Wide(g[1][2])]),
        Vec3([Wide(g[2][0]), Wide(g[2][1]), Wide(g[2][2])]),
    ]
}

/// Differences of the corners to the first.
#[inline(always)]
fn edges<R: Scalar, const N: usize>(from: &[[R; 4]], node: &[[u32; N]; 4]) -> [Vec3<Wide<R, N>>; 3] {
    let origin = corner(from, &node[0]);
    [corner(from, &node[1]) - origin, corner(from, &node[2]) - origin, corner(from, &node[3]) - origin]
}

/// 2 mu E + lam tr(E) I with E the symmetric part of G.
#[inline(always)]
fn stress<R: Scalar, const N: usize>(G: Mat3<Wide<R, N>>, lambda: Wide<R, N>, two_mu: Wide<R, N>) -> Mat3<Wide<R, N>> {
    let mu = two_mu * Wide::constant(0.5);
    let g = G.0;
    let t = lambda * (g[0][0] + g[1][1] + g[2][2]);
    let (xy, yz, zx) = (mu * (g[0][1] + g[1][0]), mu * (g[1][2] + g[2][1]), mu * (g[2][0] + g[0][2]));
    Mat3([[two_mu * g[0][0] + t, xy, zx], [xy, two_mu * g[1][1] + t, yz], [zx, yz, two_mu * g[2][2] + t]])
}

#[inline(always)]
fn scatter_all<R: Scalar, const N: usize>(P: Mat3<Wide<R, N>>, group: &Group<R, N>, to: &mut [[R; 4]]) {
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
pub(super) struct Linear<'a, R, const N: usize> {
    pub cells: &'a mut Cells<R, N>,
    pub input: Input<'a, R>,
    pub factor: R,
    pub out: &'a mut [[R; 3]],
}

impl<R: Scalar, const N: usize> Kernel for Linear<'_, R, N> {
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
pub(super) struct LinearTwice<'a, R, const N: usize> {
    pub cells: &'a mut Cells<R, N>,
    pub input: Input<'a, R>,
    pub out: &'a mut [[R; 3]],
}

impl<R: Scalar, const N: usize> Kernel for LinearTwice<'_, R, N> {
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

/// Stiffness warping: rotations and forces in one pass over the cells.
pub(super) struct Warped<'a, R, Q, const N: usize> {
    pub cells: &'a mut Cells<R, N>,
    pub input: Input<'a, R>,
    pub rotations: Q,
    pub out: &'a mut [[R; 3]],
}

impl<R: Scalar, Q: Rotations, const N: usize> Kernel for Warped<'_, R, Q, N> {
    type Output = ();
    #[inline(always)]
    fn run<const W: usize>(self) {
        let Self { cells, input, rotations, out } = self;
        gather(&cells.part, input.position, &mut cells.u);
        cells.f.fill([R::zero(); 4]);
        for (group, stored) in cells.groups.iter().zip(&mut cells.q) {
            let F = whole(gradient_of(edges(&cells.u, &group.node), &group.gradient));
            let rot = turned(F, rotations, stored);
            let P = whole(warped_stress(F, rot, Wide(group.lambda), Wide(group.mu)));
            scatter_all(P, group, &mut cells.f);
        }
        write(&cells.f, out);
    }
}

/// The same with damping, along the turned axes.
pub(super) struct WarpedDamped<'a, R, Q, const N: usize>(pub Warped<'a, R, Q, N>);

impl<R: Scalar, Q: Rotations, const N: usize> Kernel for WarpedDamped<'_, R, Q, N> {
    type Output = ();
    #[inline(always)]
    fn run<const W: usize>(self) {
        let Warped { cells, input, rotations, out } = self.0;
        gather(&cells.part, input.position, &mut cells.u);
        gather(&cells.part, input.velocity, &mut cells.v);
        cells.f.fill([R::zero(); 4]);
        for (group, stored) in cells.groups.iter().zip(&mut cells.q) {
            let F = whole(gradient_of(edges(&cells.u, &group.node), &group.gradient));
            let rot = turned(F, rotations, stored);
            let b = Wide(group.damping) + Wide::splat(input.damping);
            let rate = gradient_of(edges(&cells.v, &group.node), &group.gradient).scale(b);
            // strain S - I, and its rate times b, in the cell's own axes
            let E = rot.transpose() * (F + rate) - Mat3::identity();
            let P = whole(rot * stress(E, Wide(group.lambda), Wide(group.mu)));
            scatter_all(P, group, &mut cells.f);
        }
        write(&cells.f, out);
    }
}

/// The rotation of F, which is stored.
#[inline(always)]
fn turned<R: Scalar, const N: usize>(
    F: Mat3<Wide<R, N>>,
    rotations: impl Rotations,
    stored: &mut [[R; N]; 4],
) -> Mat3<Wide<R, N>> {
    let q = rotations.follow(F, [Wide(stored[0]), Wide(stored[1]), Wide(stored[2]), Wide(stored[3])]);
    for c in 0..4 {
        stored[c] = q[c].0;
    }
    rotation(q)
}
