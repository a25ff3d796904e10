//! What the assembly reads of tetrahedra: their shape gradients, turned and weighted, in the numbers of the matrix.
//!
//! A matrix in f32 of a body in f64 has them from the edges of the rest shape, differences of f64 and f32 from there on, twice as many
//! cells at a time. Flat cells, whose inverse would lose digits, take the way of f64.

use super::super::incidence::GROUP;
use super::{BLOCK, Tets, cast, load_q};
use crate::force::polar::rotation;
use softrig_linalg::{Lane, Scalar, Vec3, Wide};

/// What the assembly reads of a cell: for each corner h_a = sqrt(V mu c) R g_a, c = 1 + rate (b + damping), so that
/// c K_ab = (lam / mu) h_a h_bᵀ + h_b h_aᵀ + (h_a . h_b) I; and lam / mu in the fourth place of the first.
pub(in crate::force) type Warped<R> = [[R; 4]; 4];

/// Six volumes of a cell, squared, that are less than this of the squared product of its edges at a corner are those of a flat one. (A
/// regular tetrahedron has one half.)
const FLAT: f64 = 1e-4;
/// Below this f32 runs out of range, for edges of some micrometres.
const TINY: f64 = 1e-36;

/// The cells of a group as the assembly reads them, in its numbers; `factors` are rate and damping.
#[inline(always)]
pub(in crate::force) fn warp<R: Scalar, A: Scalar, const W: usize>(
    tets: &Tets<R>,
    q: &[[[R; BLOCK]; 4]],
    group: usize,
    factors: [R; 2],
    warped: &mut [Warped<A>; GROUP],
) {
    let block = group * GROUP / BLOCK;
    let first = group * GROUP % BLOCK;
    let fewer_digits = A::EPSILON.to_f64() > R::EPSILON.to_f64() && W > 1;
    if fewer_digits && let Some(edges) = tets.edges(block, first) {
        warp_in_fewer_digits(tets, q, block, first, factors, edges, warped);
    } else if W > GROUP {
        warp_lanes::<R, A, GROUP>(tets, q, block, first, factors, warped);
    } else {
        for k in (0..GROUP).step_by(W) {
            warp_lanes::<R, A, W>(tets, q, block, first + k, factors, &mut warped[k..]);
        }
    }
}

#[inline(always)]
fn warp_in_fewer_digits<R: Scalar, A: Scalar>(
    tets: &Tets<R>,
    q: &[[[R; BLOCK]; 4]],
    block: usize,
    first: usize,
    factors: [R; 2],
    [e, f, k]: [Vec3<Wide<A, GROUP>>; 3],
    warped: &mut [Warped<A>; GROUP],
) {
    let rot = rotation(load_q::<R, GROUP>(&q[block], first).map(lanes));
    let (root, ratio) = root_and_ratio::<R, GROUP>(tets, block, first, factors);
    // rows of the inverse of the edges, times their determinant
    let (a, b, c) = (f.cross(k), k.cross(e), e.cross(f));
    let det = e.dot(a);
    let scale = lanes::<R, A, GROUP>(root) / det;
    write([(rot * a).scale(scale), (rot * b).scale(scale), (rot * c).scale(scale)], lanes(ratio), warped);
    let least = (e.dot(e) * f.dot(f) * k.dot(k) * Wide::constant(FLAT)).max(Wide::constant(TINY));
    let square = det * det;
    let mut flat = [false; GROUP];
    for lane in 0..GROUP {
        // also where a number is none
        flat[lane] = square.0[lane] < least.0[lane] || !square.0[lane].is_finite();
    }
    if flat != [false; GROUP] {
        again(tets, q, block, first, factors, flat, warped);
    }
}

/// The flat ones among them, with all digits. Kept out of the hot loop's code.
#[cold]
#[inline(never)]
fn again<R: Scalar, A: Scalar>(
    tets: &Tets<R>,
    q: &[[[R; BLOCK]; 4]],
    block: usize,
    first: usize,
    factors: [R; 2],
    flat: [bool; GROUP],
    warped: &mut [Warped<A>; GROUP],
) {
    for lane in (0..GROUP).filter(|lane| flat[*lane]) {
        warp_lanes::<R, A, 1>(tets, q, block, first + lane, factors, &mut warped[lane..]);
    }
}

#[inline(always)]
fn warp_lanes<R: Scalar, A: Scalar, const W: usize>(
    tets: &Tets<R>,
    q: &[[[R; BLOCK]; 4]],
    block: usize,
    first: usize,
    factors: [R; 2],
    warped: &mut [Warped<A>],
) {
    let rot = rotation(load_q::<R, W>(&q[block], first));
    let [a, b, c] = tets.gradients::<W>(block, first);
    let (root, ratio) = root_and_ratio(tets, block, first, factors);
    let h = [(rot * a).scale(root), (rot * b).scale(root), (rot * c).scale(root)];
    write(h.map(|Vec3(h)| Vec3(h.map(lanes))), lanes(ratio), warped);
}

/// sqrt(V mu c) and lam / mu.
#[inline(always)]
fn root_and_ratio<R: Scalar, const W: usize>(
    tets: &Tets<R>,
    block: usize,
    first: usize,
    [rate, damping]: [R; 2],
) -> (Wide<R, W>, Wide<R, W>) {
    let [lambda, mu, b] = tets.moduli::<W>(block, first);
    let factor = Wide::splat(R::one()) + Wide::splat(rate) * (b + Wide::splat(damping));
    ((mu * factor).sqrt(), lambda / mu)
}

/// Writes `W` cells, from the h of their corners 1, 2, 3.
#[inline(always)]
fn write<A: Scalar, const W: usize>(h: [Vec3<Wide<A, W>>; 3], ratio: Wide<A, W>, warped: &mut [Warped<A>]) {
    let zero = Wide::splat(A::zero());
    // gradients add up to nothing
    let all = [(-(h[0] + h[1] + h[2]), ratio), (h[0], zero), (h[1], zero), (h[2], zero)];
    for a in 0..4 {
        let (Vec3([x, y, z]), last) = all[a];
        let rows = [&x.0, &y.0, &z.0, &last.0];
        for k in 0..W / 4 {
            let part = [&rows[0].as_chunks::<4>().0[k], &rows[1].as_chunks::<4>().0[k]];
            let rest = [&rows[2].as_chunks::<4>().0[k], &rows[3].as_chunks::<4>().0[k]];
            for (out, quad) in warped[4 * k..].iter_mut().zip(A::transposed([part[0], part[1], rest[0], rest[1]])) {
                out[a] = quad;
            }
        }
        for i in W - W % 4..W {
            warped[i][a] = [rows[0][i], rows[1][i], rows[2][i], rows[3][i]];
        }
    }
}

/// Lanes in other numbers.
#[inline(always)]
fn lanes<R: Scalar, A: Scalar, const W: usize>(v: Wide<R, W>) -> Wide<A, W> {
    Wide(v.0.map(cast))
}
