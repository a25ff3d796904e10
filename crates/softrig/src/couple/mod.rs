//! Where flesh meets bone: which nodes hang on which bones, and where bones take them.

mod binding;
mod blend;
mod bone;
mod depth;
mod region;
mod surface;
mod weight;

pub use binding::{BindError, BindSettings, Binding, BoneRule};
pub use blend::{BoneMotion, blend_point, blend_rotation};
pub use bone::{Bone, Nearest, Segment};
pub use region::{NearBone, Region, RegionError, Selector, material_map};
