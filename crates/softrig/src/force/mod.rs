//! Force models: the internal force of a deformed body, and its stiffness.

use softrig_linalg::{BlockCsr, Scalar};

/// Internal force and stiffness of a body. Sign: f_int as on the left of `M a + C v + f_int(x) = f_ext`.
///
/// A model is linearised at a position first; force and stiffness are then those of that linearisation.
pub trait ForceModel<R: Scalar>: Send {
    /// Moves the linearisation point to `position` [m], one per node: rotations of cells, warm-started from the last call.
    fn linearise(&mut self, position: &[[R; 3]]);

    /// Writes `f_int(x) + K y` [N] for every node into `force` (overwriting it), with `x` the point given to the last
    /// [`Self::linearise`], `K` its stiffness and `y` an optional displacement [m]. Returns the elastic energy at `x` [J].
    fn force(&mut self, position: &[[R; 3]], displacement: Option<&[[R; 3]]>, force: &mut [[R; 3]]) -> f64;

    /// Writes `K` at the last linearisation point into `matrix` (overwriting it) [N/m].
    fn stiffness(&mut self, matrix: &mut BlockCsr<R>);

    /// What the next [`Self::linearise`] reads besides its argument: one quaternion (x, y, z, w) per cell, or nothing.
    fn history(&self) -> Vec<[R; 4]>;

    /// Puts back what [`Self::history`] gave. A history of another length is ignored: the next linearisation starts cold.
    fn restore(&mut self, history: &[[R; 4]]);
}
