//! Where flesh meets bone: which nodes hang on which bones, and where bones take them.

mod binding;
mod blend;
mod bone;
mod coarse;
mod depth;
mod follow;
mod jacobian;
mod joint_mass;
mod krylov;
mod monolithic;
mod pull;
mod region;
mod rows;
mod surface;
mod weight;

pub use binding::{BindError, BindSettings, Binding, BoneRule};
pub use blend::{BoneMotion, blend_point, blend_rotation};
pub use bone::{Bone, Nearest, Segment};
pub use joint_mass::{JointMasses, joint_masses, nearest_bone};
pub use monolithic::{Coupled, CoupledInput, Lead, Monolithic};
pub(crate) use pull::shortened;
pub use pull::{JointSpring, PointSpring};
pub use region::{NearBone, Region, RegionError, Selector, material_map};
