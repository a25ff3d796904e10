//! Advancing flesh and skeleton together.

use super::advance::{LONGEST_MOVE, LONGEST_TURN, MOST_SUBSTEPS, TELEPORT_RATIO, TELEPORT_SHARE};
use super::coupling::{CoupledState, JointReaction};
use super::{Course, FrameReport, Motion, START_LOOK, Simulation};
use crate::couple::{Coupled, CoupledInput};
use crate::integrate::{Scheme, StepError};
use crate::rig::{Base, JointId, Pose};
use glam::DVec3;
use softrig_linalg::Scalar;

/// A step that took bones so many times as far as a step may is cut [-].
const TOO_FAR: f64 = 2.0;

/// What is asked of a step.
#[derive(Clone, Copy)]
struct Asked {
    /// What joints carry at its end.
    reactions: bool,
    /// It may be undone, to be done in two.
    may_cut: bool,
}

/// Length at which torques count as forces, as a share of the body's longest side.
const ARM: f64 = 0.2;

impl<R: Scalar> Simulation<R> {
    /// Force and torque that every joint passes on at the current time; zeros without two-way coupling.
    #[must_use]
    pub fn joint_reaction(&self) -> &[JointReaction] {
        self.coupled.as_ref().map_or(&[], |c| &c.reaction)
    }

    /// Unknowns of the skeleton: what its joints leave free.
    #[must_use]
    pub fn joint_unknowns(&self) -> usize {
        self.coupled.as_ref().map_or(0, |c| c.articulation.unknown_count())
    }

    /// Mass that projects to no bone, which the nearest joint got [kg]: staggered coupling only.
    #[must_use]
    pub fn unassigned_mass(&self) -> f64 {
        self.coupled.as_ref().and_then(|c| c.staggered.as_ref()).map_or(0.0, |s| s.unassigned)
    }

    /// How far the worst joint is beyond its limits [rad].
    #[must_use]
    pub fn limit_violation(&self) -> f64 {
        self.coupled.as_ref().map_or(0.0, |c| c.articulation.violation(&c.now.configuration))
    }

    /// Joints that leave their place under the joint above: the roots of a free skeleton.
    #[must_use]
    pub fn free_roots(&self) -> &[JointId] {
        let free =
            |c: &&CoupledState<R>| c.articulation.entries().iter().any(|e| e.kind == crate::rig::EntryKind::Place);
        self.coupled.as_deref().as_ref().copied().filter(free).map_or(&[], |c| &c.roots)
    }

    /// A clip's pose, its joints within their limits.
    pub(super) fn led_pose(&self, clip: Pose) -> Pose {
        let Some(c) = &self.coupled else { return clip };
        let (mut base, mut pose) = (Base::default(), Pose::default());
        c.articulation.base_into(&self.skeleton, &clip, &mut base);
        c.articulation.pose_into(&self.skeleton, &base, &c.articulation.configuration(&base), &mut pose);
        pose
    }

    /// The skeleton's unknowns as the clip has them at its start.
    pub(super) fn start_coupled(&mut self, clip: &Pose) {
        let Some(mut c) = self.coupled.take() else { return };
        c.articulation.base_into(&self.skeleton, clip, &mut c.base);
        c.now.configuration = c.articulation.configuration(&c.base);
        c.articulation.pose_into(&self.skeleton, &c.base, &c.now.configuration, &mut self.pose);
        let (pose, configuration) = (&self.pose, &c.now.configuration);
        c.articulation.deviation_into(&self.skeleton, pose, &c.base, configuration, &mut c.now.deviation);
        c.now.anchors.iter_mut().for_each(|a| *a = None);
        (c.now.turn_rate, c.now.speed) = (0.0, 0.0);
        c.now.previous.clear();
        c.now.pull.clear();
        c.stepper.forget();
        self.coupled = Some(c);
    }

    /// Pose that the clip's pose and the unknowns make.
    fn composed(&self, c: &mut CoupledState<R>, clip: &Pose, pose: &mut Pose) {
        c.articulation.base_into(&self.skeleton, clip, &mut c.base);
        c.articulation.pose_into(&self.skeleton, &c.base, &c.now.configuration, pose);
    }

    pub(super) fn advance_coupled(
        &mut self,
        course: &mut Course,
        motion: &dyn Motion,
        time: f64,
    ) -> Result<FrameReport, StepError> {
        let Some(mut c) = self.coupled.take() else {
            return Err(StepError::Unsupported("advancing a coupling that is not set up".into()));
        };
        self.remember();
        c.pose_before.world.clone_from(&self.pose.world);
        c.before.copy(&c.now);
        let result = self.advance_coupled_by(&mut c, course, motion, time);
        if result.is_err() {
            self.go_back();
            std::mem::swap(&mut self.pose, &mut c.pose_before);
            std::mem::swap(&mut c.now, &mut c.before);
            c.stepper.forget();
        }
        self.coupled = Some(c);
        result
    }

    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to a small range before")]
    fn advance_coupled_by(
        &mut self,
        c: &mut CoupledState<R>,
        course: &mut Course,
        motion: &dyn Motion,
        time: f64,
    ) -> Result<FrameReport, StepError> {
        let t0 = self.state.time;
        let dt = time - t0;
        let mut report = FrameReport::default();
        motion.pose_into(time, &mut course.locals, &mut course.now);
        let mut end = std::mem::take(&mut course.end);
        self.composed(c, &course.now, &mut end);
        course.from.set(&self.skeleton, &self.binding, &self.pose);
        course.to.set(&self.skeleton, &self.binding, &end);
        let rest = &self.body.mesh.nodes;
        let moved = course.from.largest_move(&course.to, &self.binding, rest);
        if moved > TELEPORT_SHARE * self.size {
            let mut next = Pose::default();
            self.composed(c, &motion.pose(time + dt), &mut next);
            let next = course.to.largest_move(&self.drive(&next), &self.binding, rest);
            let around = self.last_move.map_or(next, |last| last.max(next));
            if moved > TELEPORT_RATIO * around {
                let mut after = Pose::default();
                self.composed(c, &motion.pose(time + START_LOOK), &mut after);
                self.carry_over(&course.from, &course.to, &self.drive(&after));
                self.composed(c, &course.now, &mut end);
                self.state.time = time;
                std::mem::swap(&mut self.pose, &mut end);
                course.end = end;
                self.last_move = None;
                (c.now.turn_rate, c.now.speed) = (0.0, 0.0);
                c.stepper.forget();
                report.teleported = true;
                return Ok(report);
            }
        }
        course.end = end;
        let by_turn = dt * c.now.turn_rate / LONGEST_TURN;
        let by_speed = dt * c.now.speed / (LONGEST_MOVE * self.size);
        let own = by_turn.max(by_speed).ceil().clamp(1.0, MOST_SUBSTEPS) as usize;
        let mut pieces = self.substeps(&course.from, &course.to, moved, dt).max(own);
        let mut s = 1;
        while s <= pieces {
            let t = if s < pieces { t0 + dt * s as f64 / pieces as f64 } else { time };
            motion.pose_into(t, &mut course.locals, &mut course.now);
            c.articulation.base_into(&self.skeleton, &course.now, &mut c.base);
            let stays = match c.staggered.take() {
                None => {
                    let may_cut = 2 * pieces <= MOST_SUBSTEPS as usize;
                    self.coupled_step(c, t, Asked { reactions: s == pieces, may_cut }, &mut report)?
                }
                Some(scheme) => {
                    let result = self.staggered_step(c, &scheme, t, &mut report);
                    c.staggered = Some(scheme);
                    result.map(|()| true)?
                }
            };
            if stays {
                (s, report.substeps) = (s + 1, report.substeps + 1);
            } else {
                // the first half of the same step
                (s, pieces) = (2 * s - 1, 2 * pieces);
            }
        }
        self.last_move = Some(moved);
        self.collect_reactions(c);
        course.to.set(&self.skeleton, &self.binding, &self.pose);
        self.collect_joint_force(&course.to);
        Ok(report)
    }

    /// One step, done again by implicit Euler where it gained more than physics can give. One that took bones much further than a step
    /// may, as no speed before it told, is undone where it may be cut: `false`.
    fn coupled_step(
        &mut self,
        c: &mut CoupledState<R>,
        t: f64,
        asked: Asked,
        report: &mut FrameReport,
    ) -> Result<bool, StepError> {
        let dt = t - self.state.time;
        self.forces(c, t, dt);
        let method = self.settings.dynamics.method::<R>();
        let least = self.settings.coupled_linearisations;
        let (mut scheme, mut linearisations) = (method.scheme, method.linearisations.max(least));
        c.step.state.copy(&self.state);
        c.step.pose.world.clone_from(&self.pose.world);
        c.before_step.copy(&c.now);
        let bound = self.bound(dt, c);
        let was = self.fastest();
        for attempt in 0..2 {
            let input = CoupledInput {
                skeleton: &self.skeleton,
                binding: &self.binding,
                articulation: &c.articulation,
                base: &c.base,
                leads: &c.leads,
                deviation: &c.before_step.deviation,
                pulls: &c.pulls,
                drags: &c.drags,
                external_force: &self.scratch.external_force,
                dt,
                tolerance: self.settings.tolerance,
                length: ARM * self.size,
                scheme,
                linearisations,
                reactions: asked.reactions,
            };
            let mut moving = Coupled {
                body: &mut self.body,
                state: &mut self.state,
                configuration: &mut c.now.configuration,
                pose: &mut self.pose,
            };
            let result = c.stepper.step(&mut moving, &mut *self.solver, &input, &mut self.output);
            let speed = self.fastest();
            let sane = speed <= bound || speed <= was;
            match result {
                Ok(()) if sane => break,
                Ok(()) if attempt == 1 => {
                    if speed > 1e3 * bound && speed > 2.0 * was {
                        return Err(StepError::Diverged { time: c.step.state.time, speed });
                    }
                    break;
                }
                Err(e) if attempt == 1 || matches!(e, StepError::Unsupported(_)) => return Err(e),
                done => {
                    self.undo_step(c, done.is_ok());
                    (scheme, linearisations) = (Scheme::ImplicitEuler, 3);
                    report.guarded_steps += 1;
                }
            }
        }
        c.step.from.set(&self.skeleton, &self.binding, &c.step.pose);
        c.step.to.set(&self.skeleton, &self.binding, &self.pose);
        c.now.turn_rate = c.step.from.largest_turn(&c.step.to) / dt;
        let at = |x: &[R; 3]| DVec3::from(x.map(Scalar::to_f64));
        let moved = self.state.position.iter().zip(&c.step.state.position).zip(&self.binding.bound);
        let moved = moved.filter(|(_, bound)| **bound).map(|((a, b), _)| at(a).distance(at(b)));
        c.now.speed = moved.fold(0.0, f64::max) / dt;
        let far = (c.now.turn_rate * dt / LONGEST_TURN).max(c.now.speed * dt / (LONGEST_MOVE * self.size));
        if asked.may_cut && far > TOO_FAR {
            self.undo_step(c, true);
            return Ok(false);
        }
        self.state.time = t;
        c.now.deviation.clear();
        c.now.deviation.extend_from_slice(c.stepper.deviation());
        report.add_step(&self.output);
        Ok(true)
    }

    /// Puts everything back to where the step began; `done` when it had succeeded.
    fn undo_step(&mut self, c: &mut CoupledState<R>, done: bool) {
        if done {
            self.body.model.roll_back();
        }
        self.state.copy(&c.step.state);
        self.pose.world.clone_from(&c.step.pose.world);
        c.now.copy(&c.before_step);
        c.stepper.forget();
    }

    /// Largest speed of a node [m/s], against the mean motion: a body that nobody holds may fly as fast as it likes.
    fn fastest(&self) -> f64 {
        let mut mean = DVec3::ZERO;
        let velocity = |n: usize| DVec3::from(self.state.velocity[n].map(Scalar::to_f64));
        let mut mass = 0.0;
        for (n, m) in self.body.mass.iter().enumerate() {
            mean += velocity(n) * m.to_f64();
            mass += m.to_f64();
        }
        mean /= mass.max(f64::MIN_POSITIVE);
        (0..self.body.mass.len()).map(|n| velocity(n).distance(mean)).fold(0.0, f64::max)
    }
}
