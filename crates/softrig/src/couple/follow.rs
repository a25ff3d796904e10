//! How far flesh follows its bones within one step: a share per node, 1 on bones, less the longer a push takes to get there.
//!
//! Bones that move for one step drag along what is near them and leave the rest where inertia keeps it. The exact share would be
//! the solution of the whole system for every motion of every bone; that of one number per node is nearly as good, because what
//! decays with the distance is the same for all motions: s φ = 0 on free nodes, φ = 1 on bound ones, with s_ij = tr(A_ij) / 3, which
//! turning the cells does not change.

use super::jacobian::Role;
use rayon::prelude::*;
use softrig_linalg::par::Each;
use softrig_linalg::{BlockCsr, Scalar};

/// Nodes per task.
const CHUNK: usize = 1024;
/// Iterations of conjugate gradients: the shares feed a preconditioner, two digits are plenty.
const MOST_ITERATIONS: usize = 60;
const TOLERANCE: f64 = 1e-2;
/// Smaller shares are none.
const LEAST: f64 = 5e-3;

/// Memory of the iteration.
#[derive(Debug, Default)]
pub(super) struct Following {
    scalar: Vec<f64>,
    inverse: Vec<f64>,
    r: Vec<f64>,
    p: Vec<f64>,
    q: Vec<f64>,
}

impl Following {
    /// The share of every node [-]; zero on nodes without cells.
    pub fn shares<R: Scalar>(&mut self, matrix: &BlockCsr<R>, role: &[Role], out: &mut Vec<f64>) {
        let n = role.len();
        let pattern = &matrix.pattern;
        let Self { scalar, inverse, r, p, q } = self;
        scalar.clear();
        scalar.extend(matrix.values.iter().map(|b| (b[0].to_f64() + b[4].to_f64() + b[8].to_f64()) / 3.0));
        let free = |i: usize| role[i] == Role::Free;
        out.clear();
        out.extend(role.iter().map(|r| if *r == Role::Bound { 1.0 } else { 0.0 }));
        let product = |x: &[f64], y: &mut [f64]| {
            y.par_chunks_mut(CHUNK).enumerate().each(|(c, y)| {
                for (k, y) in y.iter_mut().enumerate() {
                    let i = c * CHUNK + k;
                    let row = pattern.row(i);
                    let terms = scalar[row.clone()].iter().zip(&pattern.column()[row]);
                    *y = if free(i) { terms.map(|(a, j)| a * x[*j as usize]).sum() } else { 0.0 };
                }
            });
        };
        inverse.clear();
        inverse.extend((0..n).map(|i| {
            let d = scalar[pattern.diagonal()[i] as usize];
            if free(i) && d > 0.0 { 1.0 / d } else { 0.0 }
        }));
        for v in [&mut *r, &mut *q] {
            v.clear();
            v.resize(n, 0.0);
        }
        product(out, r);
        r.iter_mut().for_each(|r| *r = -*r);
        p.clear();
        p.extend(r.iter().zip(&*inverse).map(|(r, d)| r * d));
        let energy = |r: &[f64]| r.iter().zip(&*inverse).map(|(r, d)| r * r * d).sum::<f64>();
        let mut rz = energy(r);
        let least = TOLERANCE * TOLERANCE * rz;
        for _ in 0..MOST_ITERATIONS {
            product(p, q);
            let pq: f64 = p.iter().zip(&*q).map(|(p, q)| p * q).sum();
            if !(pq > 0.0 && rz > least) {
                break;
            }
            let alpha = rz / pq;
            for i in 0..n {
                out[i] += alpha * p[i];
                r[i] -= alpha * q[i];
            }
            let before = rz;
            rz = energy(r);
            for i in 0..n {
                p[i] = r[i] * inverse[i] + rz / before * p[i];
            }
        }
        for share in out.iter_mut() {
            *share = if *share >= LEAST { share.min(1.0) } else { 0.0 };
        }
    }
}
