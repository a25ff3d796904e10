//! Implicit steps within linear conditions between nodes: exact at the end of every step, by elimination.
//!
//! With x = T y + o the step's equation A d = b becomes Tᵀ A T y = Tᵀ (b − A d0), d0 any displacement that meets the goals. The
//! method begins its step with d0, so that b − A d0 is the residual it computes anyway; corrections are T y ([`Reduced`]). What is left of
//! A d − b is the force of the links. It is a combination of their weights: the forces of a joint sum to zero, and momentum is kept.
//!
//! Velocities and accelerations that break the rate of a condition, when a link comes on or its goal turns, are brought back by the
//! smallest change in the metric of the masses, T (Tᵀ M T)⁻¹ Tᵀ M: an inelastic impact, which keeps momentum too.

use super::start::initial_acceleration;
use super::{Guarded, Implicit, Integrator, Scheme, State, StepError, StepInput, StepOutput};
use crate::body::Body;
use crate::constraint::{Elimination, Link, LinkError, Reduced, Within};
use softrig_linalg::solver::Direct;
use softrig_linalg::{BlockCsr, BlockPattern, DofConstraints, LinearSolver, Scalar};
use std::sync::Arc;

/// Deviations of velocities from the rate of a condition below this, relative to the largest one, are rounding.
const ROUNDING: f64 = 1e-11;

/// An [`Implicit`] method, guarded, whose bodies are held by links.
pub struct Linked<R> {
    method: Guarded<R>,
    links: Vec<Link>,
    goal: Vec<[f64; 3]>,
    rate: Vec<[f64; 3]>,
    made: Option<Made<R>>,
    /// No step has been taken with these links.
    fresh: bool,
    force: Vec<[R; 3]>,
}

/// All that depends on which links there are.
struct Made<R> {
    whole: Arc<BlockPattern>,
    prescribed: DofConstraints,
    elimination: Arc<Elimination>,
    reduced: Reduced<R>,
    mass: Reduced<R>,
    /// The masses on the body's pattern.
    weights: BlockCsr<R>,
    projector: Direct<R>,
    /// Which solver was prepared for the reduced system.
    solver: usize,
}

impl<R: Scalar> Linked<R> {
    /// A method without links yet.
    #[must_use]
    pub fn new(method: Implicit<R>) -> Self {
        Self {
            method: Guarded::new(method),
            links: Vec::new(),
            goal: Vec::new(),
            rate: Vec::new(),
            made: None,
            fresh: true,
            force: Vec::new(),
        }
    }

    /// Replaces the links. Goals of zero are those of joints; [`Self::set_goals`] gives others. Before the next step velocities lose what
    /// is against the links, and accelerations are found anew.
    pub fn set_links(&mut self, links: Vec<Link>) {
        self.continue_links(links);
        self.fresh = true;
    }

    /// As [`Self::set_links`], for a state that was stepped with these links before: it goes on as it would have.
    pub fn continue_links(&mut self, links: Vec<Link>) {
        self.goal = vec![[0.0; 3]; links.len()];
        self.rate = self.goal.clone();
        self.links = links;
        self.made = None;
        self.fresh = false;
    }

    /// Where each link is to be at the end of the next step [m], and how fast it moves then [m/s]: one entry per link.
    pub fn set_goals(&mut self, goal: &[[f64; 3]], rate: &[[f64; 3]]) {
        self.goal = goal.to_vec();
        self.rate = rate.to_vec();
    }

    /// The links.
    #[must_use]
    pub fn links(&self) -> &[Link] {
        &self.links
    }

    /// Force by which the links held each node in the last step [N]; zero on prescribed nodes.
    #[must_use]
    pub fn force(&self) -> &[[R; 3]] {
        &self.force
    }

    /// Checks the links on their own: `position` says where prescribed nodes are.
    ///
    /// # Errors
    /// [`LinkError`] when they have no solution.
    pub fn check(&self, prescribed: &DofConstraints, position: &[[R; 3]]) -> Result<(), LinkError> {
        Elimination::new(&self.links, prescribed.mask())?.offsets(&self.goal, position).map(|_| ())
    }

    fn prepare(&mut self, body: &Body<R>, time: f64) -> Result<(), StepError> {
        let known = self
            .made
            .as_ref()
            .is_some_and(|m| Arc::ptr_eq(&m.whole, &body.pattern) && m.prescribed == body.constraints);
        if known {
            return Ok(());
        }
        let failed = |source| StepError::Link { time, source };
        let elimination = Arc::new(Elimination::new(&self.links, body.constraints.mask()).map_err(failed)?);
        let reduce = || Reduced::new(elimination.clone(), &body.pattern, body.mesh.cells(), &body.constraints);
        let (reduced, mass) = (reduce().map_err(failed)?, reduce().map_err(failed)?);
        let mut weights = BlockCsr::zero(body.pattern.clone());
        for (at, m) in body.pattern.diagonal().iter().zip(&body.mass) {
            (0..3).for_each(|k| weights.values[*at as usize][4 * k] = *m);
        }
        let mut projector = Direct::new();
        projector.prepare(&mass.pattern, &mass.constraints).map_err(|source| StepError::Solve { time, source })?;
        self.made = Some(Made {
            whole: body.pattern.clone(),
            prescribed: body.constraints.clone(),
            elimination,
            reduced,
            mass,
            weights,
            projector,
            solver: 0,
        });
        Ok(())
    }
}

impl<R: Scalar> Made<R> {
    /// The nearest vector that has these offsets, in the metric of the masses. Prescribed entries stay.
    fn project(
        &mut self,
        body: &Body<R>,
        offset: &[[f64; 3]],
        vector: &mut [[R; 3]],
        time: f64,
    ) -> Result<(), StepError> {
        let largest = vector.iter().flatten().chain(&[R::zero()]).fold(0.0f64, |m, v| m.max(v.to_f64().abs()));
        let rounding = ROUNDING.max(64.0 * R::EPSILON.to_f64());
        if self.elimination.miss(offset, vector) <= rounding * largest {
            self.elimination.place(offset, vector);
            return Ok(());
        }
        // a vector with these offsets, and what it lacks of the one given
        let mut base = vector.to_vec();
        self.elimination.place(offset, &mut base);
        let rhs: Vec<[R; 3]> =
            (0..base.len()).map(|i| std::array::from_fn(|k| body.mass[i] * (vector[i][k] - base[i][k]))).collect();
        let (mut change, mut unused) = (vec![[R::zero(); 3]; base.len()], vec![[R::zero(); 3]; base.len()]);
        let tolerance = (64.0 * R::EPSILON.to_f64()).max(1e-13);
        self.mass
            .solve(&mut self.projector, &self.weights, &rhs, tolerance, &mut change, &mut unused)
            .map_err(|source| StepError::Solve { time, source })?;
        for i in 0..base.len() {
            vector[i] = std::array::from_fn(|k| base[i][k] + change[i][k]);
        }
        self.elimination.place(offset, vector);
        Ok(())
    }
}

impl<R: Scalar> Linked<R> {
    /// A step of a body without links.
    fn free_step(
        &mut self,
        body: &mut Body<R>,
        solver: &mut dyn LinearSolver<R>,
        input: &StepInput<'_, R>,
        state: &mut State<R>,
        output: &mut StepOutput<R>,
    ) -> Result<(), StepError> {
        self.method.inner().start.clear();
        self.force.clear();
        self.force.resize(body.mass.len(), [R::zero(); 3]);
        if self.fresh && self.is_newmark() {
            initial_acceleration(body, input.external_force, state)?;
        }
        self.method.step(body, solver, input, state, output)
    }

    fn linked_step(
        &mut self,
        body: &mut Body<R>,
        solver: &mut dyn LinearSolver<R>,
        input: &StepInput<'_, R>,
        state: &mut State<R>,
        output: &mut StepOutput<R>,
    ) -> Result<(), StepError> {
        let (n, time, newmark) = (body.mass.len(), state.time, self.is_newmark());
        self.prepare(body, time)?;
        let made = self.made.as_mut().expect("it was prepared above");
        let link = |source| StepError::Link { time, source };
        // where prescribed nodes will be, and how fast
        let mut lead = state.position.clone();
        let mut speed = vec![[R::zero(); 3]; n];
        for i in (0..n).filter(|i| body.constraints.is_constrained(*i) && body.mass[*i] > R::zero()) {
            (lead[i], speed[i]) = (input.target_position[i], input.target_velocity[i]);
        }
        let offset = made.elimination.offsets(&self.goal, &lead).map_err(link)?;
        let rate = made.elimination.offsets(&self.rate, &speed).map_err(link)?;
        let still = vec![[0.0; 3]; rate.len()];
        made.elimination.place(&offset, &mut lead);
        for (d, x) in lead.iter_mut().zip(&state.position) {
            *d = std::array::from_fn(|k| d[k] - x[k]);
        }
        let address = std::ptr::from_mut(solver).cast::<()>() as usize;
        if made.solver != address {
            made.solver = 0;
            let prepared = solver.prepare(&made.reduced.pattern, &made.reduced.constraints);
            prepared.map_err(|source| StepError::Solve { time, source })?;
            made.solver = address;
        }
        if self.fresh {
            if newmark {
                initial_acceleration(body, input.external_force, state)?;
            }
            with_prescribed(&body.constraints, &speed, &mut state.velocity);
            made.project(body, &rate, &mut state.velocity, time)?;
            made.project(body, &still, &mut state.acceleration, time)?;
        }
        self.method.inner().start = lead;
        self.force.clear();
        self.force.resize(n, [R::zero(); 3]);
        let mut within = Within { inner: solver, reduced: &mut made.reduced, force: &mut self.force };
        self.method.step(body, &mut within, input, state, output)?;
        made.elimination.place(&offset, &mut state.position);
        made.project(body, &rate, &mut state.velocity, time)?;
        made.project(body, &still, &mut state.acceleration, time)?;
        output.kinetic_energy = body.kinetic_energy(&state.velocity);
        Ok(())
    }

    fn is_newmark(&mut self) -> bool {
        matches!(self.method.inner().scheme, Scheme::Newmark { .. })
    }
}

impl<R: Scalar> Integrator<R> for Linked<R> {
    fn name(&self) -> &'static str {
        self.method.name()
    }

    fn step(
        &mut self,
        body: &mut Body<R>,
        solver: &mut dyn LinearSolver<R>,
        input: &StepInput<'_, R>,
        state: &mut State<R>,
        output: &mut StepOutput<R>,
    ) -> Result<(), StepError> {
        let n = body.mass.len();
        let lists = [state.position.len(), state.velocity.len(), state.acceleration.len()];
        if lists != [n; 3] || [input.target_position.len(), input.target_velocity.len()] != [n; 2] {
            return Err(StepError::Unsupported(format!(
                "a state or targets of another size than the body's {n} nodes"
            )));
        }
        if body.consistent_mass.is_some() {
            return Err(StepError::Unsupported("links between nodes of a body with consistent mass".into()));
        }
        let before = state.clone();
        let history = body.model.history();
        let done = if self.links.is_empty() {
            self.free_step(body, solver, input, state, output)
        } else {
            self.linked_step(body, solver, input, state, output)
        };
        if done.is_ok() {
            self.fresh = false;
        } else {
            *state = before;
            body.model.restore(&history);
        }
        done
    }
}

fn with_prescribed<R: Scalar>(constraints: &DofConstraints, from: &[[R; 3]], to: &mut [[R; 3]]) {
    for i in (0..to.len()).filter(|i| constraints.is_constrained(*i)) {
        to[i] = from[i];
    }
}
