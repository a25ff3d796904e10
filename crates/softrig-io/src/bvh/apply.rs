//! A motion put on a character whose joints have the same names.
//!
//! Rotations: how far a joint of the motion has turned in the world since the rest pose of the motion is applied to the rest frame
//! of the character's joint. Two differences of the rest poses are taken out first: the way the figures stand and face
//! (in quarter turns), and, joint by joint along limbs, the direction of the bone (arms out against arms down). Bone lengths stay the character's.
//! Position: the path of the motion's root, scaled by the ratio of the hip heights.

use super::Bvh;
use super::roles::roles;
use super::write::rotation;
use crate::error::{ImportError, Place};
use glam::{DQuat, DVec3};
use softrig::character::Character;
use softrig::rig::{Affine, Clip, Interpolation, JointId, Property, Skeleton, Track};
use std::collections::HashMap;
use std::f64::consts::FRAC_PI_2;

/// Bone directions that differ by less [rad] are anatomy, not another rest pose.
const SAME_DIRECTION: f64 = 10.0 * std::f64::consts::PI / 180.0;

/// A pair of joints with the same name.
#[derive(Clone, Copy)]
struct Pair {
    source: JointId,
    target: JointId,
    /// Index of the pair above, if any.
    above: Option<usize>,
    /// Rotation that lays the character's bone along the motion's, both at rest.
    align: DQuat,
}

/// A clip for `character` from a motion whose joints have the same names, and notes on what was not used. Case, spaces, underscores and
/// namespaces such as `mixamorig:` do not matter.
///
/// # Errors
/// [`ImportError::Unsupported`] when no joint of one has a namesake in the other.
pub fn apply_to(character: &Character, bvh: &Bvh) -> Result<(Clip, Vec<String>), ImportError> {
    apply_named(character, bvh, &[])
}

/// As [`apply_to`], with pairs of names (of the motion, of the character) that come before all others. Joints without a namesake
/// are paired by what their names say they are: arms, legs, spine, as CMU, Mixamo, Blender and others name them.
///
/// # Errors
/// As [`apply_to`]; also when a name is that of no joint.
pub fn apply_named(
    character: &Character,
    bvh: &Bvh,
    named: &[[String; 2]],
) -> Result<(Clip, Vec<String>), ImportError> {
    let skeleton = &character.skeleton;
    let mut notes = Vec::new();
    let mut given = Vec::new();
    for [from, to] in named {
        let pair = (bvh.skeleton.find(from), skeleton.find(to));
        let (Some(source), Some(target)) = pair else {
            let (file, name) = if pair.0.is_none() { ("motion", from) } else { ("character", to) };
            let reason = format!("the {file} has no joint `{name}`, which the map of names has");
            return Err(ImportError::unsupported(&bvh.file, Place::Whole, reason, "correct the name"));
        };
        given.push((target, source));
    }
    let (mut pairs, by_role) = pairs(skeleton, &bvh.skeleton, &given);
    if by_role > 0 {
        notes.push(format!("{by_role} joints were paired by what their names say they are"));
    }
    if pairs.is_empty() {
        let reason = format!(
            "no joint of the motion has a namesake in `{}`: the motion has {}; the character has {}",
            character.name,
            names(bvh.skeleton.joints().iter().map(|j| j.name.as_str())),
            names(skeleton.joints().iter().map(|j| j.name.as_str())),
        );
        return Err(ImportError::unsupported(&bvh.file, Place::Whole, reason, "rename the joints of one of them"));
    }
    let mut missing = |what: &str, all: &Skeleton, has: &dyn Fn(JointId) -> bool| {
        let lost: Vec<&str> = all.order().iter().filter(|j| !has(**j)).map(|j| all.joint(*j).name.as_str()).collect();
        if !lost.is_empty() {
            notes.push(format!("{what}: {}", names(lost.into_iter())));
        }
    };
    missing("joints of the motion that the character does not have", &bvh.skeleton, &|j| {
        pairs.iter().any(|p| p.source == j)
    });
    missing("joints of the character that the motion does not move", skeleton, &|j| {
        pairs.iter().any(|p| p.target == j)
    });

    let stand = stand_alike(skeleton, bvh, &pairs);
    align_bones(skeleton, bvh, &mut pairs, stand);
    let turned = pairs.iter().filter(|p| p.align != DQuat::IDENTITY).count();
    if turned > 0 {
        notes.push(format!("the rest poses differ: bone directions of {turned} joints were matched"));
    }
    Ok((transfer(character, bvh, &pairs, stand, &mut notes), notes))
}

/// At most a dozen names.
fn names<'a>(all: impl Iterator<Item = &'a str>) -> String {
    let all: Vec<_> = all.collect();
    let mut text = all.iter().take(12).map(|n| format!("`{n}`")).collect::<Vec<_>>().join(", ");
    if all.len() > 12 {
        text.push_str(&format!(" and {} more", all.len() - 12));
    }
    if text.is_empty() { "none".into() } else { text }
}

/// A name without namespace, case and separators.
fn plain(name: &str) -> String {
    let name = name.rsplit([':', '|']).next().unwrap_or(name).to_lowercase();
    let name = name.strip_prefix("mixamorig").unwrap_or(&name);
    name.chars().filter(|c| !matches!(c, '_' | ' ' | '-' | '.')).collect()
}

/// Pairs with those above first.
fn pairs(target: &Skeleton, source: &Skeleton, given: &[(JointId, JointId)]) -> (Vec<Pair>, usize) {
    let mut by_name = HashMap::new();
    for (i, joint) in source.joints().iter().enumerate() {
        by_name.entry(plain(&joint.name)).or_insert(JointId(i as u32));
    }
    let mut source_of: HashMap<JointId, JointId> = given.iter().copied().collect();
    by_name.retain(|_, id| !given.iter().any(|g| g.1 == *id));
    // namesakes, then joints of the same role
    for &id in target.order() {
        let joint = target.joint(id);
        if joint.local_matrix.is_none()
            && !source_of.contains_key(&id)
            && let Some(found) = by_name.remove(&plain(&joint.name))
        {
            source_of.insert(id, found);
        }
    }
    let (ours, theirs) = (roles(target), roles(source));
    let mut by_role = 0;
    for &id in target.order() {
        let role = ours.iter().find(|r| *r.1 == id).map(|r| r.0);
        if let Some(found) = role.and_then(|r| theirs.get(r))
            && target.joint(id).local_matrix.is_none()
            && !source_of.contains_key(&id)
            && !source_of.values().any(|s| s == found)
        {
            source_of.insert(id, *found);
            by_role += 1;
        }
    }
    let mut pair_of_joint: Vec<Option<usize>> = vec![None; target.joint_count()];
    let mut pairs: Vec<Pair> = Vec::new();
    for &id in target.order() {
        let joint = target.joint(id);
        let above = joint.parent.and_then(|p| pair_of_joint[p.index()]);
        pair_of_joint[id.index()] = above;
        // each joint of the motion moves one joint, and a node with a matrix cannot be moved
        if joint.local_matrix.is_none()
            && let Some(&found) = source_of.get(&id)
        {
            pair_of_joint[id.index()] = Some(pairs.len());
            pairs.push(Pair { source: found, target: id, above, align: DQuat::IDENTITY });
        }
    }
    (pairs, by_role)
}

fn at(map: &Affine) -> DVec3 {
    DVec3::from(map.translation)
}

/// Quarter turns that make the motion's rest pose stand upright and face as the character's does.
fn stand_alike(skeleton: &Skeleton, bvh: &Bvh, pairs: &[Pair]) -> DQuat {
    // upright: the rest pose may lie on its back while the motion stands
    let lies = super::build::direction_of_head(&bvh.skeleton, None)
        .map(|d| DVec3::from(bvh.skeleton.to_world().vector(d)).normalize_or_zero());
    let upright = match lies {
        Some(d) if d.z.abs() > 0.8 => DQuat::from_rotation_x(-FRAC_PI_2 * d.z.signum()),
        Some(d) if d.y < -0.8 => DQuat::from_rotation_x(2.0 * FRAC_PI_2),
        _ => DQuat::IDENTITY,
    };
    // facing: the turn about Y that fits joint positions best
    let count = pairs.len() as f64;
    let ours: Vec<DVec3> = pairs.iter().map(|p| at(&skeleton.joint(p.target).rest)).collect();
    let theirs: Vec<DVec3> = pairs.iter().map(|p| upright * at(&bvh.skeleton.joint(p.source).rest)).collect();
    let (our_mean, their_mean) = (ours.iter().sum::<DVec3>() / count, theirs.iter().sum::<DVec3>() / count);
    let (mut sine, mut cosine) = (0.0, 0.0);
    for (a, b) in ours.iter().zip(&theirs) {
        let (a, b) = (*a - our_mean, *b - their_mean);
        cosine += a.x * b.x + a.z * b.z;
        sine += a.x * b.z - a.z * b.x;
    }
    let turn = (sine.atan2(cosine) / FRAC_PI_2).round() * FRAC_PI_2;
    DQuat::from_rotation_y(if turn.is_finite() { turn } else { 0.0 }) * upright
}

/// Bone directions along limbs. A joint with several children has no one direction, and the last bones (feet, hands) hold
/// whatever angle their tips happen to have: those follow the joint above.
fn align_bones(skeleton: &Skeleton, bvh: &Bvh, pairs: &mut [Pair], stand: DQuat) {
    let mut below = vec![Vec::new(); pairs.len()];
    for (i, pair) in pairs.iter().enumerate() {
        if let Some(above) = pair.above {
            below[above].push(i);
        }
    }
    for i in 0..pairs.len() {
        let inherited = pairs[i].above.map_or(DQuat::IDENTITY, |a| pairs[a].align);
        pairs[i].align = inherited;
        let [child] = below[i][..] else { continue };
        if below[child].is_empty() {
            continue;
        }
        let bone = |s: &Skeleton, from: JointId, to: JointId| at(&s.joint(to).rest) - at(&s.joint(from).rest);
        let ours = bone(skeleton, pairs[i].target, pairs[child].target).try_normalize();
        let theirs = stand * bone(&bvh.skeleton, pairs[i].source, pairs[child].source);
        let (Some(ours), Some(theirs)) = (ours, theirs.try_normalize()) else { continue };
        // on top of what the limb above has turned
        let carried = inherited * ours;
        if carried.angle_between(theirs) > SAME_DIRECTION {
            pairs[i].align = DQuat::from_rotation_arc(carried, theirs) * inherited;
        }
    }
}

/// Height of a skeleton's root above its lowest joint, at rest and standing.
fn hip_height(skeleton: &Skeleton, hip: JointId, stand: DQuat) -> f64 {
    let y = |map: &Affine| (stand * at(map)).y;
    let hip = y(&skeleton.joint(hip).rest);
    let lowest = skeleton.joints().iter().map(|j| y(&j.rest)).fold(hip, f64::min);
    hip - lowest
}

fn transfer(character: &Character, bvh: &Bvh, pairs: &[Pair], stand: DQuat, notes: &mut Vec<String>) -> Clip {
    let skeleton = &character.skeleton;
    let rest_locals = skeleton.rest_locals();
    let at_rest = skeleton.pose(&rest_locals);
    let pair_of_joint: HashMap<JointId, usize> = pairs.iter().enumerate().map(|(i, p)| (p.target, i)).collect();
    let source_rest: Vec<DQuat> = bvh.skeleton.joints().iter().map(|j| stand * rotation(&j.rest)).collect();
    let target_rest: Vec<DQuat> = skeleton.joints().iter().map(|j| rotation(&j.rest)).collect();
    let times: Vec<f64> = (0..bvh.frame_count).map(|f| f as f64 * bvh.frame_time).collect();
    let mut rotations: Vec<Vec<[f64; 4]>> = vec![Vec::with_capacity(times.len()); pairs.len()];

    // the first pair whose joint the motion moves about carries the character
    let carrier = pairs
        .iter()
        .position(|p| bvh.clip.tracks.iter().any(|t| t.joint == p.source && t.property == Property::Translation));
    let carrier = carrier.filter(|c| pairs[*c].above.is_none());
    if carrier.is_none() {
        notes.push("the character stays in place: the joint that carries the motion has no namesake".into());
    }
    let mut path = Vec::new();
    let ratio = carrier.map_or(1.0, |c| {
        let ours = hip_height(skeleton, pairs[c].target, DQuat::IDENTITY);
        let theirs = hip_height(&bvh.skeleton, pairs[c].source, stand);
        if ours > 0.0 && theirs > 0.0 { ours / theirs } else { 1.0 }
    });
    let ground = character.meshes.iter().flat_map(|m| &m.positions).map(|p| p[1]).fold(f64::INFINITY, f64::min);
    let joint_ground = skeleton.joints().iter().map(|j| j.rest.translation[1]).fold(f64::INFINITY, f64::min);
    // a character modelled with its feet at zero stays there; one modelled elsewhere is taken to stand on its lowest point
    let ground = [ground, joint_ground].into_iter().find(|g| g.is_finite()).unwrap_or(0.0);

    let mut world = vec![DQuat::IDENTITY; skeleton.joint_count()];
    for &time in &times {
        let pose = bvh.skeleton.pose(&bvh.clip.sample(&bvh.skeleton, time));
        for &id in skeleton.order() {
            let joint = skeleton.joint(id);
            let above = joint.parent.map_or_else(|| rotation(skeleton.to_world()), |p| world[p.index()]);
            world[id.index()] = match pair_of_joint.get(&id) {
                Some(&i) => {
                    let pair = &pairs[i];
                    // turned since rest, on the character's rest frame
                    let turn = rotation(pose.joint(pair.source)) * source_rest[pair.source.index()].inverse();
                    let wanted = (turn * pair.align * target_rest[id.index()]).normalize();
                    let mut local = (above.inverse() * wanted).normalize();
                    if rotations[i].last().is_some_and(|q| DQuat::from_array(*q).dot(local) < 0.0) {
                        local = -local;
                    }
                    rotations[i].push(local.to_array());
                    wanted
                }
                None => {
                    let local = joint.local_matrix.unwrap_or_else(|| rest_locals[id.index()].to_affine());
                    above * rotation(&local)
                }
            };
        }
        if let Some(c) = carrier {
            let p = ratio * at(pose.joint(pairs[c].source)) + DVec3::Y * ground;
            let parent = skeleton.joint(pairs[c].target).parent;
            let above = parent.map_or(*skeleton.to_world(), |p| *at_rest.joint(p));
            let local = above.inverse().map_or(p.to_array(), |back| back.point(p.to_array()));
            path.push([local[0], local[1], local[2], 0.0]);
        }
    }
    let track = |joint, property, values| Track {
        joint,
        property,
        interpolation: Interpolation::Linear,
        times: times.clone(),
        values,
    };
    let mut tracks: Vec<Track> =
        pairs.iter().zip(rotations).map(|(p, values)| track(p.target, Property::Rotation, values)).collect();
    if let Some(c) = carrier {
        tracks.push(track(pairs[c].target, Property::Translation, path));
    }
    Clip { name: bvh.clip.name.clone(), start: 0.0, end: bvh.clip.end, tracks }
}
