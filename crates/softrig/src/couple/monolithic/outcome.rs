//! The end of a step: joints turn, flesh goes along, and what is left is velocities, forces and energies.

use super::{CHUNK, Course, Monolithic};
use crate::body::Body;
use crate::couple::CoupledInput;
use crate::couple::jacobian::Role;
use crate::force::Increment;
use crate::integrate::{StepError, StepOutput};
use crate::rig::{Configuration, EntryKind};
use rayon::prelude::*;
use softrig_linalg::Scalar;
use softrig_linalg::par::Each;

/// A correction turns no joint further [rad]; then another linearisation follows.
const LONGEST_TURN: f64 = 0.5;

impl<R: Scalar> Monolithic<R> {
    /// Share of the correction that can be trusted; `None` when it is not finite.
    pub(super) fn trusted(&self, input: &CoupledInput<'_, R>) -> Option<f64> {
        let turns = input.articulation.entries().iter().filter(|e| e.kind != EntryKind::Place);
        let turns = turns.flat_map(|e| e.first..e.first + e.count());
        let mut longest = 0.0f64;
        for i in turns {
            let turn = self.krylov.x.joint[i].abs();
            if !turn.is_finite() {
                return None;
            }
            longest = longest.max(turn);
        }
        Some(if longest > LONGEST_TURN { LONGEST_TURN / longest } else { 1.0 })
    }

    /// Puts bound nodes where their bones are.
    pub(super) fn put_bound(&mut self) {
        let (role, placed) = (&self.role, &self.nodes.placed);
        for (n, x) in self.now.iter_mut().enumerate().filter(|(n, _)| role[*n] == Role::Bound) {
            *x = placed[n];
        }
    }

    /// How far each unknown is from the clip.
    pub(super) fn set_deviation(&mut self, course: &Course<'_, R>, configuration: &Configuration) {
        let input = course.input;
        let (pose, deviation) = (&self.pose, &mut self.deviation);
        input.articulation.deviation_into(input.skeleton, pose, input.base, configuration, deviation);
    }

    /// Turns the joints by what was found and moves the flesh along.
    pub(super) fn apply(
        &mut self,
        body: &Body<R>,
        input: &CoupledInput<'_, R>,
        scale: f64,
        configuration: &mut Configuration,
    ) {
        let found = &self.krylov.x;
        self.increment.clear();
        self.increment.extend(found.joint.iter().map(|q| q * scale));
        if self.increment.is_empty() {
            self.now.par_chunks_mut(CHUNK).zip(found.node.par_chunks(CHUNK)).each(|(x, d)| {
                for (x, d) in x.iter_mut().zip(d) {
                    (0..3).for_each(|k| x[k] += d[k]);
                }
            });
            return;
        }
        // what flesh does besides following its bones is added to where they take it
        self.twist.resize(self.motions.len(), [0.0; 6]);
        self.joints.twists(&self.increment, &mut self.twist);
        let (nodes, role, share, twist) = (&self.nodes, &self.role, &self.coarse.share, &self.twist);
        self.now.par_chunks_mut(CHUNK).enumerate().each(|(c, x)| {
            for (k, x) in x.iter_mut().enumerate() {
                let n = c * CHUNK + k;
                if role[n] == Role::Free {
                    let (d, s) = (found.node[n], share[n]);
                    let along = if s > 0.0 { nodes.moved(input.binding, n, twist) } else { [0.0; 3] };
                    (0..3).for_each(|k| x[k] += scale * d[k] - s * (along[k] + nodes.placed[n][k]));
                }
            }
        });
        input.articulation.advance(input.skeleton, &self.pose, &self.increment, configuration);
        input.articulation.clamp(configuration);
        self.take_pose(body, input, configuration);
        let (placed, share, role) = (&self.nodes.placed, &self.coarse.share, &self.role);
        self.now.par_chunks_mut(CHUNK).enumerate().each(|(c, x)| {
            for (k, x) in x.iter_mut().enumerate() {
                let n = c * CHUNK + k;
                match role[n] {
                    Role::Free => (0..3).for_each(|k| x[k] += share[n] * placed[n][k]),
                    Role::Bound => *x = placed[n],
                    Role::Held => {}
                }
            }
        });
    }

    /// Velocities, accelerations and kinetic energy at the end of the step; holding forces and elastic energy where asked for.
    pub(super) fn finish(
        &mut self,
        body: &mut Body<R>,
        course: &Course<'_, R>,
        configuration: &mut Configuration,
        output: &mut StepOutput<R>,
    ) -> Result<(), StepError> {
        self.set_velocities(course);
        self.keep_momentum(body, course, configuration);
        for (i, x) in self.now.iter().enumerate() {
            let fine = x.iter().all(|v| v.is_finite()) && self.v[i].iter().all(|v| v.is_finite());
            if !fine {
                return Err(StepError::NotFinite { time: course.state.time, what: "position", node: i });
            }
            self.x[i] = x.map(R::from_f64);
        }
        output.kinetic_energy = body.kinetic_energy(&self.v);
        self.set_deviation(course, configuration);
        if course.input.reactions {
            body.model.linearise(&self.x);
            output.elastic_energy = body.model.force(&self.x, Increment::none(), &mut self.force);
            output.reaction.clear();
            let on = |(role, force): (&Role, &[R; 3])| if *role == Role::Bound { *force } else { [R::zero(); 3] };
            output.reaction.extend(self.role.iter().zip(&self.force).map(on));
            self.hold(body, course);
        }
        Ok(())
    }

    /// v' and a' of what was found.
    fn set_velocities(&mut self, course: &Course<'_, R>) {
        let (state, c, h) = (course.state, course.c, course.input.dt);
        let (old, now, role) = (&self.old, &self.now, &self.role);
        self.v.par_chunks_mut(CHUNK).zip(self.a.par_chunks_mut(CHUNK)).enumerate().each(|(chunk, (to_v, to_a))| {
            for k in 0..to_v.len() {
                let i = chunk * CHUNK + k;
                for k3 in 0..3 {
                    let d = now[i][k3] - old[i][k3];
                    let (v, a) = (state.velocity[i][k3].to_f64(), state.acceleration[i][k3].to_f64());
                    let of = |f: [f64; 3]| f[0] * d + f[1] * v + f[2] * a;
                    let (v, a) = match role[i] {
                        Role::Free => (of(c.velocity), of(c.acceleration)),
                        Role::Bound => (d / h, 0.0),
                        Role::Held => (0.0, 0.0),
                    };
                    (to_v[k][k3], to_a[k][k3]) = (R::from_f64(v), R::from_f64(a));
                }
            }
        });
    }
}
