//! One implicit step of flesh and skeleton together: the unknowns are the free nodes and what the joints leave free.
//!
//! Bound nodes are functions of the joints, x_b = x_b(q), so the equations are those of the nodes, M a + C v + f_int = f_ext, projected:
//! free nodes one by one, bound ones by Jᵀ. Each linearisation solves for corrections of both (see `augmented`), turns the
//! joints, and puts bound nodes exactly where their bones are: bones are rigid and flesh is attached to rounding.
//!
//! Free nodes follow the scheme of the dynamics; bound nodes, whose paths limits and clips may bend sharply, implicit Euler,
//! v' = d/h and a' = (v' − v)/h, which no kink sets ringing. Damping acts on d/h everywhere, so that the system is symmetric.
//!
//! Limits hold by an active set: a limit that a correction would leave becomes a stiff spring to its end, and the correction is solved
//! for again; one that would have to pull lets go. What rounding leaves of a violation is cut off.
#![allow(non_snake_case, reason = "symbols of the time integration literature")]

use super::augmented::{Krylov, Pair, Parts};
use super::binding::Binding;
use super::blend::BoneMotion;
use super::jacobian::{JointJacobian, NodeJacobian, Role};
use super::pull::{JointSpring, PointSpring, shortened};
use crate::body::Body;
use crate::character::bone_map;
use crate::force::Increment;
use crate::integrate::{Scheme, State, StepError, StepOutput, StepSystem};
use crate::rig::dense::Cholesky;
use crate::rig::limited::{HOLD, hold, reach};
use crate::rig::{Articulation, Base, Configuration, Limit, Pose, Skeleton};
use glam::DVec3;
use softrig_linalg::solver::Operator;
use softrig_linalg::{BlockCsr, BlockPattern, CubeMatrix, LinearSolver, LinearSystem, Scalar};
use std::sync::Arc;

/// A correction turns no joint further [rad]; then another linearisation follows.
const LONGEST_TURN: f64 = 0.5;
/// At most so many more linearisations than asked for.
const EXTRA: usize = 3;
/// Rounds of the active set in one linearisation.
const ROUNDS: usize = 5;
/// Part of an unknown's own stiffness that is added to it, so that one that nothing resists stays where it is [-].
const SHIFT: f64 = 1e-7;

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
    operator: Operator,
    nodes: NodeJacobian,
    joints: JointJacobian,
    krylov: Krylov,
    role: Vec<Role>,
    shift: Vec<f64>,
    rhs: Pair,
    wrench: Vec<[f64; 6]>,
    /// The bones' part of the system in their own axes, from some step before, with the dt it is for.
    bone_matrix: Vec<f64>,
    bone_matrix_dt: f64,
    bone_matrix_world: Vec<f64>,
    /// Iterations right after the lagging parts were made.
    fresh: Option<usize>,
    coarse: Cholesky,
    limits: Vec<Limit>,
    limit_torque: Vec<f64>,
    motions: Vec<BoneMotion>,
    pose: Pose,
    d: Vec<[R; 3]>,
    x: Vec<[R; 3]>,
    v: Vec<[R; 3]>,
    a: Vec<[R; 3]>,
    force: Vec<[R; 3]>,
    deviation: Vec<f64>,
    /// What is left for the bones to hold at each bound node at the end of the last step [N].
    load: Vec<[f64; 3]>,
}

/// v' = vd d + vv v + va a and a' = ad d + av v + aa a.
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

impl<R: Scalar> Monolithic<R> {
    /// Nothing is kept yet.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Drops what may lag behind, so that the next step depends on its arguments only.
    pub fn forget(&mut self) {
        self.fresh = None;
    }

    /// Torque of the limits on each unknown in the last step [N m].
    #[must_use]
    pub fn limit_torque(&self) -> &[f64] {
        &self.limit_torque
    }

    /// Force that bound flesh exerts on its bones at each node at the end of the last step [N]: weight, pulls and inertia
    /// included, zero on free nodes.
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
        let mut configuration = moving.configuration.clone();
        if let Err(e) = self.attempt(moving, solver, input, &mut configuration, output) {
            moving.body.model.roll_back();
            return Err(e);
        }
        *moving.configuration = configuration;
        std::mem::swap(moving.pose, &mut self.pose);
        let state = &mut *moving.state;
        std::mem::swap(&mut state.position, &mut self.x);
        std::mem::swap(&mut state.velocity, &mut self.v);
        std::mem::swap(&mut state.acceleration, &mut self.a);
        state.time += input.dt;
        Ok(())
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
        }
        let address = std::ptr::from_mut(solver).cast::<()>() as usize;
        if !self.prepared.as_ref().is_some_and(|p| Arc::ptr_eq(&p.0, &body.pattern) && p.1 == address) {
            solver.prepare(&body.pattern, &body.constraints).map_err(|source| StepError::Solve { time, source })?;
            self.prepared = Some((body.pattern.clone(), address));
            self.fresh = None;
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
        let (body, state) = (&mut *moving.body, &*moving.state);
        let (h, time) = (input.dt, state.time);
        let c = Constants::new(input.scheme, h);
        let n = body.mass.len();
        let count = input.articulation.unknown_count();
        let old: Vec<[f64; 3]> = state.position.iter().map(|p| p.map(Scalar::to_f64)).collect();
        let mut x = old.clone();
        self.shift.clear();
        self.shift.extend((0..n).map(|i| match self.role[i] {
            // the matrix has the free nodes' factor on the mass everywhere
            Role::Bound => (1.0 / (h * h) - c.acceleration[0]) * body.mass[i].to_f64(),
            _ => 0.0,
        }));
        let place = |drag: &JointSpring| DVec3::from(moving.pose.joint(drag.joint).translation);
        let start: Vec<DVec3> = input.drags.iter().map(place).collect();
        let mut pulls = input.pulls.to_vec();
        pulls.iter_mut().for_each(|p| p.effective = p.stiffness + p.damping / h);
        self.take_pose(body, input, configuration);
        self.put_bound(&mut x);
        (output.iterations, output.residual, output.converged) = (0, 0.0, true);
        let (mut first, mut asked_for) = (0.0f64, input.linearisations.max(1));
        let most = asked_for + EXTRA;
        let mut k = 0;
        while k < asked_for {
            // rotations: those of the start, then those of what has been found
            self.set_motion(h, &old, &x);
            if k == 0 {
                body.model.linearise(&state.position);
            } else {
                body.model.linearise(&self.x);
            }
            let at = if k == 0 { &state.position } else { &self.x };
            let displacement = (k == 0).then_some(&self.d[..]);
            let increment = Increment { displacement, velocity: Some(&self.v), damping: body.stiffness_damping };
            body.model.force(at, increment, &mut self.force);
            self.residual(body, state, input, &c, &old, &x, &pulls, &start, configuration);
            let norm = self.rhs.size(input.length);
            if k == 0 {
                first = norm;
            }
            // what a later linearisation corrects anyway needs half the digits
            let asked = if k + 1 == asked_for { input.tolerance } else { input.tolerance.sqrt() };
            let target = (asked * first.max(norm)).max(f64::MIN_POSITIVE).min(0.3 * norm.max(f64::MIN_POSITIVE));
            // the system
            let matrix = self.matrix.as_mut().expect("prepare made it");
            if self.bone_matrix_dt != h || self.bone_matrix.len() != (6 * self.motions.len()).pow(2) {
                self.fresh = None;
            }
            let renew = self.fresh.is_none();
            if renew {
                solver.forget();
            }
            let mut system = StepSystem::new(body, (1.0 / h, c.acceleration[0]), matrix, self.cubes.as_mut());
            let mut preconditioner = solver.preconditioner();
            let solve_error = |source| StepError::Solve { time, source };
            if let Some(cycle) = &mut preconditioner {
                cycle.load(&mut system).map_err(solve_error)?;
            }
            if self.operator.load(&mut system) || preconditioner.is_none() || renew {
                system.assembled();
            }
            let stored = self.matrix.as_ref().expect("prepare made it");
            if preconditioner.is_none() {
                self.krylov.load_diagonal(stored);
            }
            if renew {
                self.bone_matrix_dt = h;
                self.nodes.bone_matrix(input.binding, &self.role, stored, &self.shift, &mut self.bone_matrix);
            }
            self.bone_matrix_world.clone_from(&self.bone_matrix);
            self.nodes.turn_blocks(&mut self.bone_matrix_world, false);
            for p in &pulls {
                let world = &mut self.bone_matrix_world;
                self.nodes.add_spring(input.binding, &self.role, &p.nodes, p.effective, world);
            }
            // Q: what the joints resist by themselves
            let mut joint_matrix = vec![0.0; count * count];
            for (i, lead) in input.leads.iter().enumerate() {
                joint_matrix[i * count + i] += lead.stiffness + lead.damping / h;
            }
            for drag in input.drags {
                let at = DVec3::from(self.pose.joint(drag.joint).translation);
                let moved = self.joints.point(input.articulation, drag.joint, at);
                for (i, a) in &moved {
                    moved.iter().for_each(|(j, b)| {
                        joint_matrix[i * count + j] += (drag.stiffness + drag.damping / h) * a.dot(*b)
                    });
                }
            }
            let mut coarse = joint_matrix.clone();
            self.joints.reduce(&self.bone_matrix_world, count, &mut coarse);
            let largest = (0..count).map(|i| coarse[i * count + i]).fold(0.0, f64::max);
            for i in 0..count {
                let own = SHIFT * coarse[i * count + i].max(1e-6 * largest);
                joint_matrix[i * count + i] += own;
                coarse[i * count + i] += own;
            }
            // limits: those reached already hold until they would have to pull
            input.articulation.limits_into(input.skeleton, &self.pose, configuration, &mut self.limits);
            let mut active: Vec<bool> = self.limits.iter().map(|l| l.gap <= 1e-9).collect();
            self.krylov.start(n, count, self.motions.len());
            self.limit_torque.clear();
            self.limit_torque.resize(count, 0.0);
            for round in 0..ROUNDS {
                let (mut held, mut coarse_held) = (joint_matrix.clone(), coarse.clone());
                let mut rhs = std::mem::take(&mut self.rhs);
                let free_rhs = rhs.joint.clone();
                let stiffness = HOLD * largest;
                for (limit, _) in self.limits.iter().zip(&active).filter(|(_, on)| **on) {
                    let mut ignored = vec![0.0; count];
                    hold(limit, stiffness, count, &mut held, &mut rhs.joint);
                    hold(limit, stiffness, count, &mut coarse_held, &mut ignored);
                    // start where the limit holds already
                    let square: f64 = limit.normal.iter().map(|v| v * v).sum();
                    let off = (limit.gap - reach(limit, &self.krylov.x.joint)) / square;
                    (0..limit.count).for_each(|i| self.krylov.x.joint[limit.first + i] += off * limit.normal[i]);
                }
                self.coarse.factorise(count, &coarse_held);
                let mut parts = Parts {
                    operator: &mut self.operator,
                    stored,
                    preconditioner: preconditioner.as_deref_mut().map(|p| p as _),
                    binding: input.binding,
                    role: &self.role,
                    nodes: &mut self.nodes,
                    joints: &self.joints,
                    shift: &self.shift,
                    springs: &pulls,
                    joint_matrix: &held,
                    coarse: &self.coarse,
                };
                let solved = self.krylov.solve(&mut parts, &rhs, target, input.length);
                if !solved.residual.is_finite() {
                    return Err(StepError::NotFinite { time, what: "force", node: 0 });
                }
                output.iterations += solved.iterations;
                output.residual = if first > 0.0 { solved.residual / first } else { 0.0 };
                output.converged = solved.converged;
                rhs.joint = free_rhs;
                self.rhs = rhs;
                if round == 0 {
                    let fresh = *self.fresh.get_or_insert(solved.iterations.max(1));
                    if solved.iterations > fresh + fresh / 2 + 4 {
                        self.fresh = None;
                    }
                }
                // which limits would be left, and which would have to pull
                let mut changed = false;
                self.limit_torque.fill(0.0);
                for (limit, on) in self.limits.iter().zip(&mut active) {
                    let over = reach(limit, &self.krylov.x.joint) - limit.gap;
                    if *on {
                        let torque = -stiffness * over;
                        if torque > 1e-3 * target * input.length && round + 2 < ROUNDS {
                            (*on, changed) = (false, true);
                        } else {
                            (0..limit.count)
                                .for_each(|i| self.limit_torque[limit.first + i] += torque * limit.normal[i]);
                        }
                    } else if over > 1e-9 {
                        (*on, changed) = (true, true);
                    }
                }
                if !changed {
                    break;
                }
            }
            // a correction too long to be trusted is shortened, and looked at once more
            let longest = input.articulation.entries().iter().filter(|e| e.kind != crate::rig::EntryKind::Place);
            let longest = longest.flat_map(|e| e.first..e.first + e.count());
            let longest = longest.map(|i| self.krylov.x.joint[i].abs()).fold(0.0, f64::max);
            if !longest.is_finite() {
                return Err(StepError::NotFinite { time, what: "joint angle", node: 0 });
            }
            let scale = if longest > LONGEST_TURN { LONGEST_TURN / longest } else { 1.0 };
            if scale < 1.0 && asked_for < most {
                asked_for += 1;
            }
            self.apply(body, input, scale, configuration, &mut x);
            k += 1;
        }
        self.finish(body, state, (&c, h), &old, &x, output)?;
        let deviation = &mut self.deviation;
        input.articulation.deviation_into(input.skeleton, &self.pose, input.base, configuration, deviation);
        self.hold(body, state, input, &old, &x, &pulls);
        Ok(())
    }

    /// Puts bound nodes where their bones are.
    fn put_bound(&self, x: &mut [[f64; 3]]) {
        for (n, x) in x.iter_mut().enumerate().filter(|(n, _)| self.role[*n] == Role::Bound) {
            *x = self.nodes.placed[n];
        }
    }

    /// Displacement d and its velocity d/h in the numbers of the model.
    fn set_motion(&mut self, h: f64, old: &[[f64; 3]], x: &[[f64; 3]]) {
        for i in 0..x.len() {
            self.x[i] = x[i].map(R::from_f64);
            self.d[i] = std::array::from_fn(|k| R::from_f64(x[i][k] - old[i][k]));
            self.v[i] = std::array::from_fn(|k| R::from_f64((x[i][k] - old[i][k]) / h));
        }
    }

    /// r = f_ext − f_int − M a' − C d/h, free nodes as they are, bound ones through Jᵀ, with springs and leads.
    #[allow(clippy::too_many_arguments, reason = "the parts of one balance of forces")]
    fn residual(
        &mut self,
        body: &Body<R>,
        state: &State<R>,
        input: &CoupledInput<'_, R>,
        c: &Constants,
        old: &[[f64; 3]],
        x: &[[f64; 3]],
        pulls: &[PointSpring],
        start: &[DVec3],
        configuration: &Configuration,
    ) {
        let h = input.dt;
        let n = x.len();
        let count = input.articulation.unknown_count();
        self.rhs.resize(n, count);
        let mut all = vec![[0.0; 3]; n];
        let extra = body.mass_damping.to_f64();
        for i in (0..n).filter(|i| self.role[*i] != Role::Held) {
            let m = body.mass[i].to_f64();
            let drag = body.drag[i].to_f64() + extra * m;
            let (v, a) = (state.velocity[i].map(Scalar::to_f64), state.acceleration[i].map(Scalar::to_f64));
            for k in 0..3 {
                let d = x[i][k] - old[i][k];
                let inertia = match self.role[i] {
                    Role::Bound => (d / h - v[k]) / h,
                    _ => c.acceleration[0] * d + c.acceleration[1] * v[k] + c.acceleration[2] * a[k],
                };
                all[i][k] =
                    input.external_force[i][k].to_f64() - self.force[i][k].to_f64() - m * inertia - drag * d / h;
            }
        }
        for p in pulls {
            let (now, then) = (p.point(x), p.point(old));
            let f: [f64; 3] = std::array::from_fn(|k| {
                p.stiffness * (p.target[k] - now[k]) + p.damping * (p.velocity[k] - (now[k] - then[k]) / h)
            });
            for (i, w) in &p.nodes {
                (0..3).for_each(|k| all[*i as usize][k] += w * f[k]);
            }
        }
        self.wrench.resize(input.binding.bones.len(), [0.0; 6]);
        self.nodes.gather(input.binding, &self.role, Role::Bound, &all, &mut self.wrench);
        self.joints.collect(&self.wrench, &mut self.rhs.joint);
        for ((to, f), role) in self.rhs.node.iter_mut().zip(&all).zip(&self.role) {
            if *role == Role::Free {
                *to = *f;
            }
        }
        // toward the clip
        let deviation = &mut self.deviation;
        input.articulation.deviation_into(input.skeleton, &self.pose, input.base, configuration, deviation);
        for (i, lead) in input.leads.iter().enumerate() {
            let rate = (deviation[i] - input.deviation[i]) / h;
            self.rhs.joint[i] -= lead.stiffness * deviation[i] + lead.damping * rate;
        }
        for (drag, then) in input.drags.iter().zip(start) {
            let at = DVec3::from(self.pose.joint(drag.joint).translation);
            let pull = shortened((DVec3::from(drag.target) - at).into(), drag.longest);
            let f = DVec3::from(pull) * drag.stiffness + (DVec3::from(drag.velocity) - (at - *then) / h) * drag.damping;
            for (i, column) in self.joints.point(input.articulation, drag.joint, at) {
                self.rhs.joint[i] += column.dot(f);
            }
        }
    }

    /// Turns the joints by what was found and moves the flesh along.
    fn apply(
        &mut self,
        body: &Body<R>,
        input: &CoupledInput<'_, R>,
        scale: f64,
        configuration: &mut Configuration,
        x: &mut [[f64; 3]],
    ) {
        let found = &mut self.krylov.x;
        let joint: Vec<f64> = found.joint.iter().map(|q| q * scale).collect();
        if joint.is_empty() {
            for (x, d) in x.iter_mut().zip(&found.node) {
                (0..3).for_each(|k| x[k] += d[k]);
            }
            return;
        }
        // what flesh does besides following its bones is added to where they take it
        let mut twist = vec![[0.0; 6]; self.motions.len()];
        self.joints.twists(&found.joint, &mut twist);
        let mut along = vec![[0.0; 3]; x.len()];
        self.nodes.spread(input.binding, &self.role, Role::Free, &twist, &mut along);
        let before = self.nodes.placed.clone();
        input.articulation.advance(input.skeleton, &self.pose, &joint, configuration);
        input.articulation.clamp(configuration);
        self.take_pose(body, input, configuration);
        let placed = &self.nodes.placed;
        for (i, x) in x.iter_mut().enumerate().filter(|(i, _)| self.role[*i] == Role::Free) {
            let d = self.krylov.x.node[i];
            (0..3).for_each(|k| x[k] += scale * (d[k] - along[i][k]) + placed[i][k] - before[i][k]);
        }
        self.put_bound(x);
    }

    /// Velocities, accelerations, holding forces and energies at the end of the step.
    fn finish(
        &mut self,
        body: &mut Body<R>,
        state: &State<R>,
        (c, h): (&Constants, f64),
        old: &[[f64; 3]],
        x: &[[f64; 3]],
        output: &mut StepOutput<R>,
    ) -> Result<(), StepError> {
        let time = state.time;
        for i in 0..x.len() {
            self.x[i] = x[i].map(R::from_f64);
            for k in 0..3 {
                let d = x[i][k] - old[i][k];
                let (v, a) = (state.velocity[i][k].to_f64(), state.acceleration[i][k].to_f64());
                let of = |f: [f64; 3]| f[0] * d + f[1] * v + f[2] * a;
                let (v, a) = match self.role[i] {
                    Role::Free => (of(c.velocity), of(c.acceleration)),
                    Role::Bound => (d / h, 0.0),
                    Role::Held => (0.0, 0.0),
                };
                if !(x[i][k].is_finite() && v.is_finite()) {
                    return Err(StepError::NotFinite { time, what: "position", node: i });
                }
                (self.v[i][k], self.a[i][k]) = (R::from_f64(v), R::from_f64(a));
            }
        }
        body.model.linearise(&self.x);
        output.elastic_energy = body.model.force(&self.x, Increment::none(), &mut self.force);
        output.reaction.resize(x.len(), [R::zero(); 3]);
        output.kinetic_energy = 0.0;
        for i in 0..x.len() {
            output.reaction[i] = if self.role[i] == Role::Bound { self.force[i] } else { [R::zero(); 3] };
            let v = self.v[i].map(Scalar::to_f64);
            output.kinetic_energy += 0.5 * body.mass[i].to_f64() * (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
        }
        Ok(())
    }

    /// What bones hold at the end of the step.
    fn hold(
        &mut self,
        body: &Body<R>,
        state: &State<R>,
        input: &CoupledInput<'_, R>,
        old: &[[f64; 3]],
        x: &[[f64; 3]],
        pulls: &[PointSpring],
    ) {
        let h = input.dt;
        self.load.clear();
        self.load.resize(x.len(), [0.0; 3]);
        for i in (0..x.len()).filter(|i| self.role[*i] == Role::Bound) {
            let m = body.mass[i].to_f64();
            for k in 0..3 {
                let inertia = ((x[i][k] - old[i][k]) / h - state.velocity[i][k].to_f64()) / h;
                self.load[i][k] = input.external_force[i][k].to_f64() - self.force[i][k].to_f64() - m * inertia;
            }
        }
        for p in pulls {
            let (now, then) = (p.point(x), p.point(old));
            for (i, w) in p.nodes.iter().filter(|(i, _)| self.role[*i as usize] == Role::Bound) {
                for k in 0..3 {
                    let rate = (now[k] - then[k]) / h;
                    let f = p.stiffness * (p.target[k] - now[k]) + p.damping * (p.velocity[k] - rate);
                    self.load[*i as usize][k] += w * f;
                }
            }
        }
    }
}
