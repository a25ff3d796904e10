//! What is left of the equations: r = f_ext − f_int − M a' − C d/h, free nodes as they are, bound ones through Jᵀ, with springs,
//! drags and leads.

use super::{CHUNK, Course, Monolithic};
use crate::body::Body;
use crate::couple::jacobian::Role;
use crate::couple::pull::{PointSpring, shortened};
use crate::rig::Configuration;
use glam::DVec3;
use rayon::prelude::*;
use softrig_linalg::Scalar;
use softrig_linalg::par::Each;

impl<R: Scalar> Monolithic<R> {
    /// Linearises the flesh, at the start or at what has been found, and computes what is left of the equations. Returns its elastic
    /// energy there [J].
    pub(super) fn balance(
        &mut self,
        body: &mut Body<R>,
        course: &Course<'_, R>,
        configuration: &Configuration,
        at_start: bool,
    ) -> f64 {
        self.set_motion(course.input.dt);
        // rotations: those of the start, then those of what has been found
        let at = if at_start { &course.state.position } else { &self.x };
        body.model.linearise(at);
        // what no bone moved and nothing damps costs nothing
        let moved = at_start && self.d.iter().flatten().any(|d| *d != R::zero());
        let increment = body.increment(moved.then_some(&self.d[..]), &self.v);
        let energy = body.model.force(at, increment, &mut self.force);
        self.rhs.resize(self.now.len(), course.input.articulation.unknown_count());
        self.node_balance(body, course);
        self.joint_balance(course, configuration);
        energy
    }

    /// Displacement d and its velocity d/h in the numbers of the model.
    fn set_motion(&mut self, h: f64) {
        let (old, now) = (&self.old, &self.now);
        let all = (self.x.par_chunks_mut(CHUNK), self.d.par_chunks_mut(CHUNK), self.v.par_chunks_mut(CHUNK));
        all.into_par_iter().enumerate().each(|(c, (x, d, v))| {
            for k in 0..x.len() {
                let (a, b) = (old[c * CHUNK + k], now[c * CHUNK + k]);
                x[k] = b.map(R::from_f64);
                d[k] = std::array::from_fn(|i| R::from_f64(b[i] - a[i]));
                v[k] = std::array::from_fn(|i| R::from_f64((b[i] - a[i]) / h));
            }
        });
    }

    fn node_balance(&mut self, body: &Body<R>, course: &Course<'_, R>) {
        let (input, state, c, h) = (course.input, course.state, course.c, course.input.dt);
        let extra = body.mass_damping.to_f64();
        let (old, now, role, force) = (&self.old, &self.now, &self.role, &self.force);
        let (mass, drags) = (&body.mass, &body.drag);
        self.force_sum.resize(now.len(), [0.0; 3]);
        self.force_sum.par_chunks_mut(CHUNK).enumerate().each(|(chunk, out)| {
            for (k, out) in out.iter_mut().enumerate() {
                let i = chunk * CHUNK + k;
                *out = [0.0; 3];
                if role[i] == Role::Held {
                    continue;
                }
                let m = mass[i].to_f64();
                let drag = drags[i].to_f64() + extra * m;
                let (v, a) = (state.velocity[i].map(Scalar::to_f64), state.acceleration[i].map(Scalar::to_f64));
                for k in 0..3 {
                    let d = now[i][k] - old[i][k];
                    let inertia = match role[i] {
                        Role::Bound => (d / h - v[k]) / h,
                        _ => c.acceleration[0] * d + c.acceleration[1] * v[k] + c.acceleration[2] * a[k],
                    };
                    let f = input.external_force[i][k].to_f64() - force[i][k].to_f64();
                    out[k] = f - m * inertia - drag * d / h;
                }
            }
        });
        for p in &self.pulls {
            let f = pull_of(p, &self.now, &self.old, h);
            for (i, w) in &p.nodes {
                (0..3).for_each(|k| self.force_sum[*i as usize][k] += w * f[k]);
            }
        }
        self.wrench.resize(input.binding.bones.len(), [0.0; 6]);
        self.nodes.gather(input.binding, &self.role, Role::Bound, &self.force_sum, &mut self.wrench);
        self.joints.collect(&self.wrench, &mut self.rhs.joint);
        let (all, role) = (&self.force_sum, &self.role);
        self.rhs.node.par_chunks_mut(CHUNK).enumerate().each(|(c, to)| {
            for (k, to) in to.iter_mut().enumerate().filter(|(k, _)| role[c * CHUNK + k] == Role::Free) {
                *to = all[c * CHUNK + k];
            }
        });
    }

    /// Leads toward the clip, and drags.
    fn joint_balance(&mut self, course: &Course<'_, R>, configuration: &Configuration) {
        let (input, h) = (course.input, course.input.dt);
        self.set_deviation(course, configuration);
        for (i, lead) in input.leads.iter().enumerate() {
            let rate = (self.deviation[i] - input.deviation[i]) / h;
            self.rhs.joint[i] -= lead.stiffness * self.deviation[i] + lead.damping * rate;
        }
        for (drag, then) in input.drags.iter().zip(&self.dragged) {
            let at = DVec3::from(self.pose.joint(drag.joint).translation);
            let pull = shortened((DVec3::from(drag.target) - at).into(), drag.longest);
            let f = DVec3::from(pull) * drag.stiffness + (DVec3::from(drag.velocity) - (at - *then) / h) * drag.damping;
            for (i, column) in self.joints.point(input.articulation, drag.joint, at) {
                self.rhs.joint[i] += column.dot(f);
            }
        }
    }

    /// What bones hold at the end of the step: their flesh with what damps it, and what bound nodes have by themselves.
    pub(super) fn hold(&mut self, body: &mut Body<R>, course: &Course<'_, R>) {
        let (input, h) = (course.input, course.input.dt);
        for (d, (now, old)) in self.d.iter_mut().zip(self.now.iter().zip(&self.old)) {
            *d = std::array::from_fn(|k| R::from_f64((now[k] - old[k]) / h));
        }
        let damping = body.increment(None, &self.d);
        if damping.velocity.is_some() {
            body.model.force(&self.x, damping, &mut self.force);
        }
        let extra = body.mass_damping.to_f64();
        self.load.clear();
        self.load.resize(self.now.len(), [0.0; 3]);
        for i in (0..self.now.len()).filter(|i| self.role[*i] == Role::Bound) {
            let m = body.mass[i].to_f64();
            let drag = body.drag[i].to_f64() + extra * m;
            for k in 0..3 {
                let velocity = (self.now[i][k] - self.old[i][k]) / h;
                let inertia = (velocity - course.state.velocity[i][k].to_f64()) / h;
                let f = input.external_force[i][k].to_f64() - self.force[i][k].to_f64();
                self.load[i][k] = f - drag * velocity - m * inertia;
            }
        }
        for p in &self.pulls {
            let f = pull_of(p, &self.now, &self.old, h);
            for (i, w) in p.nodes.iter().filter(|(i, _)| self.role[*i as usize] == Role::Bound) {
                (0..3).for_each(|k| self.load[*i as usize][k] += w * f[k]);
            }
        }
    }
}

/// Force of a spring on its point [N].
fn pull_of(p: &PointSpring, now: &[[f64; 3]], old: &[[f64; 3]], h: f64) -> [f64; 3] {
    let (now, then) = (p.point(now), p.point(old));
    std::array::from_fn(|k| p.stiffness * (p.target[k] - now[k]) + p.damping * (p.velocity[k] - (now[k] - then[k]) / h))
}
