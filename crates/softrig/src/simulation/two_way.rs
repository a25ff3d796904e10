//! Advancing flesh and skeleton together.

use super::coupling::{CoupledState, Coupling, JointReaction, TwoWay, TwoWayScheme};
use super::drive::Drive;
use super::event::{Action, Event, along};
use super::staggered::Staggered;
use super::{Course, FrameReport, LONGEST_MOVE, LONGEST_TURN, MOST_SUBSTEPS, Motion, START_LOOK, Simulation};
use super::{TELEPORT_RATIO, TELEPORT_SHARE, cast};
use crate::couple::{Coupled, CoupledInput, JointSpring, PointSpring};
use crate::integrate::{Scheme, StepError};
use crate::rig::{Base, JointId, Pose, RigError};
use glam::{DQuat, DVec3};
use softrig_linalg::Scalar;

/// A dragged body as a whole swings this many times a second [1/s]: fast enough to follow a hand.
const DRAG_FREQUENCY: f64 = 3.0;
/// A spring pulls no harder than at this length, as a share of the height: a target out of reach must not tear.
const LONGEST_SPRING: f64 = 0.3;
/// Density of air [kg/m3].
const AIR: f64 = 1.2;
/// Length at which torques count as forces, as a share of the height.
const ARM: f64 = 0.2;

/// Why a coupling cannot be set up.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum CoupleError {
    /// The joints do not make sense.
    #[error(transparent)]
    Rig(#[from] RigError),
    /// An event does not make sense.
    #[error("event {number}: {reason}")]
    Event {
        /// Which one, from 1.
        number: usize,
        /// Why not, and what to change.
        reason: String,
    },
}

impl<R: Scalar> Simulation<R> {
    /// Sets who moves whom, and what happens on the way. Call it before [`Self::start`].
    ///
    /// # Errors
    /// [`CoupleError`]; nothing has changed then.
    pub fn couple(&mut self, coupling: &Coupling, events: Vec<Event>) -> Result<(), CoupleError> {
        if *coupling == Coupling::OneWay && events.is_empty() {
            self.coupled = None;
            return Ok(());
        }
        for (k, event) in events.iter().enumerate() {
            let wrong = |reason: String| CoupleError::Event { number: k + 1, reason };
            self.check_event(event, *coupling == Coupling::OneWay).map_err(wrong)?;
        }
        let state =
            CoupledState::new(&self.skeleton, &self.binding, &self.body.mesh, &self.body.mass, coupling, events)?;
        let mut state = state;
        if let Coupling::TwoWay(TwoWay { scheme: TwoWayScheme::Staggered, .. }) = coupling {
            state.staggered = Some(Staggered::new(self));
        }
        self.coupled = Some(Box::new(state));
        Ok(())
    }

    fn check_event(&self, event: &Event, one_way: bool) -> Result<(), String> {
        let number = |v: &f64| v.is_finite() && v.abs() < 1e6;
        if !(event.start.is_finite() && event.end > event.start) {
            return Err(format!("it lasts from {} s to {} s; it must end after it starts", event.start, event.end));
        }
        let path = |path: &[super::event::Key]| {
            if !path.iter().all(|k| number(&k.time) && k.position.iter().all(number)) {
                return Err("a key of its path is no number, or further than 1000 km".to_owned());
            }
            if path.windows(2).any(|w| w[1].time < w[0].time) {
                return Err("the keys of its path are not in the order of time".to_owned());
            }
            Ok(())
        };
        let spring = |s: &Option<f64>| match s {
            Some(s) if !(*s > 0.0 && *s <= 1e9) => Err(format!("its stiffness is {s} N/m; it must be above 0")),
            _ => Ok(()),
        };
        let point = |mesh: usize, vertex: usize| match self.skin.point(mesh, vertex) {
            Some(_) => Ok(()),
            None => Err(format!("vertex {vertex} of mesh {mesh} is not there, or no flesh carries it")),
        };
        match &event.action {
            Action::DragJoint { joint, path: keys, stiffness } => {
                if one_way {
                    return Err("it drags a joint, which the clip alone moves; make the coupling two-way".into());
                }
                if joint.index() >= self.skeleton.joint_count() {
                    return Err(format!("there is no joint {}", joint.0));
                }
                path(keys).and(spring(stiffness))
            }
            Action::PullFlesh { mesh, vertex, path: keys, stiffness } => {
                path(keys).and(spring(stiffness)).and(point(*mesh, *vertex))
            }
            Action::Force { mesh, vertex, force } => {
                if !force.iter().all(number) {
                    return Err("its force is no number, or above 1e6 N".into());
                }
                point(*mesh, *vertex)
            }
            Action::Gravity(v) | Action::Wind(v) => {
                if v.iter().all(number) {
                    Ok(())
                } else {
                    Err("its vector is no number, or above 1e6".into())
                }
            }
        }
    }

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
        let pose = self.pose.clone();
        c.before.clone_from(&c.now);
        let result = self.advance_coupled_by(&mut c, course, motion, time);
        if result.is_err() {
            self.go_back();
            self.pose = pose;
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
        if moved > TELEPORT_SHARE * self.height {
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
        let by_speed = dt * c.now.speed / (LONGEST_MOVE * self.height);
        let own = by_turn.max(by_speed).ceil().clamp(1.0, MOST_SUBSTEPS) as usize;
        report.substeps = self.substeps(&course.from, &course.to, moved, dt).max(own);
        for s in 1..=report.substeps {
            let t = if s < report.substeps { t0 + dt * s as f64 / report.substeps as f64 } else { time };
            motion.pose_into(t, &mut course.locals, &mut course.now);
            c.articulation.base_into(&self.skeleton, &course.now, &mut c.base);
            match c.staggered.take() {
                None => self.coupled_step(c, t, &mut report)?,
                Some(scheme) => {
                    let result = self.staggered_step(c, &scheme, t, &mut report);
                    c.staggered = Some(scheme);
                    result?;
                }
            }
        }
        self.last_move = Some(moved);
        if c.staggered.is_none() {
            self.collect_reactions(c);
        }
        course.to.set(&self.skeleton, &self.binding, &self.pose);
        self.collect_joint_force(&course.to);
        Ok(report)
    }

    /// One step, done again by implicit Euler where it gained more than physics can give.
    fn coupled_step(&mut self, c: &mut CoupledState<R>, t: f64, report: &mut FrameReport) -> Result<(), StepError> {
        let dt = t - self.state.time;
        let (pulls, drags) = self.forces(c, t, dt);
        let method = self.settings.dynamics.method::<R>();
        let (mut scheme, mut linearisations) = (method.scheme, method.linearisations.max(2));
        let before = self.state.clone();
        let pose = self.pose.clone();
        c.before_step.clone_from(&c.now);
        let bound = self.bound(&pulls, &drags, dt, c);
        let was = self.fastest();
        for attempt in 0..2 {
            let input = CoupledInput {
                skeleton: &self.skeleton,
                binding: &self.binding,
                articulation: &c.articulation,
                base: &c.base,
                leads: &c.leads,
                deviation: &c.before_step.deviation,
                pulls: &pulls,
                drags: &drags,
                external_force: &self.scratch.external_force,
                dt,
                tolerance: self.settings.tolerance,
                length: ARM * self.height,
                scheme,
                linearisations,
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
                        return Err(StepError::Diverged { time: before.time, speed });
                    }
                    break;
                }
                Err(e) if attempt == 1 || matches!(e, StepError::Unsupported(_)) => return Err(e),
                done => {
                    if done.is_ok() {
                        self.body.model.roll_back();
                    }
                    self.state.clone_from(&before);
                    self.pose.clone_from(&pose);
                    c.now.clone_from(&c.before_step);
                    c.stepper.forget();
                    (scheme, linearisations) = (Scheme::ImplicitEuler, 3);
                    report.guarded_steps += 1;
                }
            }
        }
        self.state.time = t;
        c.now.deviation.clear();
        c.now.deviation.extend_from_slice(c.stepper.deviation());
        let turned = |a: &DQuat, b: &DQuat| 2.0 * a.dot(*b).abs().min(1.0).acos();
        let (from, to) = (self.drive(&pose), self.drive(&self.pose));
        let rotation =
            |d: &Drive| -> Vec<DQuat> { d.motions.iter().map(|m| DQuat::from_array(m.rotation())).collect() };
        let turn = rotation(&from).iter().zip(&rotation(&to)).map(|(a, b)| turned(a, b)).fold(0.0, f64::max);
        c.now.turn_rate = turn / dt;
        let bound_speed = (0..before.position.len()).filter(|n| self.binding.bound[*n]).map(|n| {
            let [a, b] = [&before, &self.state].map(|s| DVec3::from(s.position[n].map(Scalar::to_f64)));
            a.distance(b)
        });
        c.now.speed = bound_speed.fold(0.0, f64::max) / dt;
        report.add_step(&self.output);
        Ok(())
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

    /// The fastest that forces, falls and drags can make a node [m/s].
    fn bound(&self, pulls: &[PointSpring], drags: &[JointSpring], dt: f64, c: &CoupledState<R>) -> f64 {
        let length = |v: [f64; 3]| DVec3::from(v).length();
        let mut acceleration = 9.81f64;
        let mut force = 0.0;
        for (f, m) in self.scratch.external_force.iter().zip(&self.body.mass).filter(|(_, m)| m.to_f64() > 0.0) {
            acceleration = acceleration.max(length(f.map(Scalar::to_f64)) / m.to_f64());
        }
        let mut hand = 0.0f64;
        for p in pulls {
            force += p.stiffness * LONGEST_SPRING * self.height;
            hand = hand.max(length(p.velocity));
        }
        for d in drags {
            force += d.stiffness * d.longest;
            hand = hand.max(length(d.velocity));
        }
        // what the clip alone does to joints that follow it
        let mut led = Pose::default();
        c.articulation.pose_into(&self.skeleton, &c.base, &c.now.configuration, &mut led);
        let bone = led
            .world
            .iter()
            .zip(&self.pose.world)
            .map(|(a, b)| DVec3::from(a.translation).distance(DVec3::from(b.translation)) / dt);
        let bone = bone.fold(0.0, f64::max);
        let fall = (acceleration + 20.0 * force / c.mass.max(f64::MIN_POSITIVE)) * self.height;
        3.0 * ((2.0 * fall).sqrt() + 2.0 * bone + hand)
    }

    /// Gravity, wind, set forces into the external forces; springs as they are in a step that ends at `t`.
    pub(super) fn forces(&mut self, c: &mut CoupledState<R>, t: f64, dt: f64) -> (Vec<PointSpring>, Vec<JointSpring>) {
        let gravity = self.settings.gravity;
        let mut wind = None;
        for event in c.events.iter().filter(|e| e.acts(t)) {
            match event.action {
                Action::Gravity(g) => self.settings.gravity = g,
                Action::Wind(v) => wind = Some(v),
                _ => {}
            }
        }
        let drive = self.drive(&self.pose);
        self.external_force(&drive);
        self.settings.gravity = gravity;
        if let Some(wind) = wind {
            self.blow(c, wind);
        }
        let (mut pulls, mut drags) = (Vec::new(), Vec::new());
        let omega = std::f64::consts::TAU * DRAG_FREQUENCY;
        let longest = LONGEST_SPRING * self.height;
        for (event, anchor) in c.events.iter().zip(&mut c.now.anchors) {
            if !event.acts(t) {
                *anchor = None;
                continue;
            }
            let spring = |stiffness: &Option<f64>| {
                let stiffness = stiffness.unwrap_or(c.mass * omega * omega);
                (stiffness, 2.0 * (stiffness * c.mass).sqrt())
            };
            match &event.action {
                Action::DragJoint { joint, path, stiffness } => {
                    let at = *anchor.get_or_insert(self.pose.joint(*joint).translation);
                    let (target, velocity) = along(path, t).unwrap_or((at, [0.0; 3]));
                    let (stiffness, damping) = spring(stiffness);
                    drags.push(JointSpring { joint: *joint, target, velocity, stiffness, damping, longest });
                }
                Action::PullFlesh { mesh, vertex, path, stiffness } => {
                    let Some(nodes) = self.skin.point(*mesh, *vertex) else { continue };
                    let mut pull = PointSpring { nodes, ..PointSpring::default() };
                    let mut here = [0.0; 3];
                    for (n, w) in &pull.nodes {
                        (0..3).for_each(|k| here[k] += w * self.state.position[*n as usize][k].to_f64());
                    }
                    let at = *anchor.get_or_insert(here);
                    let (target, velocity) = along(path, t).unwrap_or((at, [0.0; 3]));
                    // no longer than it may be, seen from where the point is
                    let off: [f64; 3] = std::array::from_fn(|k| target[k] - here[k]);
                    let off = crate::couple::shortened(off, longest + dt * DVec3::from(velocity).length());
                    pull.target = std::array::from_fn(|k| here[k] + off[k]);
                    pull.velocity = velocity;
                    (pull.stiffness, pull.damping) = spring(stiffness);
                    pulls.push(pull);
                }
                Action::Force { mesh, vertex, force } => {
                    for (n, w) in self.skin.point(*mesh, *vertex).unwrap_or_default() {
                        let f = &mut self.scratch.external_force[n as usize];
                        (0..3).for_each(|k| f[k] = R::from_f64(f[k].to_f64() + w * force[k]));
                    }
                }
                Action::Gravity(_) | Action::Wind(_) => {}
            }
        }
        (pulls, drags)
    }

    /// Air presses on faces that it blows against: half its density times the square of its speed along their normal.
    fn blow(&mut self, c: &CoupledState<R>, wind: [f64; 3]) {
        let at = |n: u32| DVec3::from(self.state.position[n as usize].map(Scalar::to_f64));
        let velocity = |n: u32| DVec3::from(self.state.velocity[n as usize].map(Scalar::to_f64));
        let mut add = Vec::new();
        for t in &c.faces.triangles {
            let [p, q, r] = t.map(at);
            let area = (q - p).cross(r - p) * 0.5;
            let moving = t.map(velocity).iter().sum::<DVec3>() / 3.0;
            let Some(normal) = area.try_normalize() else { continue };
            let against = (DVec3::from(wind) - moving).dot(normal);
            if against < 0.0 {
                let force = area * (-0.5 * AIR * against * against / 3.0);
                t.iter().for_each(|n| add.push((*n, force)));
            }
        }
        for (n, f) in add {
            let to = &mut self.scratch.external_force[n as usize];
            *to = cast(std::array::from_fn(|k| to[k].to_f64() + f[k]));
        }
    }

    /// What every joint passes on: the load of all bones at and below it.
    fn collect_reactions(&self, c: &mut CoupledState<R>) {
        c.reaction.fill(JointReaction::default());
        let load = c.stepper.load();
        let place = |j: JointId| DVec3::from(self.pose.joint(j).translation);
        for n in (0..load.len()).filter(|n| self.binding.bound[*n]) {
            let (f, x) = (DVec3::from(load[n]), DVec3::from(self.state.position[n].map(Scalar::to_f64)));
            for &(bone, w) in self.binding.blend(n) {
                let joint = self.binding.joint(bone);
                add(&mut c.reaction[joint.index()], f * w, (x - place(joint)).cross(f * w));
            }
        }
        for &id in self.skeleton.order().iter().rev() {
            if let Some(p) = self.skeleton.joint(id).parent {
                let own = c.reaction[id.index()];
                let (f, t) = (DVec3::from(own.force), DVec3::from(own.torque));
                add(&mut c.reaction[p.index()], f, t + (place(id) - place(p)).cross(f));
            }
        }
    }
}

fn add(to: &mut JointReaction, force: DVec3, torque: DVec3) {
    to.force = (DVec3::from(to.force) + force).into();
    to.torque = (DVec3::from(to.torque) + torque).into();
}
