//! Force models: the internal force of a deformed body, and its stiffness.

mod assembly;
mod corotated;
mod hex;
mod incidence;
mod load;
pub mod polar;
mod stress;
mod stvk;
mod tet;

pub(crate) use assembly::LONGEST_ROW;
pub use assembly::{Diagonal, Increment};
pub(crate) use corotated::corotated;
pub use corotated::{Corotated, Rotations};
pub use hex::{QuadraturePoint, hex_points, hex_stiffness};
pub use stress::{CellStress, cell_stress};
pub use stvk::{StVenantKirchhoff, stvk_hessian};
pub use tet::tet_gradients;

use serde::{Deserialize, Serialize};
use softrig_linalg::{BlockCsr, CubeMatrix, CubePattern, Scalar, in_single};
use std::sync::Arc;

/// Which elasticity a body has.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum ElasticModel {
    /// Corotated linear elasticity: cheap, safe in every shape. The default.
    #[default]
    Corotated,
    /// Linear elasticity: no rotations. For checks; swells when it turns.
    Linear,
    /// St. Venant-Kirchhoff: exact for large rotations, for checks; collapses under strong compression.
    StVenantKirchhoff,
}

/// Internal force and stiffness of a body. Sign: f_int as on the left of `M a + C v + f_int(x) = f_ext`.
///
/// A model is linearised at a position first; force and stiffness are then those of that linearisation.
pub trait ForceModel<R: Scalar>: Send + Sync {
    /// Moves the linearisation point to `position` [m], one per node: rotations of cells, warm-started from the last call.
    fn linearise(&mut self, position: &[[R; 3]]);

    /// Writes `f_int(x) + K d + C v` [N] for every node into `force` (overwriting it), with `x` the point given to the last
    /// [`Self::linearise`], `K` its stiffness, `C = Σ b K` over the cells. Returns the elastic energy at `x` [J].
    fn force(&mut self, position: &[[R; 3]], increment: Increment<'_, R>, force: &mut [[R; 3]]) -> f64;

    /// [`Self::linearise`] and [`Self::force`], in one pass over the cells where a model can.
    fn linearise_and_force(&mut self, position: &[[R; 3]], increment: Increment<'_, R>, force: &mut [[R; 3]]) -> f64 {
        self.linearise(position);
        self.force(position, increment, force)
    }

    /// Whether any cell has a stiffness damping of its own; where none has and none is added, velocities need not be given.
    fn is_damped(&self) -> bool {
        true
    }

    /// Writes the sum of `(1 + rate (b + damping)) K` over all cells at the last linearisation point into `matrix`
    /// (overwriting it) [N/m]. `rate` [1/s] is what a unit of displacement changes the velocity by; 0 gives K.
    fn stiffness(&mut self, rate: R, damping: R, matrix: &mut BlockCsr<R>);

    /// Replaces x by the product with what [`Self::stiffness`] would write and a diagonal on top of it, one number per node, without the
    /// matrix, at the last linearisation point. Returns false, and does nothing, where a model cannot.
    fn product(&mut self, _rate: R, _damping: R, _diagonal: Diagonal<'_, R>, _x: &mut [[R; 3]]) -> bool {
        false
    }

    /// How many parts [`Self::stiffness_rows`] makes the rows in; 0 for models that only write all of them.
    fn row_parts(&self) -> usize {
        0
    }

    /// Hands the rows of a part of what [`Self::stiffness`] writes to `take`, one after the other: the node, and the blocks of its row in the order
    /// of the pattern, which `take` may change. Each row is in one part. Parts may be made on several threads at once.
    fn stiffness_rows(&self, _rate: R, _damping: R, _part: usize, _take: &mut dyn FnMut(usize, &mut [[R; 9]])) {}

    /// As [`Self::stiffness_rows`] for those who keep the rows in f32; a model may also sum them up in f32.
    fn stiffness_rows_in_single(&self, rate: R, damping: R, part: usize, take: &mut dyn FnMut(usize, &mut [[f32; 9]])) {
        let mut rounded = Vec::new();
        self.stiffness_rows(rate, damping, part, &mut |node, blocks| {
            take(node, in_single(blocks, &mut rounded));
        });
    }

    /// The cells as cubes, where that is what all of them are: then [`Self::cubes`] gives the stiffness without assembling it.
    fn cube_pattern(&self) -> Option<Arc<CubePattern>> {
        None
    }

    /// Writes what [`Self::stiffness`] writes as rotations and Lamé constants of cubes; the diagonal is left alone. Does
    /// nothing without a [`Self::cube_pattern`].
    fn cubes(&self, _rate: R, _damping: R, _matrix: &mut CubeMatrix<R>) {}

    /// Writes the rotation of the largest cell at each of these nodes at the last linearisation point, as a quaternion (x, y, z, w); zeros
    /// where there is none. Returns false, and does nothing, for models whose cells do not turn.
    fn rotations(&self, _node: &[u32], _out: &mut [[f32; 4]]) -> bool {
        false
    }

    /// Remembers the history for [`Self::roll_back`], without allocating. May round it to f32, the one that goes on as well as the one
    /// that is remembered, so that both lead to the same bits; so the next [`Self::linearise`] comes before forces and stiffness.
    fn save(&mut self);

    /// Puts back the history of the last [`Self::save`].
    fn roll_back(&mut self);

    /// What the next [`Self::linearise`] reads besides its argument: one quaternion (x, y, z, w) per cell, or nothing.
    fn history(&self) -> Vec<[R; 4]>;

    /// Writes [`Self::history`] into a list that is kept from frame to frame, without allocating once it is long enough.
    fn write_history(&self, out: &mut Vec<[R; 4]>) {
        *out = self.history();
    }

    /// Puts back what [`Self::history`] gave. A history of another length is ignored: the next linearisation starts cold.
    fn restore(&mut self, history: &[[R; 4]]);
}
