//! What can go wrong while making a picture.

use std::path::PathBuf;

/// Why there is no picture.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RenderError {
    /// The size is zero, or larger than memory allows for.
    #[error(
        "a picture of {width} x {height} pixels with {samples} x {samples} samples cannot be drawn; choose 1 to {limit} pixels a side and 1 to 8 samples"
    )]
    Size {
        /// Pixels across.
        width: u32,
        /// Pixels down.
        height: u32,
        /// Samples per pixel along each axis.
        samples: u32,
        /// Largest number of pixels a side.
        limit: u32,
    },
    /// An index or the length of an attribute does not fit the mesh.
    #[error("mesh {mesh} of the scene: {what}")]
    Mesh {
        /// Its place in [`crate::Scene::meshes`].
        mesh: usize,
        /// What does not fit.
        what: String,
    },
    /// The camera looks from nowhere: a number is not finite, or the distance or the angle is not positive.
    #[error("the camera is not usable: {0}")]
    Camera(&'static str),
    /// Frames of one animation differ in size.
    #[error(
        "frame {frame} is {width} x {height} pixels, but the animation is {expected_width} x {expected_height}; draw all frames in one size"
    )]
    FrameSize {
        /// Number of the frame, from 0.
        frame: usize,
        /// Its width.
        width: u32,
        /// Its height.
        height: u32,
        /// Width of the first frame.
        expected_width: u32,
        /// Height of the first frame.
        expected_height: u32,
    },
    /// Nothing to put together.
    #[error("no picture was given")]
    Empty,
    /// The file system refused.
    #[error("cannot write {path}: {source}; check that the folder exists, may be written, and has room")]
    Write {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
}
