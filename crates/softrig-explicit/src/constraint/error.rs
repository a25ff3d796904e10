//! What can be wrong with a constraint.

/// Why a constraint was not accepted or cannot be met. Nothing has changed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ConstraintError {
    /// It names a node that does not exist.
    #[error("{kind} {id}: node {node} does not exist, there are {node_count}")]
    MissingNode {
        /// Kind of the constraint.
        kind: &'static str,
        /// Its number.
        id: u32,
        /// The node it names.
        node: u32,
        /// How many there are.
        node_count: usize,
    },
    /// A node is in it twice.
    #[error("{kind} {id}: node {node} is in it twice")]
    RepeatedNode {
        /// Kind of the constraint.
        kind: &'static str,
        /// Its number.
        id: u32,
        /// Which node.
        node: u32,
    },
    /// Fewer than two points are to be one.
    #[error("points-to-point {id}: {found} nodes; it needs at least two")]
    TooFewNodes {
        /// Its number.
        id: u32,
        /// How many it has.
        found: usize,
    },
    /// A weight is outside [0, 1], or their sum is not 1.
    #[error(
        "{kind} {id}: weights {weights:?} must be in [0, 1] and have the sum 1; project the point onto its carrier first"
    )]
    Weights {
        /// Kind of the constraint.
        kind: &'static str,
        /// Its number.
        id: u32,
        /// The weights.
        weights: Vec<f64>,
    },
    /// A goal is not a number.
    #[error("{kind} {id}: its goal {goal:?} is not finite")]
    NotFinite {
        /// Kind of the constraint.
        kind: &'static str,
        /// Its number.
        id: u32,
        /// The goal.
        goal: [f64; 3],
    },
    /// Two active constraints hold the same node.
    #[error(
        "node {node} is held by {first_kind} {first} and by {second_kind} {second}; local constraints must not share nodes: use another node, or switch one of them off"
    )]
    Conflict {
        /// The node.
        node: u32,
        /// Kind of the one that was there first.
        first_kind: &'static str,
        /// Its number.
        first: u32,
        /// Kind of the other.
        second_kind: &'static str,
        /// Its number.
        second: u32,
    },
    /// Constraints that are eliminated together have no solution.
    #[error("{names} contradict one another by {by:.3e} m; switch one of them off, or move its goal")]
    Contradiction {
        /// Kinds and numbers of all of them.
        names: String,
        /// How far they are from having one [m].
        by: f64,
    },
    /// Constraints cannot be eliminated.
    #[error(transparent)]
    Link(#[from] softrig::constraint::LinkError),
    /// A share of a force is no linear condition.
    #[error(
        "unsupported: {kind} {id} is eliminated, which has no force of which a part could act; use `approach` instead of `ramp`"
    )]
    ForceRamp {
        /// Kind of the constraint.
        kind: &'static str,
        /// Its number.
        id: u32,
    },
    /// None of the nodes of a constraint can be moved.
    #[error("{kind} {id}: none of its nodes has mass, so no force can meet it")]
    Immovable {
        /// Kind of the constraint.
        kind: &'static str,
        /// Its number.
        id: u32,
    },
    /// The surface has a rim.
    #[error(
        "the surface is open: {edges} edges have one triangle only (first: nodes {first:?}); close it, a node would slide off its rim"
    )]
    OpenSurface {
        /// How many edges.
        edges: usize,
        /// One of them.
        first: [u32; 2],
    },
    /// A triangle of a surface is not one.
    #[error("triangle {triangle} of the surface names nodes {nodes:?}; they must be different and below {node_count}")]
    BadTriangle {
        /// Which triangle.
        triangle: usize,
        /// Its nodes.
        nodes: [u32; 3],
        /// How many nodes there are.
        node_count: usize,
    },
    /// A surface without triangles.
    #[error("the surface has no triangles")]
    EmptySurface,
    /// There is no such constraint or surface.
    #[error("there is no {what} {id}")]
    Unknown {
        /// Constraint or surface.
        what: &'static str,
        /// Its number.
        id: u32,
    },
    /// Only nails and velocities have goals.
    #[error("{kind} {id} has no goal to move")]
    NoGoal {
        /// Kind of the constraint.
        kind: &'static str,
        /// Its number.
        id: u32,
    },
    /// The scheme cannot enforce it.
    #[error(
        "unsupported: `{scheme}` cannot enforce a {kind} ({kind} {id}): a force moves a node only one step later; use a velocity constraint or another scheme"
    )]
    Unsupported {
        /// Which scheme.
        scheme: &'static str,
        /// Kind of the constraint.
        kind: &'static str,
        /// Its number.
        id: u32,
    },
    /// The set was made for another body.
    #[error("the constraints are for {expected} nodes, the body has {found}")]
    NodeCount {
        /// Nodes of the set.
        expected: usize,
        /// Nodes of the body.
        found: usize,
    },
}
