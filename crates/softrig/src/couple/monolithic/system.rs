//! The linear system of one linearisation, and the limits that hold in it.
//!
//! Limits hold by an active set: a limit that a correction would leave becomes a stiff spring to its end, and the correction is solved
//! for again; one that would have to pull lets go. What rounding leaves of a violation is cut off. Which limits will hold is
//! first found on the coarse space of the joints alone, which costs nothing and is mostly right.

use super::{Course, Lag, Monolithic};
use crate::body::Body;
use crate::couple::jacobian::Role;
use crate::couple::krylov::{Parts, Solved};
use crate::integrate::{StepError, StepSystem};
use crate::rig::Configuration;
use crate::rig::limited::{HOLD, hold, hold_matrix, reach, settle};
use glam::DVec3;
use softrig_linalg::{LinearSolver, LinearSystem, Scalar};

/// Rounds of the active set in one linearisation.
const ROUNDS: usize = 5;
/// Part of an unknown's own stiffness that is added to it, so that one that nothing resists stays where it is [-].
const SHIFT: f64 = 1e-7;
/// What making the lagging parts anew is worth, in iterations.
const RENEWAL: usize = 10;
/// Steps that differ by less than this share are the same to what lags behind [-]: frames end at rounded times.
const OTHER_STEP: f64 = 0.02;

impl Lag {
    fn is_stale(&self, dt: f64) -> bool {
        self.fresh.is_empty() || self.stale || (dt - self.dt).abs() > OTHER_STEP * self.dt
    }

    fn note(&mut self, linearisation: usize, iterations: usize) {
        if self.fresh.len() == linearisation {
            self.fresh.push(iterations);
        } else if let Some(fresh) = self.fresh.get(linearisation) {
            self.excess += iterations.saturating_sub(*fresh);
        }
        self.stale = self.excess > RENEWAL;
    }
}

impl<R: Scalar> Monolithic<R> {
    /// Solves for the corrections of nodes and joints until what is left is at most `target` [N].
    pub(super) fn correct(
        &mut self,
        body: &mut Body<R>,
        solver: &mut dyn LinearSolver<R>,
        course: &Course<'_, R>,
        configuration: &Configuration,
        target: f64,
        linearisation: usize,
    ) -> Result<Solved, StepError> {
        let (input, h, time) = (course.input, course.input.dt, course.state.time);
        let solve_error = |source| StepError::Solve { time, source };
        let bones = self.motions.len();
        let renew = self.lag.is_stale(h) || !self.coarse.fits(bones);
        if renew {
            solver.forget();
            self.lag = Lag { dt: h, ..Lag::default() };
        }
        let matrix = self.matrix.as_mut().expect("prepare made it");
        let mut system = StepSystem::new(body, (1.0 / h, course.c.acceleration[0]), matrix, self.cubes.as_mut());
        let mut preconditioner = solver.preconditioner();
        if let Some(cycle) = &mut preconditioner {
            cycle.load(&mut system).map_err(solve_error)?;
        }
        self.exact.load(&mut system);
        self.light.load(&mut system);
        if preconditioner.is_none() || renew {
            let stored = system.assembled();
            if preconditioner.is_none() {
                self.krylov.load_diagonal(stored, &self.role);
            }
            if renew {
                self.coarse.renew(&self.nodes, input.binding, &self.role, stored, &self.shift);
            }
        }
        self.coarse.turn(&self.nodes);
        self.joint_matrices(course);
        let count = input.articulation.unknown_count();
        let largest = (0..count).map(|i| self.dense.coarse[i * count + i]).fold(0.0, f64::max);
        input.articulation.limits_into(input.skeleton, &self.pose, configuration, &mut self.limits);
        self.krylov.start(self.now.len(), count, bones);
        self.foresee_limits(course);
        self.limit_torque.clear();
        self.limit_torque.resize(count, 0.0);
        let mut total = Solved { iterations: 0, residual: 0.0, converged: true };
        let stiffness = HOLD * largest;
        self.dense.rhs.clone_from(&self.rhs.joint);
        for round in 0..ROUNDS {
            let dense = &mut self.dense;
            dense.held.clone_from(&dense.own);
            dense.coarse_held.clone_from(&dense.coarse);
            self.rhs.joint.clone_from(&dense.rhs);
            dense.spare.clear();
            dense.spare.resize(count, 0.0);
            for (limit, _) in self.limits.iter().zip(&self.active).filter(|(_, on)| **on) {
                hold(limit, stiffness, count, &mut dense.held, &mut self.rhs.joint);
                hold_matrix(limit, stiffness, count, &mut dense.coarse_held);
                // start where the limit holds already
                let square: f64 = limit.normal.iter().map(|v| v * v).sum();
                let off = (limit.gap - reach(limit, &self.krylov.x.joint) - reach(limit, &dense.spare)) / square;
                (0..limit.count).for_each(|i| dense.spare[limit.first + i] += off * limit.normal[i]);
            }
            dense.factor.factorise(count, &dense.coarse_held);
            let mut parts = Parts {
                exact: &mut self.exact,
                light: &mut self.light,
                preconditioner: preconditioner.as_deref_mut().map(|p| p as _),
                binding: input.binding,
                role: &self.role,
                nodes: &mut self.nodes,
                joints: &self.joints,
                along: &self.coarse.along,
                between: &self.coarse.between,
                shift: &self.shift,
                springs: &self.pulls,
                joint_matrix: &dense.held,
                coarse: &dense.factor,
            };
            if dense.spare.iter().any(|v| *v != 0.0) {
                self.krylov.turn(&parts, &dense.spare);
            }
            let solved = self.krylov.solve(&mut parts, &self.rhs, target, input.length);
            if !solved.residual.is_finite() {
                return Err(StepError::NotFinite { time, what: "force", node: 0 });
            }
            total = Solved { iterations: total.iterations + solved.iterations, ..solved };
            if round == 0 {
                self.lag.note(linearisation, solved.iterations);
            }
            if !self.revise_limits(stiffness, 1e-3 * target * input.length, round + 2 < ROUNDS) {
                break;
            }
        }
        Ok(total)
    }

    /// What the joints resist by themselves, and what the coarse space of them feels of the flesh.
    fn joint_matrices(&mut self, course: &Course<'_, R>) {
        let (input, h) = (course.input, course.input.dt);
        let count = input.articulation.unknown_count();
        self.coarse.turn_matrix(&self.nodes);
        for p in &self.pulls {
            let (share, world) = (&self.coarse.share, &mut self.coarse.world);
            self.nodes.add_spring(input.binding, share, &p.nodes, p.effective, world);
        }
        let own = &mut self.dense.own;
        own.clear();
        own.resize(count * count, 0.0);
        for (i, lead) in input.leads.iter().enumerate() {
            own[i * count + i] += lead.stiffness + lead.damping / h;
        }
        for drag in input.drags {
            let at = DVec3::from(self.pose.joint(drag.joint).translation);
            let moved = self.joints.point(input.articulation, drag.joint, at);
            for (i, a) in &moved {
                moved.iter().for_each(|(j, b)| {
                    own[i * count + j] += (drag.stiffness + drag.damping / h) * a.dot(*b);
                });
            }
        }
        let coarse = &mut self.dense.coarse;
        coarse.clone_from(own);
        self.joints.reduce(&self.coarse.world, count, coarse);
        let largest = (0..count).map(|i| coarse[i * count + i]).fold(0.0, f64::max);
        for i in 0..count {
            let shift = SHIFT * coarse[i * count + i].max(1e-6 * largest);
            own[i * count + i] += shift;
            coarse[i * count + i] += shift;
        }
    }

    /// Limits that hold in the coarse problem.
    fn foresee_limits(&mut self, course: &Course<'_, R>) {
        let input = course.input;
        // g = r_q + Wᵀ r_f
        let (rhs, role) = (&self.rhs.node, &self.role);
        let force = |n: usize| (n, if role[n] == Role::Free { rhs[n].map(|v| v as f32) } else { [0.0; 3] });
        self.wrench.resize(input.binding.bones.len(), [0.0; 6]);
        self.coarse.along.gather(rhs.len(), force, &mut self.partial, &mut self.wrench);
        let g = &mut self.dense.spare;
        g.clone_from(&self.rhs.joint);
        self.joints.collect(&self.wrench, g);
        settle(&self.dense.coarse, g, &self.limits, &mut self.active, &mut self.settling);
    }

    /// Which limits would be left, and which would have to pull. Returns whether that changed anything.
    fn revise_limits(&mut self, stiffness: f64, least_torque: f64, may_let_go: bool) -> bool {
        let mut changed = false;
        self.limit_torque.fill(0.0);
        for (limit, on) in self.limits.iter().zip(&mut self.active) {
            let over = reach(limit, &self.krylov.x.joint) - limit.gap;
            if *on {
                let torque = -stiffness * over;
                if torque > least_torque && may_let_go {
                    (*on, changed) = (false, true);
                } else {
                    (0..limit.count).for_each(|i| self.limit_torque[limit.first + i] += torque * limit.normal[i]);
                }
            } else if over > 1e-9 {
                (*on, changed) = (true, true);
            }
        }
        changed
    }
}
