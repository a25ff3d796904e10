//! Which nodes a linear system may not move.

/// Nodes whose three unknowns are prescribed: their rows and columns are eliminated from the system.
///
/// The right-hand side and the solution of a constrained node are zero: prescribed displacements enter through the right-hand
/// side of their neighbours before the solve [Georgii2010 §3.1].
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct DofConstraints {
    constrained: Vec<bool>,
    count: usize,
}

impl DofConstraints {
    /// Nobody is constrained.
    #[must_use]
    pub fn none(node_count: usize) -> Self {
        Self { constrained: vec![false; node_count], count: 0 }
    }

    /// `mask[node]` is true where the node is prescribed; `mask.len()` is the number of nodes.
    #[must_use]
    pub fn from_mask(mask: Vec<bool>) -> Self {
        let count = mask.iter().filter(|c| **c).count();
        Self { constrained: mask, count }
    }

    /// Is this node prescribed?
    #[inline(always)]
    #[must_use]
    pub fn is_constrained(&self, node: usize) -> bool {
        self.constrained[node]
    }

    /// One flag per node.
    #[must_use]
    pub fn mask(&self) -> &[bool] {
        &self.constrained
    }

    /// Number of prescribed nodes.
    #[must_use]
    pub fn constrained_count(&self) -> usize {
        self.count
    }

    /// The nodes that are not prescribed, ascending.
    #[must_use]
    pub fn free_nodes(&self) -> Vec<u32> {
        (0..self.constrained.len() as u32).filter(|n| !self.constrained[*n as usize]).collect()
    }

    /// Number of nodes, prescribed or free.
    #[must_use]
    pub fn node_count(&self) -> usize {
        self.constrained.len()
    }
}
