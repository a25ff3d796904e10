//! Explicit steps of a [`Body`] in the place of an implicit integrator.
//!
//! A linear force is carried: it acts on the deviation d = Rᵀ (x - s) of each node from the place s and turn R that skinning gives it, so
//! that a limb may turn as far as it likes. What the skinning itself deforms costs no energy then.

use crate::elastic::InternalForce;
use crate::frames::{Frames, check};
use crate::scheme::Scheme;
use crate::stepper::{ForceLaw, Stepper, StepperError, TooLong};
use glam::DVec3;
use softrig::body::Body;
use softrig::force::Increment;
use softrig::integrate::{Integrator, NodeFrame, State, StepError, StepInput, StepOutput};
use softrig_linalg::{LinearSolver, Scalar};

/// Explicit steps of a [`Body`] with any of its force models, prescribed nodes met exactly at the end of each: the place of an implicit
/// [`Integrator`], without a linear system. Steps beyond the stability limit are cut.
pub struct Explicit<R> {
    /// How a step is taken.
    pub scheme: Scheme,
    /// What happens to steps that are too long.
    pub too_long: TooLong,
    /// Instead of the body's own model.
    internal: Option<Box<dyn InternalForce<R>>>,
    frames: Frames,
    carried: bool,
    stepper: Option<Stepper<R>>,
    mask: Vec<bool>,
    scratch: [Vec<[R; 3]>; 2],
}

impl<R: Scalar> Explicit<R> {
    /// Steps of this scheme with the body's own force model.
    #[must_use]
    pub fn new(scheme: Scheme) -> Self {
        Self {
            scheme,
            too_long: TooLong::default(),
            internal: None,
            frames: Frames::default(),
            carried: false,
            stepper: None,
            mask: Vec::new(),
            scratch: [Vec::new(), Vec::new()],
        }
    }

    /// Steps with other forces than those of the body's model.
    #[must_use]
    pub fn with_force(scheme: Scheme, internal: Box<dyn InternalForce<R>>) -> Self {
        Self { internal: Some(internal), ..Self::new(scheme) }
    }

    /// Lets the forces act on deviations from skinning: for linear ones.
    #[must_use]
    pub fn carried(mut self) -> Self {
        self.carried = true;
        self
    }

    /// Longest step that is taken in one piece [s]; known from the first step on.
    #[must_use]
    pub fn limit(&self) -> Option<f64> {
        self.stepper.as_ref().map(Stepper::limit)
    }
}

/// What acts on a body's nodes.
struct BodyLaw<'a, R> {
    body: &'a mut Body<R>,
    internal: Option<&'a mut Box<dyn InternalForce<R>>>,
    /// Frames of the nodes at both ends of the step, and where between them the force is taken.
    frames: Option<(&'a Frames, f64)>,
    /// Length of the step that the frames belong to [s].
    dt: f64,
    scratch: &'a mut [Vec<[R; 3]>; 2],
    external: &'a [[R; 3]],
}

impl<R: Scalar> BodyLaw<'_, R> {
    /// f_int(x, v) [N].
    fn internal(&mut self, position: &[[R; 3]], velocity: &[[R; 3]], force: &mut [[R; 3]]) {
        let Some(internal) = &mut self.internal else {
            let damping = self.body.stiffness_damping;
            self.body.model.linearise(position);
            let increment = Increment { displacement: None, velocity: Some(velocity), damping };
            self.body.model.force(position, increment, force);
            return;
        };
        let Some((frames, share)) = self.frames else {
            internal.internal_force(position, velocity, force);
            return;
        };
        let [x, v] = &mut *self.scratch;
        x.resize(position.len(), [R::zero(); 3]);
        v.resize(position.len(), [R::zero(); 3]);
        for n in 0..position.len() {
            let (place, turn, speed) = frames.between(n, share, self.dt);
            let back = turn.conjugate();
            let d =
                back * (DVec3::from(position[n].map(Scalar::to_f64)) - place) + DVec3::from(self.body.mesh.nodes[n]);
            let w = back * (DVec3::from(velocity[n].map(Scalar::to_f64)) - speed);
            (x[n], v[n]) = (d.to_array().map(R::from_f64), w.to_array().map(R::from_f64));
        }
        internal.internal_force(x, v, force);
        for (n, f) in force.iter_mut().enumerate() {
            let turn = frames.between(n, share, self.dt).1;
            *f = (turn * DVec3::from(f.map(Scalar::to_f64))).to_array().map(R::from_f64);
        }
    }
}

impl<R: Scalar> ForceLaw<R> for BodyLaw<'_, R> {
    fn force(&mut self, position: &[[R; 3]], velocity: &[[R; 3]], force: &mut [[R; 3]]) {
        self.internal(position, velocity, force);
        for i in 0..force.len() {
            let drag = self.body.drag[i] + self.body.mass_damping * self.body.mass[i];
            for k in 0..3 {
                force[i][k] = self.external[i][k] - force[i][k] - drag * velocity[i][k];
            }
        }
    }
}

impl<R: Scalar> Integrator<R> for Explicit<R> {
    fn name(&self) -> &'static str {
        self.scheme.name()
    }

    fn is_carried(&self) -> bool {
        self.carried
    }

    fn carry(&mut self, before: &[NodeFrame], after: &[NodeFrame]) {
        self.frames.carry(before, after);
    }

    fn step(
        &mut self,
        body: &mut Body<R>,
        _solver: &mut dyn LinearSolver<R>,
        input: &StepInput<'_, R>,
        state: &mut State<R>,
        output: &mut StepOutput<R>,
    ) -> Result<(), StepError> {
        let n = body.mass.len();
        check(n, input, state)?;
        if body.consistent_mass.is_some() {
            return Err(StepError::Unsupported("explicit steps of a body with consistent mass".into()));
        }
        if self.carried && !self.frames.fit(n) {
            return Err(StepError::Unsupported("a carried force without the frames of its nodes".into()));
        }
        if self.stepper.is_none() || self.mask != body.constraints.mask() {
            let rest: Vec<[R; 3]> = body.mesh.nodes.iter().map(|p| p.map(R::from_f64)).collect();
            let mass: Vec<R> =
                (0..n).map(|i| if body.constraints.is_constrained(i) { R::zero() } else { body.mass[i] }).collect();
            let zero = vec![[R::zero(); 3]; n];
            let drag = (0..n).filter(|i| mass[*i] > R::zero()).map(|i| (body.drag[i] / body.mass[i]).to_f64());
            let drag = drag.fold(f64::INFINITY, f64::min) + body.mass_damping.to_f64();
            let history = body.model.history();
            // around the rest shape there is nothing to carry
            let law = &mut BodyLaw {
                body,
                internal: self.internal.as_mut(),
                frames: None,
                dt: input.dt,
                scratch: &mut self.scratch,
                external: &zero,
            };
            let made = Stepper::new(self.scheme, &mass, &rest, law, if drag.is_finite() { drag } else { 0.0 });
            body.model.restore(&history);
            self.mask = body.constraints.mask().to_vec();
            self.stepper = Some(made.map_err(|e| failure(&e, state.time))?);
        }
        let stepper = self.stepper.as_mut().expect("it was made above");
        stepper.scheme = self.scheme;
        stepper.too_long = self.too_long;
        body.model.save();
        let before = state.clone();
        let start: Vec<(usize, [R; 3])> = (0..n).filter(|i| self.mask[*i]).map(|i| (i, state.position[i])).collect();
        // substeps of our own, so that prescribed nodes move evenly through them
        let limit = stepper.limit();
        let parts = (input.dt / limit).ceil().max(1.0);
        if !parts.is_finite() || parts > 1e6 || (parts > 1.0 && self.too_long == TooLong::Refuse) {
            let (scheme, dt) = (self.scheme.name(), input.dt);
            let substeps = if parts.is_finite() { parts.min(1e9) as usize } else { 0 };
            let e = if parts.is_finite() && parts <= 1e6 {
                StepperError::Unstable { scheme, dt, limit, substeps }
            } else {
                StepperError::NeverStable { scheme, limit }
            };
            return Err(failure(&e, state.time));
        }
        let h = input.dt / parts;
        for part in 1..=parts as usize {
            let law = &mut BodyLaw {
                body,
                internal: self.internal.as_mut(),
                frames: self.carried.then_some((&self.frames, (part - 1) as f64 / parts)),
                dt: input.dt,
                scratch: &mut self.scratch,
                external: input.external_force,
            };
            if let Err(e) = stepper.step(law, None, state, h) {
                body.model.roll_back();
                *state = before;
                return Err(failure(&e, state.time));
            }
            let share = R::from_f64(part as f64 / parts);
            for (i, from) in &start {
                let to = input.target_position[*i];
                state.position[*i] =
                    std::array::from_fn(
                        |k| {
                            if part as f64 == parts { to[k] } else { from[k] + share * (to[k] - from[k]) }
                        },
                    );
                state.velocity[*i] = input.target_velocity[*i];
            }
        }
        state.time = before.time + input.dt;
        output.reaction.resize(n, [R::zero(); 3]);
        output.elastic_energy = 0.0;
        if self.internal.is_some() {
            // what skinning gives the nodes as velocity has no damping
            let still: Vec<[R; 3]> = if self.carried {
                let speed = |n| self.frames.between(n, 1.0, input.dt).2.to_array().map(R::from_f64);
                (0..n).map(speed).collect()
            } else {
                vec![[R::zero(); 3]; n]
            };
            let mut law = BodyLaw {
                body,
                internal: self.internal.as_mut(),
                frames: self.carried.then_some((&self.frames, 1.0)),
                dt: input.dt,
                scratch: &mut self.scratch,
                external: input.external_force,
            };
            law.internal(&state.position, &still, &mut output.reaction);
        } else {
            body.model.linearise(&state.position);
            output.elastic_energy = body.model.force(&state.position, Increment::none(), &mut output.reaction);
        }
        for i in 0..n {
            if !self.mask[i] {
                output.reaction[i] = [R::zero(); 3];
            }
        }
        output.kinetic_energy = (0..n)
            .map(|i| 0.5 * body.mass[i].to_f64() * state.velocity[i].iter().map(|v| v.to_f64().powi(2)).sum::<f64>())
            .sum();
        output.substeps = parts as usize;
        (output.iterations, output.residual, output.converged, output.guarded) = (0, 0.0, true, false);
        Ok(())
    }
}

fn failure(e: &StepperError, time: f64) -> StepError {
    match e {
        StepperError::NotFinite { what, node } => StepError::NotFinite { time, what, node: *node },
        other => StepError::Unsupported(other.to_string()),
    }
}
