//! Integration tests of the core crate, one binary: a module per topic.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed; helpers count as tests")]

mod support;

mod analytic;
mod balance;
mod chain;
mod couple;
mod cycles;
mod exchange;
mod goals;
mod golden;
mod hard;
mod lead;
mod mesh;
mod multigrid;
mod odd_rigs;
mod rig;
mod staggered;
mod twoway;
mod undone;
