//! What a step refuses before anything is changed.

use super::{Scheme, held};
use crate::body::Body;
use crate::integrate::{State, StepError, StepInput};
use softrig_linalg::{Scalar, par};

pub(super) fn check<R: Scalar>(
    body: &Body<R>,
    scheme: Scheme,
    input: &StepInput<'_, R>,
    state: &State<R>,
) -> Result<(), StepError> {
    let n = body.mass.len();
    let lengths = [
        ("positions", state.position.len()),
        ("velocities", state.velocity.len()),
        ("accelerations", state.acceleration.len()),
        ("target positions", input.target_position.len()),
        ("target velocities", input.target_velocity.len()),
        ("external forces", input.external_force.len()),
    ];
    if let Some((what, found)) = lengths.into_iter().find(|(_, len)| *len != n) {
        return Err(StepError::Unsupported(format!("{found} {what} for a body of {n} nodes; give one per node")));
    }
    if !(input.dt > 0.0 && input.dt.is_finite()) {
        return Err(StepError::Unsupported(format!("a time step of {} s; it must be positive", input.dt)));
    }
    if !(input.tolerance > 0.0 && input.tolerance < 1.0) {
        let t = input.tolerance;
        return Err(StepError::Unsupported(format!("a solver tolerance of {t}; it must be between 0 and 1")));
    }
    if let Scheme::Newmark { beta, gamma } = scheme
        && !(beta > 0.0 && beta <= 10.0 && (0.0..=10.0).contains(&gamma))
    {
        return Err(StepError::Unsupported(format!("Newmark with beta {beta}, gamma {gamma}; use 0.25 and 0.5")));
    }
    finite("position", state.time, &state.position)?;
    finite("velocity", state.time, &state.velocity)?;
    finite("acceleration", state.time, &state.acceleration)?;
    finite("external force", state.time, input.external_force)?;
    for (what, v) in [("target position", input.target_position), ("target velocity", input.target_velocity)] {
        let bad = |i: usize| body.constraints.is_constrained(i) && !held(body, i) && !is_finite(&v[i]);
        if let Some(node) = par::first(n, bad) {
            return Err(StepError::NotFinite { time: state.time, what, node });
        }
    }
    Ok(())
}

fn is_finite<R: Scalar>(v: &[R; 3]) -> bool {
    v.iter().all(|c| c.is_finite())
}

pub(in crate::integrate) fn finite<R: Scalar>(what: &'static str, time: f64, v: &[[R; 3]]) -> Result<(), StepError> {
    match par::first(v.len(), |i| !is_finite(&v[i])) {
        Some(node) => Err(StepError::NotFinite { time, what, node }),
        None => Ok(()),
    }
}
