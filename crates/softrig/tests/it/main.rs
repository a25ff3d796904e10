//! Integration tests of the core crate, one module per topic.

mod mesh;
