//! Modes of a character: deviations from skinning, in the lowest modes of the body with its bound nodes held.
//!
//! x = s + R Φ q with the place s and turn R that skinning gives a node. What the frame's own acceleration does to the modes is in the
//! projection of the velocity: relative to the frame's velocity of the coming step, so a bone that speeds up throws the flesh back.
//! Nothing but the state is kept from step to step.

use super::{ModalError, ModalIntegrator};
use crate::frames::{Frames, check};
use glam::DVec3;
use softrig::body::Body;
use softrig::integrate::{Integrator, NodeFrame, State, StepError, StepInput, StepOutput};
use softrig_linalg::{LinearSolver, Scalar};

/// A body in its lowest modes, carried by skinning.
pub struct CarriedModes {
    modes: ModalIntegrator,
    frames: Frames,
    /// Deviations from the rest shape, and forces, in the frames of the nodes.
    local: State<f64>,
    load: Vec<[f64; 3]>,
}

impl CarriedModes {
    /// The lowest `count` modes of a body with its prescribed nodes held; `damping` are the Rayleigh coefficients a [1/s] and b [s].
    ///
    /// # Errors
    /// [`ModalError`].
    pub fn new<R: Scalar>(body: &mut Body<R>, count: usize, damping: (f64, f64)) -> Result<Self, ModalError> {
        let modes = ModalIntegrator::new(body, count, damping)?;
        let load = vec![[0.0; 3]; body.mesh.node_count()];
        let local = State::at_rest(body.mesh.nodes.clone());
        Ok(Self { modes, frames: Frames::default(), local, load })
    }
}

impl<R: Scalar> Integrator<R> for CarriedModes {
    fn name(&self) -> &'static str {
        "modal"
    }

    fn is_carried(&self) -> bool {
        true
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
        let (n, rest) = (body.mass.len(), &body.mesh.nodes);
        check(n, input, state)?;
        if !self.frames.fit(n) {
            return Err(StepError::Unsupported("modes without the frame of every node".into()));
        }
        let three = |v: [R; 3]| DVec3::from(v.map(Scalar::to_f64));
        for i in 0..n {
            let ((s, turn), (next, _)) = (self.frames.start(i), self.frames.end(i));
            let back = turn.conjugate();
            let speed = (next - s) / input.dt;
            self.local.position[i] = (DVec3::from(rest[i]) + back * (three(state.position[i]) - s)).into();
            self.local.velocity[i] = (back * (three(state.velocity[i]) - speed)).into();
            self.load[i] = (back * three(input.external_force[i])).into();
        }
        self.modes.set_state(body, &self.local);
        self.modes.advance(input.dt, &self.load, &mut self.local.position, &mut self.local.velocity);
        for i in 0..n {
            let ((s, _), (next, turn)) = (self.frames.start(i), self.frames.end(i));
            let held = body.constraints.is_constrained(i);
            let (x, v) = if held && body.mass[i] > R::zero() {
                (three(input.target_position[i]), three(input.target_velocity[i]))
            } else {
                let d = DVec3::from(self.local.position[i]) - DVec3::from(rest[i]);
                (next + turn * d, (next - s) / input.dt + turn * DVec3::from(self.local.velocity[i]))
            };
            state.position[i] = x.to_array().map(R::from_f64);
            state.velocity[i] = v.to_array().map(R::from_f64);
        }
        state.time += input.dt;
        // held nodes: what the modes pull them with is not resolved
        output.reaction.clear();
        output.reaction.resize(n, [R::zero(); 3]);
        (output.elastic_energy, output.kinetic_energy) = self.modes.energies();
        output.substeps = 1;
        (output.iterations, output.residual, output.converged, output.guarded) = (0, 0.0, true, false);
        Ok(())
    }
}
