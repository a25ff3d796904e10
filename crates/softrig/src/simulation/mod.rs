//! A character's flesh, driven by its skeleton: place it, let it settle, advance it frame by frame.
//!
//! Bone-bound nodes are prescribed: at the end of every step they are exactly where their bones are [Georgii2010 §3.1].

mod advance;
mod checkpoint;
mod coupling;
mod drive;
mod event;
mod forces;
mod motion;
mod reaction;
mod settings;
mod setup;
mod skin;
mod staggered;
mod stiffen;
mod two_way;

pub use checkpoint::{Checkpoint, CheckpointError};
pub use coupling::{Coupling, JointReaction, TwoWay, TwoWayScheme, root_bones};
pub use event::{Action, Event, Key, along};
pub use motion::{ClipMotion, Motion, RestMotion};
pub use settings::{FrameReport, MultigridOptions, SimulationSettings, SolverKind, interpolations};
pub use setup::CoupleError;
pub use stiffen::stiffening;

use crate::body::{Body, BodyError};
use crate::character::Character;
use crate::couple::{BindError, Binding};
use crate::force::ElasticModel;
use crate::frame::Frame;
use crate::integrate::{Dynamics, Integrator, NodeFrame, Scheme, State, StepError, StepInput, StepOutput, implicit};
use crate::material::MaterialMap;
use crate::mesh::{self, VolumeMesh};
use crate::rig::{Pose, Skeleton, Transform};
use drive::Drive;
use glam::DVec3;
use skin::SkinCarrier;
use softrig_linalg::{DofConstraints, LinearSolver, Scalar};

/// Why a simulation cannot be set up.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum SetupError {
    /// Flesh and skeleton do not fit.
    #[error(transparent)]
    Bind(#[from] BindError),
    /// The body cannot be computed with.
    #[error(transparent)]
    Body(#[from] BodyError),
    /// The linear solver cannot hold the system.
    #[error(transparent)]
    Solve(#[from] softrig_linalg::SolveError),
    /// The volume mesh cannot carry the skin.
    #[error(transparent)]
    Mesh(#[from] mesh::MeshError),
}

/// Flesh on a skeleton. Parts are public: read or replace them between frames.
pub struct Simulation<R> {
    /// The skeleton that drives it.
    pub skeleton: Skeleton,
    /// The flesh.
    pub body: Body<R>,
    /// Which nodes hang on which bones.
    pub binding: Binding,
    /// Motion of the nodes.
    pub state: State<R>,
    /// How it is computed.
    pub settings: SimulationSettings,
    integrator: Box<dyn Integrator<R>>,
    /// The integrator also settles the flesh; otherwise implicit Euler does.
    settles_itself: bool,
    solver: Box<dyn LinearSolver<R>>,
    skin: SkinCarrier,
    /// Of the character [m].
    height: f64,
    /// Longest side of the box around the rest shape [m]: what lengths are measured by, whichever way a character lies.
    size: f64,
    /// Pose realised at `state.time`.
    pose: Pose,
    output: StepOutput<R>,
    joint_force: Vec<[f64; 3]>,
    scratch: Scratch<R>,
    course: Course,
    /// Largest move of a bound node in the last frame [m]: tells a teleport from a fast motion.
    last_move: Option<f64>,
    /// What a coupled simulation knows besides.
    coupled: Option<Box<coupling::CoupledState<R>>>,
    /// Speed of sound in the stiffest flesh [m/s].
    wave_speed: f64,
}

/// The poses of a frame, kept for the next one.
#[derive(Default)]
struct Course {
    from: Drive,
    to: Drive,
    locals: Vec<Transform>,
    now: Pose,
    end: Pose,
}

struct Scratch<R> {
    /// State and history of the force model at the start of the frame, to go back to when a later step fails.
    before: State<R>,
    history: Vec<[R; 4]>,
    target_position: Vec<[R; 3]>,
    target_velocity: Vec<[R; 3]>,
    external_force: Vec<[R; 3]>,
    nodes: Vec<[f64; 3]>,
    /// Where skinning has the nodes now and at the end of the step, for integrators that want it.
    frames: [Vec<NodeFrame>; 2],
}

fn cast<R: Scalar>(v: [f64; 3]) -> [R; 3] {
    v.map(R::from_f64)
}

impl<R: Scalar> Simulation<R> {
    /// Sets up flesh around a character. The state is the rest shape; call [`Self::start`] before advancing.
    ///
    /// # Errors
    /// [`SetupError`] says what does not fit.
    pub fn new(
        character: &Character,
        mesh: VolumeMesh,
        binding: Binding,
        materials: &MaterialMap,
        settings: SimulationSettings,
    ) -> Result<Self, SetupError> {
        let constraints = DofConstraints::from_mask(binding.bound.clone());
        let skin = SkinCarrier::new(character, &mesh)?;
        let rest: Vec<[R; 3]> = mesh.nodes.iter().map(|p| cast(*p)).collect();
        let mut materials = materials.clone();
        if settings.dynamics == Dynamics::Paper {
            // the literal scheme is undamped
            materials.materials.iter_mut().for_each(|m| m.stiffness_damping = 0.0);
        }
        let square = |c: usize| materials.get(c).young_modulus / materials.get(c).density;
        let cells =
            if materials.of_cell.is_empty() && materials.stiffness_factor.is_empty() { 1 } else { mesh.cell_count() };
        let wave_speed = (0..cells.min(mesh.cell_count())).map(square).fold(0.0, f64::max).sqrt();
        let body = Body::new(mesh, &materials, ElasticModel::Corotated, constraints)?;
        let mut solver = settings.solver.build_with::<R>(&body.mesh, &settings.multigrid);
        solver.prepare(&body.pattern, &body.constraints)?;
        let zero = vec![[R::zero(); 3]; rest.len()];
        let pose = RestMotion(&character.skeleton).pose(0.0);
        Ok(Self {
            skeleton: character.skeleton.clone(),
            height: character.height(),
            size: body.mesh.bounds().map_or(0.0, |(lo, hi)| (0..3).map(|k| hi[k] - lo[k]).fold(0.0, f64::max)),
            integrator: settings.dynamics.integrator(),
            settles_itself: false,
            solver,
            skin,
            pose,
            output: StepOutput { reaction: zero.clone(), ..StepOutput::default() },
            joint_force: vec![[0.0; 3]; character.skeleton.joint_count()],
            course: Course::default(),
            scratch: Scratch {
                before: State::at_rest(Vec::new()),
                history: Vec::new(),
                target_position: rest.clone(),
                target_velocity: zero.clone(),
                external_force: zero,
                nodes: body.mesh.nodes.clone(),
                frames: [Vec::new(), Vec::new()],
            },
            state: State::at_rest(rest),
            body,
            binding,
            settings,
            last_move: None,
            coupled: None,
            wave_speed,
        })
    }

    /// Puts the flesh into the motion's first pose and lets it settle there, then gives it the speed of its bones, so that the
    /// first frame neither drops nor snaps.
    ///
    /// # Errors
    /// [`StepError`] when it cannot be settled; the state is then unchanged.
    pub fn start(&mut self, motion: &dyn Motion) -> Result<FrameReport, StepError> {
        if rayon::current_thread_index().is_none() {
            return rayon::scope(|_| self.start(motion));
        }
        let before = self.state.clone();
        let history = self.body.model.history();
        let mut pose = motion.pose(0.0);
        if self.coupled.is_some() {
            pose = self.led_pose(pose);
            self.solver.forget();
        }
        let drive = self.drive(&pose);
        let placed = self.placed(&drive);
        self.body.model.restore(&[]);
        self.state = State::at_rest(placed.iter().map(|p| cast(*p)).collect());
        self.reset_frames(&drive);
        let mut report = FrameReport::default();
        match self.settle(&drive, &mut report) {
            Ok(()) => {
                let next = self.led_pose(motion.pose(START_LOOK));
                self.move_with_bones(&placed, &self.drive(&next), START_LOOK);
                self.state.time = 0.0;
                self.pose = pose;
                self.last_move = None;
                self.start_coupled(&motion.pose(0.0));
                self.collect_joint_force(&drive);
                Ok(report)
            }
            Err(e) => {
                self.state = before;
                self.body.model.restore(&history);
                Err(e)
            }
        }
    }

    /// Puts every node where blended skinning has it at `time`, at rest: what the flesh looks like without physics.
    pub fn place(&mut self, motion: &dyn Motion, time: f64) {
        self.pose = motion.pose(time);
        let drive = self.drive(&self.pose);
        self.reset_frames(&drive);
        let placed = self.placed(&drive);
        self.state = State { time, ..State::at_rest(placed.iter().map(|p| cast(*p)).collect()) };
        self.body.model.restore(&[]);
        self.last_move = None;
    }

    /// Puts another method in the place of the implicit ones. It also settles the flesh, in short steps that lose a part of their speed.
    /// Call [`Self::start`] or [`Self::place`] before advancing.
    pub fn set_integrator(&mut self, integrator: Box<dyn Integrator<R>>) {
        self.integrator = integrator;
        self.settles_itself = true;
    }

    /// Where skinning has the nodes now.
    fn reset_frames(&mut self, drive: &Drive) {
        if self.integrator.is_carried() {
            drive.frames(&self.binding, &self.body.mesh.nodes, &mut self.scratch.frames[0]);
        }
    }

    /// Settling: implicit Euler with long steps from rest each time, so that what remains is the balance, not a swing.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a step count, bounded by the settings")]
    fn settle(&mut self, drive: &Drive, report: &mut FrameReport) -> Result<(), StepError> {
        if self.settles_itself {
            return self.settle_slowly(drive, report);
        }
        let steps = (self.settings.preroll / SETTLE_STEP).ceil().clamp(0.0, 1e4) as usize;
        let mut euler = implicit(Scheme::ImplicitEuler, 1);
        for k in 1..=steps {
            for v in [&mut self.state.velocity, &mut self.state.acceleration] {
                v.iter_mut().for_each(|v| *v = [R::zero(); 3]);
            }
            self.step(drive, SETTLE_STEP, Some(&mut *euler), k == steps, report)?;
        }
        Ok(())
    }

    /// Settling by the integrator itself.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a step count, bounded by the settings")]
    fn settle_slowly(&mut self, drive: &Drive, report: &mut FrameReport) -> Result<(), StepError> {
        let dt = self.settings.longest_step;
        let steps = (self.settings.preroll / dt).ceil().clamp(0.0, 1e5) as usize;
        for k in 1..=steps {
            self.step(drive, dt, None, k == steps, report)?;
            let kept = R::from_f64(SETTLE_KEPT.powf(60.0 * dt));
            self.state.velocity.iter_mut().for_each(|v| *v = v.map(|v| kept * v));
        }
        Ok(())
    }

    /// Gives every node the velocity of blended skinning over the next `dt` seconds.
    fn move_with_bones(&mut self, now: &[[f64; 3]], next: &Drive, dt: f64) {
        for (n, from) in now.iter().enumerate() {
            let to = next.node(&self.binding, n, self.body.mesh.nodes[n]);
            self.state.velocity[n] = cast(std::array::from_fn(|k| (to[k] - from[k]) / dt));
            self.state.acceleration[n] = [R::zero(); 3];
        }
    }

    fn drive(&self, pose: &Pose) -> Drive {
        Drive::new(&self.skeleton, &self.binding, pose)
    }

    fn placed(&self, drive: &Drive) -> Vec<[f64; 3]> {
        self.body.mesh.nodes.iter().enumerate().map(|(n, p)| drive.node(&self.binding, n, *p)).collect()
    }

    /// One step to the pose of `drive`; `reactions` for [`Self::collect_joint_force`] after it.
    fn step(
        &mut self,
        drive: &Drive,
        dt: f64,
        integrator: Option<&mut dyn Integrator<R>>,
        reactions: bool,
        report: &mut FrameReport,
    ) -> Result<(), StepError> {
        self.set_targets(drive, dt);
        self.external_force(drive);
        let carried = integrator.is_none() && self.integrator.is_carried();
        if carried {
            let [now, next] = &mut self.scratch.frames;
            drive.frames(&self.binding, &self.body.mesh.nodes, next);
            self.integrator.carry(now, next);
        }
        self.integrate(dt, integrator, reactions, report)?;
        if carried {
            self.scratch.frames.swap(0, 1);
        }
        Ok(())
    }

    /// Where bound nodes are at the end of a step, and how fast they get there.
    fn set_targets(&mut self, drive: &Drive, dt: f64) {
        let rest = &self.body.mesh.nodes;
        let inverse_dt = R::from_f64(1.0 / dt);
        for n in (0..rest.len()).filter(|n| self.binding.bound[*n]) {
            let target: [R; 3] = cast(drive.node(&self.binding, n, rest[n]));
            let x = self.state.position[n];
            self.scratch.target_position[n] = target;
            self.scratch.target_velocity[n] = std::array::from_fn(|k| (target[k] - x[k]) * inverse_dt);
        }
    }

    /// One step of the flesh under the external forces and targets that are set.
    fn integrate(
        &mut self,
        dt: f64,
        integrator: Option<&mut dyn Integrator<R>>,
        reactions: bool,
        report: &mut FrameReport,
    ) -> Result<(), StepError> {
        let input = StepInput {
            target_position: &self.scratch.target_position,
            target_velocity: &self.scratch.target_velocity,
            external_force: &self.scratch.external_force,
            dt,
            tolerance: self.settings.tolerance,
            reactions,
        };
        let integrator: &mut dyn Integrator<R> = match integrator {
            Some(euler) => euler,
            None => &mut *self.integrator,
        };
        integrator.step(&mut self.body, &mut *self.solver, &input, &mut self.state, &mut self.output)?;
        report.add_step(&self.output);
        Ok(())
    }

    /// Gravity. Without sag the rest shape is taken as already in balance: only the change of gravity, seen from the turned
    /// flesh, acts.
    fn external_force(&mut self, drive: &Drive) {
        let g = DVec3::from(self.settings.gravity);
        for n in 0..self.body.mass.len() {
            let g = if self.settings.sag { g } else { g - drive.rotation(&self.binding, n) * g };
            let m = self.body.mass[n].to_f64();
            self.scratch.external_force[n] = cast((g * m).into());
        }
    }

    /// The pull of the flesh on each joint: minus what holds the bound nodes, plus their weight [Georgii2010 eq. 1].
    fn collect_joint_force(&mut self, drive: &Drive) {
        self.external_force(drive);
        self.joint_force.iter_mut().for_each(|f| *f = [0.0; 3]);
        for n in (0..self.binding.bound.len()).filter(|n| self.binding.bound[*n]) {
            for &(bone, w) in self.binding.blend(n) {
                let force = &mut self.joint_force[self.binding.joint(bone).index()];
                for k in 0..3 {
                    let pull = self.scratch.external_force[n][k].to_f64() - self.output.reaction[n][k].to_f64();
                    force[k] += w * pull;
                }
            }
        }
    }

    /// Puts something around the linear solver, to watch it at work.
    pub fn wrap_solver(&mut self, wrap: impl FnOnce(Box<dyn LinearSolver<R>>) -> Box<dyn LinearSolver<R>>) {
        let inner = std::mem::replace(&mut self.solver, Box::new(softrig_linalg::solver::Pcg::new()));
        self.solver = wrap(inner);
    }

    /// Pose of the skeleton at the current time.
    #[must_use]
    pub fn pose(&self) -> &Pose {
        &self.pose
    }

    /// Force of the flesh on each joint of the skeleton [N].
    #[must_use]
    pub fn joint_force(&self) -> &[[f64; 3]] {
        &self.joint_force
    }

    /// Largest distance between a bound node and its bones' frame, evaluated anew from the pose in f64 [m].
    #[must_use]
    pub fn attachment_gap(&self) -> f64 {
        let drive = self.drive(&self.pose);
        (0..self.binding.bound.len())
            .filter(|n| self.binding.bound[*n])
            .map(|n| {
                let target = drive.node(&self.binding, n, self.body.mesh.nodes[n]);
                DVec3::from(target).distance(DVec3::from(self.state.position[n].map(Scalar::to_f64)))
            })
            .fold(0.0, f64::max)
    }

    /// The current frame, with the skin carried to where the flesh is.
    pub fn frame(&mut self, index: usize) -> Frame<'_> {
        self.skin.carry(&self.state.position, &self.skeleton, &self.pose);
        for (to, from) in self.scratch.nodes.iter_mut().zip(&self.state.position) {
            *to = from.map(Scalar::to_f64);
        }
        Frame {
            index,
            time: self.state.time,
            skin: &self.skin.positions,
            pose: &self.pose,
            nodes: &self.scratch.nodes,
            joint_force: &self.joint_force,
        }
    }
}

/// Step of the settling [s]: long against the slowest swing of flesh, so that a handful of steps finds the balance.
const SETTLE_STEP: f64 = 0.05;
/// Part of its speed that flesh keeps per 1/60 s where its own method settles it [-]: drag of 13 /s, about critical for what swings
/// twice a second.
const SETTLE_KEPT: f64 = 0.8;
/// Over what time the speed of the bones at the start is measured [s].
const START_LOOK: f64 = 1.0 / 240.0;
