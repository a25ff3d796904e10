//! Skeletons, poses, clips, joints that move by themselves. Everything here is f64 and knows nothing of meshes.

mod affine;
mod articulation;
mod automatic;
mod clip;
pub(crate) mod dense;
pub mod ik;
mod joint;
pub(crate) mod limited;
pub(crate) mod rotation;
mod skeleton;

pub use affine::{Affine, Transform};
pub use articulation::{Articulation, Base, Column, Configuration, Entry, EntryKind, Limit, Value};
pub use automatic::{Choice, automatic};
pub use clip::{Clip, Interpolation, Property, Track};
pub use joint::{JointKind, JointSetup, RigError, RootKind};
pub use skeleton::{Joint, JointId, Pose, Skeleton, SkeletonError};
