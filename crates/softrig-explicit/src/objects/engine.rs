//! What advances objects by a step.

use super::{Law, ObjectSettings};
use crate::constraint::Constraints;
use crate::scheme::Scheme;
use crate::stepper::{Stepper, StepperError};
use softrig::body::Body;
use softrig::force::ForceModel;
use softrig::integrate::{Integrator, Linked, State, StepError, StepInput, StepOutput};
use softrig_linalg::LinearSolver;

/// By forces after the step, or by elimination in it.
pub(super) enum Engine {
    Local(Box<Local>),
    Implicit(Box<Implicit>),
}

/// Steps with forces of constraints after them.
pub(super) struct Local {
    pub law: Law,
    pub stepper: Stepper<f64>,
}

/// Implicit steps of finite elements that eliminate their constraints.
pub struct Implicit {
    /// The finite elements. Nodes that it prescribes stay where they are.
    pub body: Body<f64>,
    /// Force on every node, gravity included [N].
    pub external: Vec<[f64; 3]>,
    /// How a step is taken.
    pub method: Linked<f64>,
    /// Solves the systems without dependent nodes: made for any pattern, so not by multigrid of the body's own mesh.
    pub solver: Box<dyn LinearSolver<f64>>,
    /// Residual asked of a step's solve [-].
    pub tolerance: f64,
}

impl Engine {
    /// Longest step that is taken in one piece [s].
    pub fn limit(&self) -> f64 {
        match self {
            Self::Local(l) => l.stepper.limit(),
            Self::Implicit(_) => f64::INFINITY,
        }
    }

    pub fn scheme(&self, settings: &ObjectSettings) -> &'static str {
        match self {
            Self::Local(_) => settings.scheme.name(),
            Self::Implicit(i) => i.method.name(),
        }
    }

    pub fn step(&mut self, set: &mut Constraints, state: &mut State<f64>, dt: f64) -> Result<(), StepperError> {
        match self {
            Self::Local(l) => l.stepper.step(&mut l.law, Some(set), state, dt).map(|_| ()),
            Self::Implicit(i) => {
                let done = i.step(set, state, dt);
                if done.is_err() {
                    set.abandon();
                }
                done
            }
        }
    }

    /// What the next step reads of the cells.
    pub fn history(&self) -> Vec<[f64; 4]> {
        match self {
            Self::Local(l) => match &l.law {
                Law::Cells(law) => law.internal.history(),
                _ => Vec::new(),
            },
            Self::Implicit(i) => i.body.model.history(),
        }
    }

    /// Goes on from a state that was reached with these constraints, at `time` [s].
    pub fn restore(&mut self, history: &[[f64; 4]], set: &mut Constraints, time: f64) {
        match self {
            Self::Local(l) => {
                if let Law::Cells(law) = &mut l.law {
                    law.internal.restore(history);
                }
            }
            Self::Implicit(i) => {
                i.body.model.restore(history);
                let links = set.links().to_vec();
                if time > 0.0 { i.method.continue_links(links) } else { i.method.set_links(links) }
            }
        }
    }
}

impl Implicit {
    fn step(&mut self, set: &mut Constraints, state: &mut State<f64>, dt: f64) -> Result<(), StepperError> {
        if set.is_stale() {
            self.method.set_links(set.links().to_vec());
        }
        let inverse: Vec<f64> = self.body.mass.iter().map(|m| if *m > 0.0 { 1.0 / m } else { 0.0 }).collect();
        let (goal, rate) = set.link_goals(dt, &inverse, &state.position)?;
        self.method.set_goals(&goal, &rate);
        let still = vec![[0.0; 3]; inverse.len()];
        let place = state.position.clone();
        let input = StepInput {
            target_position: &place,
            target_velocity: &still,
            external_force: &self.external,
            dt,
            tolerance: self.tolerance,
            reactions: false,
        };
        let mut output = StepOutput::default();
        // the step undoes itself; what comes after it may fail too
        let before = set.has_local().then(|| (state.clone(), self.body.model.history()));
        let done = self.method.step(&mut self.body, self.solver.as_mut(), &input, state, &mut output);
        done.map_err(|e| match e {
            StepError::Link { source, .. } => set.named(source).into(),
            StepError::NotFinite { what, node, .. } => StepperError::NotFinite { what, node },
            e => StepperError::Implicit(e),
        })?;
        if let Some((kept, history)) = before {
            set.clear_forces();
            if let Err(e) = set.enforce(Scheme::ImplicitEuler, dt, &inverse, state) {
                *state = kept;
                self.body.model.restore(&history);
                return Err(e.into());
            }
        }
        set.take_forces(self.method.force());
        set.advance();
        Ok(())
    }
}
