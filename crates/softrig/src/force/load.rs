//! Which forces of the cells are asked for. `tet.rs` and `hex.rs` say what each of them is for their cells.

use super::assembly::Increment;

/// `f_int(x) + K d + C v`, and the energy at x.
#[derive(Clone, Copy)]
pub(super) struct Internal<'a, R> {
    /// x [m], one per node.
    pub position: &'a [[R; 3]],
    pub increment: Increment<'a, R>,
    /// Whether the rotations of cells follow their deformation.
    pub rotate: bool,
}

/// `(1 + rate (b + damping)) K x`, and no energy.
#[derive(Clone, Copy)]
pub(super) struct Product<'a, R> {
    /// Any vectors, one per node.
    pub x: &'a [[R; 3]],
    pub rate: R,
    pub damping: R,
}
