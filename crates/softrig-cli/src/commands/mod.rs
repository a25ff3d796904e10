//! One module for each command.

pub mod bake;
pub mod bench;
pub mod completions;
pub mod convert;
pub mod demo;
pub mod inspect;
pub mod mesh;
pub mod papers;
pub mod render;
