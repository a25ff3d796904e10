//! Integration tests of the core crate, one binary: a module per topic.

mod support;

mod analytic;
mod golden;
mod mesh;
