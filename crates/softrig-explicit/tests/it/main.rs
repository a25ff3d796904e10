//! Integration tests of the explicit side, one binary: a module per topic.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed; helpers count as tests")]

mod constraint;
mod elastic;
#[allow(non_snake_case, reason = "symbols of [Gissler2006]")]
mod gissler;
#[allow(non_snake_case, reason = "symbols of linear algebra")]
mod linked;
mod mass_point;
mod modal;
mod order;
mod skeleton;
mod speed;
