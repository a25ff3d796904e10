//! Tests of the public face of softrig-io, on real files where `shared/data` is present.

#![allow(clippy::unwrap_used, reason = "a failing unwrap is a failing test")]

mod bad;
mod bvh;
mod export;
mod gltf;
mod gltf_made;
mod gltf_mutated;
mod gltf_reference;
mod journal;
mod made;
mod shared;
mod surface;
mod volume;
