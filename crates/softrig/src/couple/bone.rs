//! Bones: the straight segments that the joints of a skin stand for.
//!
//! Only joints with skin weight are bones. A bone's segments run from its joint to the nearest weighted joints below it; a leaf
//! (hand, head, toe) gets one segment toward the skin it carries.

use crate::rig::{JointId, Skeleton};
use glam::DVec3;

/// A skin vertex and the bone that moves it most.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct OwnedVertex {
    /// Rest position [m].
    pub position: [f64; 3],
    /// Index of the bone with the largest weight.
    pub bone: usize,
    /// On the outside of the body, not on a shell buried in it.
    pub exposed: bool,
}

/// A straight piece of a bone in the rest shape.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Segment {
    /// Joint end [m].
    pub start: [f64; 3],
    /// Far end [m]; equal to `start` for a bone without length.
    pub end: [f64; 3],
}

/// A joint with skin weight.
#[derive(Clone, Debug, PartialEq)]
pub struct Bone {
    /// Its joint.
    pub joint: JointId,
    /// Index of the bone above, skipping joints without weight.
    pub parent: Option<usize>,
    /// At least one.
    pub segments: Vec<Segment>,
}

/// The nearest point of a bone.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Nearest {
    /// Which segment.
    pub segment: usize,
    /// How far along it [m].
    pub along: f64,
    /// Distance [m].
    pub distance: f64,
}

impl Segment {
    /// Distance along and away from the segment [m].
    #[must_use]
    pub fn nearest(&self, p: [f64; 3]) -> (f64, f64) {
        let (a, b, p) = (DVec3::from(self.start), DVec3::from(self.end), DVec3::from(p));
        let axis = b - a;
        let length = axis.length();
        let along = if length > 0.0 { ((p - a).dot(axis) / length).clamp(0.0, length) } else { 0.0 };
        let on = if length > 0.0 { a + axis * (along / length) } else { a };
        (along, p.distance(on))
    }

    /// Length [m].
    #[must_use]
    pub fn length(&self) -> f64 {
        DVec3::from(self.start).distance(DVec3::from(self.end))
    }
}

impl Bone {
    /// The nearest point of any of its segments; the first one on a tie.
    #[must_use]
    pub fn nearest(&self, p: [f64; 3]) -> Nearest {
        let mut best = Nearest { segment: 0, along: 0.0, distance: f64::INFINITY };
        for (segment, s) in self.segments.iter().enumerate() {
            let (along, distance) = s.nearest(p);
            if distance < best.distance {
                best = Nearest { segment, along, distance };
            }
        }
        best
    }
}

/// The joints that `weighted` marks, as bones in joint order, without segments yet.
pub(crate) fn find_bones(skeleton: &Skeleton, weighted: &[bool]) -> Vec<Bone> {
    let mut bone_of = vec![None; skeleton.joint_count()];
    let mut bones = Vec::new();
    for (j, _) in weighted.iter().enumerate().filter(|(_, w)| **w) {
        bone_of[j] = Some(bones.len());
        bones.push(Bone { joint: JointId(j as u32), parent: None, segments: Vec::new() });
    }
    for bone in &mut bones {
        let mut up = skeleton.joint(bone.joint).parent;
        while let Some(j) = up {
            if let Some(b) = bone_of[j.index()] {
                bone.parent = Some(b);
                break;
            }
            up = skeleton.joint(j).parent;
        }
    }
    bones
}

/// Gives every bone its segments. `owned` are the skin vertices each bone dominates.
pub(crate) fn lay_segments(skeleton: &Skeleton, bones: &mut [Bone], owned: &[OwnedVertex], height: f64) {
    let origin = |b: &Bone| skeleton.joint(b.joint).rest.translation;
    // below this a bone has no direction: real files repeat joints at one place
    let shortest = 1e-6 * height;
    for b in 0..bones.len() {
        let start = origin(&bones[b]);
        let mut segments: Vec<Segment> = bones
            .iter()
            .filter(|c| c.parent == Some(b))
            .map(|c| Segment { start, end: origin(c) })
            .filter(|s| s.length() > shortest)
            .collect();
        if segments.is_empty() {
            segments.push(leaf_segment(start, owned.iter().filter(|v| v.bone == b).map(|v| v.position)));
        }
        bones[b].segments = segments;
    }
}

/// From the joint toward the middle of its skin, as long as the 85th percentile of the skin along that direction.
fn leaf_segment(start: [f64; 3], skin: impl Iterator<Item = [f64; 3]>) -> Segment {
    let origin = DVec3::from(start);
    let offsets: Vec<DVec3> = skin.map(|p| DVec3::from(p) - origin).collect();
    let mean = offsets.iter().sum::<DVec3>() / (offsets.len().max(1) as f64);
    let Some(direction) = mean.try_normalize() else { return Segment { start, end: start } };
    let mut along: Vec<f64> = offsets.iter().map(|o| o.dot(direction)).collect();
    along.sort_by(f64::total_cmp);
    let length = along[(along.len() * 85 / 100).min(along.len() - 1)].max(0.0);
    Segment { start, end: (origin + direction * length).into() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rig::{Affine, Joint, Transform};

    fn chain(names: &[&str]) -> Skeleton {
        let joint = |(i, name): (usize, &&str)| Joint {
            name: (*name).into(),
            parent: i.checked_sub(1).map(|p| JointId(p as u32)),
            local: Transform::default(),
            local_matrix: None,
            rest: Affine::from_translation([0.0, i as f64, 0.0]),
        };
        Skeleton::new(names.iter().enumerate().map(joint).collect(), Affine::IDENTITY).unwrap()
    }

    /// A twist helper between upper and lower arm carries no skin: the upper arm's bone still reaches the lower arm.
    #[test]
    fn segments_skip_joints_without_weight() {
        let s = chain(&["upper", "helper", "lower"]);
        let mut bones = find_bones(&s, &[true, false, true]);
        let owned = [1.0, 2.0, 3.0].map(|x| OwnedVertex { position: [x, 2.0, 0.0], bone: 1, exposed: true });
        lay_segments(&s, &mut bones, &owned, 2.0);
        assert_eq!(bones[1].parent, Some(0));
        assert_eq!(bones[0].segments, vec![Segment { start: [0.0; 3], end: [0.0, 2.0, 0.0] }]);
        // the leaf points at its skin
        assert!(bones[1].segments[0].end[0] > 1.0 && bones[1].segments[0].end[1] == 2.0);
        let n = bones[0].nearest([0.5, 1.25, 0.0]);
        assert_eq!((n.along, n.distance), (1.25, 0.5));
    }
}
