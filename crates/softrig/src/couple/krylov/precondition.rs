//! What preconditions the iteration: a cycle on the flesh between two looks at the joints (see [`super`]).

use super::super::jacobian::Role;
use super::super::rows::wide6;
use super::{CHUNK, Krylov, Parts};
use rayon::prelude::*;
use softrig_linalg::par::Each;
use softrig_linalg::{BlockCsr, Mat3, Scalar};

impl Krylov {
    /// Inverts the diagonal blocks, for systems without another preconditioner.
    pub fn load_diagonal<R: Scalar>(&mut self, matrix: &BlockCsr<R>, role: &[Role]) {
        let pattern = &matrix.pattern;
        self.free.clear();
        self.free.extend((0..role.len() as u32).filter(|n| role[*n as usize] == Role::Free));
        self.inverse.clear();
        self.inverse.extend(self.free.iter().map(|n| {
            let m = matrix.values[pattern.diagonal()[*n as usize] as usize].map(Scalar::to_f64);
            let block = Mat3([[m[0], m[1], m[2]], [m[3], m[4], m[5]], [m[6], m[7], m[8]]]);
            let inverse = block.inverse().0.map(|row| row.map(|v| v as f32));
            if inverse.iter().flatten().all(|v| v.is_finite()) { inverse } else { [[0.0; 3]; 3] }
        }));
    }

    /// z = (preconditioner) r.
    pub(super) fn precondition<R: Scalar>(&mut self, parts: &mut Parts<'_, R>) {
        let coupled = !self.r.joint.is_empty();
        self.first.clone_from(&self.r.joint);
        parts.coarse.solve(&mut self.first);
        self.wide.clear();
        if coupled {
            parts.joints.twists(&self.first, &mut self.twist);
            let own = self.twist.iter().zip(&parts.nodes.rotation);
            self.wide.extend(own.map(|(t, r)| wide6(&turned(t, r, true))));
        }
        let [r, z] = &mut self.packed;
        let free = parts.preconditioner.as_ref().map_or(&self.free[..], |c| c.free_nodes());
        r.resize(free.len(), [0.0; 4]);
        z.resize(free.len(), [0.0; 4]);
        let (from, wide, between, frame) = (&self.r.node, &self.wide, parts.between, &parts.nodes.frame);
        let owner = &parts.binding.owner;
        r.par_chunks_mut(CHUNK).zip(free.par_chunks(CHUNK)).each(|(r, free)| {
            for (r, n) in r.iter_mut().zip(free) {
                let n = *n as usize;
                *r = from[n];
                if coupled {
                    let f = times(&frame[owner[n] as usize], between.moved(n, wide));
                    (0..3).for_each(|k| r[k] -= f[k]);
                }
            }
        });
        match &mut parts.preconditioner {
            Some(cycle) => cycle.apply(r, z),
            None => {
                for ((z, r), m) in z.iter_mut().zip(r.iter()).zip(&self.inverse) {
                    (0..3).for_each(|k| z[k] = m[k][0] * r[0] + m[k][1] * r[1] + m[k][2] * r[2]);
                }
            }
        }
        let free = parts.preconditioner.as_ref().map_or(&self.free[..], |c| c.free_nodes());
        for (n, z) in free.iter().zip(z.iter()) {
            self.z.node[*n as usize] = *z;
        }
        if coupled {
            let own = |row: usize| {
                let n = free[row] as usize;
                (n, back(&frame[owner[n] as usize], z[row]))
            };
            between.gather(free.len(), own, &mut self.partial, &mut self.wrench);
            for (w, r) in self.wrench.iter_mut().zip(&parts.nodes.rotation) {
                *w = turned(w, r, false);
            }
            self.second.clear();
            self.second.resize(self.first.len(), 0.0);
            parts.joints.collect(&self.wrench, &mut self.second);
            parts.coarse.solve(&mut self.second);
            for (z, (a, b)) in self.z.joint.iter_mut().zip(self.first.iter().zip(&self.second)) {
                *z = a - b;
            }
        }
    }
}

/// A twist or wrench in the axes of a bone, or from there in those of the world.
fn turned(v: &[f64; 6], rotation: &glam::DMat3, to_bone: bool) -> [f64; 6] {
    let m = if to_bone { rotation.transpose() } else { *rotation };
    let (a, b) = (m * glam::DVec3::new(v[0], v[1], v[2]), m * glam::DVec3::new(v[3], v[4], v[5]));
    [a.x, a.y, a.z, b.x, b.y, b.z]
}

#[inline]
fn times(m: &[[f32; 3]; 3], v: [f32; 3]) -> [f32; 3] {
    m.map(|row| row[0] * v[0] + row[1] * v[1] + row[2] * v[2])
}

#[inline]
fn back(m: &[[f32; 3]; 3], v: [f32; 4]) -> [f32; 3] {
    std::array::from_fn(|k| m[0][k] * v[0] + m[1][k] * v[1] + m[2][k] * v[2])
}
