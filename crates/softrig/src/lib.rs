//! Physical flesh for rigged characters.
//!
//! A skinned mesh, its skeleton and a clip go in; the character with volumetric soft tissue that follows the bones comes out.
//! Data flows one way:
//!
//! ```text
//! Character -> VolumeMesh -> Embedding -> Body -> Binding
//! per step:  Clip -> Pose -> targets -> Integrator -> LinearSolver -> State -> skin positions -> FrameSink
//! ```
//!
//! All quantities are SI units, Y is up. Floors: `mesh`, `rig`, `material`, `force`, `integrate` know nothing of each other's
//! business beyond what they import downwards; `couple` and `simulation` are where flesh meets bone.

pub mod body;
pub mod character;
pub mod constraint;
pub mod couple;
pub mod force;
pub mod frame;
pub mod integrate;
pub mod material;
pub mod mesh;
pub mod rig;
pub mod sample;
pub mod simulation;
