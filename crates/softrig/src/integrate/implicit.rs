//! Implicit one-step schemes in displacement form: Newmark and implicit Euler are one routine with different constants.
//!
//! The unknown is d = x' − x. Velocity and acceleration at the end of the step are linear in it,
//!   v' = vd d + vv v + va a,   a' = ad d + av v + aa a,
//! so that each linearisation solves  (K + vd C + ad M) d = f_ext − f_int − C v' − M a'  for the correction of d, with
//! C = a M + b K. Later linearisations take their rotations at x + d [Newmark1959; Georgii2010 §3].
//!
//! Prescribed nodes are given d = target − x, v' = target velocity and a' = 0. The formulas above would make them ring:
//! v' = 2 V, 0, 2 V, 0 for a bone at constant speed V, and an acceleration that grows with every step.
#![allow(non_snake_case, reason = "symbols of the time integration literature")]

mod check;

pub(super) use check::finite;

use check::check;

use super::system::StepSystem;
use super::{Integrator, State, StepError, StepInput, StepOutput, earlier_tolerance};
use crate::body::Body;
use crate::force::Increment;
use rayon::prelude::*;
use softrig_linalg::par::Each;
use softrig_linalg::{BlockCsr, BlockPattern, CubeMatrix, DofConstraints, LinearSolver, Scalar, either, par};
use std::ops::Range;
use std::sync::Arc;

/// A time integration scheme.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Scheme {
    /// Newmark's family [Newmark1959]. beta 1/4, gamma 1/2 is second order and keeps the energy of a linear body; a gamma
    /// above 1/2 damps, and wants beta = (gamma + 1/2)² / 4.
    Newmark {
        /// Weight of the new acceleration in the position [-].
        beta: f64,
        /// Weight of the new acceleration in the velocity [-].
        gamma: f64,
    },
    /// Implicit Euler: first order, damps strongly, never unstable.
    ImplicitEuler,
}

/// v' = vd d + vv v + va a and a' = ad d + av v + aa a.
#[derive(Clone, Copy, Debug)]
struct Constants {
    vd: f64,
    vv: f64,
    va: f64,
    ad: f64,
    av: f64,
    aa: f64,
}

impl Scheme {
    fn constants(self, h: f64) -> Constants {
        match self {
            Self::Newmark { beta, gamma } => Constants {
                vd: gamma / (beta * h),
                vv: 1.0 - gamma / beta,
                va: h * (1.0 - gamma / (2.0 * beta)),
                ad: 1.0 / (beta * h * h),
                av: -1.0 / (beta * h),
                aa: 1.0 - 1.0 / (2.0 * beta),
            },
            Self::ImplicitEuler => {
                Constants { vd: 1.0 / h, vv: 0.0, va: 0.0, ad: 1.0 / (h * h), av: -1.0 / h, aa: 0.0 }
            }
        }
    }
}

/// One step by a [`Scheme`] with a number of linearisations. Owns the scratch memory of the step and nothing that matters to
/// the next one.
pub struct Implicit<R> {
    /// The scheme.
    pub scheme: Scheme,
    /// How often stiffness and rotations are computed anew in a step; at least 1.
    pub linearisations: usize,
    matrix: Option<BlockCsr<R>>,
    cubes: Option<CubeMatrix<R>>,
    prepared: Option<Prepared>,
    d: Vec<[R; 3]>,
    x: Vec<[R; 3]>,
    /// v', where flesh is damped.
    v: Vec<[R; 3]>,
    /// M a', where the mass is not lumped.
    inertia: Vec<[R; 3]>,
    rhs: Vec<[R; 3]>,
    correction: Vec<[R; 3]>,
    /// Displacements of free nodes that steps begin with; empty: none.
    pub(super) start: Vec<[R; 3]>,
}

/// What the solver's symbolic work was done for.
struct Prepared {
    pattern: Arc<BlockPattern>,
    constraints: DofConstraints,
    solver: usize,
}

/// [`Implicit`] behind its trait.
#[must_use]
pub fn implicit<R: Scalar>(scheme: Scheme, linearisations: usize) -> Box<dyn Integrator<R>> {
    either(|| single(scheme, linearisations), || double(scheme, linearisations))
}

fn single(scheme: Scheme, linearisations: usize) -> Box<dyn Integrator<f32>> {
    Box::new(Implicit::new(scheme, linearisations))
}

fn double(scheme: Scheme, linearisations: usize) -> Box<dyn Integrator<f64>> {
    Box::new(Implicit::new(scheme, linearisations))
}

impl<R: Scalar> Implicit<R> {
    /// A scheme with its number of linearisations per step (at least one is done).
    #[must_use]
    pub fn new(scheme: Scheme, linearisations: usize) -> Self {
        Self {
            scheme,
            linearisations,
            matrix: None,
            cubes: None,
            prepared: None,
            d: Vec::new(),
            x: Vec::new(),
            v: Vec::new(),
            inertia: Vec::new(),
            rhs: Vec::new(),
            correction: Vec::new(),
            start: Vec::new(),
        }
    }

    fn prepare(&mut self, body: &Body<R>, solver: &mut dyn LinearSolver<R>, time: f64) -> Result<(), StepError> {
        let n = body.mass.len();
        for v in [&mut self.d, &mut self.x, &mut self.rhs, &mut self.correction] {
            v.resize(n, [R::zero(); 3]);
        }
        if !self.matrix.as_ref().is_some_and(|m| Arc::ptr_eq(&m.pattern, &body.pattern)) {
            // assembled when a solver asks for it
            self.matrix = Some(BlockCsr { pattern: body.pattern.clone(), values: Vec::new() });
            self.cubes = None;
        }
        match body.model.cube_pattern().filter(|_| body.consistent_mass.is_none()) {
            None => self.cubes = None,
            Some(pattern) if self.cubes.as_ref().is_some_and(|c| Arc::ptr_eq(&c.pattern, &pattern)) => {}
            Some(pattern) => self.cubes = Some(CubeMatrix::zero(pattern)),
        }
        // a solver is told apart by its address: exchanging it between steps must not leave it unprepared
        let address = std::ptr::from_mut(solver).cast::<()>() as usize;
        let known = self.prepared.as_ref().is_some_and(|p| {
            Arc::ptr_eq(&p.pattern, &body.pattern) && p.constraints == body.constraints && p.solver == address
        });
        if !known {
            self.prepared = None;
            solver.prepare(&body.pattern, &body.constraints).map_err(|source| StepError::Solve { time, source })?;
            let (pattern, constraints) = (body.pattern.clone(), body.constraints.clone());
            self.prepared = Some(Prepared { pattern, constraints, solver: address });
        }
        Ok(())
    }

    /// Velocity and acceleration of a node at the end of the step, from its d.
    #[inline]
    fn motion(
        &self,
        body: &Body<R>,
        c: &Constants,
        input: &StepInput<'_, R>,
        state: &State<R>,
        i: usize,
    ) -> [[R; 3]; 2] {
        motion(body, c, input, i, [self.d[i], state.velocity[i], state.acceleration[i]])
    }

    /// Linearises at x, and writes f = f_int + K d + b K v' to the right-hand side, with d where `moved` says so. Returns the elastic energy.
    fn forces(
        &mut self,
        body: &mut Body<R>,
        c: &Constants,
        input: &StepInput<'_, R>,
        state: &State<R>,
        moved: bool,
    ) -> f64 {
        if body.is_damped() {
            let (mut v, still) = (std::mem::take(&mut self.v), &*body);
            v.resize(self.d.len(), [R::zero(); 3]);
            v.par_iter_mut().enumerate().with_min_len(par::CHUNK).each(|(i, v)| {
                *v = self.motion(still, c, input, state, i)[0];
            });
            self.v = v;
        }
        let increment = body.increment(moved.then_some(&self.d[..]), &self.v);
        body.model.linearise_and_force(&self.x, increment, &mut self.rhs)
    }

    /// Makes r = f_ext − f − M a' − a M v' of the f in the right-hand side on free nodes, zero on the others. Returns |r|.
    fn residual(&mut self, body: &Body<R>, c: &Constants, input: &StepInput<'_, R>, state: &State<R>) -> f64 {
        let mut rhs = std::mem::take(&mut self.rhs);
        if let Some(m) = &body.consistent_mass {
            let a: Vec<[R; 3]> = (0..self.d.len()).map(|i| self.motion(body, c, input, state, i)[1]).collect();
            self.inertia.resize(a.len(), [R::zero(); 3]);
            multiply(m, &a, &mut self.inertia);
        }
        rhs.par_iter_mut().enumerate().with_min_len(par::CHUNK).each(|(i, r)| {
            if body.constraints.is_constrained(i) {
                *r = [R::zero(); 3];
                return;
            }
            let drag = body.drag[i] + body.mass_damping * body.mass[i];
            let [v, a] = self.motion(body, c, input, state, i);
            let consistent = body.consistent_mass.is_some();
            let inertia = if consistent { self.inertia[i] } else { a.map(|a| a * body.mass[i]) };
            *r = std::array::from_fn(|k| input.external_force[i][k] - r[k] - inertia[k] - drag * v[k]);
        });
        let square = |range: Range<usize>| rhs[range].as_flattened().iter().map(|r| r.to_f64() * r.to_f64()).sum();
        let square = par::sum(rhs.len(), square);
        self.rhs = rhs;
        square.sqrt()
    }

    fn attempt(
        &mut self,
        body: &mut Body<R>,
        solver: &mut dyn LinearSolver<R>,
        input: &StepInput<'_, R>,
        state: &State<R>,
        output: &mut StepOutput<R>,
    ) -> Result<(), StepError> {
        let time = state.time;
        let c = self.scheme.constants(input.dt);
        let n = state.position.len();
        let (start, still) = (&self.start, &*body);
        let both = self.d.par_iter_mut().zip(&mut self.x).enumerate().with_min_len(par::CHUNK);
        both.each(|(i, (d, x))| {
            *d = start.get(i).copied().unwrap_or([R::zero(); 3]);
            if still.constraints.is_constrained(i) {
                *d = [R::zero(); 3];
            }
            if still.constraints.is_constrained(i) && !held(still, i) {
                *d = std::array::from_fn(|k| input.target_position[i][k] - state.position[i][k]);
            }
            *x = state.position[i];
        });
        (output.iterations, output.residual, output.converged) = (0, 0.0, true);
        let mut first = 0.0;
        for linearisation in 0..self.linearisations.max(1) {
            // d counts only while x does not contain it, and then only prescribed and linked nodes have one
            let moved = linearisation == 0 && par::first(n, |i| self.d[i] != [R::zero(); 3]).is_some();
            output.elastic_energy = self.forces(body, &c, input, state, moved);
            let norm = self.residual(body, &c, input, state);
            if linearisation == 0 {
                first = norm;
            }
            let last = linearisation + 1 == self.linearisations.max(1);
            let asked = if last { input.tolerance } else { earlier_tolerance(input.tolerance, linearisation) };
            self.correction.fill([R::zero(); 3]);
            // a hundredth of what may be left is not worth a solve
            if norm <= 0.01 * asked * first {
                output.residual = if first > 0.0 { norm / first } else { 0.0 };
            } else {
                // relative to the first right-hand side, but never looser than half a digit
                let ratio = if norm > 0.0 && norm < first { first / norm } else { 1.0 };
                let tolerance = (asked * ratio).min(asked.max(0.3));
                let matrix = self.matrix.as_mut().expect("prepare made it");
                // flesh goes on about as it moves; linked nodes start where their links want them
                let guess = (linearisation == 0 && self.start.is_empty()).then_some(&state.velocity[..]);
                let mut system = StepSystem::new(body, (c.vd, c.ad), matrix, self.cubes.as_mut()).with_guess(guess);
                let report = solver
                    .solve_system(&mut system, &self.rhs, &mut self.correction, tolerance)
                    .map_err(|source| StepError::Solve { time, source })?;
                output.iterations += report.iterations;
                output.residual = report.residual / ratio;
                output.converged = report.converged;
            }
            let (correction, still) = (&self.correction, &*body);
            let both = self.d.par_iter_mut().zip(&mut self.x).enumerate().with_min_len(par::CHUNK);
            both.each(|(i, (d, x))| {
                if !still.constraints.is_constrained(i) {
                    (0..3).for_each(|k| d[k] += correction[i][k]);
                }
                if !held(still, i) {
                    *x = std::array::from_fn(|k| state.position[i][k] + d[k]);
                }
                // prescribed nodes are exactly where they were asked to be
                if last && still.constraints.is_constrained(i) && !held(still, i) {
                    *x = input.target_position[i];
                }
            });
        }
        // the velocities wait where the correction was
        let (d, still) = (&self.d, &*body);
        self.correction.par_iter_mut().enumerate().with_min_len(par::CHUNK).each(|(i, v)| {
            [*v, _] = motion(still, &c, input, i, [d[i], state.velocity[i], state.acceleration[i]]);
        });
        finite("position", time, &self.x)?;
        finite("velocity", time, &self.correction)?;
        if input.reactions {
            output.reaction.clear();
            output.elastic_energy = body.model.linearise_and_force(&self.x, Increment::none(), &mut self.rhs);
            let on = |i: usize| if body.constraints.is_constrained(i) { self.rhs[i] } else { [R::zero(); 3] };
            output.reaction.extend((0..n).map(on));
        }
        Ok(())
    }
}

impl<R: Scalar> Integrator<R> for Implicit<R> {
    fn name(&self) -> &'static str {
        match self.scheme {
            Scheme::Newmark { .. } => "newmark",
            Scheme::ImplicitEuler => "implicit-euler",
        }
    }

    fn step(
        &mut self,
        body: &mut Body<R>,
        solver: &mut dyn LinearSolver<R>,
        input: &StepInput<'_, R>,
        state: &mut State<R>,
        output: &mut StepOutput<R>,
    ) -> Result<(), StepError> {
        check(body, self.scheme, input, state)?;
        self.prepare(body, solver, state.time)?;
        body.model.save();
        output.guarded = false;
        if let Err(e) = self.attempt(body, solver, input, state, output) {
            body.model.roll_back();
            return Err(e);
        }
        let c = self.scheme.constants(input.dt);
        let (d, still) = (&self.d, &*body);
        let (velocity, accelerations) = (&state.velocity, state.acceleration.par_iter_mut());
        accelerations.enumerate().with_min_len(par::CHUNK).each(|(i, a)| {
            [_, *a] = motion(still, &c, input, i, [d[i], velocity[i], *a]);
        });
        std::mem::swap(&mut state.velocity, &mut self.correction);
        std::mem::swap(&mut state.position, &mut self.x);
        state.time += input.dt;
        output.kinetic_energy = body.kinetic_energy(&state.velocity);
        Ok(())
    }
}

/// Velocity and acceleration of a node at the end of a step, from its d and what they were.
#[inline]
fn motion<R: Scalar>(
    body: &Body<R>,
    c: &Constants,
    input: &StepInput<'_, R>,
    i: usize,
    [d, v, a]: [[R; 3]; 3],
) -> [[R; 3]; 2] {
    let zero = [R::zero(); 3];
    if body.constraints.is_constrained(i) {
        return [if held(body, i) { zero } else { input.target_velocity[i] }, zero];
    }
    let [vd, vv, va, ad, av, aa] = [c.vd, c.vv, c.va, c.ad, c.av, c.aa].map(R::from_f64);
    [
        std::array::from_fn(|k| vd * d[k] + vv * v[k] + va * a[k]),
        std::array::from_fn(|k| ad * d[k] + av * v[k] + aa * a[k]),
    ]
}

/// A node without a cell: it has nothing to move it and stays.
fn held<R: Scalar>(body: &Body<R>, i: usize) -> bool {
    body.mass[i] == R::zero()
}

/// y = A x on all nodes.
fn multiply<R: Scalar>(A: &BlockCsr<R>, x: &[[R; 3]], y: &mut [[R; 3]]) {
    for (i, y) in y.iter_mut().enumerate() {
        *y = [R::zero(); 3];
        for k in A.pattern.row(i) {
            let (m, x) = (&A.values[k], x[A.pattern.column()[k] as usize]);
            (0..3).for_each(|r| y[r] += m[3 * r] * x[0] + m[3 * r + 1] * x[1] + m[3 * r + 2] * x[2]);
        }
    }
}
