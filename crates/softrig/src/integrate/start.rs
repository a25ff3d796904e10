//! The acceleration a motion starts with.

use super::implicit::finite;
use super::{State, StepError};
use crate::body::Body;
use crate::force::Increment;
use softrig_linalg::Scalar;

/// Sets the acceleration of a state from the balance of forces: M a = f_ext − f_int(x) − C v on free nodes, zero on prescribed
/// ones. Call it when a state is started or put somewhere, and when the set of prescribed nodes changes: Newmark carries the
/// acceleration from step to step, and a wrong one rings.
///
/// # Errors
/// [`StepError`] when lengths do not fit, something is not finite, or the body has a consistent mass (which would need a
/// solve); the state is unchanged then.
pub fn initial_acceleration<R: Scalar>(
    body: &mut Body<R>,
    external_force: &[[R; 3]],
    state: &mut State<R>,
) -> Result<(), StepError> {
    let n = body.mass.len();
    if [state.position.len(), state.velocity.len(), external_force.len()] != [n; 3] {
        return Err(StepError::Unsupported(format!("a state or force of another size than the body's {n} nodes")));
    }
    if body.consistent_mass.is_some() {
        return Err(StepError::Unsupported("the initial acceleration of a body with consistent mass".into()));
    }
    finite("position", state.time, &state.position)?;
    finite("velocity", state.time, &state.velocity)?;
    finite("external force", state.time, external_force)?;
    let mut force = vec![[R::zero(); 3]; n];
    body.model.linearise(&state.position);
    let velocity = Some(&state.velocity[..]);
    let increment = Increment { displacement: None, velocity, damping: body.stiffness_damping };
    body.model.force(&state.position, increment, &mut force);
    state.acceleration.resize(n, [R::zero(); 3]);
    for i in 0..n {
        let m = body.mass[i];
        let drag = body.drag[i] + body.mass_damping * m;
        state.acceleration[i] = if body.constraints.is_constrained(i) {
            [R::zero(); 3]
        } else {
            std::array::from_fn(|k| (external_force[i][k] - force[i][k] - drag * state.velocity[i][k]) / m)
        };
    }
    Ok(())
}
