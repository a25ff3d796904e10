//! The clips of the sample character.
//!
//! Each is a function of time that says where the hips are, how joints turn, and where each foot stands; legs are solved for the
//! feet, so that a standing foot does not slide. Sampled at [`RATE`] into linear keys.

use super::joints::{place, sided};
use crate::rig::{Clip, Interpolation, JointId, Property, Skeleton, Track};
use glam::{DQuat, DVec3};
use std::f64::consts::{PI, TAU};

/// Keys per second [1/s].
const RATE: f64 = 30.0;

/// Hips below their rest height in every stance [m]: a straight knee has no direction to bend.
const STANCE: f64 = 0.03;

/// What a clip says of one instant.
struct Stance {
    /// Hips from their rest place [m].
    hips: DVec3,
    /// World rotation of the hips.
    turn: DQuat,
    /// Local rotations of joints outside the legs; joints not listed do not turn.
    bend: Vec<(String, DQuat)>,
    /// Left and right foot.
    feet: [Foot; 2],
}

/// Where a foot is.
#[derive(Clone, Copy)]
struct Foot {
    /// Ankle from its rest place [m].
    shift: DVec3,
    /// About the vertical [rad].
    yaw: f64,
    /// Heel up over the ball of the foot, or (negative) toes up over the heel [rad].
    pitch: f64,
}

/// All clips.
pub(super) fn all(skeleton: &Skeleton) -> Vec<Clip> {
    vec![clip(skeleton, "walk", 1.0, walk), clip(skeleton, "jump", 2.4, jump), clip(skeleton, "turn", 2.4, turn)]
}

fn clip(skeleton: &Skeleton, name: &str, length: f64, stance: fn(f64) -> Stance) -> Clip {
    let times: Vec<f64> = (0..=(length * RATE).round() as u32).map(|i| f64::from(i) / RATE).collect();
    let poses: Vec<(DVec3, Vec<DQuat>)> = times.iter().map(|t| locals(skeleton, &stance(*t))).collect();
    let track = |joint: usize, property: Property, values: Vec<[f64; 4]>| Track {
        joint: JointId(joint as u32),
        property,
        interpolation: Interpolation::Linear,
        times: times.clone(),
        values,
    };
    let hips = poses.iter().map(|(hips, _)| hips.extend(0.0).to_array()).collect();
    let mut tracks = vec![track(0, Property::Translation, hips)];
    for joint in 0..skeleton.joint_count() {
        let mut values: Vec<[f64; 4]> = poses.iter().map(|(_, turns)| turns[joint].to_array()).collect();
        // neighbouring keys on the same side, or interpolation takes the long way round
        for i in 1..values.len() {
            if DQuat::from_array(values[i]).dot(DQuat::from_array(values[i - 1])) < 0.0 {
                values[i] = values[i].map(|c| -c);
            }
        }
        tracks.push(track(joint, Property::Rotation, values));
    }
    Clip { name: name.into(), start: 0.0, end: *times.last().expect("a clip has two keys or more"), tracks }
}

/// Place of the hips and local rotation of every joint.
fn locals(skeleton: &Skeleton, stance: &Stance) -> (DVec3, Vec<DQuat>) {
    let at = |name: &str| DVec3::from_array(place(name));
    let id = |name: &str| skeleton.find(name).expect("the table has this joint").index();
    let mut turns = vec![DQuat::IDENTITY; skeleton.joint_count()];
    for (name, q) in &stance.bend {
        turns[id(name)] = *q;
    }
    turns[id("hips")] = stance.turn;
    let hips = at("hips") + stance.hips;
    for (left, foot) in [(true, stance.feet[0]), (false, stance.feet[1])] {
        let name = |base: &str| sided(base, left);
        let [thigh, shin, ankle, toes] = ["thigh", "shin", "foot", "toes"].map(name);
        // the foot rolls over its ball or its heel, on the ground
        let pivot =
            if foot.pitch > 0.0 { at(&toes) - DVec3::Y * 0.04 } else { at(&ankle) - DVec3::new(0.0, 0.10, 0.06) };
        let (yaw, pitch) = (DQuat::from_rotation_y(foot.yaw), DQuat::from_rotation_x(foot.pitch));
        // the step turns about the middle of the body
        let target = yaw * (pivot + pitch * (at(&ankle) - pivot)) + foot.shift;
        let root = hips + stance.turn * (at(&thigh) - at("hips"));
        let ahead = (stance.turn.slerp(yaw, 0.5) * DVec3::Z).normalize();
        let [upper, lower] = leg(root, target, ahead, [at(&thigh), at(&shin), at(&ankle)]);
        let sole = yaw * pitch;
        turns[id(&thigh)] = stance.turn.inverse() * upper;
        turns[id(&shin)] = upper.inverse() * lower;
        turns[id(&ankle)] = lower.inverse() * sole;
        turns[id(&toes)] = DQuat::from_rotation_x(-foot.pitch.max(0.0) * 0.8);
    }
    (hips, turns)
}

/// World rotations of thigh and shin that bring the ankle to `target`, knee towards `ahead`; `rest` is hip, knee, ankle at rest.
/// A target out of reach is approached as far as the leg is long.
fn leg(root: DVec3, target: DVec3, ahead: DVec3, rest: [DVec3; 3]) -> [DQuat; 2] {
    let (upper, lower) = (rest[1] - rest[0], rest[2] - rest[1]);
    let (a, b) = (upper.length(), lower.length());
    let reach = (target - root).length().clamp((a - b).abs() + 1e-3, (a + b) * 0.9995);
    let down = (target - root).normalize();
    let front = (ahead - down * ahead.dot(down)).normalize();
    // law of cosines: how far along the line from hip to ankle the knee is, and how far in front of it
    let along = (a * a - b * b + reach * reach) / (2.0 * reach);
    let out = (a * a - along * along).max(0.0).sqrt();
    let knee = root + down * along + front * out;
    let ankle = root + down * reach;
    [between(upper, DVec3::Z, knee - root, ahead), between(lower, DVec3::Z, ankle - knee, ahead)]
}

/// The rotation that takes one direction to another and keeps the fronts as near to each other as it can.
fn between(from: DVec3, from_front: DVec3, to: DVec3, to_front: DVec3) -> DQuat {
    let frame = |d: DVec3, front: DVec3| {
        let y = d.normalize();
        let x = y.cross(front).normalize();
        DQuat::from_mat3(&glam::DMat3::from_cols(x, y, x.cross(y)))
    };
    frame(to, to_front) * frame(from, from_front).inverse()
}

/// 0 before `a`, 1 after `b`, smooth between.
fn ramp(t: f64, a: f64, b: f64) -> f64 {
    let s = ((t - a) / (b - a)).clamp(0.0, 1.0);
    s * s * s * (s * (6.0 * s - 15.0) + 10.0)
}

/// Cubic with given values and slopes at times `a` and `b`.
fn hermite(t: f64, a: (f64, f64, f64), b: (f64, f64, f64)) -> f64 {
    let ((ta, xa, va), (tb, xb, vb)) = (a, b);
    let h = tb - ta;
    let s = (t - ta) / h;
    let (s2, s3) = (s * s, s * s * s);
    (2.0 * s3 - 3.0 * s2 + 1.0) * xa + h * (s3 - 2.0 * s2 + s) * va + (3.0 * s2 - 2.0 * s3) * xb + h * (s3 - s2) * vb
}

/// Arms: `down` lowers them from the A-pose, `swing` carries them forward, `flex` bends the elbow, all [rad].
fn arm(bend: &mut Vec<(String, DQuat)>, left: bool, down: f64, swing: f64, flex: f64) {
    let side = if left { 1.0 } else { -1.0 };
    bend.push((sided("shoulder", left), DQuat::from_rotation_z(-side * 0.15 * down)));
    bend.push((sided("upper_arm", left), DQuat::from_rotation_x(-swing) * DQuat::from_rotation_z(-side * 0.85 * down)));
    // the elbow's axis is across the arm and to the side
    let axis = DVec3::new(1.0, side, 0.0).normalize();
    bend.push((sided("forearm", left), DQuat::from_axis_angle(axis, -flex)));
}

/// One step of each foot in one second, on the spot: the ground runs backwards under a standing foot at constant speed.
fn walk(t: f64) -> Stance {
    const STRIDE: f64 = 0.15; // half of it, ankle to hips [m]
    const STANDING: f64 = 0.6; // part of the time a foot is on the ground
    let phase = TAU * t;
    let foot = |phase: f64| {
        let s = phase.rem_euclid(1.0);
        let speed = -2.0 * STRIDE / STANDING;
        let (z, lift) = if s < STANDING {
            (STRIDE + speed * s, 0.0)
        } else {
            let u = (s - STANDING) / (1.0 - STANDING);
            // leaves and meets the ground at the ground's speed
            (hermite(s, (STANDING, -STRIDE, speed), (1.0, STRIDE, speed)), 0.055 * (PI * u).sin().powi(2))
        };
        let heel_up = 0.55 * ramp(s, 0.38, 0.64) * (1.0 - ramp(s, 0.64, 0.88));
        let toes_up = 0.30 * if s < 0.14 { 1.0 - ramp(s, 0.0, 0.14) } else { ramp(s, 0.80, 0.97) };
        Foot { shift: DVec3::new(0.0, lift, z), yaw: 0.0, pitch: heel_up - toes_up }
    };
    let lean = (phase - 0.6 * PI).cos(); // 1 in the middle of the left stance
    let ahead = phase.cos(); // 1 when the left heel meets the ground
    let hips = DVec3::new(0.035 * lean, -STANCE - 0.004 - 0.018 * (2.0 * phase - 0.2 * TAU).cos(), 0.0);
    let turn = DQuat::from_rotation_y(-0.16 * ahead) * DQuat::from_rotation_z(0.07 * lean);
    let mut bend = vec![
        ("spine".into(), DQuat::from_rotation_y(0.10 * ahead) * DQuat::from_rotation_z(-0.05 * lean)),
        ("chest".into(), DQuat::from_rotation_y(0.18 * ahead) * DQuat::from_rotation_z(-0.05 * lean)),
        ("neck".into(), DQuat::from_rotation_y(-0.07 * ahead) * DQuat::from_rotation_z(0.02 * lean)),
        ("head".into(), DQuat::from_rotation_y(-0.05 * ahead) * DQuat::from_rotation_x(0.03 * (2.0 * phase).sin())),
    ];
    for (left, side) in [(true, 1.0), (false, -1.0)] {
        arm(&mut bend, left, 0.28, -0.5 * side * ahead, 0.45 - 0.2 * side * ahead);
    }
    Stance { hips, turn, bend, feet: [foot(t), foot(t + 0.5)] }
}

/// Crouch, leap on a ballistic arc, land deep, stand up.
fn jump(t: f64) -> Stance {
    const GRAVITY: f64 = 9.81;
    const LEAP: f64 = 2.5; // speed at take-off [m/s]: 0.32 m high
    const OFF: f64 = 0.80; // feet leave the ground [s]
    let air = 2.0 * LEAP / GRAVITY;
    let land = OFF + air;
    let (low, high) = (-0.17, -0.004);
    let y = if t < 0.45 {
        -STANCE + (low + STANCE) * ramp(t, 0.05, 0.45)
    } else if t < 0.62 {
        low
    } else if t < OFF {
        hermite(t, (0.62, low, 0.0), (OFF, high, LEAP))
    } else if t < land {
        high + LEAP * (t - OFF) - 0.5 * GRAVITY * (t - OFF).powi(2)
    } else if t < land + 0.16 {
        hermite(t, (land, high, -LEAP), (land + 0.16, -0.20, 0.0))
    } else {
        -0.20 + (0.20 - STANCE) * ramp(t, land + 0.16, land + 0.62)
    };
    let flying = ramp(t, OFF, OFF + 0.12) * (1.0 - ramp(t, land - 0.12, land));
    let height = if (OFF..land).contains(&t) { y - high } else { 0.0 };
    let crouch = ramp(t, 0.05, 0.45) * (1.0 - ramp(t, 0.62, OFF));
    let dip = ramp(t, land - 0.05, land + 0.16) * (1.0 - ramp(t, land + 0.16, land + 0.62));
    let throw = ramp(t, 0.60, OFF + 0.02) * (1.0 - ramp(t, land - 0.15, land + 0.20));
    let fold = 0.42 * crouch + 0.45 * dip - 0.06 * throw;
    let mut bend = vec![
        ("spine".into(), DQuat::from_rotation_x(0.5 * fold)),
        ("chest".into(), DQuat::from_rotation_x(0.5 * fold)),
        ("neck".into(), DQuat::from_rotation_x(-0.4 * fold)),
        ("head".into(), DQuat::from_rotation_x(-0.6 * fold)),
    ];
    for left in [true, false] {
        let down = 0.15 * (1.0 - throw) - 0.75 * throw - 0.35 * dip;
        arm(
            &mut bend,
            left,
            down,
            -0.9 * crouch + 0.75 * throw + 0.35 * dip,
            0.25 + 0.45 * crouch - 0.1 * throw + 0.3 * dip,
        );
    }
    let pitch = 0.55 * (ramp(t, 0.70, OFF) * (1.0 - ramp(t, land - 0.10, land + 0.01)));
    // feet hang below the hips on the way, a little tucked, and wait for the ground on the way down
    let foot = |side: f64| Foot {
        shift: DVec3::new(0.02 * side * flying, height + 0.05 * flying, -0.02 * flying),
        yaw: 0.0,
        pitch: pitch * (1.0 - 0.2 * flying),
    };
    let hips = DVec3::new(0.0, y, -0.05 * (crouch + dip));
    Stance { hips, turn: DQuat::from_rotation_x(0.35 * fold), bend, feet: [foot(1.0), foot(-1.0)] }
}

/// Winds up, turns by half a circle in half a second, stops dead.
fn turn(t: f64) -> Stance {
    let wind = ramp(t, 0.05, 0.40) * (1.0 - ramp(t, 0.42, 0.62));
    // most of the way at constant speed: a hard start and a hard stop
    let go = |a: f64, b: f64| {
        let s = ((t - a) / (b - a)).clamp(0.0, 1.0);
        s * s * (3.0 - 2.0 * s)
    };
    let yaw = PI * go(0.45, 0.92);
    let busy = ramp(t, 0.45, 0.58) * (1.0 - ramp(t, 0.85, 1.05));
    let after = ramp(t, 0.88, 1.0) * (1.0 - ramp(t, 1.0, 1.5));
    let step = |a: f64, b: f64| {
        let s = ((t - a) / (b - a)).clamp(0.0, 1.0);
        Foot {
            shift: DVec3::Y * 0.07 * (PI * s).sin().powi(2),
            yaw: PI * go(a, b),
            pitch: 0.35 * (PI * s).sin().powi(2),
        }
    };
    let twist = -0.30 * wind;
    let mut bend = vec![
        ("spine".into(), DQuat::from_rotation_y(0.6 * twist + 0.10 * after)),
        ("chest".into(), DQuat::from_rotation_y(0.8 * twist + 0.18 * after)),
        ("neck".into(), DQuat::from_rotation_y(-0.2 * twist + 0.12 * wind)),
        ("head".into(), DQuat::from_rotation_y(-0.3 * twist + 0.25 * wind + 0.10 * busy - 0.10 * after)),
    ];
    for (left, side) in [(true, 1.0), (false, -1.0)] {
        arm(
            &mut bend,
            left,
            0.15 - 0.40 * busy,
            side * (-0.45 * wind + 0.35 * busy - 0.35 * after),
            0.35 + 0.35 * wind,
        );
    }
    let squat = 0.045 * wind + 0.03 * ramp(t, 0.85, 0.97) * (1.0 - ramp(t, 0.97, 1.35)) - 0.012 * busy;
    Stance {
        hips: DVec3::new(0.0, -STANCE - squat, 0.0),
        turn: DQuat::from_rotation_y(yaw + 0.7 * twist),
        bend,
        feet: [step(0.45, 0.80), step(0.58, 0.95)],
    }
}
