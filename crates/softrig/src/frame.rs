//! What comes out, frame by frame.

use crate::rig::Pose;

/// One finished frame. Positions are in the world, metres, Y up; writers convert to the file's own space.
#[derive(Clone, Copy, Debug)]
pub struct Frame<'a> {
    /// Number of the frame, from 0.
    pub index: usize,
    /// Time since the first frame [s].
    pub time: f64,
    /// Skin of each mesh of the character, in the file's own vertex order [m].
    pub skin: &'a [Vec<[f64; 3]>],
    /// The skeleton.
    pub pose: &'a Pose,
    /// The volume mesh's nodes [m].
    pub nodes: &'a [[f64; 3]],
    /// Force the flesh exerts on each joint's bone [N], one per joint of the skeleton; zero where no node is bound.
    pub joint_force: &'a [[f64; 3]],
}

/// Takes frames as they are finished: a cache file, a viewer, your program.
pub trait FrameSink {
    /// What can go wrong.
    type Error: std::error::Error;

    /// Takes one frame.
    ///
    /// # Errors
    /// Whatever the sink cannot do with it; frames taken before stay valid.
    fn frame(&mut self, frame: &Frame<'_>) -> Result<(), Self::Error>;
}
