//! Tests across the crate: the solvers against dense algebra, and what must never change with threads.

#![allow(clippy::unwrap_used, reason = "helpers of tests may fail loudly too")]

mod parity;
mod solver;
mod streamed;
mod system;
