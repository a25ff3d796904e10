//! Bones to nodes: where a pose puts every node, and how far a body may be moved in one step.

use crate::character::bone_map;
use crate::couple::{Binding, BoneMotion, blend_point, blend_rotation};
use crate::integrate::NodeFrame;
use crate::rig::{Pose, Skeleton};
use glam::{DQuat, DVec3};

/// A pose of the skeleton, as the motions of the bones.
#[derive(Default)]
pub(super) struct Drive {
    pub motions: Vec<BoneMotion>,
}

impl Drive {
    pub fn new(skeleton: &Skeleton, binding: &Binding, pose: &Pose) -> Self {
        let mut drive = Self::default();
        drive.set(skeleton, binding, pose);
        drive
    }

    /// Takes another pose; the memory is kept.
    pub fn set(&mut self, skeleton: &Skeleton, binding: &Binding, pose: &Pose) {
        self.motions.clear();
        self.motions.extend(binding.bones.iter().map(|b| {
            let joint = skeleton.joint(b.joint);
            BoneMotion::new(&bone_map(joint, &pose.world[b.joint.index()]), joint.rest.translation)
        }));
    }

    /// Where blended skinning puts node `n`, resting at `rest` [m].
    pub fn node(&self, binding: &Binding, n: usize, rest: [f64; 3]) -> [f64; 3] {
        blend_point(&self.motions, binding.blend(n), rest)
    }

    /// Rotation of the flesh at node `n` since the rest shape.
    pub fn rotation(&self, binding: &Binding, n: usize) -> DQuat {
        DQuat::from_array(blend_rotation(&self.motions, binding.blend(n)))
    }

    /// Writes where blended skinning has every node of a body that rests at `rest` [m], and how it is turned there.
    pub fn frames(&self, binding: &Binding, rest: &[[f64; 3]], out: &mut Vec<NodeFrame>) {
        out.clear();
        out.extend(rest.iter().enumerate().map(|(n, p)| NodeFrame {
            place: self.node(binding, n, *p),
            turn: blend_rotation(&self.motions, binding.blend(n)),
        }));
    }

    /// Largest rotation of a bone from `self` to `next` [rad].
    pub fn largest_turn(&self, next: &Self) -> f64 {
        self.motions
            .iter()
            .zip(&next.motions)
            .map(|(a, b)| {
                let dot = DQuat::from_array(a.rotation()).dot(DQuat::from_array(b.rotation())).abs().min(1.0);
                2.0 * dot.acos()
            })
            .fold(0.0, f64::max)
    }

    /// Largest distance a bound node moves from `self` to `next` [m].
    pub fn largest_move(&self, next: &Self, binding: &Binding, rest: &[[f64; 3]]) -> f64 {
        (0..rest.len())
            .filter(|n| binding.bound[*n])
            .map(|n| {
                let (a, b) = (self.node(binding, n, rest[n]), next.node(binding, n, rest[n]));
                DVec3::from(a).distance(DVec3::from(b))
            })
            .fold(0.0, f64::max)
    }
}
