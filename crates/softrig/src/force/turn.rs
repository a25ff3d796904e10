//! How the cells around a node are turned, on the mean: sums of their quaternions, which have no sign of their own.

use super::tet::{BLOCK, TASK};
use rayon::prelude::*;
use softrig_linalg::par::Each;
use softrig_linalg::{Kernel, Scalar, Scatter, par, run_wide};

/// Nodes per task, at least.
const NODES: usize = 512;

/// Sums the rotations of the cells of each chunk at its nodes.
pub(super) fn fill_parts<R: Scalar, const N: usize>(scatter: &Scatter<N>, q: &[[[R; BLOCK]; 4]], parts: &mut [[R; 4]]) {
    scatter.for_chunks(parts, |chunk, local, parts| {
        run_wide::<R, _>(Sum { q: par::chunk(q, chunk, TASK), local, parts });
    });
}

/// Sums up what the chunks of tetrahedra and of hexahedra have for each of these nodes.
pub(super) fn gather<R: Scalar>(
    tets: (&Scatter<4>, &[[R; 4]]),
    hexes: (&Scatter<8>, &[[R; 4]]),
    node: &[u32],
    out: &mut [[f32; 4]],
) {
    out.par_iter_mut().zip(node).with_min_len(NODES).each(|(out, node)| {
        let mut sum = [R::zero(); 4];
        for part in tets.0.parts(*node as usize) {
            add(&mut sum, tets.1[*part as usize]);
        }
        for part in hexes.0.parts(*node as usize) {
            add(&mut sum, hexes.1[*part as usize]);
        }
        *out = sum.map(|v| v.to_f64() as f32);
    });
}

struct Sum<'a, R, const N: usize> {
    q: &'a [[[R; BLOCK]; 4]],
    local: &'a [[u16; N]],
    parts: &'a mut [[R; 4]],
}

impl<R: Scalar, const N: usize> Kernel for Sum<'_, R, N> {
    type Output = ();
    #[inline(always)]
    fn run<const W: usize>(self) {
        self.parts.fill([R::zero(); 4]);
        for (q, local) in self.q.iter().zip(self.local.chunks(BLOCK)) {
            for (l, at) in local.iter().enumerate() {
                let q = [q[0][l], q[1][l], q[2][l], q[3][l]];
                for at in at {
                    add(&mut self.parts[usize::from(*at)], q);
                }
            }
        }
    }
}

/// Adds the rotation with the sign that is nearer to the sum.
#[inline(always)]
fn add<R: Scalar>(sum: &mut [R; 4], q: [R; 4]) {
    let dot = (sum[0] * q[0] + sum[1] * q[1]) + (sum[2] * q[2] + sum[3] * q[3]);
    let sign = if dot < R::zero() { -R::one() } else { R::one() };
    for (s, q) in sum.iter_mut().zip(q) {
        *s += sign * q;
    }
}
