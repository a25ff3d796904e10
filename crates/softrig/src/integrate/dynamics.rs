//! Presets of the time integration.

use super::{Guarded, Implicit, Integrator, Scheme};
use serde::{Deserialize, Serialize};
use softrig_linalg::{Scalar, either};

/// How flesh moves in time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Dynamics {
    /// Swings and bounces: Newmark with gamma .6, beta .3025 = (gamma + .5)² / 4 and two linearisations a step. The default:
    /// the liveliest setting that never exploded on a character; needs the materials' b of .005 s or so at low stiffness.
    #[default]
    Lively,
    /// Follows with little overshoot, about half the motion: implicit Euler with one linearisation a step. Half the work.
    Calm,
    /// Newmark with beta 1/4, gamma 1/2 and one linearisation, as printed in [Georgii2010]. Gains energy at interactive
    /// steps: expect the growth guard to step in.
    Paper,
}

impl Dynamics {
    /// All presets.
    pub const ALL: [Self; 3] = [Self::Lively, Self::Calm, Self::Paper];

    /// Name as written in scene files and on the command line.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Lively => "lively",
            Self::Calm => "calm",
            Self::Paper => "paper",
        }
    }

    /// The method without the growth guard.
    #[must_use]
    pub fn method<R: Scalar>(self) -> Implicit<R> {
        match self {
            Self::Lively => Implicit::new(Scheme::Newmark { beta: 0.3025, gamma: 0.6 }, 2),
            Self::Calm => Implicit::new(Scheme::ImplicitEuler, 1),
            Self::Paper => Implicit::new(Scheme::Newmark { beta: 0.25, gamma: 0.5 }, 1),
        }
    }

    /// The method inside the growth guard.
    #[must_use]
    pub fn integrator<R: Scalar>(self) -> Box<dyn Integrator<R>> {
        either(|| single(self), || double(self))
    }
}

fn single(dynamics: Dynamics) -> Box<dyn Integrator<f32>> {
    Box::new(Guarded::new(dynamics.method()))
}

fn double(dynamics: Dynamics) -> Box<dyn Integrator<f64>> {
    Box::new(Guarded::new(dynamics.method()))
}
