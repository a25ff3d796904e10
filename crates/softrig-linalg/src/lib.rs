//! The lowest floor of softrig: numbers, 3x3 blocks, sparse matrices and linear solvers.
//!
//! * [`Scalar`] is what data is made of (`f32`, `f64`), [`Lane`] what kernels compute with (one scalar, or several side by side).
//! * [`Vec3`] and [`Mat3`] are generic over [`Lane`]; bulk data crosses crates as slices of `[R; 3]`.
//! * [`BlockPattern`] and [`BlockCsr`] are the sparse matrices of three-dimensional elasticity: one 3x3 block per pair of nodes.
//! * [`Rows`] is a matrix that makes its rows when they are asked for.
//! * [`LinearSolver`] is the one face of all solvers: `prepare` once per pattern, `solve` once per system.
//! * [`par`] runs loops on threads so that results are bitwise equal for any number of them.
//! * [`Kernel`] and [`run_wide`] compile one loop body for every instruction set and run the widest one of the machine.
//!
//! This is the only crate of the workspace with `unsafe` code.

mod block;
mod constraint;
pub mod cubes;
mod lane;
pub mod par;
mod rows;
mod scalar;
mod scatter;
mod small;
pub mod solver;
mod stacked;
mod wide;

pub use block::{BlockCsr, BlockPattern};
pub use constraint::DofConstraints;
pub use cubes::{CubeMatrix, CubePattern};
pub use lane::{Lane, Wide};
pub use rows::{Rows, in_single};
pub use scalar::{Scalar, either};
pub use scatter::{CELLS, Scatter, add_four};
pub use small::{Mat3, Vec3};
pub use solver::{LinearSolver, LinearSystem, SolveError, SolveReport, Traffic};
pub use stacked::Stacked;
pub use wide::{Instructions, Kernel, run_wide, run_wide_with};
