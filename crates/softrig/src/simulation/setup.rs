//! Setting a coupling and its events, checked before anything moves.

use super::Simulation;
use super::coupling::{CoupledState, Coupling, TwoWay, TwoWayScheme};
use super::event::{Action, Event, Key};
use super::staggered::Staggered;
use crate::rig::{JointKind, RigError};
use softrig_linalg::Scalar;

/// Why a coupling cannot be set up.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum CoupleError {
    /// The joints do not make sense.
    #[error(transparent)]
    Rig(#[from] RigError),
    /// The scheme cannot do what was asked.
    #[error("unsupported: {0}")]
    Unsupported(String),
    /// An event does not make sense.
    #[error("event {number}: {reason}")]
    Event {
        /// Which one, from 1.
        number: usize,
        /// Why not, and what to change.
        reason: String,
    },
}

impl<R: Scalar> Simulation<R> {
    /// Sets who moves whom, and what happens on the way. Call it before [`Self::start`].
    ///
    /// # Errors
    /// [`CoupleError`]; nothing has changed then.
    pub fn couple(&mut self, coupling: &Coupling, events: Vec<Event>) -> Result<(), CoupleError> {
        if *coupling == Coupling::OneWay && events.is_empty() {
            self.coupled = None;
            return Ok(());
        }
        for (k, event) in events.iter().enumerate() {
            let wrong = |reason: String| CoupleError::Event { number: k + 1, reason };
            self.check_event(event, *coupling == Coupling::OneWay).map_err(wrong)?;
        }
        if let Coupling::TwoWay(two) = coupling {
            self.check_scheme(two)?;
        }
        let state =
            CoupledState::new(&self.skeleton, &self.binding, &self.body.mesh, &self.body.mass, coupling, events)?;
        let mut state = state;
        if let Coupling::TwoWay(TwoWay { scheme: TwoWayScheme::Staggered, .. }) = coupling {
            state.staggered = Some(Staggered::new(self));
        }
        self.coupled = Some(Box::new(state));
        Ok(())
    }

    /// The staggered scheme has goals for joints, but no torques about them.
    fn check_scheme(&self, two: &TwoWay) -> Result<(), CoupleError> {
        if two.scheme != TwoWayScheme::Staggered {
            return Ok(());
        }
        let sprung = |s: &crate::rig::JointSetup| s.kind != JointKind::Fixed && (s.stiffness > 0.0 || s.damping > 0.0);
        match two.joints.iter().position(sprung) {
            Some(j) => Err(CoupleError::Unsupported(format!(
                "joint `{}` has a spring or damping, which the staggered scheme cannot apply; use the monolithic one",
                self.skeleton.joints().get(j).map_or("", |j| &j.name)
            ))),
            None => Ok(()),
        }
    }

    fn check_event(&self, event: &Event, one_way: bool) -> Result<(), String> {
        let number = |v: &f64| v.is_finite() && v.abs() < 1e6;
        if !(event.start.is_finite() && event.end > event.start) {
            return Err(format!("it lasts from {} s to {} s; it must end after it starts", event.start, event.end));
        }
        let path = |path: &[Key]| {
            if !path.iter().all(|k| number(&k.time) && k.position.iter().all(number)) {
                return Err("a key of its path is no number, or further than 1000 km".to_owned());
            }
            if path.windows(2).any(|w| w[1].time < w[0].time) {
                return Err("the keys of its path are not in the order of time".to_owned());
            }
            Ok(())
        };
        let spring = |s: &Option<f64>| match s {
            Some(s) if !(*s > 0.0 && *s <= 1e9) => Err(format!("its stiffness is {s} N/m; it must be above 0")),
            _ => Ok(()),
        };
        let point = |mesh: usize, vertex: usize| match self.skin.point(mesh, vertex) {
            Some(_) => Ok(()),
            None => Err(format!("vertex {vertex} of mesh {mesh} is not there, or no flesh carries it")),
        };
        match &event.action {
            Action::DragJoint { joint, path: keys, stiffness } => {
                if one_way {
                    return Err("it drags a joint, which the clip alone moves; make the coupling two-way".into());
                }
                if joint.index() >= self.skeleton.joint_count() {
                    return Err(format!("there is no joint {}", joint.0));
                }
                path(keys).and(spring(stiffness))
            }
            Action::PullFlesh { mesh, vertex, path: keys, stiffness } => {
                path(keys).and(spring(stiffness)).and(point(*mesh, *vertex))
            }
            Action::Force { mesh, vertex, force } => {
                if !force.iter().all(number) {
                    return Err("its force is no number, or above 1e6 N".into());
                }
                point(*mesh, *vertex)
            }
            Action::Gravity(v) | Action::Wind(v) => {
                if v.iter().all(number) {
                    Ok(())
                } else {
                    Err("its vector is no number, or above 1e6".into())
                }
            }
        }
    }
}
