//! From channels to a skeleton and a clip: rotations as quaternions, units, the up axis, the added first frame.

use super::parse::{Channel, Motion};
use super::{Bvh, BvhOptions, FirstFrame};
use crate::error::{ImportError, Place};
use crate::units::{CANDIDATE_UNITS, Units, UpAxis, box_size};
use glam::{DQuat, DVec3};
use softrig::rig::{Affine, Clip, Interpolation, Joint, JointId, Property, Skeleton, Track, Transform};
use std::collections::HashSet;
use std::path::Path;

/// Heights [m] at which a usual unit is believed; people with their arms down or up.
const PERSON: [f64; 2] = [1.2, 2.3];
/// Height [m] given to skeletons in no usual unit.
const USUAL_HEIGHT: f64 = 1.7;
/// Height of the hip joint of a person over the sole, as a share of the height.
const HIP_SHARE: f64 = 0.55;
/// A joint that turns by more than this between the first two frames...
const JUMP: f64 = 20.0 * std::f64::consts::PI / 180.0;
/// ...and by this many times more than anything does between the next two: the first frame was added.
const JUMP_RATIO: f64 = 4.0;

pub(super) fn build(mut motion: Motion, file: &Path, options: &BvhOptions) -> Result<Bvh, ImportError> {
    let mut notes = std::mem::take(&mut motion.notes);
    let mut tracks = tracks(&motion);
    let mut frame_count = motion.values.len() / motion.width;
    let first_frame_jumps = first_frame_jumps(&tracks);
    if first_frame_jumps {
        let dropped = options.first_frame == FirstFrame::DropIfItJumps;
        let what = if dropped { "left it out" } else { "kept it" };
        notes.push(format!("the first frame is a pose added by a conversion (the motion jumps behind it); {what}"));
        if dropped {
            frame_count -= 1;
            for track in &mut tracks {
                track.times.pop();
                track.values.remove(0);
            }
        }
    }
    let name = file.file_stem().map_or_else(|| "motion".into(), |s| s.to_string_lossy().into_owned());
    let end = motion.frame_time * (frame_count - 1) as f64;
    let clip = Clip { name, start: 0.0, end, tracks };

    let in_file = skeleton(&motion, Affine::IDENTITY, file)?;
    let units = units(&motion, &in_file, &clip, options);
    notes.extend(units.notes.iter().cloned());
    Ok(Bvh {
        file: file.into(),
        skeleton: skeleton(&motion, units.to_world(), file)?,
        tips: motion.tips.iter().map(|(j, offset)| (JointId(*j), *offset)).collect(),
        clip,
        frame_time: motion.frame_time,
        frame_count,
        first_frame_jumps,
        notes,
    })
}

/// Joints with their rest frames: all channels zero.
fn skeleton(motion: &Motion, to_world: Affine, file: &Path) -> Result<Skeleton, ImportError> {
    let mut taken = HashSet::new();
    let joints = motion.nodes.iter().enumerate().map(|(i, node)| {
        let mut name = if node.name.is_empty() { format!("joint_{i}") } else { node.name.clone() };
        if !taken.insert(name.clone()) {
            // joint numbers are unique, so at most the number of joints is tried
            name =
                (i..).map(|k| format!("{}_{k}", node.name)).find(|n| !taken.contains(n)).expect("numbers do not end");
            taken.insert(name.clone());
        }
        let local = Transform { translation: node.offset, ..Transform::default() };
        Joint { name, parent: node.parent.map(JointId), local, local_matrix: None, rest: Affine::IDENTITY }
    });
    let wrong = |e: String| ImportError::malformed(file, Place::Whole, e, "export it again");
    let bare = Skeleton::new(joints.collect(), to_world).map_err(|e| wrong(e.to_string()))?;
    let rest = bare.pose(&bare.rest_locals());
    let joints = bare.joints().iter().zip(rest.world).map(|(j, rest)| Joint { rest, ..j.clone() }).collect();
    Skeleton::new(joints, to_world).map_err(|e| wrong(e.to_string()))
}

/// One rotation track per joint with rotation channels, one translation track per joint with position channels.
fn tracks(motion: &Motion) -> Vec<Track> {
    let frames = motion.values.len() / motion.width;
    let times: Vec<f64> = (0..frames).map(|f| f as f64 * motion.frame_time).collect();
    let mut tracks = Vec::new();
    let mut first = 0;
    for (i, node) in motion.nodes.iter().enumerate() {
        let columns = first..first + node.channels.len();
        first = columns.end;
        let rows = || motion.values.chunks_exact(motion.width).map(|row| &row[columns.clone()]);
        let track = |property, values| Track {
            joint: JointId(i as u32),
            property,
            interpolation: Interpolation::Linear,
            times: times.clone(),
            values,
        };
        if node.channels.iter().any(|c| matches!(c, Channel::Position(_))) {
            let at = |row: &[f64]| {
                let mut t = [node.offset[0], node.offset[1], node.offset[2], 0.0];
                for (channel, value) in node.channels.iter().zip(row) {
                    if let Channel::Position(axis) = channel {
                        t[*axis] = *value;
                    }
                }
                t
            };
            tracks.push(track(Property::Translation, rows().map(at).collect()));
        }
        if node.channels.iter().any(|c| matches!(c, Channel::Rotation(_))) {
            let mut before = DQuat::IDENTITY;
            let at = |row: &[f64]| {
                let mut q = rotation(&node.channels, row);
                // the nearer of the two quaternions of a rotation, so that keys read smoothly
                if q.dot(before) < 0.0 {
                    q = -q;
                }
                before = q;
                q.to_array()
            };
            tracks.push(track(Property::Rotation, rows().map(at).collect()));
        }
    }
    tracks
}

/// The first channel is the outermost rotation.
fn rotation(channels: &[Channel], row: &[f64]) -> DQuat {
    let mut q = DQuat::IDENTITY;
    for (channel, degrees) in channels.iter().zip(row) {
        if let Channel::Rotation(axis) = channel {
            // the remainder keeps the precision of angles far beyond a turn
            let angle = (degrees % 720.0).to_radians();
            q *= DQuat::from_axis_angle(DVec3::AXES[*axis], angle);
        }
    }
    q.normalize()
}

fn first_frame_jumps(tracks: &[Track]) -> bool {
    let turn = |frame: usize| {
        let rotations = tracks.iter().filter(|t| t.property == Property::Rotation && t.values.len() > frame + 1);
        let angle =
            |t: &Track| DQuat::from_array(t.values[frame]).angle_between(DQuat::from_array(t.values[frame + 1]));
        rotations.map(angle).fold(0.0, f64::max)
    };
    let frames = tracks.first().map_or(0, |t| t.values.len());
    frames > 2 && turn(0) > JUMP && turn(0) > JUMP_RATIO * turn(1)
}

/// Unit and up axis. Motion capture comes in units that are no units (5.6 cm), but of people.
fn units(motion: &Motion, in_file: &Skeleton, clip: &Clip, options: &BvhOptions) -> Units {
    let moving_up = options.import.up.or_else(|| direction_of_head(in_file, Some(clip)).and_then(axis_of));
    let up = moving_up.unwrap_or(UpAxis::Y);
    // rest poses lie down or stand with their legs apart: the legs are measured where the motion stretches them most
    let joints = in_file.pose(&in_file.rest_locals()).world;
    let tips = motion.tips.iter().map(|(j, offset)| joints[*j as usize].point(*offset));
    let size = box_size(joints.iter().map(|w| w.translation).chain(tips));
    let axis = if up == UpAxis::Y { 1 } else { 2 };
    let legs = samples(clip).map(|time| {
        let world = in_file.pose(&clip.sample(in_file, time)).world;
        let joints = world.iter().map(|w| w.translation[axis]);
        let tips = motion.tips.iter().map(|(j, offset)| world[*j as usize].point(*offset)[axis]);
        world[0].translation[axis] - joints.chain(tips).fold(f64::INFINITY, f64::min)
    });
    let height = legs.fold(0.0, f64::max) / HIP_SHARE;

    let mut import = options.import;
    import.up = Some(up);
    let mut notes = Vec::new();
    if options.import.up.is_none() && up == UpAxis::Z {
        notes.push("took Z as the up axis: that is where the head is (--up Y if it is not)".into());
    }
    if import.unit.is_none() && import.height.is_none() && height > 0.0 {
        let fits = |u: &f64| (PERSON[0]..=PERSON[1]).contains(&(height * u));
        let unit = CANDIDATE_UNITS.into_iter().find(fits).unwrap_or(USUAL_HEIGHT / height);
        notes.push(format!(
            "took one unit of the motion as {unit:.4} m, judging by its legs a figure {:.2} m tall",
            height * unit
        ));
        import.unit = Some(unit);
    }
    if let Some(wanted) = import.height
        && import.unit.is_none()
        && height > 0.0
    {
        import.unit = Some(wanted / height);
    }
    let mut units = Units::choose(size, up, &import);
    units.notes.splice(0..0, notes);
    units
}

/// Mean direction from the root to the head, in file axes: at rest, or over a clip.
pub(super) fn direction_of_head(skeleton: &Skeleton, clip: Option<&Clip>) -> Option<[f64; 3]> {
    let joints = skeleton.joints();
    let named = |what: &str| joints.iter().position(|j| j.name.to_ascii_lowercase().contains(what));
    let head = named("head").or_else(|| named("neck"))?;
    let mut root = head;
    while let Some(parent) = joints[root].parent {
        root = parent.index();
    }
    let to_file = skeleton.to_world().inverse()?;
    let mut sum = [0.0; 3];
    let times: Vec<Option<f64>> = clip.map_or_else(|| vec![None], |c| samples(c).map(Some).collect());
    for time in times {
        let locals = match (clip, time) {
            (Some(clip), Some(time)) => clip.sample(skeleton, time),
            _ => skeleton.rest_locals(),
        };
        let pose = skeleton.pose(&locals);
        let (h, r) = (pose.world[head].translation, pose.world[root].translation);
        let d = to_file.vector([h[0] - r[0], h[1] - r[1], h[2] - r[2]]);
        (0..3).for_each(|c| sum[c] += d[c]);
    }
    Some(sum)
}

/// A few times all over a clip [s].
fn samples(clip: &Clip) -> impl Iterator<Item = f64> {
    (0..32).map(|k| clip.start + clip.duration() * (f64::from(k) + 0.5) / 32.0)
}

/// The up axis a direction stands for, if it clearly does for one.
pub(super) fn axis_of(d: [f64; 3]) -> Option<UpAxis> {
    let length = (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt();
    if d[1] > 0.8 * length && length > 0.0 {
        Some(UpAxis::Y)
    } else if d[2] > 0.8 * length && length > 0.0 {
        Some(UpAxis::Z)
    } else {
        None
    }
}
