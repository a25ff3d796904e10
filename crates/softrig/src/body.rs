//! A body: a volume mesh with materials, mass, a force model and prescribed nodes.

use crate::force::ForceModel;
use crate::mesh::VolumeMesh;
use softrig_linalg::{BlockPattern, DofConstraints};
use std::sync::Arc;

/// Everything about flesh that does not change from step to step, and the force model's history.
pub struct Body<R> {
    /// Rest shape.
    pub mesh: VolumeMesh,
    /// Lumped mass of each node [kg].
    pub mass: Vec<R>,
    /// Mass-proportional damping a [1/s].
    pub mass_damping: R,
    /// Stiffness-proportional damping b [s].
    pub stiffness_damping: R,
    /// Internal forces and stiffness.
    pub model: Box<dyn ForceModel<R>>,
    /// Which nodes are prescribed.
    pub constraints: DofConstraints,
    /// Where the blocks of the stiffness matrix are.
    pub pattern: Arc<BlockPattern>,
}
