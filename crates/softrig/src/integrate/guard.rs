//! The growth guard: a step that gains more than physics can give is done again with implicit Euler.
//!
//! The rotations of a corotated body lag behind its motion, which makes undamped second-order schemes gain energy: silently,
//! then explosively. What a body of size L and mass M can have at most: it may fall by its own size, M g L, and be swung by
//! bones of speed V to twice that speed, M (2 V)² / 2. Beyond twice the sum of both, and growing, it is not physics.

use super::{Implicit, Integrator, Scheme, State, StepError, StepInput, StepOutput};
use crate::body::Body;
use softrig_linalg::{LinearSolver, Scalar, par};

/// An [`Implicit`] method with implicit Euler to fall back on.
pub struct Guarded<R> {
    inner: Implicit<R>,
    before: State<R>,
}

/// Size of motion.
#[derive(Clone, Copy, Debug)]
struct Motion {
    /// Kinetic energy [J], relative to the mean motion where no node is prescribed.
    kinetic: f64,
    /// Largest speed of a free node [m/s], likewise.
    speed: f64,
}

impl<R: Scalar> Guarded<R> {
    /// Guards a method.
    #[must_use]
    pub fn new(inner: Implicit<R>) -> Self {
        Self { inner, before: State::default() }
    }

    /// The guarded method.
    pub(super) fn inner(&mut self) -> &mut Implicit<R> {
        &mut self.inner
    }

    /// Takes back the step just done and does it with implicit Euler.
    fn redo(
        &mut self,
        body: &mut Body<R>,
        solver: &mut dyn LinearSolver<R>,
        input: &StepInput<'_, R>,
        state: &mut State<R>,
        output: &mut StepOutput<R>,
    ) -> Result<(), StepError> {
        let (scheme, linearisations) = (self.inner.scheme, self.inner.linearisations);
        (self.inner.scheme, self.inner.linearisations) = (Scheme::ImplicitEuler, 1);
        let result = self.inner.step(body, solver, input, state, output);
        (self.inner.scheme, self.inner.linearisations) = (scheme, linearisations);
        output.guarded = true;
        result
    }

    fn restore(&self, body: &mut Body<R>, state: &mut State<R>) {
        body.model.roll_back();
        state.time = self.before.time;
        state.position.copy_from_slice(&self.before.position);
        state.velocity.copy_from_slice(&self.before.velocity);
        state.acceleration.copy_from_slice(&self.before.acceleration);
    }
}

impl<R: Scalar> Integrator<R> for Guarded<R> {
    fn name(&self) -> &'static str {
        self.inner.name()
    }

    fn step(
        &mut self,
        body: &mut Body<R>,
        solver: &mut dyn LinearSolver<R>,
        input: &StepInput<'_, R>,
        state: &mut State<R>,
        output: &mut StepOutput<R>,
    ) -> Result<(), StepError> {
        self.before.time = state.time;
        copy(&mut self.before.position, &state.position);
        copy(&mut self.before.velocity, &state.velocity);
        copy(&mut self.before.acceleration, &state.acceleration);
        let can_fall_back = self.inner.scheme != Scheme::ImplicitEuler;
        match self.inner.step(body, solver, input, state, output) {
            Ok(()) => {}
            // an input that no method can take
            Err(e @ StepError::Unsupported(_)) => return Err(e),
            Err(e) if !can_fall_back => return Err(e),
            Err(_) => return self.redo(body, solver, input, state, output),
        }
        let bound = Bound::new(body, input);
        let before = motion(body, &self.before);
        let after = motion(body, state);
        // elastic where last linearised: what a step added since then shows in its speed
        let energy = after.kinetic + output.elastic_energy;
        let fast = after.speed > bound.speed && after.speed > before.speed;
        // the elastic energy before is not known without work: growth shows in the motion, or the whole is many times too large
        let rich = energy > bound.energy && (after.kinetic > before.kinetic || energy > 100.0 * bound.energy);
        if !(fast || rich) {
            return Ok(());
        }
        if can_fall_back {
            self.restore(body, state);
            self.redo(body, solver, input, state, output)?;
        }
        let speed = motion(body, state).speed;
        if speed > 1e3 * bound.speed && speed > 2.0 * before.speed {
            let time = self.before.time;
            self.restore(body, state);
            return Err(StepError::Diverged { time, speed });
        }
        Ok(())
    }
}

/// What physics can give.
struct Bound {
    energy: f64,
    speed: f64,
}

impl Bound {
    fn new<R: Scalar>(body: &Body<R>, input: &StepInput<'_, R>) -> Self {
        let size = body.mesh.bounds().map_or(0.0, |(lo, hi)| length([hi[0] - lo[0], hi[1] - lo[1], hi[2] - lo[2]]));
        let n = body.mass.len();
        let of = |held: bool, i: usize, v: &[[R; 3]]| {
            let counts = body.mass[i] != R::zero() && body.constraints.is_constrained(i) == held;
            if counts { length(v[i].map(Scalar::to_f64)) } else { 0.0 }
        };
        let bone = par::max(n, |i| of(true, i, input.target_velocity));
        // nothing over nothing does not count
        let gravity = par::max(n, |i| of(false, i, input.external_force) / body.mass[i].to_f64());
        // at least what gravity could give, so that a body without forces is not frozen by rounding
        let fall = gravity.max(9.81) * size;
        Self { energy: 2.0 * body.total_mass() * (fall + 2.0 * bone * bone), speed: 3.0 * ((2.0 * fall).sqrt() + bone) }
    }
}

fn motion<R: Scalar>(body: &Body<R>, state: &State<R>) -> Motion {
    let mut mean = [0.0; 3];
    // a body nobody holds may fly as fast as it likes: only motion in itself counts
    if body.constraints.mask().iter().zip(&body.mass).all(|(c, m)| !c || *m == R::zero()) {
        let mass = body.total_mass();
        for (v, m) in state.velocity.iter().zip(&body.mass) {
            (0..3).for_each(|k| mean[k] += v[k].to_f64() * m.to_f64() / mass);
        }
    }
    let n = state.velocity.len();
    let speed = |i: usize| length(std::array::from_fn(|k| state.velocity[i][k].to_f64() - mean[k]));
    Motion {
        kinetic: par::sum(n, |range| range.map(|i| 0.5 * body.mass[i].to_f64() * speed(i) * speed(i)).sum()),
        speed: par::max(n, |i| if body.constraints.is_constrained(i) { 0.0 } else { speed(i) }),
    }
}

fn length(v: [f64; 3]) -> f64 {
    (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]).sqrt()
}

fn copy<R: Scalar>(to: &mut Vec<[R; 3]>, from: &[[R; 3]]) {
    to.clear();
    to.extend_from_slice(from);
}
