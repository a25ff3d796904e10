//! Skeletons, poses and clips. Everything here is f64 and knows nothing of meshes.

mod affine;
mod clip;
mod skeleton;

pub use affine::{Affine, Transform};
pub use clip::{Clip, Interpolation, Property, Track};
pub use skeleton::{Joint, JointId, Pose, Skeleton, SkeletonError};
