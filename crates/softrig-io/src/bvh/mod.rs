//! Motion capture in BVH files.
//!
//! A BVH file is a tree of joints with offsets, all joint frames parallel to the axes of the file at rest, and a table of
//! channels per frame. A joint's rotation is the product of its rotation channels in the order in which they are listed,
//! the first one outermost; its position channels, where it has any, replace its offset.

mod apply;
mod build;
mod parse;
mod roles;
mod write;

pub use apply::{apply_named, apply_to};
pub use write::to_text;

use crate::error::ImportError;
use crate::import::ImportOptions;
use crate::source::read_file;
use softrig::rig::{Clip, JointId, Skeleton};
use std::path::{Path, PathBuf};

/// A skeleton and its motion.
#[derive(Clone, Debug)]
pub struct Bvh {
    /// The file it is from.
    pub file: PathBuf,
    /// One joint per `ROOT` and `JOINT`, in the order of the file. Local transforms are in file units and axes;
    /// [`Skeleton::to_world`] takes them to metres, Y up. `Joint::rest` is the pose in which all channels are zero.
    pub skeleton: Skeleton,
    /// End sites: the joint each hangs on, and its offset in file units.
    pub tips: Vec<(JointId, [f64; 3])>,
    /// The motion; one key per frame, the first at 0 s.
    pub clip: Clip,
    /// Seconds between frames.
    pub frame_time: f64,
    /// Number of frames in `clip`.
    pub frame_count: usize,
    /// Whether the first frame is a pose that a conversion added: the motion jumps behind it.
    pub first_frame_jumps: bool,
    /// What was assumed, repaired or dropped, in plain words.
    pub notes: Vec<String>,
}

/// What to do with a first frame behind which the motion jumps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum FirstFrame {
    /// Leave it out: nobody moves 100 degrees in one frame.
    #[default]
    DropIfItJumps,
    /// Keep every frame of the file.
    Keep,
}

/// How to read a BVH file.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct BvhOptions {
    /// Unit, height and up axis, where the user knows them. Default: the unit in which the legs are those of a person 1.2 to 2.3 m tall, else
    /// of 1.7 m; up is where the head is during the motion.
    pub import: ImportOptions,
    /// What to do with a first frame that was added.
    pub first_frame: FirstFrame,
}

/// Reads a BVH file with default options.
///
/// # Errors
/// [`ImportError`].
pub fn read(path: &Path) -> Result<Bvh, ImportError> {
    read_with(path, &BvhOptions::default())
}

/// Reads a BVH file.
///
/// # Errors
/// [`ImportError`].
pub fn read_with(path: &Path, options: &BvhOptions) -> Result<Bvh, ImportError> {
    from_bytes(&read_file(path)?, path, options)
}

/// As [`read_with`], from bytes; `file` is only a name.
///
/// # Errors
/// [`ImportError`].
pub fn from_bytes(bytes: &[u8], file: &Path, options: &BvhOptions) -> Result<Bvh, ImportError> {
    build::build(parse::parse(bytes, file)?, file, options)
}
