//! Tests across the crate: the solvers against dense algebra, and what must never change with threads.

mod parity;
mod solver;
mod system;
