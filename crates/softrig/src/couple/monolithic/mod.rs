//! One implicit step of flesh and skeleton together: the unknowns are the free nodes and what the joints leave free.
//!
//! Bound nodes are functions of the joints, x_b = x_b(q), so the equations are those of the nodes, M a + C v + f_int = f_ext, projected:
//! free nodes one by one, bound ones by Jᵀ. Each linearisation solves for corrections of both (see `krylov`), turns the
//! joints, and puts bound nodes exactly where their bones are: bones are rigid and flesh is attached to rounding.
//!
//! Free nodes follow the scheme of the dynamics; bound nodes, whose paths limits and clips may bend sharply, implicit Euler,
//! v' = d/h and a' = (v' − v)/h, which no kink sets ringing. Damping acts on d/h everywhere, so that the system is symmetric.
//!
//! `balance` has what is left of the equations, `system` the linear system and its limits, `outcome` the end of the step, and
//! `momentum` what a body that nothing holds keeps exactly.
#![allow(non_snake_case, reason = "symbols of the time integration literature")]

mod balance;
mod momentum;
mod outcome;
mod system;

use super::binding::Binding;
use super::blend::BoneMotion;
use super::coarse::CoarseSpace;
use super::jacobian::{JointJacobian, NodeJacobian, Role};
use super::krylov::{Krylov, Pair};
use super::pull::{JointSpring, PointSpring};
use super::rows::Partial;
use crate::body::Body;
use crate::character::bone_map;
use crate::integrate::{Scheme, State, StepError, StepOutput};
use crate::rig::dense::Cholesky;
use crate::rig::limited::Settling;
use crate::rig::{Articulation, Base, Configuration, Limit, Pose, Skeleton};
use glam::DVec3;
use softrig_linalg::solver::Operator;
use softrig_linalg::{BlockCsr, BlockPattern, CubeMatrix, LinearSolver, Scalar};
use std::sync::Arc;

/// Nodes per task.
const CHUNK: usize = 1024;
/// At most so many more linearisations than asked for, for corrections too long to be trusted.
const EXTRA: usize = 3;

/// What leads one unknown toward the clip.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Lead {
    /// [N m/rad], [N/m] for places.
    pub stiffness: f64,
    /// [N m s/rad], [N s/m].
    pub damping: f64,
}

/// What drives one coupled step.
pub struct CoupledInput<'a, R> {
    /// The skeleton.
    pub skeleton: &'a Skeleton,
    /// Which nodes hang on which bones.
    pub binding: &'a Binding,
    /// What its joints can do.
    pub articulation: &'a Articulation,
    /// The clip's pose at the end of the step.
    pub base: &'a Base,
    /// One per unknown.
    pub leads: &'a [Lead],
    /// How far each unknown was from the clip at the start of the step.
    pub deviation: &'a [f64],
    /// Springs on the flesh.
    pub pulls: &'a [PointSpring],
    /// Springs on joints.
    pub drags: &'a [JointSpring],
    /// On each node [N].
    pub external_force: &'a [[R; 3]],
    /// Step length [s].
    pub dt: f64,
    /// As in [`crate::integrate::StepInput`].
    pub tolerance: f64,
    /// A length at which torques count as forces [m].
    pub length: f64,
    /// Time integration of free nodes.
    pub scheme: Scheme,
    /// How often it is linearised.
    pub linearisations: usize,
    /// Whether the forces that hold bound nodes are wanted: they cost one more evaluation of all cells.
    pub reactions: bool,
}

/// What moves in a coupled step.
pub struct Coupled<'a, R> {
    /// Flesh.
    pub body: &'a mut Body<R>,
    /// Its motion.
    pub state: &'a mut State<R>,
    /// The skeleton's unknowns.
    pub configuration: &'a mut Configuration,
    /// The skeleton's pose.
    pub pose: &'a mut Pose,
}

/// Owns the memory of the steps, and the part of the preconditioner that may lag behind.
#[derive(Default)]
pub struct Monolithic<R> {
    matrix: Option<BlockCsr<R>>,
    cubes: Option<CubeMatrix<R>>,
    prepared: Option<(Arc<BlockPattern>, usize)>,
    exact: Operator<f64>,
    light: Operator<f32>,
    nodes: NodeJacobian,
    joints: JointJacobian,
    coarse: CoarseSpace,
    lag: Lag,
    krylov: Krylov,
    role: Vec<Role>,
    /// Added to the diagonal of the system at each node: what bound nodes' own scheme makes of their mass.
    shift: Vec<f64>,
    rhs: Pair,
    wrench: Vec<[f64; 6]>,
    dense: Dense,
    limits: Vec<Limit>,
    active: Vec<bool>,
    settling: Settling,
    partial: Partial,
    limit_torque: Vec<f64>,
    motions: Vec<BoneMotion>,
    configuration: Configuration,
    pose: Pose,
    pulls: Vec<PointSpring>,
    /// Places of dragged joints at the start of the step.
    dragged: Vec<DVec3>,
    /// Positions at the start of the step and now.
    old: Vec<[f64; 3]>,
    now: Vec<[f64; 3]>,
    twist: Vec<[f64; 6]>,
    increment: Vec<f64>,
    force_sum: Vec<[f64; 3]>,
    d: Vec<[R; 3]>,
    x: Vec<[R; 3]>,
    v: Vec<[R; 3]>,
    a: Vec<[R; 3]>,
    force: Vec<[R; 3]>,
    deviation: Vec<f64>,
    /// What is left for the bones to hold at each bound node at the end of the last step with reactions [N].
    load: Vec<[f64; 3]>,
}

/// Small dense matrices of the joints, full rows.
#[derive(Default)]
struct Dense {
    /// What the joints resist by themselves, and with limits that hold.
    own: Vec<f64>,
    held: Vec<f64>,
    /// The coarse space's, likewise.
    coarse: Vec<f64>,
    coarse_held: Vec<f64>,
    factor: Cholesky,
    /// Right-hand side without limits, and a spare one.
    rhs: Vec<f64>,
    spare: Vec<f64>,
}

/// How far the lagging parts of the preconditioner lag behind.
#[derive(Default)]
struct Lag {
    /// Step length they are for [s].
    dt: f64,
    /// Iterations of the first solves after they were made, one per linearisation; empty when they have to be made.
    fresh: Vec<usize>,
    /// Iterations more than that since.
    excess: usize,
    stale: bool,
}

/// v' = vd d + vv v + va a and a' = ad d + av v + aa a.
#[derive(Clone, Copy)]
struct Constants {
    velocity: [f64; 3],
    acceleration: [f64; 3],
}

impl Constants {
    fn new(scheme: Scheme, h: f64) -> Self {
        match scheme {
            Scheme::Newmark { beta, gamma } => Self {
                velocity: [gamma / (beta * h), 1.0 - gamma / beta, h * (1.0 - gamma / (2.0 * beta))],
                acceleration: [1.0 / (beta * h * h), -1.0 / (beta * h), 1.0 - 1.0 / (2.0 * beta)],
            },
            Scheme::ImplicitEuler => {
                Self { velocity: [1.0 / h, 0.0, 0.0], acceleration: [1.0 / (h * h), -1.0 / h, 0.0] }
            }
        }
    }
}

/// What one step is computed from: its input, where it starts, and the scheme's constants.
struct Course<'a, R> {
    input: &'a CoupledInput<'a, R>,
    state: &'a State<R>,
    c: Constants,
}

impl<R: Scalar> Monolithic<R> {
    /// Nothing is kept yet.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Drops what may lag behind, so that the next step depends on its arguments only.
    pub fn forget(&mut self) {
        self.lag.fresh.clear();
    }

    /// Torque of the limits on each unknown in the last step [N m].
    #[must_use]
    pub fn limit_torque(&self) -> &[f64] {
        &self.limit_torque
    }

    /// Force that bound flesh exerts on its bones at each node at the end of the last step that was asked for reactions [N]:
    /// weight, pulls, damping and inertia included, zero on free nodes.
    #[must_use]
    pub fn load(&self) -> &[[f64; 3]] {
        &self.load
    }

    /// How far each unknown was from the clip at the end of the last step.
    #[must_use]
    pub fn deviation(&self) -> &[f64] {
        &self.deviation
    }

    /// One step. On `Err` nothing that moves has moved.
    ///
    /// # Errors
    /// [`StepError`].
    pub fn step(
        &mut self,
        moving: &mut Coupled<'_, R>,
        solver: &mut dyn LinearSolver<R>,
        input: &CoupledInput<'_, R>,
        output: &mut StepOutput<R>,
    ) -> Result<(), StepError> {
        if moving.body.consistent_mass.is_some() {
            return Err(StepError::Unsupported("two-way coupling of a body with consistent mass".into()));
        }
        if !(input.dt > 0.0 && input.dt.is_finite()) {
            return Err(StepError::Unsupported(format!("a time step of {} s; it must be positive", input.dt)));
        }
        self.prepare(moving.body, solver, input, moving.state.time)?;
        moving.body.model.save();
        output.guarded = false;
        let mut configuration = std::mem::take(&mut self.configuration);
        configuration.values.clone_from(&moving.configuration.values);
        let result = self.attempt(moving, solver, input, &mut configuration, output);
        if result.is_ok() {
            std::mem::swap(moving.configuration, &mut configuration);
            std::mem::swap(moving.pose, &mut self.pose);
            let state = &mut *moving.state;
            std::mem::swap(&mut state.position, &mut self.x);
            std::mem::swap(&mut state.velocity, &mut self.v);
            std::mem::swap(&mut state.acceleration, &mut self.a);
            state.time += input.dt;
        } else {
            moving.body.model.roll_back();
        }
        self.configuration = configuration;
        result
    }

    fn prepare(
        &mut self,
        body: &Body<R>,
        solver: &mut dyn LinearSolver<R>,
        input: &CoupledInput<'_, R>,
        time: f64,
    ) -> Result<(), StepError> {
        let n = body.mass.len();
        for v in [&mut self.d, &mut self.x, &mut self.v, &mut self.a, &mut self.force] {
            v.resize(n, [R::zero(); 3]);
        }
        if !self.matrix.as_ref().is_some_and(|m| Arc::ptr_eq(&m.pattern, &body.pattern)) {
            self.matrix = Some(BlockCsr { pattern: body.pattern.clone(), values: Vec::new() });
            self.cubes = body.model.cube_pattern().map(CubeMatrix::zero);
            (self.exact, self.light) = (Operator::default(), Operator::default());
        }
        let address = std::ptr::from_mut(solver).cast::<()>() as usize;
        if !self.prepared.as_ref().is_some_and(|p| Arc::ptr_eq(&p.0, &body.pattern) && p.1 == address) {
            solver.prepare(&body.pattern, &body.constraints).map_err(|source| StepError::Solve { time, source })?;
            self.prepared = Some((body.pattern.clone(), address));
            self.forget();
        }
        self.role.clear();
        self.role.extend((0..n).map(|i| match (body.mass[i] == R::zero(), input.binding.bound[i]) {
            (true, _) => Role::Held,
            (false, true) => Role::Bound,
            (false, false) => Role::Free,
        }));
        Ok(())
    }

    /// Takes the pose of a configuration: where bones and nodes are, and how they move.
    fn take_pose(&mut self, body: &Body<R>, input: &CoupledInput<'_, R>, configuration: &Configuration) {
        input.articulation.pose_into(input.skeleton, input.base, configuration, &mut self.pose);
        self.motions.clear();
        self.motions.extend(input.binding.bones.iter().map(|b| {
            let joint = input.skeleton.joint(b.joint);
            BoneMotion::new(&bone_map(joint, self.pose.joint(b.joint)), joint.rest.translation)
        }));
        self.nodes.set(input.binding, &self.motions, &self.pose, &body.mesh.nodes);
        self.joints.set(input.articulation, input.skeleton, input.binding, &self.pose);
    }

    fn attempt(
        &mut self,
        moving: &mut Coupled<'_, R>,
        solver: &mut dyn LinearSolver<R>,
        input: &CoupledInput<'_, R>,
        configuration: &mut Configuration,
        output: &mut StepOutput<R>,
    ) -> Result<(), StepError> {
        let body = &mut *moving.body;
        let course = Course { input, state: moving.state, c: Constants::new(input.scheme, input.dt) };
        let (h, time) = (input.dt, moving.state.time);
        let n = body.mass.len();
        self.old.clear();
        self.old.extend(course.state.position.iter().map(|p| p.map(Scalar::to_f64)));
        self.now.clone_from(&self.old);
        self.shift.clear();
        self.shift.extend((0..n).map(|i| match self.role[i] {
            // the matrix has the free nodes' factor on the mass everywhere
            Role::Bound => (1.0 / (h * h) - course.c.acceleration[0]) * body.mass[i].to_f64(),
            _ => 0.0,
        }));
        let place = |drag: &JointSpring| DVec3::from(moving.pose.joint(drag.joint).translation);
        self.dragged.clear();
        self.dragged.extend(input.drags.iter().map(place));
        self.pulls.clear();
        self.pulls.extend(input.pulls.iter().cloned());
        self.pulls.iter_mut().for_each(|p| p.effective = p.stiffness + p.damping / h);
        self.take_pose(body, input, configuration);
        self.put_bound();
        (output.iterations, output.residual, output.converged) = (0, 0.0, true);
        let (mut first, mut asked_for) = (0.0f64, input.linearisations.max(1));
        let most = asked_for + EXTRA;
        let mut k = 0;
        while k < asked_for {
            output.elastic_energy = self.balance(body, &course, configuration, k == 0);
            let norm = self.rhs.size(input.length);
            if k == 0 {
                first = norm;
            }
            // what a later linearisation corrects anyway needs half the digits
            let asked = if k + 1 == asked_for { input.tolerance } else { input.tolerance.sqrt() };
            let target = (asked * first.max(norm)).max(f64::MIN_POSITIVE).min(0.3 * norm.max(f64::MIN_POSITIVE));
            let solved = self.correct(body, solver, &course, configuration, target, k)?;
            output.iterations += solved.iterations;
            output.residual = if first > 0.0 { solved.residual / first } else { 0.0 };
            output.converged = solved.converged;
            // a correction too long to be trusted is shortened, and looked at once more
            let scale = self.trusted(input).ok_or(StepError::NotFinite { time, what: "joint angle", node: 0 })?;
            if scale < 1.0 && asked_for < most {
                asked_for += 1;
            }
            self.apply(body, input, scale, configuration);
            k += 1;
        }
        self.finish(body, &course, configuration, output)
    }
}
