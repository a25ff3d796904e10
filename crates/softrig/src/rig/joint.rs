//! What joints can do: kinds, limits, springs, and how far a clip leads them.

use super::skeleton::JointId;

/// Which turns a joint allows. Angles count from the rest shape.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum JointKind {
    /// Turns as the clip says and not otherwise.
    #[default]
    Fixed,
    /// Turns about one axis. What a clip turns about other axes is kept as it is.
    Hinge {
        /// In the joint's own frame at rest; of any length but zero.
        axis: [f64; 3],
        /// Least and greatest angle [rad], right-handed about the axis.
        range: [f64; 2],
    },
    /// Turns any way, its bone within a cone about its direction at rest, its twist about the bone within a range.
    Ball {
        /// Direction of the bone in the joint's own frame at rest; of any length but zero.
        axis: [f64; 3],
        /// Greatest angle between the bone and its direction at rest [rad].
        cone: f64,
        /// Least and greatest twist [rad].
        twist: [f64; 2],
    },
}

/// One joint of an articulated skeleton.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointSetup {
    /// Which turns it allows.
    pub kind: JointKind,
    /// How much a clip leads the joint, 0 to 1 [-]: 1 follows it exactly, 0 leaves the joint to flesh and gravity.
    pub drive: f64,
    /// Spring toward the clip's angle, on top of the drive [N m/rad].
    pub stiffness: f64,
    /// Damping of the motion relative to the clip's [N m s/rad].
    pub damping: f64,
}

impl Default for JointSetup {
    fn default() -> Self {
        Self { kind: JointKind::Fixed, drive: 1.0, stiffness: 0.0, damping: 0.0 }
    }
}

/// How the skeleton as a whole is held.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum RootKind {
    /// Its root moves and turns as the clip says.
    #[default]
    Driven,
    /// Its root is where the clip says, and turns as its joint allows.
    Pinned,
    /// Its root falls, flies and turns freely.
    Free,
}

/// Why joints cannot be set up.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum RigError {
    /// There is not one setup per joint.
    #[error("{found} joint setups for a skeleton of {expected} joints; give one for each")]
    Count {
        /// Length of the list.
        found: usize,
        /// Joints of the skeleton.
        expected: usize,
    },
    /// An axis has no direction.
    #[error("joint `{joint}`: its axis is zero or no number; give the direction it turns about, such as [1, 0, 0]")]
    Axis {
        /// Name of the joint.
        joint: String,
    },
    /// A range of angles does not make sense.
    #[error("joint `{joint}`: {what} from {low:.3} to {high:.3} rad leaves out the rest pose (0); widen it")]
    ExcludesRest {
        /// Name of the joint.
        joint: String,
        /// Which range.
        what: &'static str,
        /// Its lower end [rad].
        low: f64,
        /// Its upper end [rad].
        high: f64,
    },
    /// A number is out of its range.
    #[error("joint `{joint}`: {what} is {value}; {expected}")]
    Value {
        /// Name of the joint.
        joint: String,
        /// Which number.
        what: &'static str,
        /// What it is.
        value: f64,
        /// What it must be.
        expected: &'static str,
    },
    /// The joint cannot be turned without stretching what hangs on it.
    #[error("joint `{joint}` cannot move: {reason}; make it `fixed`")]
    Unmovable {
        /// Name of the joint.
        joint: String,
        /// Why.
        reason: &'static str,
    },
    /// A root that is none.
    #[error("joint {0:?} is no joint of the skeleton")]
    NoSuchJoint(JointId),
}

impl JointSetup {
    /// Checks the numbers and makes axes unit vectors.
    pub(super) fn checked(mut self, joint: &str) -> Result<Self, RigError> {
        use std::f64::consts::PI;
        let value = |what, value, expected| Err(RigError::Value { joint: joint.into(), what, value, expected });
        if !(0.0..=1.0).contains(&self.drive) {
            return value("drive", self.drive, "it must be between 0 and 1");
        }
        for (what, v) in [("stiffness", self.stiffness), ("damping", self.damping)] {
            if !(0.0..=1e12).contains(&v) {
                return value(what, v, "it must be 0 or more");
            }
        }
        let unit = |axis: &mut [f64; 3]| match glam::DVec3::from(*axis).try_normalize() {
            Some(a) if a.is_finite() => {
                *axis = a.into();
                Ok(())
            }
            _ => Err(RigError::Axis { joint: joint.into() }),
        };
        let around = |what, [low, high]: [f64; 2]| match low <= 0.0 && high >= 0.0 {
            true => Ok(()),
            false => Err(RigError::ExcludesRest { joint: joint.into(), what, low, high }),
        };
        match &mut self.kind {
            JointKind::Fixed => {}
            JointKind::Hinge { axis, range } => {
                unit(axis)?;
                around("the angle", *range)?;
                *range = [range[0].max(-PI), range[1].min(PI)];
            }
            JointKind::Ball { axis, cone, twist } => {
                unit(axis)?;
                if cone.is_nan() || *cone < 0.0 {
                    return value("cone", *cone, "it must be 0 or more");
                }
                around("the twist", *twist)?;
                *cone = cone.min(PI);
                *twist = [twist[0].max(-PI), twist[1].min(PI)];
            }
        }
        Ok(self)
    }
}
