//! Advancing by one frame: cut into as many steps as its motion needs, jumps carried over, all or nothing.

use super::drive::Drive;
use super::{Course, FrameReport, Motion, START_LOOK, Simulation, cast};
use crate::integrate::StepError;
use glam::DVec3;
use softrig_linalg::Scalar;

/// A bone may turn this much in one step [rad]: a third of a right angle, which the rotations of cells follow safely.
pub(super) const LONGEST_TURN: f64 = 0.5;
/// A bound node may move this share of the body's longest side in one step.
pub(super) const LONGEST_MOVE: f64 = 0.1;
/// However fast the bones, a frame has at most this many steps.
pub(super) const MOST_SUBSTEPS: f64 = 64.0;
/// A jump is a teleport when it is this share of the body's longest side ...
pub(super) const TELEPORT_SHARE: f64 = 0.2;
/// ... and this many times the move of the frames before and after.
pub(super) const TELEPORT_RATIO: f64 = 8.0;

impl<R: Scalar> Simulation<R> {
    /// Advances to `time` [s], in as many steps as the motion needs. Called from a thread outside rayon's pool, it runs on one
    /// of the pool's: a step is hundreds of parallel loops, each of which would have to be handed over.
    ///
    /// # Errors
    /// [`StepError`]; the state is then that of the last frame.
    pub fn advance(&mut self, motion: &dyn Motion, time: f64) -> Result<FrameReport, StepError> {
        let t0 = self.state.time;
        let dt = time - t0;
        if !(dt > 0.0 && dt.is_finite()) {
            return Err(StepError::Unsupported(format!("a step from {t0} s to {time} s: time must advance")));
        }
        if rayon::current_thread_index().is_none() {
            return rayon::scope(|_| self.advance(motion, time));
        }
        // memory of the last frame: advancing takes none of its own
        let mut course = std::mem::take(&mut self.course);
        let result = match self.coupled {
            None => self.advance_along(&mut course, motion, time),
            Some(_) => self.advance_coupled(&mut course, motion, time),
        };
        self.course = course;
        result
    }

    fn advance_along(&mut self, c: &mut Course, motion: &dyn Motion, time: f64) -> Result<FrameReport, StepError> {
        let t0 = self.state.time;
        let dt = time - t0;
        let mut report = FrameReport::default();
        c.from.set(&self.skeleton, &self.binding, &self.pose);
        motion.pose_into(time, &mut c.locals, &mut c.end);
        c.to.set(&self.skeleton, &self.binding, &c.end);
        let rest = &self.body.mesh.nodes;
        let moved = c.from.largest_move(&c.to, &self.binding, rest);
        if moved > TELEPORT_SHARE * self.size {
            let next = c.to.largest_move(&self.drive(&motion.pose(time + dt)), &self.binding, rest);
            let around = self.last_move.map_or(next, |last| last.max(next));
            if moved > TELEPORT_RATIO * around {
                self.carry_over(&c.from, &c.to, &self.drive(&motion.pose(time + START_LOOK)));
                self.state.time = time;
                std::mem::swap(&mut self.pose, &mut c.end);
                self.last_move = None;
                self.collect_joint_force(&c.to);
                report.teleported = true;
                return Ok(report);
            }
        }
        report.substeps = self.substeps(&c.from, &c.to, moved, dt);
        self.remember();
        for s in 1..=report.substeps {
            let mut t = time;
            if s < report.substeps {
                t = t0 + dt * s as f64 / report.substeps as f64;
                motion.pose_into(t, &mut c.locals, &mut c.now);
                c.to.set(&self.skeleton, &self.binding, &c.now);
            } else {
                c.to.set(&self.skeleton, &self.binding, &c.end);
            }
            let step = t - self.state.time;
            if let Err(e) = self.step(&c.to, step, None, s == report.substeps, &mut report) {
                self.go_back();
                return Err(e);
            }
            self.state.time = t;
        }
        std::mem::swap(&mut self.pose, &mut c.end);
        self.last_move = Some(moved);
        self.collect_joint_force(&c.to);
        Ok(report)
    }

    /// Keeps the state for [`Self::go_back`], in memory that is there from the frame before.
    pub(super) fn remember(&mut self) {
        let (state, before) = (&self.state, &mut self.scratch.before);
        before.time = state.time;
        before.position.clone_from(&state.position);
        before.velocity.clone_from(&state.velocity);
        before.acceleration.clone_from(&state.acceleration);
        self.body.model.write_history(&mut self.scratch.history);
    }

    /// Puts the state of the last [`Self::remember`] back.
    pub(super) fn go_back(&mut self) {
        std::mem::swap(&mut self.state, &mut self.scratch.before);
        self.body.model.restore(&self.scratch.history);
        let drive = self.drive(&self.pose);
        self.reset_frames(&drive);
    }

    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to a small range before")]
    pub(super) fn substeps(&self, from: &Drive, to: &Drive, moved: f64, dt: f64) -> usize {
        let by_time = dt / self.settings.longest_step - 1e-6;
        let by_turn = from.largest_turn(to) / LONGEST_TURN;
        let by_move = moved / (LONGEST_MOVE * self.size);
        by_time.max(by_turn).max(by_move).ceil().clamp(1.0, MOST_SUBSTEPS) as usize
    }

    /// A jump that no flesh could follow: shape and strain are carried over to the new pose, speed is that of the bones there.
    pub(super) fn carry_over(&mut self, from: &Drive, to: &Drive, next: &Drive) {
        let rest = &self.body.mesh.nodes;
        let mut placed = Vec::with_capacity(rest.len());
        for n in 0..rest.len() {
            let (a, b) = (from.node(&self.binding, n, rest[n]), to.node(&self.binding, n, rest[n]));
            let turn = to.rotation(&self.binding, n) * from.rotation(&self.binding, n).conjugate();
            let offset = DVec3::from(self.state.position[n].map(Scalar::to_f64)) - DVec3::from(a);
            self.state.position[n] = cast((DVec3::from(b) + turn * offset).into());
            placed.push(b);
        }
        self.body.model.restore(&[]);
        self.reset_frames(to);
        self.move_with_bones(&placed, next, START_LOOK);
    }
}
