//! A skeleton and a clip as a BVH file.

use glam::{DMat3, DQuat, DVec3, EulerRot};
use softrig::rig::{Affine, Clip, JointId, Property, Skeleton};
use std::fmt::Write;

/// The text of a BVH file: metres, Y up, rest pose = `Joint::rest`, one frame every `frame_time` [s] from the start of the clip
/// to its end. Scales are not written, BVH has none. Joints whose translation is animated, and roots, get position channels.
#[must_use]
pub fn to_text(skeleton: &Skeleton, clip: &Clip, frame_time: f64) -> String {
    let children = skeleton.children();
    let mut out = String::from("HIERARCHY\n");
    let mut columns = Vec::new();
    let moves = |id: JointId| {
        let joint = skeleton.joint(id);
        joint.parent.is_none() || clip.tracks.iter().any(|t| t.joint == id && t.property == Property::Translation)
    };
    let roots = skeleton.order().iter().filter(|id| skeleton.joint(**id).parent.is_none());
    // depth first without recursion: skeletons of files may be deep
    let mut stack: Vec<(JointId, usize, bool)> = roots.rev().map(|id| (*id, 0, false)).collect();
    while let Some((id, depth, closing)) = stack.pop() {
        let pad = "\t".repeat(depth.min(64));
        if closing {
            let _ = writeln!(out, "{pad}}}");
            continue;
        }
        let joint = skeleton.joint(id);
        let parent = joint.parent.map_or([0.0; 3], |p| skeleton.joint(p).rest.translation);
        let [x, y, z] = (DVec3::from(joint.rest.translation) - DVec3::from(parent)).to_array();
        let key = if joint.parent.is_none() { "ROOT" } else { "JOINT" };
        let (count, positions) = if moves(id) { (6, "Xposition Yposition Zposition ") } else { (3, "") };
        let name = joint.name.replace(['{', '}', '\n', '\r'], "_");
        let _ = write!(out, "{pad}{key} {name}\n{pad}{{\n{pad}\tOFFSET {x:.9} {y:.9} {z:.9}\n");
        let _ = writeln!(out, "{pad}\tCHANNELS {count} {positions}Zrotation Xrotation Yrotation");
        columns.push(id);
        stack.push((id, depth, true));
        if children[id.index()].is_empty() {
            let _ = write!(out, "{pad}\tEnd Site\n{pad}\t{{\n{pad}\t\tOFFSET 0 0 0\n{pad}\t}}\n");
        }
        stack.extend(children[id.index()].iter().rev().map(|c| (*c, depth + 1, false)));
    }

    let frame_time = if frame_time > 0.0 && frame_time.is_finite() { frame_time } else { 1.0 / 30.0 };
    let frames = (clip.duration().max(0.0) / frame_time).round() as usize + 1;
    let _ = write!(out, "MOTION\nFrames: {frames}\nFrame Time: {frame_time:.9}\n");
    for f in 0..frames {
        let pose = skeleton.pose(&clip.sample(skeleton, clip.start + f as f64 * frame_time));
        // joint frames of a BVH file are parallel to the world at rest: only the turn since then counts
        let turn = |id: JointId| {
            let back = skeleton.joint(id).rest.inverse();
            back.map_or(DQuat::IDENTITY, |back| rotation(&pose.joint(id).after(&back)))
        };
        for &id in &columns {
            let parent = skeleton.joint(id).parent;
            let above = parent.map_or(DQuat::IDENTITY, turn);
            if moves(id) {
                let origin = parent.map_or([0.0; 3], |p| pose.joint(p).translation);
                let p = above.inverse() * (DVec3::from(pose.joint(id).translation) - DVec3::from(origin));
                let _ = write!(out, "{:.9} {:.9} {:.9} ", p.x, p.y, p.z);
            }
            let (z, x, y) = (above.inverse() * turn(id)).to_euler(EulerRot::ZXY);
            let _ = write!(out, "{:.9} {:.9} {:.9} ", z.to_degrees(), x.to_degrees(), y.to_degrees());
        }
        out.push('\n');
    }
    out
}

/// Rotation of a map, its scale divided out.
pub(super) fn rotation(map: &Affine) -> DQuat {
    let m = DMat3::from_cols_array_2d(&map.linear).transpose();
    let unit = |v: DVec3| v.try_normalize();
    let (Some(x), Some(y)) = (unit(m.x_axis), unit(m.y_axis)) else { return DQuat::IDENTITY };
    // sheared frames: the first two axes decide
    let Some(z) = unit(x.cross(y)) else { return DQuat::IDENTITY };
    let q = DQuat::from_mat3(&DMat3::from_cols(x, z.cross(x), z));
    if q.is_finite() { q.normalize() } else { DQuat::IDENTITY }
}
