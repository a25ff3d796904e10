//! Integration tests of the core crate, one binary: a module per topic.

mod support;

mod analytic;
mod couple;
mod golden;
mod mesh;
mod multigrid;
