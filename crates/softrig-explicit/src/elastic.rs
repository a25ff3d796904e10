//! Elastic bodies as force laws, and explicit steps for [`Body`].

use crate::clustered::Clustered;
use crate::element::ElementWise;
use crate::scheme::Scheme;
use crate::stepper::{ForceLaw, Stepper, StepperError, TooLong};
use softrig::body::Body;
use softrig::force::Increment;
use softrig::integrate::{Integrator, State, StepError, StepInput, StepOutput};
use softrig_linalg::{LinearSolver, Scalar};

/// Elastic forces without an energy or a matrix: what an explicit step needs, as fast as it goes.
pub trait InternalForce<R>: Send {
    /// Writes f_int(x, v) [N] with the stiffness damping of the materials; sign as on the left of `M a + f_int = f_ext`.
    fn internal_force(&mut self, position: &[[R; 3]], velocity: &[[R; 3]], force: &mut [[R; 3]]);
}

impl<R: Scalar> InternalForce<R> for Box<dyn InternalForce<R>> {
    fn internal_force(&mut self, position: &[[R; 3]], velocity: &[[R; 3]], force: &mut [[R; 3]]) {
        (**self).internal_force(position, velocity, force);
    }
}

impl<R: Scalar> InternalForce<R> for Clustered<R> {
    fn internal_force(&mut self, position: &[[R; 3]], velocity: &[[R; 3]], force: &mut [[R; 3]]) {
        Self::internal_force(self, position, velocity, R::zero(), force);
    }
}

impl<R: Scalar> InternalForce<R> for ElementWise<R> {
    fn internal_force(&mut self, position: &[[R; 3]], velocity: &[[R; 3]], force: &mut [[R; 3]]) {
        Self::internal_force(self, position, velocity, R::zero(), force);
    }
}

/// F = f_ext - f_int(x, v) - a M v.
pub struct ElasticLaw<R, F> {
    /// The elastic forces.
    pub internal: F,
    /// f_ext on every node [N].
    pub external: Vec<[R; 3]>,
    /// a M of every node [kg/s].
    pub drag: Vec<R>,
}

impl<R: Scalar, F: InternalForce<R>> ForceLaw<R> for ElasticLaw<R, F> {
    fn force(&mut self, position: &[[R; 3]], velocity: &[[R; 3]], force: &mut [[R; 3]]) {
        self.internal.internal_force(position, velocity, force);
        for (((f, e), v), d) in force.iter_mut().zip(&self.external).zip(velocity).zip(&self.drag) {
            for k in 0..3 {
                f[k] = e[k] - f[k] - *d * v[k];
            }
        }
    }
}

/// Explicit steps of a [`Body`] with any of its force models, prescribed nodes met exactly at the end of each: the place of an implicit
/// [`Integrator`], without a linear system. Steps beyond the stability limit are cut.
pub struct Explicit<R> {
    /// How a step is taken.
    pub scheme: Scheme,
    /// What happens to steps that are too long.
    pub too_long: TooLong,
    stepper: Option<Stepper<R>>,
    mask: Vec<bool>,
}

impl<R: Scalar> Explicit<R> {
    /// Steps of this scheme.
    #[must_use]
    pub fn new(scheme: Scheme) -> Self {
        Self { scheme, too_long: TooLong::default(), stepper: None, mask: Vec::new() }
    }
}

/// A body's model as a force law.
struct BodyLaw<'a, R> {
    body: &'a mut Body<R>,
    external: &'a [[R; 3]],
}

impl<R: Scalar> ForceLaw<R> for BodyLaw<'_, R> {
    fn force(&mut self, position: &[[R; 3]], velocity: &[[R; 3]], force: &mut [[R; 3]]) {
        let damping = self.body.stiffness_damping;
        self.body.model.linearise(position);
        self.body.model.force(position, Increment { displacement: None, velocity: Some(velocity), damping }, force);
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

    fn step(
        &mut self,
        body: &mut Body<R>,
        _solver: &mut dyn LinearSolver<R>,
        input: &StepInput<'_, R>,
        state: &mut State<R>,
        output: &mut StepOutput<R>,
    ) -> Result<(), StepError> {
        let n = body.mass.len();
        let lists = [state.position.len(), input.external_force.len(), input.target_position.len()];
        if lists != [n; 3] || input.target_velocity.len() != n {
            return Err(StepError::Unsupported(format!("a state or input of another size than the body's {n} nodes")));
        }
        if body.consistent_mass.is_some() {
            return Err(StepError::Unsupported("explicit steps of a body with consistent mass".into()));
        }
        if self.stepper.is_none() || self.mask != body.constraints.mask() {
            let rest: Vec<[R; 3]> = body.mesh.nodes.iter().map(|p| p.map(R::from_f64)).collect();
            let mass: Vec<R> =
                (0..n).map(|i| if body.constraints.is_constrained(i) { R::zero() } else { body.mass[i] }).collect();
            let zero = vec![[R::zero(); 3]; n];
            let drag = (0..n).filter(|i| mass[*i] > R::zero()).map(|i| (body.drag[i] / body.mass[i]).to_f64());
            let drag = drag.fold(f64::INFINITY, f64::min) + body.mass_damping.to_f64();
            let history = body.model.history();
            let law = &mut BodyLaw { body, external: &zero };
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
            let law = &mut BodyLaw { body, external: input.external_force };
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
        body.model.linearise(&state.position);
        output.elastic_energy = body.model.force(&state.position, Increment::none(), &mut output.reaction);
        for i in 0..n {
            if !self.mask[i] {
                output.reaction[i] = [R::zero(); 3];
            }
        }
        output.kinetic_energy = (0..n)
            .map(|i| 0.5 * body.mass[i].to_f64() * state.velocity[i].iter().map(|v| v.to_f64().powi(2)).sum::<f64>())
            .sum();
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
