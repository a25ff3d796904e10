//! Conjugate gradients on nodes and joints together.
//!
//! ```text
//! [ A_ff      A_fb J          ] [d]   [r_f]
//! [ Jᵀ A_bf   Jᵀ A_bb J + Q   ] [q] = [r_q]
//! ```
//!
//! The preconditioner has two parts, one after the other and back: a coarse space of the joints, in which flesh follows its bones
//! as in blended skinning, and that of the flesh alone (a multigrid cycle on the free nodes). Without the first, every unknown
//! of the skeleton would cost an iteration.

use super::binding::Binding;
use super::jacobian::{JointJacobian, NodeJacobian, Role};
use super::pull::PointSpring;
use crate::rig::dense::Cholesky;
use rayon::prelude::*;
use softrig_linalg::solver::{Operator, Preconditioner};
use softrig_linalg::{BlockCsr, Mat3, Scalar, par};

/// Nodes per task.
const CHUNK: usize = 1024;
/// More iterations than this are never worth it: the next linearisation starts from what there is.
const MOST_ITERATIONS: usize = 400;

/// A vector over nodes (zero at all but free ones) and unknowns of the skeleton.
#[derive(Clone, Debug, Default)]
pub(crate) struct Pair {
    pub node: Vec<[f64; 3]>,
    pub joint: Vec<f64>,
}

impl Pair {
    pub fn resize(&mut self, nodes: usize, unknowns: usize) {
        self.node.clear();
        self.node.resize(nodes, [0.0; 3]);
        self.joint.clear();
        self.joint.resize(unknowns, 0.0);
    }

    /// self += a other.
    fn add(&mut self, a: f64, other: &Self) {
        self.node.par_chunks_mut(CHUNK).zip(other.node.par_chunks(CHUNK)).for_each(|(x, y)| {
            for (x, y) in x.iter_mut().zip(y) {
                (0..3).for_each(|k| x[k] += a * y[k]);
            }
        });
        self.joint.iter_mut().zip(&other.joint).for_each(|(x, y)| *x += a * y);
    }

    /// self = other + b self.
    fn direction(&mut self, b: f64, other: &Self) {
        self.node.par_chunks_mut(CHUNK).zip(other.node.par_chunks(CHUNK)).for_each(|(x, y)| {
            for (x, y) in x.iter_mut().zip(y) {
                (0..3).for_each(|k| x[k] = y[k] + b * x[k]);
            }
        });
        self.joint.iter_mut().zip(&other.joint).for_each(|(x, y)| *x = y + b * *x);
    }

    fn dot(&self, other: &Self) -> f64 {
        let nodes = par::sum(self.node.len(), |r| {
            self.node[r.clone()].iter().zip(&other.node[r]).map(|(a, b)| a[0] * b[0] + a[1] * b[1] + a[2] * b[2]).sum()
        });
        nodes + self.joint.iter().zip(&other.joint).map(|(a, b)| a * b).sum::<f64>()
    }

    /// Size of a residual [N]: torques count as forces at `length` [m].
    pub fn size(&self, length: f64) -> f64 {
        let nodes =
            par::sum(self.node.len(), |r| self.node[r].iter().map(|a| a[0] * a[0] + a[1] * a[1] + a[2] * a[2]).sum());
        (nodes + self.joint.iter().map(|t| t * t).sum::<f64>() / (length * length)).sqrt()
    }
}

/// The parts of a coupled system.
pub(crate) struct Parts<'a, R> {
    pub operator: &'a mut Operator,
    /// Entries of A, read where the operator needs them.
    pub stored: &'a BlockCsr<R>,
    pub preconditioner: Option<&'a mut dyn Preconditioner<R>>,
    pub binding: &'a Binding,
    pub role: &'a [Role],
    pub nodes: &'a mut NodeJacobian,
    pub joints: &'a JointJacobian,
    /// Added to the diagonal of A at each node.
    pub shift: &'a [f64],
    pub springs: &'a [PointSpring],
    /// Q, full rows.
    pub joint_matrix: &'a [f64],
    /// Of the coarse space of the joints.
    pub coarse: &'a Cholesky,
}

/// Memory of the iteration.
#[derive(Debug, Default)]
pub(crate) struct Krylov {
    /// The solution; also where the iteration starts.
    pub x: Pair,
    r: Pair,
    z: Pair,
    /// What a part of the preconditioner leaves for the next.
    left: Pair,
    p: Pair,
    q: Pair,
    full: Vec<[f64; 3]>,
    image: Vec<[f64; 3]>,
    twist: Vec<[f64; 6]>,
    wrench: Vec<[f64; 6]>,
    packed: [Vec<[f64; 4]>; 2],
    /// Inverted diagonal blocks, where there is no cycle.
    inverse: Vec<[[f64; 3]; 3]>,
}

/// Which vector is multiplied.
#[derive(Clone, Copy)]
enum Which {
    Solution,
    Direction,
    Preconditioned,
}

/// What an iteration came to.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Solved {
    pub iterations: usize,
    /// Size of the residual [N].
    pub residual: f64,
    pub converged: bool,
}

impl Krylov {
    /// Makes room, and starts from zero.
    pub fn start(&mut self, nodes: usize, unknowns: usize, bones: usize) {
        for v in [&mut self.x, &mut self.r, &mut self.z, &mut self.left, &mut self.p, &mut self.q] {
            v.resize(nodes, unknowns);
        }
        for v in [&mut self.full, &mut self.image] {
            v.resize(nodes, [0.0; 3]);
        }
        for v in [&mut self.twist, &mut self.wrench] {
            v.resize(bones, [0.0; 6]);
        }
    }

    /// Inverts the diagonal blocks, for systems without another preconditioner.
    pub fn load_diagonal<R: Scalar>(&mut self, matrix: &BlockCsr<R>) {
        let pattern = &matrix.pattern;
        self.inverse.clear();
        self.inverse.extend((0..pattern.row_count()).map(|i| {
            let m = matrix.values[pattern.diagonal()[i] as usize].map(Scalar::to_f64);
            let block = Mat3([[m[0], m[1], m[2]], [m[3], m[4], m[5]], [m[6], m[7], m[8]]]);
            let inverse = block.inverse().0;
            if inverse.iter().flatten().all(|v| v.is_finite()) { inverse } else { [[0.0; 3]; 3] }
        }));
    }

    /// `q = (system) v`, with v one of the vectors.
    fn multiply<R: Scalar>(&mut self, parts: &mut Parts<'_, R>, of: Which) {
        let v = match of {
            Which::Solution => &self.x,
            Which::Direction => &self.p,
            Which::Preconditioned => &self.z,
        };
        parts.joints.twists(&v.joint, &mut self.twist);
        self.full.copy_from_slice(&v.node);
        parts.nodes.spread(parts.binding, parts.role, Role::Bound, &self.twist, &mut self.full);
        parts.operator.product(parts.stored, &self.full, &mut self.image);
        self.image.par_chunks_mut(CHUNK).zip(self.full.par_chunks(CHUNK)).zip(parts.shift.par_chunks(CHUNK)).for_each(
            |((y, x), shift)| {
                for ((y, x), s) in y.iter_mut().zip(x).zip(shift) {
                    (0..3).for_each(|k| y[k] += s * x[k]);
                }
            },
        );
        parts.springs.iter().for_each(|s| s.add_product(&self.full, &mut self.image));
        parts.nodes.gather(parts.binding, parts.role, Role::Bound, &self.image, &mut self.wrench);
        let n = v.joint.len();
        let out = if matches!(of, Which::Preconditioned) { &mut self.left } else { &mut self.q };
        for i in 0..n {
            out.joint[i] = (0..n).map(|j| parts.joint_matrix[i * n + j] * v.joint[j]).sum();
        }
        parts.joints.collect(&self.wrench, &mut out.joint);
        let (image, role) = (&self.image, parts.role);
        out.node.par_chunks_mut(CHUNK).enumerate().for_each(|(c, q)| {
            for (k, q) in q.iter_mut().enumerate() {
                let n = c * CHUNK + k;
                *q = if role[n] == Role::Free { image[n] } else { [0.0; 3] };
            }
        });
    }

    /// z = (preconditioner) r: the joints with the flesh along, the flesh, the joints again, each on what is left.
    fn precondition<R: Scalar>(&mut self, parts: &mut Parts<'_, R>) {
        self.left.clone_from(&self.r);
        if self.z.joint.is_empty() {
            self.z.node.fill([0.0; 3]);
            self.smooth(parts);
            return;
        }
        self.z.joint.fill(0.0);
        self.z.node.fill([0.0; 3]);
        self.correct_joints(parts);
        self.look_again(parts);
        self.smooth(parts);
        self.look_again(parts);
        self.correct_joints(parts);
    }

    /// left = r − (system) z.
    fn look_again<R: Scalar>(&mut self, parts: &mut Parts<'_, R>) {
        self.multiply(parts, Which::Preconditioned);
        self.left.direction(-1.0, &self.r);
    }

    /// Adds to z what the joints can do about what is left, with the flesh along.
    fn correct_joints<R: Scalar>(&mut self, parts: &mut Parts<'_, R>) {
        parts.nodes.gather(parts.binding, parts.role, Role::Free, &self.left.node, &mut self.wrench);
        parts.joints.collect(&self.wrench, &mut self.left.joint);
        parts.coarse.solve(&mut self.left.joint);
        self.z.joint.iter_mut().zip(&self.left.joint).for_each(|(z, c)| *z += c);
        parts.joints.twists(&self.left.joint, &mut self.twist);
        parts.nodes.spread_add(parts.binding, parts.role, Role::Free, &self.twist, &mut self.z.node);
    }

    /// Adds to z what the flesh alone can do about what is left.
    fn smooth<R: Scalar>(&mut self, parts: &mut Parts<'_, R>) {
        match &mut parts.preconditioner {
            Some(cycle) => {
                let [r, z] = &mut self.packed;
                let free = cycle.free_nodes();
                r.clear();
                r.extend(free.iter().map(|n| {
                    let v = self.left.node[*n as usize];
                    [v[0], v[1], v[2], 0.0]
                }));
                z.resize(r.len(), [0.0; 4]);
                cycle.apply(r, z);
                for (n, z) in cycle.free_nodes().iter().zip(z.iter()) {
                    let to = &mut self.z.node[*n as usize];
                    (0..3).for_each(|k| to[k] += z[k]);
                }
            }
            None => {
                for ((z, r), m) in self.z.node.iter_mut().zip(&self.left.node).zip(&self.inverse) {
                    (0..3).for_each(|k| z[k] += m[k][0] * r[0] + m[k][1] * r[1] + m[k][2] * r[2]);
                }
            }
        }
    }

    /// Goes on from `x` until the residual is at most `target` [N].
    pub fn solve<R: Scalar>(&mut self, parts: &mut Parts<'_, R>, rhs: &Pair, target: f64, length: f64) -> Solved {
        self.multiply(parts, Which::Solution);
        self.r.node.copy_from_slice(&rhs.node);
        self.r.joint.copy_from_slice(&rhs.joint);
        self.r.add(-1.0, &self.q);
        let mut left = self.r.size(length);
        let done = |iterations, residual: f64| Solved { iterations, residual, converged: residual <= target };
        if left <= target {
            return done(0, left);
        }
        self.precondition(parts);
        self.p.direction(0.0, &self.z);
        let mut rz = self.r.dot(&self.z);
        let (mut best, mut since_best) = (left, 0);
        for iteration in 1..=MOST_ITERATIONS {
            self.multiply(parts, Which::Direction);
            let pq = self.p.dot(&self.q);
            if pq.is_nan() || pq <= 0.0 || !rz.is_finite() {
                return done(iteration, left);
            }
            let alpha = rz / pq;
            self.x.add(alpha, &self.p);
            self.r.add(-alpha, &self.q);
            left = self.r.size(length);
            if left < best {
                (best, since_best) = (left, 0);
            } else {
                since_best += 1;
            }
            // rounding has the last word
            if left <= target || since_best > 60 {
                return done(iteration, left);
            }
            self.precondition(parts);
            // a cycle in f32 is symmetric only up to rounding: zᵀ (r - r_before) instead of zᵀ r
            let beta = -alpha * self.z.dot(&self.q) / rz;
            rz = self.r.dot(&self.z);
            self.p.direction(beta, &self.z);
        }
        done(MOST_ITERATIONS, left)
    }
}
