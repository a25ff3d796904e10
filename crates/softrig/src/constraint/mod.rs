//! Linear conditions between nodes, met by elimination: nails, joints, points on lines, triangles and tetrahedra.
//!
//! A [`Link`] is Σ w x = g, with the same weights for x, y and z. [`Elimination`] solves a list of them for as many dependent nodes,
//!   x_s = Σ w x_i + o,
//! so that x = T y + o with y the other nodes, and a system A x = b becomes Tᵀ A T y = Tᵀ (b − A o) ([`Reduced`]): symmetric, positive
//! definite, and none of its solutions breaks a condition by more than rounding. Nodes may be in any number of links; links that follow
//! from others are dropped, links that contradict others are an error with the names of all of them.

mod elimination;
mod reduced;

pub use elimination::Elimination;
pub use reduced::Reduced;
pub(crate) use reduced::Within;

/// A condition Σ w x = g on the places of nodes; the goal g is given apart, since it may move.
#[derive(Clone, Debug, PartialEq)]
pub struct Link {
    /// Nodes with their weights w [-]; each node once.
    pub terms: Vec<(u32, f64)>,
    /// What an error calls it.
    pub label: u32,
}

/// Why links cannot be met. Nothing has changed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum LinkError {
    /// A link names a node that does not exist, twice, or with a weight that is not a number.
    #[error("link {label}: {what} (node {node}, of {node_count})")]
    BadTerm {
        /// Label of the link.
        label: u32,
        /// What is wrong.
        what: &'static str,
        /// The node it names.
        node: u32,
        /// How many nodes there are.
        node_count: usize,
    },
    /// A goal is missing or not a number.
    #[error("link {label}: its goal is not finite, or missing")]
    BadGoal {
        /// Label of the link.
        label: u32,
    },
    /// Together these links have no solution.
    #[error("links {labels:?} contradict one another by {by:.3e} m; switch one of them off, or move its goal")]
    Conflict {
        /// Labels of the links, ascending; none can be left out.
        labels: Vec<u32>,
        /// How far they are from having one [m].
        by: f64,
    },
    /// Nodes hang on so many others that elimination would fill the matrix.
    #[error(
        "links chain {terms} terms onto {node_count} nodes, too many to eliminate; use fewer links that hang on one another"
    )]
    TooDense {
        /// Terms of all dependent nodes.
        terms: usize,
        /// How many nodes there are.
        node_count: usize,
    },
}
