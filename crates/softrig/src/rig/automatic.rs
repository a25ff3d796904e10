//! Kinds and limits for the joints of any skeleton, from what its clips do and what its joints are called.
//!
//! A joint that its clips turn about one axis only is a hinge; so is an elbow or knee by name, unless its clips say otherwise.
//! Every other joint is a ball. Limits hold whatever the clips do, and some room around it.

use super::clip::{Clip, Property};
use super::joint::{JointKind, JointSetup};
use super::rotation::{keeps_angles, log, rotation_in, swing_twist, twist};
use super::skeleton::{JointId, Skeleton};
use glam::{DMat3, DQuat, DVec3};

/// What was chosen for a joint, and why.
#[derive(Clone, Debug, PartialEq)]
pub struct Choice {
    /// The joint.
    pub joint: JointId,
    /// What it can do. It is led by nothing: `drive`, `stiffness` and `damping` are 0.
    pub setup: JointSetup,
    /// Why, in a few words.
    pub reason: &'static str,
}

/// Samples of each clip.
const SAMPLES: usize = 60;
/// A joint has turned at all from here on [rad].
const LEAST_TURN: f64 = 0.35;
/// Part of a joint's turns that may be about other axes if it is a hinge by its motion, and if it is one by name too.
const OFF_AXIS: [f64; 2] = [0.12, 0.5];
/// Room beyond what the clips do [rad].
const ROOM: f64 = 0.25;

/// A kind with limits for each of `bones`, the joints that carry flesh. All other joints are best left fixed.
#[must_use]
pub fn automatic(skeleton: &Skeleton, bones: &[JointId], clips: &[Clip]) -> Vec<Choice> {
    let squeezed = squeezed_joints(skeleton, clips);
    let directions = directions(skeleton, bones);
    bones
        .iter()
        .zip(directions)
        .map(|(&joint, direction)| {
            let reason_to_fix = if skeleton.joint(joint).local_matrix.is_some() {
                Some("its node has a matrix, which cannot be animated")
            } else if squeezed[joint.index()] {
                Some("joints above it scale differently along different axes")
            } else {
                None
            };
            let (kind, reason) = match reason_to_fix {
                Some(reason) => (JointKind::Fixed, reason),
                None => choose(skeleton, joint, direction, clips),
            };
            Choice { joint, setup: JointSetup { kind, drive: 0.0, ..JointSetup::default() }, reason }
        })
        .collect()
}

fn choose(skeleton: &Skeleton, id: JointId, direction: DVec3, clips: &[Clip]) -> (JointKind, &'static str) {
    let turns = turns_in_clips(skeleton, id, clips);
    let first = turns.first().copied().unwrap_or(DQuat::IDENTITY);
    let relative: Vec<DVec3> = turns.iter().map(|d| log(*d * first.conjugate())).collect();
    let (axis, off_axis) = principal_axis(&relative);
    let along = || relative.iter().map(|v| v.dot(axis));
    let range = along().fold(0.0, f64::max) - along().fold(0.0, f64::min);
    let named = is_hinge_by_name(&skeleton.joint(id).name);
    if range > LEAST_TURN && off_axis < OFF_AXIS[usize::from(named)] {
        // turned so that most of its motion is positive
        let axis = if along().sum::<f64>() < 0.0 { -axis } else { axis };
        let angle = || turns.iter().map(|d| twist(*d, axis));
        let range = [angle().fold(0.0, f64::min) - ROOM, angle().fold(0.0, f64::max) + ROOM];
        let reason = if named { "a hinge by its name and its clips" } else { "its clips turn it about one axis" };
        return (JointKind::Hinge { axis: axis.into(), range }, reason);
    }
    if named && range <= LEAST_TURN {
        return (named_hinge(skeleton, id, direction), "a hinge by its name; its clips hardly turn it");
    }
    let parts = || turns.iter().map(|d| swing_twist(*d, direction));
    // a joint that no clip moves gets the room of a spine
    let cone = (parts().map(|p| p.0.length()).fold(0.0, f64::max) + ROOM).max(0.6);
    let low = (parts().map(|p| p.1).fold(0.0, f64::min) - ROOM).min(-0.5);
    let high = (parts().map(|p| p.1).fold(0.0, f64::max) + ROOM).max(0.5);
    let kind = JointKind::Ball { axis: direction.into(), cone, twist: [low, high] };
    (
        kind,
        if turns.len() > 1 {
            "a ball with the room of its clips"
        } else {
            "a ball with ordinary limits; no clip moves it"
        },
    )
}

/// Rotations since rest that the clips give a joint.
fn turns_in_clips(skeleton: &Skeleton, id: JointId, clips: &[Clip]) -> Vec<DQuat> {
    let joint = skeleton.joint(id);
    let parent = joint.parent.map_or(*skeleton.to_world(), |p| skeleton.joint(p).rest);
    let Some(back) = parent.inverse() else { return Vec::new() };
    let rest = rotation_in(&back.after(&joint.rest));
    let mut out = Vec::new();
    for clip in clips {
        for track in clip.tracks.iter().filter(|t| t.joint == id && t.property == Property::Rotation) {
            for k in 0..=SAMPLES {
                let time = clip.start + clip.duration() * k as f64 / SAMPLES as f64;
                let q = track.sample(time).map(DQuat::from_array).filter(|q| q.is_finite());
                out.extend(q.map(|q| rest.conjugate() * q));
            }
        }
    }
    out
}

/// The axis with most of the rotation vectors, and the part of their size (root mean square) that is about other axes.
fn principal_axis(vectors: &[DVec3]) -> (DVec3, f64) {
    let mut moment = DMat3::ZERO;
    for v in vectors {
        moment += DMat3::from_cols(*v * v.x, *v * v.y, *v * v.z);
    }
    let total = moment.x_axis.x + moment.y_axis.y + moment.z_axis.z;
    if total < 1e-12 {
        return (DVec3::X, 1.0);
    }
    // power iteration by squaring, from the longest column
    let mut m = moment * (1.0 / total);
    for _ in 0..12 {
        m = m * m;
        let trace = m.x_axis.x + m.y_axis.y + m.z_axis.z;
        m *= 1.0 / trace;
    }
    let columns = [m.x_axis, m.y_axis, m.z_axis];
    let longest = columns.into_iter().fold(DVec3::ZERO, |a, b| if b.length() > a.length() { b } else { a });
    let axis = longest.normalize_or(DVec3::X);
    let share = axis.dot(moment * axis) / total;
    (axis, (1.0 - share).max(0.0).sqrt())
}

/// Elbows and knees, in the ways that character tools name them.
fn is_hinge_by_name(name: &str) -> bool {
    let name = name.rsplit([':', '|']).next().unwrap_or(name).to_lowercase();
    let plain: String = name.chars().filter(|c| c.is_alphanumeric()).collect();
    let contains = |words: &[&str]| words.iter().any(|w| plain.contains(w));
    if contains(&["twist", "roll", "end", "nub"]) {
        return false;
    }
    // a figure's "LeftLeg" is the part below the knee, its "LeftUpLeg" the thigh
    let leg = plain.contains("leg") && (plain.contains("left") || plain.contains("right")) && !plain.contains("up");
    leg || contains(&["elbow", "forearm", "lowerarm", "lowarm", "knee", "shin", "calf", "lowerleg", "lowleg"])
}

/// Without motion to go by: bends the way the rest pose is bent already; else knees bend backward and elbows forward (+Z).
fn named_hinge(skeleton: &Skeleton, id: JointId, direction: DVec3) -> JointKind {
    let joint = skeleton.joint(id);
    let to_world = DMat3::from_quat(rotation_in(&joint.rest));
    let bone = to_world * direction;
    let above = joint
        .parent
        .map_or(DVec3::ZERO, |p| DVec3::from(joint.rest.translation) - DVec3::from(skeleton.joint(p).rest.translation));
    let bend = above.normalize_or_zero().cross(bone);
    let axis = if bend.length() > 0.1 {
        bend
    } else if bone.y < -0.7
        && !joint.name.to_lowercase().contains("arm")
        && !joint.name.to_lowercase().contains("elbow")
    {
        DVec3::X
    } else {
        bone.cross(DVec3::Z)
    };
    let axis = (axis - bone * axis.dot(bone)).try_normalize().unwrap_or_else(|| bone.any_orthonormal_vector());
    JointKind::Hinge { axis: (to_world.transpose() * axis).into(), range: [-0.15 - bend.length().min(0.9).asin(), 2.4] }
}

/// Direction of each bone in its joint's frame at rest: toward the bones below, or on from the one above.
fn directions(skeleton: &Skeleton, bones: &[JointId]) -> Vec<DVec3> {
    let at = |j: JointId| DVec3::from(skeleton.joint(j).rest.translation);
    let mut sum = vec![DVec3::ZERO; skeleton.joint_count()];
    for &b in bones {
        if let Some(p) = skeleton.joint(b).parent {
            sum[p.index()] += at(b) - at(p);
        }
    }
    let world = |b: JointId| {
        let above = skeleton.joint(b).parent.map_or(DVec3::ZERO, |p| at(b) - at(p));
        [sum[b.index()], above].into_iter().find_map(DVec3::try_normalize).unwrap_or(DVec3::Y)
    };
    bones.iter().map(|b| rotation_in(&skeleton.joint(*b).rest).conjugate() * world(*b)).collect()
}

/// Joints whose turns would stretch what hangs on them, because something above them squeezes.
fn squeezed_joints(skeleton: &Skeleton, clips: &[Clip]) -> Vec<bool> {
    let uniform = |v: &[f64; 4]| {
        let [x, y, z] = [v[0].abs(), v[1].abs(), v[2].abs()];
        (x - y).abs().max((x - z).abs()) <= 1e-4 * x.max(y).max(z)
    };
    let mut squeezes: Vec<bool> = skeleton.joints().iter().map(|j| !keeps_angles(&j.rest)).collect();
    for track in clips.iter().flat_map(|c| &c.tracks).filter(|t| t.property == Property::Scale) {
        if let Some(s) = squeezes.get_mut(track.joint.index()) {
            *s |= !track.values.iter().all(uniform);
        }
    }
    let mut below = vec![!keeps_angles(skeleton.to_world()); skeleton.joint_count()];
    for &id in skeleton.order() {
        if let Some(p) = skeleton.joint(id).parent {
            below[id.index()] = below[p.index()] || squeezes[p.index()];
        }
    }
    below
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rig::{Affine, Interpolation, Joint, Track, Transform};

    fn limb(names: [&str; 3]) -> Skeleton {
        let joint = |i: usize| Joint {
            name: names[i].into(),
            parent: i.checked_sub(1).map(|p| JointId(p as u32)),
            local: Transform { translation: [0.0, -0.3, 0.0], ..Transform::default() },
            local_matrix: None,
            rest: Affine::from_translation([0.0, -0.3 * i as f64, 0.0]),
        };
        Skeleton::new((0..3).map(joint).collect(), Affine::IDENTITY).unwrap()
    }

    fn clip(joint: u32, turn: impl Fn(f64) -> DVec3) -> Clip {
        let times: Vec<f64> = (0..=20).map(|k| 0.05 * f64::from(k)).collect();
        let values = times.iter().map(|t| DQuat::from_scaled_axis(turn(*t)).to_array()).collect();
        let (property, interpolation) = (Property::Rotation, Interpolation::Linear);
        let track = Track { joint: JointId(joint), property, interpolation, times, values };
        Clip { name: String::new(), start: 0.0, end: 1.0, tracks: vec![track] }
    }

    fn choices(names: [&str; 3], clips: &[Clip]) -> Vec<JointKind> {
        let bones = [JointId(0), JointId(1), JointId(2)];
        automatic(&limb(names), &bones, clips).into_iter().map(|c| c.setup.kind).collect()
    }

    #[test]
    fn a_joint_that_turns_about_one_axis_is_a_hinge_with_the_clips_range() {
        let kinds = choices(["a", "b", "c"], &[clip(1, |t| DVec3::new(0.6, 0.0, 0.8) * (1.2 * t))]);
        let JointKind::Hinge { axis, range } = kinds[1] else { panic!("{:?}", kinds[1]) };
        assert!((DVec3::from(axis) - DVec3::new(0.6, 0.0, 0.8)).length() < 1e-6, "{axis:?}");
        assert!((range[0] + ROOM).abs() < 1e-6 && (range[1] - 1.2 - ROOM).abs() < 1e-6, "{range:?}");
        assert!(matches!(kinds[0], JointKind::Ball { .. }));
    }

    #[test]
    fn a_joint_that_turns_every_way_is_a_ball_that_holds_its_clips() {
        let kinds =
            choices(["a", "b", "c"], &[clip(1, |t| DVec3::new((9.0 * t).sin(), 0.5 * t, (9.0 * t).cos() - 1.0))]);
        let JointKind::Ball { axis, cone, .. } = kinds[1] else { panic!("{:?}", kinds[1]) };
        assert_eq!(axis, [0.0, -1.0, 0.0]);
        assert!(cone > 1.0 && cone < 2.8, "{cone}");
    }

    #[test]
    fn knees_and_elbows_are_hinges_by_name() {
        let kinds = choices(["mixamorig:LeftUpLeg", "mixamorig:LeftLeg", "mixamorig:LeftFoot"], &[]);
        assert!(matches!(kinds[0], JointKind::Ball { .. }));
        // the shin swings backward for positive angles
        let JointKind::Hinge { axis, range } = kinds[1] else { panic!("{:?}", kinds[1]) };
        let foot = DQuat::from_axis_angle(DVec3::from(axis), 1.0) * -DVec3::Y;
        assert!(foot.z < -0.5 && range[1] > 2.0, "{foot}");
        let kinds = choices(["upper_arm.L", "forearm.L", "forearm_twist.L"], &[]);
        assert!(matches!(kinds[1], JointKind::Hinge { .. }) && matches!(kinds[2], JointKind::Ball { .. }));
    }
}
