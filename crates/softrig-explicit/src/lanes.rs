//! Cells side by side, four or a multiple of it: corners of cells as lanes, and forces of lanes on nodes.
//!
//! Closures of the kernels that call this have to be inlined: others are compiled without their wide instructions.

use crate::part::Part;
use softrig_linalg::{Scalar, Vec3, Wide};

/// Cells side by side.
pub(crate) const LANES: usize = 4;
/// One number of each of them.
pub(crate) type Quad<R> = Wide<R, LANES>;

/// A value as it is, stored and read again as a whole: between long stretches of lane operations this keeps the optimiser from taking
/// lanes apart and computing with components instead, which costs more instructions than the arithmetic itself.
#[inline(always)]
pub(crate) fn whole<T>(mut value: T) -> T {
    std::hint::black_box(&mut value);
    value
}

/// Copies `from` of a part's nodes into quads.
#[inline(always)]
pub(crate) fn gather<R: Scalar>(part: &Part, from: &[[R; 3]], to: &mut [[R; 4]]) {
    let (own, copies) = to.split_at_mut(part.own.len());
    for (t, f) in own.iter_mut().zip(&from[part.own.clone()]) {
        *t = [f[0], f[1], f[2], R::zero()];
    }
    for (t, n) in copies.iter_mut().zip(&part.copies) {
        let f = from[*n as usize];
        *t = [f[0], f[1], f[2], R::zero()];
    }
}

/// One corner of `N` cells, a multiple of four.
#[inline(always)]
pub(crate) fn corner<R: Scalar, const N: usize>(from: &[[R; 4]], node: &[u32; N]) -> Vec3<Wide<R, N>> {
    let mut out = Vec3([Wide([R::zero(); N]); 3]);
    for c in 0..N / LANES {
        let n = |l: usize| node[LANES * c + l] as usize;
        let t = R::transposed([&from[n(0)], &from[n(1)], &from[n(2)], &from[n(3)]]);
        for k in 0..3 {
            for l in 0..LANES {
                out.0[k].0[LANES * c + l] = t[k][l];
            }
        }
    }
    out
}

/// Adds the forces on one corner of `N` cells.
#[inline(always)]
pub(crate) fn scatter<R: Scalar, const N: usize>(f: Vec3<Wide<R, N>>, node: &[u32; N], to: &mut [[R; 4]]) {
    let zero = [R::zero(); 4];
    for c in 0..N / LANES {
        let mut four = [zero; 3];
        for k in 0..3 {
            for l in 0..LANES {
                four[k][l] = f.0[k].0[LANES * c + l];
            }
        }
        let t = R::transposed([&four[0], &four[1], &four[2], &zero]);
        for l in 0..LANES {
            let at = &mut to[node[LANES * c + l] as usize];
            *at = (Wide(*at) + Wide(t[l])).0;
        }
    }
}
