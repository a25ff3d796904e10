//! Constraints that hold exactly at the end of every step, without a linear system [Gissler2006 §4].
//!
//! A scheme moves a node by c F for every force F on it in the step ([`crate::scheme::Gain`]). So from the unconstrained
//! result x^ of the step follows the force that was missing, and x^ + c F meets the constraint to rounding, whatever scheme made
//! x^. Forces of one constraint sum to zero (but for nails), so momentum is kept. A node may be in one active constraint only:
//! then no constraint undoes another. Two that share a node are an error with both names.
//!
//! Implicit steps of finite elements eliminate constraints instead ([`Constraints::eliminated`], [`softrig::integrate::Linked`]): the step
//! knows of them, and nodes may be in as many as can be met together.

mod error;
mod links;
mod ramp;
mod set;
mod solve;
mod surface;
mod work;

pub use error::ConstraintError;
pub use ramp::Progress;
pub use set::Constraints;
pub use solve::{carried_force, nail_force, points_to_point_forces, velocity_force};
pub use surface::{ClosestPoint, Surface};

/// Which constraint of a [`Constraints`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ConstraintId(pub u32);

/// Which surface of a [`Constraints`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct SurfaceId(pub u32);

/// What a constraint asks of the end of every step.
#[derive(Clone, Debug, PartialEq)]
pub enum Constraint {
    /// A node is at a place [Gissler2006 §4.1].
    Nail {
        /// Which node.
        node: u32,
        /// Where [m].
        goal: [f64; 3],
    },
    /// A node has a velocity: all that explicit Euler can be asked for.
    Velocity {
        /// Which node.
        node: u32,
        /// Its velocity [m/s].
        goal: [f64; 3],
    },
    /// Nodes are in one place, wherever that is [Gissler2006 §4.2].
    PointsToPoint {
        /// At least two nodes.
        nodes: Vec<u32>,
    },
    /// A node is at a fixed place of a line [Gissler2006 §4.3].
    PointToLine {
        /// Which node.
        node: u32,
        /// Ends of the line.
        carriers: [u32; 2],
        /// Weights of the ends [-]: in [0, 1], their sum 1. Here and below.
        weights: [f64; 2],
    },
    /// A node is at a fixed place of a triangle.
    PointToTriangle {
        /// Which node.
        node: u32,
        /// Corners of the triangle.
        carriers: [u32; 3],
        /// Weights of the corners [-].
        weights: [f64; 3],
    },
    /// A node is at a fixed place of a tetrahedron.
    PointToTetrahedron {
        /// Which node.
        node: u32,
        /// Corners of the tetrahedron.
        carriers: [u32; 4],
        /// Weights of the corners [-].
        weights: [f64; 4],
    },
    /// A node is on a surface and may slide there [Gissler2006 §4.4].
    PointToSurface {
        /// Which node.
        node: u32,
        /// Which surface.
        surface: SurfaceId,
    },
}

impl Constraint {
    /// Name of the kind, for messages.
    #[must_use]
    pub fn kind(&self) -> &'static str {
        match self {
            Self::Nail { .. } => "nail",
            Self::Velocity { .. } => "velocity",
            Self::PointsToPoint { .. } => "points-to-point",
            Self::PointToLine { .. } => "point-to-line",
            Self::PointToTriangle { .. } => "point-to-triangle",
            Self::PointToTetrahedron { .. } => "point-to-tetrahedron",
            Self::PointToSurface { .. } => "point-to-surface",
        }
    }

    /// All nodes it takes hold of, as far as they are known before a step.
    pub(crate) fn nodes(&self) -> Vec<u32> {
        match self {
            Self::Nail { node, .. } | Self::Velocity { node, .. } | Self::PointToSurface { node, .. } => vec![*node],
            Self::PointsToPoint { nodes } => nodes.clone(),
            Self::PointToLine { node, carriers, .. } => [&[*node][..], carriers].concat(),
            Self::PointToTriangle { node, carriers, .. } => [&[*node][..], carriers].concat(),
            Self::PointToTetrahedron { node, carriers, .. } => [&[*node][..], carriers].concat(),
        }
    }

    /// Weights of the carriers.
    pub(crate) fn weights(&self) -> &[f64] {
        match self {
            Self::PointToLine { weights, .. } => weights,
            Self::PointToTriangle { weights, .. } => weights,
            Self::PointToTetrahedron { weights, .. } => weights,
            _ => &[],
        }
    }
}
