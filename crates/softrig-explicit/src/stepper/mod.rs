//! One step of `M a = F(x, v)` with any [`Scheme`], constraints met at its end.
//!
//! Verlet is written with velocities, so that a state is all there is to know: with v(t) = (x(t) - x(t-h))/h + h/2 a(t-h) the
//! step x' = 2 x - x(t-h) + h² a becomes x' = x + h (v + h a - h/2 a(t-h)), v' = v + 3h/2 a - h/2 a(t-h), and a(t-h) is the
//! acceleration of the state.

mod newton;

use crate::constraint::{ConstraintError, Constraints};
use crate::scheme::Scheme;
use crate::stability::{Spectrum, spectrum};
use rayon::prelude::*;
use softrig::integrate::{State, StepError};
use softrig_linalg::Scalar;

/// Nodes per task of the loops over nodes.
const CHUNK: usize = 4096;

/// What acts on the nodes.
pub trait ForceLaw<R> {
    /// Writes the whole force F(x, v) on every node [N]; positions in m, velocities in m/s.
    fn force(&mut self, position: &[[R; 3]], velocity: &[[R; 3]], force: &mut [[R; 3]]);
}

impl<R, F: FnMut(&[[R; 3]], &[[R; 3]], &mut [[R; 3]])> ForceLaw<R> for F {
    fn force(&mut self, position: &[[R; 3]], velocity: &[[R; 3]], force: &mut [[R; 3]]) {
        self(position, velocity, force);
    }
}

/// What to do with a step that is too long to be stable.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum TooLong {
    /// Take it as several equal ones that are short enough. The default: the result is what a patient user would have got.
    #[default]
    Substep,
    /// Answer [`StepperError::Unstable`].
    Refuse,
}

/// Why a step was not taken. The state is as it was.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum StepperError {
    /// The step is longer than the scheme can take.
    #[error(
        "a step of {dt:.3e} s is beyond the stability limit {limit:.3e} s of `{scheme}` on this body; use at most that, {substeps} substeps, or `implicit-euler`"
    )]
    Unstable {
        /// Which scheme.
        scheme: &'static str,
        /// Step asked for [s].
        dt: f64,
        /// Longest stable step [s].
        limit: f64,
        /// How many equal parts of the step would do.
        substeps: usize,
    },
    /// No step is short enough.
    #[error(
        "`{scheme}` is stable for no time step on this body (limit {limit:.1e} s): without damping it gains energy; use `verlet`, `euler-cromer` or `implicit-euler`, or add damping"
    )]
    NeverStable {
        /// Which scheme.
        scheme: &'static str,
        /// Longest stable step found [s].
        limit: f64,
    },
    /// The step is not a positive number.
    #[error("a time step of {0} s; it must be positive and finite")]
    BadStep(f64),
    /// The state, masses or forces do not belong together.
    #[error("{what}: {found} for {expected} nodes")]
    Length {
        /// Which list.
        what: &'static str,
        /// Its length.
        found: usize,
        /// Number of nodes.
        expected: usize,
    },
    /// A number is not finite.
    #[error(
        "{what} of node {node} is not a finite number; the body came apart, use a shorter step or a stiffer material"
    )]
    NotFinite {
        /// Which quantity.
        what: &'static str,
        /// First such node.
        node: usize,
    },
    /// The equation of an implicit step could not be solved.
    #[error(
        "the implicit step stopped at residual {residual:.1e} after {iterations} Newton iterations; use a shorter step"
    )]
    NotConverged {
        /// Residual relative to that at the start [-].
        residual: f64,
        /// Newton iterations done.
        iterations: usize,
    },
    /// A step of the implicit core failed.
    #[error(transparent)]
    Implicit(StepError),
    /// A constraint cannot be met.
    #[error(transparent)]
    Constraint(#[from] ConstraintError),
}

/// Advances states; keeps its memory from step to step.
#[derive(Clone, Debug)]
pub struct Stepper<R> {
    /// How a step is taken.
    pub scheme: Scheme,
    /// What happens to steps that are too long.
    pub too_long: TooLong,
    /// Part of the stability limit that is used [-]. Default 0.9: the spectrum is that of the rest shape, and a deformed body is
    /// somewhat stiffer.
    pub safety: f64,
    /// 1/m of each node [1/kg], zero for nodes that no force moves.
    inverse_mass: Vec<R>,
    spectrum: Spectrum,
    /// The limit that was computed last, and for which scheme.
    stable: (Scheme, f64),
    force: Vec<[R; 3]>,
    ahead: Vec<[R; 3]>,
    next: State<R>,
    newton: newton::Newton<R>,
}

impl<R: Scalar> Stepper<R> {
    /// A stepper for nodes of these masses [kg] whose spectrum around `rest` is found by power iteration on `law` itself.
    /// `drag` is the mass-proportional damping in it [1/s].
    ///
    /// # Errors
    /// [`StepperError::Length`] when there is not one position per mass, [`StepperError::NotFinite`] when a position, a mass or the
    /// force at rest is not a number.
    pub fn new(
        scheme: Scheme,
        mass: &[R],
        rest: &[[R; 3]],
        law: &mut dyn ForceLaw<R>,
        drag: f64,
    ) -> Result<Self, StepperError> {
        let n = mass.len();
        if rest.len() != n {
            return Err(StepperError::Length { what: "rest positions", found: rest.len(), expected: n });
        }
        finite("rest position", rest)?;
        let bad = mass.iter().position(|m| !(m.is_finite() && *m >= R::zero()));
        if let Some(node) = bad {
            return Err(StepperError::NotFinite { what: "mass", node });
        }
        let inverse_mass: Vec<R> =
            mass.iter().map(|m| if *m > R::zero() { R::one() / *m } else { R::zero() }).collect();
        let mut force = vec![[R::zero(); 3]; n];
        let mut spectrum = spectrum(law, &inverse_mass, rest, &mut force);
        spectrum.drag = drag;
        if !(spectrum.frequency.is_finite() && spectrum.damping.is_finite()) {
            let node = force.iter().position(|f| !f.iter().all(|c| c.is_finite())).unwrap_or(0);
            return Err(StepperError::NotFinite { what: "force", node });
        }
        Ok(Self {
            scheme,
            too_long: TooLong::default(),
            safety: 0.9,
            inverse_mass,
            stable: (scheme, scheme.stable_step(&spectrum)),
            spectrum,
            ahead: force.clone(),
            next: State::at_rest(force.clone()),
            force,
            newton: newton::Newton::default(),
        })
    }

    /// Largest frequency and damping of the body at rest.
    #[must_use]
    pub fn spectrum(&self) -> Spectrum {
        self.spectrum
    }

    /// Longest step that is taken in one piece [s].
    #[must_use]
    pub fn limit(&self) -> f64 {
        let (scheme, limit) = self.stable;
        self.safety * if scheme == self.scheme { limit } else { self.scheme.stable_step(&self.spectrum) }
    }

    /// 1/m of each node [1/kg].
    #[must_use]
    pub fn inverse_mass(&self) -> &[R] {
        &self.inverse_mass
    }

    /// Sets the acceleration a motion starts with, which Verlet needs for its second order.
    ///
    /// # Errors
    /// [`StepperError::Length`] when the state is not this body's.
    pub fn start(&mut self, law: &mut dyn ForceLaw<R>, state: &mut State<R>) -> Result<(), StepperError> {
        self.check(state)?;
        law.force(&state.position, &state.velocity, &mut self.force);
        state.acceleration.resize(self.force.len(), [R::zero(); 3]);
        for ((a, f), w) in state.acceleration.iter_mut().zip(&self.force).zip(&self.inverse_mass) {
            *a = f.map(|f| f * *w);
        }
        Ok(())
    }

    /// One step of length `dt` [s]; returns how many substeps it took. Constraints are met at the end of every substep.
    ///
    /// # Errors
    /// [`StepperError`]; state and constraints are then as before the call.
    pub fn step(
        &mut self,
        law: &mut dyn ForceLaw<R>,
        constraints: Option<&mut Constraints>,
        state: &mut State<R>,
        dt: f64,
    ) -> Result<usize, StepperError> {
        if !(dt > 0.0 && dt.is_finite()) {
            return Err(StepperError::BadStep(dt));
        }
        self.check(state)?;
        if self.stable.0 != self.scheme {
            self.stable = (self.scheme, self.scheme.stable_step(&self.spectrum));
        }
        let limit = self.limit();
        let scheme = self.scheme.name();
        let parts = if dt <= limit { 1.0 } else { (dt / limit).ceil() };
        if parts > 1e6 {
            return Err(StepperError::NeverStable { scheme, limit });
        }
        let substeps = parts as usize;
        if substeps > 1 && self.too_long == TooLong::Refuse {
            return Err(StepperError::Unstable { scheme, dt, limit, substeps });
        }
        let mut constraints = constraints;
        if substeps == 1 {
            let done = self.part(law, constraints.as_deref_mut(), state, dt);
            if let (Err(_), Some(set)) = (&done, constraints) {
                set.abandon();
            }
            return done.map(|()| 1);
        }
        let before = state.clone();
        let set_before = constraints.as_deref().cloned();
        for _ in 0..substeps {
            if let Err(e) = self.part(law, constraints.as_deref_mut(), state, dt / parts) {
                *state = before;
                if let (Some(now), Some(then)) = (constraints, set_before) {
                    *now = then;
                }
                return Err(e);
            }
        }
        Ok(substeps)
    }

    fn check(&self, state: &State<R>) -> Result<(), StepperError> {
        let expected = self.inverse_mass.len();
        for (what, found) in [("positions", state.position.len()), ("velocities", state.velocity.len())] {
            if found != expected {
                return Err(StepperError::Length { what, found, expected });
            }
        }
        Ok(())
    }

    fn part(
        &mut self,
        law: &mut dyn ForceLaw<R>,
        constraints: Option<&mut Constraints>,
        state: &mut State<R>,
        dt: f64,
    ) -> Result<(), StepperError> {
        let n = self.inverse_mass.len();
        for list in [&mut self.next.position, &mut self.next.velocity, &mut self.next.acceleration] {
            list.resize(n, [R::zero(); 3]);
        }
        state.acceleration.resize(n, [R::zero(); 3]);
        let h = R::from_f64(dt);
        let half = h * R::from_f64(0.5);
        match self.scheme {
            Scheme::ExplicitEuler => {
                law.force(&state.position, &state.velocity, &mut self.force);
                self.advance(state, |x, v, _, a| (x + h * v, v + h * a));
            }
            Scheme::EulerCromer => {
                law.force(&state.position, &state.velocity, &mut self.force);
                self.advance(state, |x, v, _, a| (x + h * (v + h * a), v + h * a));
            }
            Scheme::Verlet => {
                law.force(&state.position, &state.velocity, &mut self.force);
                self.advance(state, |x, v, b, a| (x + h * (v + h * a - half * b), v + h * a + half * (a - b)));
            }
            Scheme::Midpoint => {
                law.force(&state.position, &state.velocity, &mut self.force);
                self.advance(state, |x, v, _, a| (x + half * v, v + half * a));
                law.force(&self.next.position, &self.next.velocity, &mut self.force);
                self.ahead.copy_from_slice(&self.next.velocity);
                self.advance_with(state, |x, v, mid, a| (x + h * mid, v + h * a));
            }
            Scheme::RungeKutta2 => {
                law.force(&state.position, &state.velocity, &mut self.force);
                self.advance(state, |x, v, _, a| (x + h * v, v + h * a));
                law.force(&self.next.position, &self.next.velocity, &mut self.force);
                self.ahead.copy_from_slice(&self.next.velocity);
                self.advance_with(state, |x, v, end, a| (x + half * (v + end), v + half * ((end - v) / h + a)));
            }
            Scheme::ImplicitEuler => {
                self.newton.step(law, &self.inverse_mass, state, dt, &mut self.next)?;
            }
        }
        self.next.time = state.time + dt;
        if let Some(constraints) = constraints {
            constraints.enforce(self.scheme, dt, &self.inverse_mass, &mut self.next)?;
            finite("position", &self.next.position)?;
            finite("velocity", &self.next.velocity)?;
            constraints.advance();
        } else {
            finite("position", &self.next.position)?;
            finite("velocity", &self.next.velocity)?;
        }
        std::mem::swap(state, &mut self.next);
        Ok(())
    }

    /// Writes the next state from `f(x, v, a(t-h), a)`, component by component.
    fn advance(&mut self, state: &State<R>, f: impl Fn(R, R, R, R) -> (R, R) + Sync) {
        advance(&self.inverse_mass, &self.force, state, &state.acceleration, &mut self.next, f);
    }

    /// Writes the next state from `f(x, v, velocity ahead, a)`.
    fn advance_with(&mut self, state: &State<R>, f: impl Fn(R, R, R, R) -> (R, R) + Sync) {
        advance(&self.inverse_mass, &self.force, state, &self.ahead, &mut self.next, f);
    }
}

fn advance<R: Scalar>(
    inverse_mass: &[R],
    force: &[[R; 3]],
    state: &State<R>,
    third: &[[R; 3]],
    next: &mut State<R>,
    f: impl Fn(R, R, R, R) -> (R, R) + Sync,
) {
    let n = inverse_mass.len();
    let work = |first: usize, x: &mut [[R; 3]], v: &mut [[R; 3]], a: &mut [[R; 3]]| {
        let range = first..first + x.len();
        let (old_x, old_v) = (&state.position[range.clone()], &state.velocity[range.clone()]);
        let (third, force, w) = (&third[range.clone()], &force[range.clone()], &inverse_mass[range]);
        for i in 0..w.len() {
            for k in 0..3 {
                a[i][k] = force[i][k] * w[i];
                let moved = f(old_x[i][k], old_v[i][k], third[i][k], a[i][k]);
                // nodes without mass stay
                (x[i][k], v[i][k]) = if w[i] > R::zero() { moved } else { (old_x[i][k], R::zero()) };
            }
        }
    };
    if n <= CHUNK {
        work(0, &mut next.position, &mut next.velocity, &mut next.acceleration);
        return;
    }
    let parts = next.position.par_chunks_mut(CHUNK).zip(next.velocity.par_chunks_mut(CHUNK));
    parts
        .zip(next.acceleration.par_chunks_mut(CHUNK))
        .enumerate()
        .for_each(|(k, ((x, v), a))| work(k * CHUNK, x, v, a));
}

fn finite<R: Scalar>(what: &'static str, list: &[[R; 3]]) -> Result<(), StepperError> {
    // x 0 is zero for numbers and NaN for everything else; no branch per number, and sums that do not wait for one another
    let zero = R::zero();
    let (body, rest) = list.as_flattened().as_chunks::<16>();
    let mut sum = [zero; 16];
    for x in body {
        for k in 0..16 {
            sum[k] += x[k] * zero;
        }
    }
    rest.iter().for_each(|x| sum[0] += *x * zero);
    if sum.iter().all(|s| *s == zero) {
        return Ok(());
    }
    let node = list.iter().position(|p| !p.iter().all(|c| c.is_finite())).unwrap_or(0);
    Err(StepperError::NotFinite { what, node })
}
