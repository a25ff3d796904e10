//! Four cells side by side: corners of cells as lanes, and forces of lanes on nodes.
//!
//! No closures here or in the kernels that call this: one that is not inlined is compiled without their wide instructions.

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

/// One corner of four cells.
#[inline(always)]
pub(crate) fn corner<R: Scalar>(from: &[[R; 4]], node: &[u32; LANES]) -> Vec3<Quad<R>> {
    let [a, b, c, d] = *node;
    let t = R::transposed([&from[a as usize], &from[b as usize], &from[c as usize], &from[d as usize]]);
    Vec3([Wide(t[0]), Wide(t[1]), Wide(t[2])])
}

/// Adds the forces on one corner of four cells.
#[inline(always)]
pub(crate) fn scatter<R: Scalar>(f: Vec3<Quad<R>>, node: &[u32; LANES], to: &mut [[R; 4]]) {
    let zero = [R::zero(); 4];
    let t = R::transposed([&f.0[0].0, &f.0[1].0, &f.0[2].0, &zero]);
    for l in 0..LANES {
        let at = &mut to[node[l] as usize];
        *at = (Wide(*at) + Wide(t[l])).0;
    }
}
