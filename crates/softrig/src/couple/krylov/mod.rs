//! Conjugate gradients on nodes and joints together.
//!
//! ```text
//! [ A_ff      A_fb J          ] [d]   [r_f]
//! [ Jᵀ A_bf   Jᵀ A_bb J + Q   ] [q] = [r_q]
//! ```
//!
//! Flesh is counted from where its bones take it: d = d' + W q with W the share of the bones' motion of [`super::follow`]. In these
//! unknowns flesh and joints hardly meet, and what is left between them, B = (A W) at the free nodes, is eliminated approximately:
//! with M for a multigrid cycle on A_ff and E = Wᵀ A W + Q,
//!
//! ```text
//! q1 = E⁻¹ g;   d' = M (r_f − B q1);   q = q1 − E⁻¹ Bᵀ d'
//! ```
//!
//! is a symmetric preconditioner of one cycle and no further product, whatever E and B lag behind by. Without W every unknown of
//! the skeleton would cost an iteration.
//!
//! The iteration runs in f32. Its result is added to the solution in f64, and as often as the true residual there is not small
//! enough, it runs again on what is left.

mod precondition;
mod vector;

pub(crate) use vector::Pair;

use super::binding::Binding;
use super::jacobian::{JointJacobian, NodeJacobian, Role};
use super::pull::PointSpring;
use super::rows::{BoneRows, Partial, Wide6, wide6};
use crate::rig::dense::Cholesky;
use rayon::prelude::*;
use softrig_linalg::Scalar;
use softrig_linalg::par::Each;
use softrig_linalg::solver::{Operator, Preconditioner};
use vector::Light;

/// Nodes per task.
const CHUNK: usize = 1024;
/// More iterations than this are never worth it: the next linearisation starts from what there is.
const MOST_ITERATIONS: usize = 400;
/// The residual of a pass is believed down to this share of where it started: some fifty roundings.
const BELIEVED: f64 = 50.0 * f32::EPSILON as f64;

/// The parts of a coupled system.
pub(crate) struct Parts<'a, R> {
    /// A, for true residuals and for the iteration.
    pub exact: &'a mut Operator<f64>,
    pub light: &'a mut Operator<f32>,
    pub preconditioner: Option<&'a mut dyn Preconditioner<R>>,
    pub binding: &'a Binding,
    pub role: &'a [Role],
    pub nodes: &'a mut NodeJacobian,
    pub joints: &'a JointJacobian,
    /// W of free nodes, J of bound ones.
    pub along: &'a BoneRows,
    /// B, in the axes of each node's own bone on the left and of the bones on the right.
    pub between: &'a BoneRows,
    /// Added to the diagonal of A at each node.
    pub shift: &'a [f64],
    pub springs: &'a [PointSpring],
    /// Q, full rows.
    pub joint_matrix: &'a [f64],
    /// E.
    pub coarse: &'a Cholesky,
}

/// Memory of the iteration.
#[derive(Debug, Default)]
pub(crate) struct Krylov {
    /// The solution; also where the iteration starts.
    pub x: Pair,
    /// Nothing has moved it from zero yet.
    at_zero: bool,
    /// Its true residual, and the torques in it with those of the flesh that follows, g = r_q + Wᵀ r_f.
    left: Pair,
    torque: Vec<f64>,
    d: Light,
    r: Light,
    z: Light,
    p: Light,
    q: Light,
    twist: Vec<[f64; 6]>,
    wrench: Vec<[f64; 6]>,
    wide: Vec<Wide6>,
    partial: Partial,
    /// Joint corrections before and after the flesh.
    first: Vec<f64>,
    second: Vec<f64>,
    packed: [Vec<[f32; 4]>; 2],
    image: Vec<[f64; 3]>,
    /// Free nodes and their inverted diagonal blocks, where there is no cycle.
    free: Vec<u32>,
    inverse: Vec<[[f32; 3]; 3]>,
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
        self.x.resize(nodes, unknowns);
        self.at_zero = true;
        self.left.resize(nodes, unknowns);
        for v in [&mut self.d, &mut self.r, &mut self.z, &mut self.p, &mut self.q] {
            v.resize(nodes, unknowns);
        }
        for v in [&mut self.twist, &mut self.wrench] {
            v.resize(bones, [0.0; 6]);
        }
        self.image.resize(nodes, [0.0; 3]);
    }

    /// Moves the solution by a change of the skeleton's unknowns, flesh along.
    pub fn turn<R: Scalar>(&mut self, parts: &Parts<'_, R>, change: &[f64]) {
        self.at_zero = false;
        self.x.joint.iter_mut().zip(change).for_each(|(x, c)| *x += c);
        parts.joints.twists(change, &mut self.twist);
        self.wide.clear();
        self.wide.extend(self.twist.iter().map(wide6));
        let (wide, role) = (&self.wide, parts.role);
        self.x.node.par_chunks_mut(CHUNK).enumerate().each(|(c, x)| {
            for (k, x) in x.iter_mut().enumerate().filter(|(k, _)| role[c * CHUNK + k] == Role::Free) {
                let moved = parts.along.moved(c * CHUNK + k, wide);
                (0..3).for_each(|k| x[k] += f64::from(moved[k]));
            }
        });
    }

    /// Size of what is left [N]. A joint that turns takes the flesh along, so its torque counts with that of the flesh around it: so does
    /// the iteration's own measure, and what the flesh leaves at a hundred nodes is no torque on a bone that it would move with.
    fn size_left<R: Scalar>(&mut self, parts: &Parts<'_, R>, length: f64) -> f64 {
        let left = &self.left.node;
        parts.along.gather(left.len(), |n| (n, left[n].map(|v| v as f32)), &mut self.partial, &mut self.wrench);
        self.torque.clone_from(&self.left.joint);
        parts.joints.collect(&self.wrench, &mut self.torque);
        std::mem::swap(&mut self.torque, &mut self.left.joint);
        let size = self.left.size(length);
        std::mem::swap(&mut self.torque, &mut self.left.joint);
        size
    }

    /// left = rhs − (system) x in f64. Returns its size.
    fn true_residual<R: Scalar>(&mut self, parts: &mut Parts<'_, R>, rhs: &Pair, length: f64) -> f64 {
        if self.at_zero {
            self.left.joint.clone_from(&rhs.joint);
            self.left.node.clone_from(&rhs.node);
            return self.size_left(parts, length);
        }
        let n = self.x.joint.len();
        parts.joints.twists(&self.x.joint, &mut self.twist);
        let (x, nodes, twist, role) = (&self.x.node, &*parts.nodes, &self.twist, parts.role);
        parts.exact.input().par_chunks_mut(CHUNK).enumerate().each(|(c, to)| {
            for (k, to) in to.iter_mut().enumerate() {
                let n = c * CHUNK + k;
                let v = match role[n] {
                    Role::Free => x[n],
                    Role::Bound => nodes.moved(parts.binding, n, twist),
                    Role::Held => [0.0; 3],
                };
                *to = [v[0], v[1], v[2], 0.0];
            }
        });
        parts.exact.product();
        for s in parts.springs {
            let f = s.point_of(|n| parts.exact.both().0[n]).map(|v| v * s.effective);
            s.nodes.iter().for_each(|(n, w)| parts.exact.add(*n as usize, f.map(|f| w * f)));
        }
        let ((x, y), shift) = (parts.exact.both(), parts.shift);
        self.image.par_chunks_mut(CHUNK).enumerate().each(|(c, to)| {
            for (k, to) in to.iter_mut().enumerate() {
                let n = c * CHUNK + k;
                *to = std::array::from_fn(|k| y[n][k] + shift[n] * x[n][k]);
            }
        });
        parts.nodes.gather(parts.binding, parts.role, Role::Bound, &self.image, &mut self.wrench);
        for i in 0..n {
            self.left.joint[i] = (0..n).map(|j| parts.joint_matrix[i * n + j] * self.x.joint[j]).sum();
        }
        parts.joints.collect(&self.wrench, &mut self.left.joint);
        self.left.joint.iter_mut().zip(&rhs.joint).for_each(|(l, b)| *l = b - *l);
        let image = &self.image;
        self.left.node.par_chunks_mut(CHUNK).enumerate().each(|(c, to)| {
            for (k, to) in to.iter_mut().enumerate() {
                let n = c * CHUNK + k;
                let free = role[n] == Role::Free;
                *to = if free { std::array::from_fn(|k| rhs.node[n][k] - image[n][k]) } else { [0.0; 3] };
            }
        });
        self.size_left(parts, length)
    }

    /// q = (system) p, flesh counted from where its bones take it.
    fn multiply<R: Scalar>(&mut self, parts: &mut Parts<'_, R>) {
        let n = self.p.joint.len();
        parts.joints.twists(&self.p.joint, &mut self.twist);
        self.wide.clear();
        self.wide.extend(self.twist.iter().map(wide6));
        let (p, wide, along, role) = (&self.p.node, &self.wide, parts.along, parts.role);
        parts.light.input().par_chunks_mut(CHUNK).enumerate().each(|(c, to)| {
            for (k, to) in to.iter_mut().enumerate() {
                let n = c * CHUNK + k;
                let m = along.moved(n, wide);
                *to = [p[n][0] + m[0], p[n][1] + m[1], p[n][2] + m[2], 0.0];
            }
        });
        parts.light.product();
        for s in parts.springs {
            let f = s.point_of(|n| parts.light.both().0[n].map(f64::from)).map(|v| v * s.effective);
            s.nodes.iter().for_each(|(n, w)| parts.light.add(*n as usize, f.map(|f| (w * f) as f32)));
        }
        let ((x, y), shift) = (parts.light.both(), parts.shift);
        let force = |n: usize| -> [f32; 3] {
            let s = shift[n] as f32;
            std::array::from_fn(|k| y[n][k] + s * x[n][k])
        };
        along.gather(y.len(), |n| (n, force(n)), &mut self.partial, &mut self.wrench);
        for i in 0..n {
            self.q.joint[i] = (0..n).map(|j| parts.joint_matrix[i * n + j] * self.p.joint[j]).sum();
        }
        parts.joints.collect(&self.wrench, &mut self.q.joint);
        self.q.node.par_chunks_mut(CHUNK).enumerate().each(|(c, to)| {
            for (k, to) in to.iter_mut().enumerate() {
                let n = c * CHUNK + k;
                *to = if role[n] == Role::Free { y[n] } else { [0.0; 4] };
            }
        });
    }

    /// Goes on from `x` until the residual is at most `target` [N].
    pub fn solve<R: Scalar>(&mut self, parts: &mut Parts<'_, R>, rhs: &Pair, target: f64, length: f64) -> Solved {
        let mut left = self.true_residual(parts, rhs, length);
        let mut iterations = 0;
        let mut asked = target;
        let done = |iterations, residual: f64| Solved { iterations, residual, converged: residual <= target };
        loop {
            if left <= target || iterations >= MOST_ITERATIONS || !left.is_finite() {
                return done(iterations, left);
            }
            let before = left;
            let goal = asked.max(BELIEVED * left);
            iterations += self.pass(parts, (goal, left), length, MOST_ITERATIONS - iterations);
            // d = d' + W q
            let found = std::mem::take(&mut self.d);
            self.x.node.par_chunks_mut(CHUNK).zip(found.node.par_chunks(CHUNK)).each(|(x, d)| {
                for (x, d) in x.iter_mut().zip(d) {
                    (0..3).for_each(|k| x[k] += f64::from(d[k]));
                }
            });
            self.turn(parts, &found.joint);
            self.d = found;
            left = self.true_residual(parts, rhs, length);
            // each pass must gain something, or rounding has the last word
            if left.is_nan() || left > 0.5 * before {
                return done(iterations, left);
            }
            // what a pass takes for its residual is another measure of it
            asked *= (0.5 * target / left).min(1.0);
        }
    }

    /// Conjugate gradients on what is left, of the size `from` [N], until that is at most `goal`; leaves the correction in `d`.
    fn pass<R: Scalar>(
        &mut self,
        parts: &mut Parts<'_, R>,
        (goal, from): (f64, f64),
        length: f64,
        limit: usize,
    ) -> usize {
        // f32 has the digits but not the range
        let scale = (-from.log2().floor()).exp2();
        let (left, factor) = (&self.left, scale);
        self.r.node.par_chunks_mut(CHUNK).zip(left.node.par_chunks(CHUNK)).each(|(r, l)| {
            for (r, l) in r.iter_mut().zip(l) {
                *r = [(l[0] * factor) as f32, (l[1] * factor) as f32, (l[2] * factor) as f32, 0.0];
            }
        });
        self.r.joint.iter_mut().zip(&self.torque).for_each(|(r, t)| *r = t * scale);
        let (nodes, unknowns) = (self.r.node.len(), self.r.joint.len());
        for v in [&mut self.d, &mut self.z] {
            v.resize(nodes, unknowns);
        }
        let square = (goal * scale).powi(2);
        let mut used = limit;
        self.precondition(parts);
        self.p.direction(0.0, &self.z);
        let mut rz = self.r.dot(&self.z);
        let (mut best, mut since_best) = (f64::INFINITY, 0);
        for iteration in 1..=limit {
            self.multiply(parts);
            let pq = self.p.dot(&self.q);
            if pq.is_nan() || pq <= 0.0 || !rz.is_finite() {
                used = iteration;
                break;
            }
            let alpha = rz / pq;
            self.d.add(alpha, &self.p);
            self.r.add(-alpha, &self.q);
            let left = self.r.square(length);
            if left < best {
                (best, since_best) = (left, 0);
            } else {
                since_best += 1;
            }
            if left <= square || since_best > 30 {
                used = iteration;
                break;
            }
            self.precondition(parts);
            // a cycle in f32 is symmetric only up to rounding: zᵀ (r − r_before) instead of zᵀ r
            let beta = -alpha * self.z.dot(&self.q) / rz;
            rz = self.r.dot(&self.z);
            self.p.direction(beta, &self.z);
        }
        let back = 1.0 / scale;
        self.d.node.par_iter_mut().each(|d| *d = d.map(|v| (f64::from(v) * back) as f32));
        self.d.joint.iter_mut().for_each(|d| *d *= back);
        used
    }
}
