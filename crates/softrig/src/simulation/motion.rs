//! What drives the bones: a pose for every time.

use crate::rig::{Clip, Pose, Skeleton, Transform};

/// Gives the pose of the skeleton at any time.
pub trait Motion: Sync {
    /// World frames of all joints at `time` [s] since the first frame.
    fn pose(&self, time: f64) -> Pose;

    /// As [`Self::pose`], into a pose that is kept; `locals` is scratch memory.
    fn pose_into(&self, time: f64, _locals: &mut Vec<Transform>, pose: &mut Pose) {
        *pose = self.pose(time);
    }
}

/// A clip, played from its first key.
#[derive(Clone, Copy, Debug)]
pub struct ClipMotion<'a> {
    /// The skeleton it moves.
    pub skeleton: &'a Skeleton,
    /// What to play; `None` holds the file's own pose.
    pub clip: Option<&'a Clip>,
    /// Clip seconds per second [-].
    pub speed: f64,
}

impl<'a> ClipMotion<'a> {
    /// A clip at its own speed.
    #[must_use]
    pub fn new(skeleton: &'a Skeleton, clip: &'a Clip) -> Self {
        Self { skeleton, clip: Some(clip), speed: 1.0 }
    }

    /// Length when played [s].
    #[must_use]
    pub fn duration(&self) -> f64 {
        self.clip.map_or(0.0, |c| c.duration() / self.speed)
    }

    /// Frames at `fps`: both ends of the clip have one.
    #[must_use]
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a frame count, bounded below by 1")]
    pub fn frame_count(&self, fps: f64) -> usize {
        // a clip of 2 s at 30 frames a second has 61 frames, whatever its keys lost to rounding
        (self.duration() * fps + 1e-6).floor().max(0.0) as usize + 1
    }
}

impl Motion for ClipMotion<'_> {
    fn pose(&self, time: f64) -> Pose {
        match self.clip {
            Some(clip) => self.skeleton.pose(&clip.sample(self.skeleton, clip.start + time * self.speed)),
            None => self.skeleton.pose(&self.skeleton.rest_locals()),
        }
    }

    fn pose_into(&self, time: f64, locals: &mut Vec<Transform>, pose: &mut Pose) {
        let Some(clip) = self.clip else {
            *pose = self.pose(time);
            return;
        };
        clip.sample_into(self.skeleton, clip.start + time * self.speed, locals);
        self.skeleton.pose_into(locals, pose);
    }
}

/// The rest (bind) pose, for ever.
#[derive(Clone, Copy, Debug)]
pub struct RestMotion<'a>(pub &'a Skeleton);

impl Motion for RestMotion<'_> {
    fn pose(&self, _: f64) -> Pose {
        Pose { world: self.0.joints().iter().map(|j| j.rest).collect() }
    }
}
