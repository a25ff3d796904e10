//! What the integrators of this crate are given with every step: frames of the nodes, and lists that must fit.

use glam::{DQuat, DVec3};
use softrig::integrate::{NodeFrame, State, StepError, StepInput};
use softrig_linalg::Scalar;

/// Where skinning has the nodes at both ends of a step; empty without it.
#[derive(Clone, Debug, Default)]
pub(crate) struct Frames([Vec<NodeFrame>; 2]);

impl Frames {
    /// Takes those of the coming step.
    pub fn carry(&mut self, before: &[NodeFrame], after: &[NodeFrame]) {
        for (to, from) in self.0.iter_mut().zip([before, after]) {
            to.clear();
            to.extend_from_slice(from);
        }
    }

    /// Whether every node of a body has them.
    pub fn fit(&self, node_count: usize) -> bool {
        self.0.iter().all(|f| f.len() == node_count)
    }

    /// Place [m] and turn at the start of the step.
    pub fn start(&self, node: usize) -> (DVec3, DQuat) {
        frame(&self.0[0][node])
    }

    /// Place [m] and turn at the end of the step.
    pub fn end(&self, node: usize) -> (DVec3, DQuat) {
        frame(&self.0[1][node])
    }

    /// Place [m], turn and velocity [m/s] at a part of a step of `dt` [s].
    pub fn between(&self, node: usize, share: f64, dt: f64) -> (DVec3, DQuat, DVec3) {
        let ((p, from), (q, to)) = (self.start(node), self.end(node));
        (p + (q - p) * share, from.lerp(to, share), (q - p) / dt)
    }
}

fn frame(f: &NodeFrame) -> (DVec3, DQuat) {
    (DVec3::from(f.place), DQuat::from_array(f.turn))
}

/// Refuses a step whose lists are not those of a body of so many nodes, or hold what is not a number.
pub(crate) fn check<R: Scalar>(node_count: usize, input: &StepInput<'_, R>, state: &State<R>) -> Result<(), StepError> {
    let lists = [
        ("position", &state.position[..]),
        ("velocity", &state.velocity),
        ("external force", input.external_force),
        ("target position", input.target_position),
        ("target velocity", input.target_velocity),
    ];
    if !(input.dt > 0.0 && input.dt.is_finite()) {
        return Err(StepError::Unsupported(format!("a time step of {} s", input.dt)));
    }
    for (what, list) in lists {
        if list.len() != node_count {
            let text = format!(
                "a state or input of another size than the body's {node_count} nodes: {} of {what}",
                list.len()
            );
            return Err(StepError::Unsupported(text));
        }
        if let Some(node) = list.iter().position(|v| !v.iter().all(|c| c.is_finite())) {
            return Err(StepError::NotFinite { time: state.time, what, node });
        }
    }
    Ok(())
}
