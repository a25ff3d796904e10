//! Motion capture files against an independent forward kinematics.

use crate::bad::cut;
use crate::shared::data;
use softrig::character::Character;
use softrig::rig::JointId;
use softrig_io::bvh::{self, Bvh, BvhOptions, FirstFrame};
use softrig_io::{ImportOptions, UpAxis};
use std::path::Path;

type Matrix = [[f64; 4]; 4];

fn multiply(a: &Matrix, b: &Matrix) -> Matrix {
    std::array::from_fn(|i| std::array::from_fn(|j| (0..4).map(|k| a[i][k] * b[k][j]).sum()))
}

fn translation(t: [f64; 3]) -> Matrix {
    [[1.0, 0.0, 0.0, t[0]], [0.0, 1.0, 0.0, t[1]], [0.0, 0.0, 1.0, t[2]], [0.0, 0.0, 0.0, 1.0]]
}

fn turn(axis: char, degrees: f64) -> Matrix {
    let (s, c) = degrees.to_radians().sin_cos();
    match axis {
        'X' => [[1.0, 0.0, 0.0, 0.0], [0.0, c, -s, 0.0], [0.0, s, c, 0.0], [0.0, 0.0, 0.0, 1.0]],
        'Y' => [[c, 0.0, s, 0.0], [0.0, 1.0, 0.0, 0.0], [-s, 0.0, c, 0.0], [0.0, 0.0, 0.0, 1.0]],
        _ => [[c, -s, 0.0, 0.0], [s, c, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]],
    }
}

/// The plainest reading of a BVH file: recursive descent over its words, matrices straight from the channels. Joint positions
/// of every frame in file units.
struct Reference {
    joints: Vec<(Option<usize>, [f64; 3], Vec<String>)>,
    frames: Vec<Vec<f64>>,
}

impl Reference {
    fn read(text: &str) -> Self {
        let words: Vec<&str> = text.split_whitespace().collect();
        let (mut joints, mut stack, mut i) = (Vec::new(), Vec::new(), 0);
        let mut last = None;
        while words[i] != "MOTION" {
            match words[i] {
                "ROOT" | "JOINT" => {
                    last = Some(joints.len());
                    joints.push((stack.last().copied().flatten(), [0.0; 3], Vec::new()));
                }
                "End" => last = None,
                "{" => stack.push(last),
                "}" => {
                    stack.pop();
                }
                "OFFSET" => {
                    if let Some(j) = last {
                        joints[j].1 = std::array::from_fn(|k| words[i + 1 + k].parse().unwrap());
                    }
                }
                "CHANNELS" => {
                    let n: usize = words[i + 1].parse().unwrap();
                    joints[last.unwrap()].2 = words[i + 2..i + 2 + n].iter().map(|w| w.to_string()).collect();
                }
                _ => {}
            }
            i += 1;
        }
        let width: usize = joints.iter().map(|j| j.2.len()).sum();
        // MOTION Frames: n Frame Time: t
        let values: Vec<f64> = words[i + 6..].iter().map(|w| w.parse().unwrap()).collect();
        Self { joints, frames: values.chunks_exact(width).map(<[f64]>::to_vec).collect() }
    }

    fn positions(&self, frame: usize) -> Vec<[f64; 3]> {
        let mut world: Vec<Matrix> = Vec::new();
        let mut column = 0;
        for (parent, offset, channels) in &self.joints {
            let (mut at, mut rotation) = (*offset, translation([0.0; 3]));
            for channel in channels {
                let value = self.frames[frame][column];
                column += 1;
                let axis = channel.chars().next().unwrap();
                if channel.ends_with("position") {
                    at[axis as usize - 'X' as usize] = value;
                } else {
                    rotation = multiply(&rotation, &turn(axis, value));
                }
            }
            let local = multiply(&translation(at), &rotation);
            world.push(parent.map_or(local, |p| multiply(&world[p], &local)));
        }
        world.iter().map(|m| [m[0][3], m[1][3], m[2][3]]).collect()
    }
}

fn every_frame() -> BvhOptions {
    BvhOptions { first_frame: FirstFrame::Keep, ..BvhOptions::default() }
}

fn joint_positions(bvh: &Bvh, frame: usize) -> Vec<[f64; 3]> {
    let locals = bvh.clip.sample(&bvh.skeleton, frame as f64 * bvh.frame_time);
    bvh.skeleton.pose(&locals).world.iter().map(|w| w.translation).collect()
}

fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f64>().sqrt()
}

/// Every joint of every frame of every file; the largest error seen is near rounding.
#[test]
fn forward_kinematics_match_the_reference_to_a_millimetre() {
    let Some(folder) = data() else { return };
    let paths = folder.files("mocap", &["bvh"]);
    assert_eq!(paths.len(), 6);
    for path in paths {
        let bvh = bvh::read_with(&path, &every_frame()).unwrap();
        let reference = Reference::read(&std::fs::read_to_string(&path).unwrap());
        assert_eq!(bvh.frame_count, reference.frames.len());
        let (mut worst, mut moved) = (0.0, 0.0f64);
        let start = joint_positions(&bvh, 0);
        for frame in 0..bvh.frame_count {
            let got = joint_positions(&bvh, frame);
            let expected = reference.positions(frame);
            assert_eq!(got.len(), expected.len());
            for (j, p) in got.iter().enumerate() {
                worst = f64::max(worst, distance(*p, bvh.skeleton.to_world().point(expected[j])));
                moved = moved.max(distance(*p, start[j]));
            }
        }
        assert!(moved > 0.5, "{}: nothing moves", path.display());
        assert!(worst < 1e-3, "{}: {worst} m", path.display());
        assert!(worst < 1e-9, "{}: beyond rounding: {worst} m", path.display());
    }
}

/// Joints and frames of the data's table; CMU skeletons come out as people, in a unit of 5.6 cm, without their added first frame.
#[test]
fn files_have_the_joints_frames_and_traps_of_the_table() {
    let Some(folder) = data() else { return };
    for (name, joints, frames, jumps, hz) in [
        ("cmu_02_01_walk", 31, 344, true, 120.0),
        ("cmu_02_04_jump_balance", 31, 484, true, 120.0),
        ("cmu_05_02_dance", 31, 1124, true, 120.0),
        ("cmu_09_01_run", 31, 149, true, 120.0),
        ("cmu_alt_02_01_walk", 31, 343, false, 120.0),
        ("zombie", 27, 779, false, 30.0),
    ] {
        let path = folder.file(format!("mocap/{name}.bvh"));
        let bvh = bvh::read(&path).unwrap();
        assert_eq!((bvh.skeleton.joint_count(), bvh.first_frame_jumps), (joints, jumps), "{name}");
        assert_eq!(bvh.frame_count, frames - usize::from(jumps), "{name}");
        assert!((1.0 / bvh.frame_time - hz).abs() < 0.01, "{name}");
        assert!((bvh.clip.duration() - bvh.frame_time * (bvh.frame_count - 1) as f64).abs() < 1e-9, "{name}");
        // the figure stands in metres: the hips of a person are 0.7 to 1.2 m above the ground somewhere in the clip
        let hips = joint_positions(&bvh, bvh.frame_count / 2)[0];
        assert!((0.6..1.3).contains(&hips[1]), "{name}: hips at {hips:?}, {:?}", bvh.notes);
        if name.starts_with("cmu") {
            let unit = bvh.skeleton.to_world().linear[0][0];
            assert!((0.045..0.065).contains(&unit), "{name}: {unit} m, {:?}", bvh.notes);
            assert!(bvh.skeleton.joints().iter().filter(|j| j.local.translation == [0.0; 3]).count() >= 5, "{name}");
        } else {
            assert!(bvh.notes.iter().any(|n| n.contains("Z as the up axis")), "{:?}", bvh.notes);
        }
    }
}

#[test]
fn what_is_written_reads_back_as_the_same_motion() {
    let Some(folder) = data() else { return };
    for name in ["zombie.bvh", "cmu_alt_02_01_walk.bvh"] {
        let bvh = bvh::read(&folder.file(format!("mocap/{name}"))).unwrap();
        let text = bvh::to_text(&bvh.skeleton, &bvh.clip, bvh.frame_time);
        let import = ImportOptions { unit: Some(1.0), up: Some(UpAxis::Y), ..ImportOptions::default() };
        let back = bvh::from_bytes(text.as_bytes(), Path::new(name), &BvhOptions { import, ..every_frame() }).unwrap();
        assert_eq!(back.frame_count, bvh.frame_count);
        for frame in [0, bvh.frame_count / 2, bvh.frame_count - 1] {
            let (a, b) = (joint_positions(&bvh, frame), joint_positions(&back, frame));
            for (j, p) in a.iter().enumerate() {
                // joints are written depth first, which is the order of these files
                assert!(distance(*p, b[j]) < 1e-6, "{name}, joint {j}: {p:?} {:?}", b[j]);
            }
        }
    }
}

/// A character made of a skeleton alone.
fn character(bvh: &Bvh) -> Character {
    Character {
        name: "figure".into(),
        meshes: Vec::new(),
        skeleton: bvh.skeleton.clone(),
        clips: Vec::new(),
        looks: Vec::new(),
        textures: Vec::new(),
        notes: Vec::new(),
    }
}

/// A motion put back on its own skeleton is the same motion.
#[test]
fn a_motion_fits_its_own_skeleton() {
    let Some(folder) = data() else { return };
    for name in ["zombie.bvh", "cmu_02_01_walk.bvh"] {
        let bvh = bvh::read(&folder.file(format!("mocap/{name}"))).unwrap();
        let figure = character(&bvh);
        let (clip, notes) = bvh::apply_to(&figure, &bvh).unwrap();
        assert!(notes.is_empty(), "{name}: {notes:?}");
        let lowest = figure.skeleton.joints().iter().map(|j| j.rest.translation[1]).fold(f64::INFINITY, f64::min);
        for frame in [0, 100, bvh.frame_count - 1] {
            let expected = joint_positions(&bvh, frame);
            let pose = figure.skeleton.pose(&clip.sample(&figure.skeleton, frame as f64 * bvh.frame_time));
            for (j, p) in expected.iter().enumerate() {
                // the figure of the file has its feet below zero at rest; it is set on its feet
                let q = pose.world[j].translation;
                assert!(distance([p[0], p[1] + lowest, p[2]], q) < 1e-9, "{name}, {j}");
            }
        }
    }
}

/// The two conversions of one CMU take have other offsets and angles, and names in common; put on the other's skeleton,
/// arms and legs must point where they do in the motion itself.
#[test]
fn limbs_point_the_same_way_on_another_conversion() {
    let Some(folder) = data() else { return };
    let bvh = bvh::read(&folder.file("mocap/cmu_alt_02_01_walk.bvh")).unwrap();
    let mut figure = character(&bvh::read(&folder.file("mocap/cmu_02_01_walk.bvh")).unwrap());
    // names as another program writes them
    let joints = figure.skeleton.joints().iter().cloned();
    let renamed = joints.map(|j| softrig::rig::Joint { name: format!("mixamorig:{}", j.name.to_uppercase()), ..j });
    figure.skeleton = softrig::rig::Skeleton::new(renamed.collect(), *figure.skeleton.to_world()).unwrap();
    let (clip, notes) = bvh::apply_to(&figure, &bvh).unwrap();
    let direction = |world: &[softrig::rig::Affine], a: JointId, b: JointId| {
        let (p, q) = (world[a.index()].translation, world[b.index()].translation);
        let d = [q[0] - p[0], q[1] - p[1], q[2] - p[2]];
        d.map(|v| v / distance(p, q))
    };
    let mut worst = 0.0f64;
    for frame in (0..bvh.frame_count).step_by(20) {
        let time = frame as f64 * bvh.frame_time;
        let ours = figure.skeleton.pose(&clip.sample(&figure.skeleton, time)).world;
        let theirs = bvh.skeleton.pose(&bvh.clip.sample(&bvh.skeleton, time)).world;
        for (a, b) in [
            ("LeftArm", "LeftForeArm"),
            ("LeftUpLeg", "LeftLeg"),
            ("RightUpLeg", "RightLeg"),
            ("RightArm", "RightForeArm"),
        ] {
            let (x, y) = (bvh.skeleton.find(a).unwrap(), bvh.skeleton.find(b).unwrap());
            let named = |n: &str| figure.skeleton.find(&format!("mixamorig:{}", n.to_uppercase())).unwrap();
            let angle = distance(direction(&ours, named(a), named(b)), direction(&theirs, x, y));
            worst = worst.max(angle);
        }
    }
    // chord of 10 degrees, below which differences of direction are left alone
    assert!(worst < 0.18, "{worst} rad, {notes:?}");
}

/// Hips, a head, and one arm of three joints along `arm`; two frames, in the second the whole figure and its arm are turned.
fn one_armed(arm: [f64; 3]) -> Bvh {
    let [x, y, z] = arm;
    let turns = "Zrotation Xrotation Yrotation";
    let text = format!(
        "HIERARCHY\nROOT Hips\n{{\nOFFSET 0 0 0\nCHANNELS 6 Xposition Yposition Zposition {turns}\n\
         JOINT Head\n{{\nOFFSET 0 0.7 0\nCHANNELS 3 {turns}\n}}\nJOINT Foot\n{{\nOFFSET 0 -0.9 0\nCHANNELS 3 {turns}\n}}\n\
         JOINT Arm\n{{\nOFFSET 0.2 0.5 0\nCHANNELS 3 {turns}\nJOINT ForeArm\n{{\nOFFSET {x} {y} {z}\nCHANNELS 3 {turns}\n\
         JOINT Hand\n{{\nOFFSET {x} {y} {z}\nCHANNELS 3 {turns}\n}}\n}}\n}}\n}}\nMOTION\nFrames: 2\nFrame Time: 0.1\n\
         0 0.9 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0\n\
         1 0.9 2 5 -8 30 0 0 0 0 0 0 40 20 -10 0 25 50 0 0 0\n"
    );
    let import = ImportOptions { unit: Some(1.0), up: Some(UpAxis::Y), ..ImportOptions::default() };
    bvh::from_bytes(text.as_bytes(), Path::new("one.bvh"), &BvhOptions { import, ..every_frame() }).unwrap()
}

/// A motion recorded from arms stretched out, on a character modelled with its arms hanging down: arm and forearm must point where
/// the motion says, whatever the rest pose.
#[test]
fn arms_hanging_down_follow_a_motion_from_arms_stretched_out() {
    let motion = one_armed([0.3, 0.0, 0.0]);
    let figure = character(&one_armed([0.15, -0.25, 0.05]));
    let (clip, notes) = bvh::apply_to(&figure, &motion).unwrap();
    assert!(notes.iter().any(|n| n.contains("rest poses differ")), "{notes:?}");
    for frame in 0..2 {
        let time = frame as f64 * motion.frame_time;
        let theirs = joint_positions(&motion, frame);
        let ours: Vec<_> =
            figure.skeleton.pose(&clip.sample(&figure.skeleton, time)).world.iter().map(|w| w.translation).collect();
        let direction = |p: &[[f64; 3]], a: &str, b: &str| {
            let (p, q) = (p[motion.skeleton.find(a).unwrap().index()], p[motion.skeleton.find(b).unwrap().index()]);
            let length = distance(p, q);
            [0, 1, 2].map(|k| (q[k] - p[k]) / length)
        };
        for (a, b) in [("Arm", "ForeArm"), ("ForeArm", "Hand"), ("Hips", "Head")] {
            let apart = distance(direction(&ours, a, b), direction(&theirs, a, b));
            assert!(apart < 1e-9, "frame {frame}, {a}: {apart}");
        }
    }
}

#[test]
fn a_motion_for_another_skeleton_names_both() {
    let Some(folder) = data() else { return };
    let zombie = bvh::read(&folder.file("mocap/zombie.bvh")).unwrap();
    let text = "HIERARCHY\nROOT tail\n{\nOFFSET 0 0 0\nCHANNELS 3 Xrotation Yrotation Zrotation\n}\nMOTION\nFrames: 1\nFrame Time: 0.1\n0 0 0\n";
    let other = bvh::from_bytes(text.as_bytes(), Path::new("tail.bvh"), &BvhOptions::default()).unwrap();
    let e = bvh::apply_to(&character(&zombie), &other).unwrap_err().to_string();
    assert!(e.contains("`tail`") && e.contains("`Hips`") && e.contains("tail.bvh"), "{e}");
}

#[test]
fn motions_cut_anywhere_end_in_a_value_or_an_error() {
    let Some(folder) = data() else { return };
    for path in folder.files("mocap", &["bvh"]) {
        cut(&path, |bytes| {
            bvh::from_bytes(bytes, &path, &BvhOptions::default()).map(|bvh| {
                assert!(joint_positions(&bvh, bvh.frame_count - 1).iter().flatten().all(|v| v.is_finite()));
            })
        });
    }
}
