//! Two-way coupling from outside: a take is baked, baked again, and taken to other programs.

use crate::shared::real_file;
use crate::{folder, said, softrig};
use serde_json::Value;
use softrig::character::Character;
use softrig::couple::{BindSettings, Binding};
use softrig::material::{Material, MaterialMap};
use softrig::mesh::{self, LatticeOptions, Resolution};
use softrig::rig::{JointId, JointSetup, RootKind, automatic};
use softrig::simulation::{Action, Coupling, Event, RestMotion, Simulation, SimulationSettings, TwoWay, TwoWayScheme};
use softrig_io::{ImportOptions, import};
use std::path::Path;

const TAKE: &str = r#"
character = "sample"
[motion]
clip = "walk"
frames = "0..8"
[body]
cells = 600
[coupling]
two_way = true
drive = 0.6
[[joint]]
joint = "hand.L"
kind = "fixed"
[[event]]
start = 0.05
end = 0.2
drag = "hand.R"
path = [[0.05, -0.5, 0.7, 0.1], [0.2, -0.4, 1.2, 0.3]]
[[event]]
start = 0.1
wind = [0, 0, 6]
[[event]]
start = 0.0
gravity = [0, -3, 0]
"#;

fn bake(folder: &Path, args: &[&str]) -> Value {
    let (code, _, err) = said(&softrig(folder, args));
    assert_eq!(code, Some(0), "{err}");
    let i = args.iter().position(|a| *a == "--report").unwrap();
    serde_json::from_slice(&std::fs::read(folder.join(args[i + 1])).unwrap()).unwrap()
}

/// The take of a scene file is the same on one thread and on two; limits hold, bones stay rigid, joints say what they carry.
#[test]
fn a_take_is_baked_again_exactly() {
    let dir = folder();
    std::fs::write(dir.path().join("take.toml"), TAKE).unwrap();
    let args =
        ["bake", "take.toml", "-o", "a.pc2", "--report", "a.json", "--skeleton", "a.bvh", "--reactions", "a.csv"];
    let first = bake(dir.path(), &args);
    let again = bake(dir.path(), &["--threads", "1", "bake", "take.toml", "-o", "b.pc2", "--report", "b.json"]);
    assert_eq!(first["state_hash"], again["state_hash"]);
    assert_eq!(first["two_way"], true);
    assert!(first["joint_unknowns"].as_u64().unwrap() > 30, "{first}");
    for (key, most) in
        [("bone_length_error_max", 1e-6), ("limit_violation_max_rad", 1e-6), ("attachment_gap_max_m", 1e-6)]
    {
        assert!(first[key].as_f64().unwrap() <= most, "{key}: {first}");
    }
    let notes = first["notes"].to_string();
    assert!(notes.contains("joints chosen") && notes.contains("hinge"), "{notes}");
    let bvh = std::fs::read_to_string(dir.path().join("a.bvh")).unwrap();
    assert!(bvh.contains("Frames: 8"), "{bvh}");
    let csv = std::fs::read_to_string(dir.path().join("a.csv")).unwrap();
    assert!(csv.starts_with("frame,time_s,joint,force_x_n") && csv.contains(",hips,"), "{csv}");
    // one way it is another motion
    let one = bake(
        dir.path(),
        &[
            "bake", "sample", "--clip", "walk", "--frames", "0..8", "--cells", "600", "-o", "c.pc2", "--report",
            "c.json",
        ],
    );
    assert!(one["state_hash"] != first["state_hash"] && one["two_way"] == false);
}

/// What makes no sense is refused at once, by name.
#[test]
fn senseless_joints_and_events_are_refused() {
    let dir = folder();
    for (text, says) in [
        ("[coupling]\ntwo_way = true\n[[joint]]\njoint = 'hip'", "`hip`"),
        (
            "[coupling]\ntwo_way = true\n[[joint]]\njoint = 'shin.L'\nkind = 'hinge'\nrange = [10, 20]",
            "leaves out the rest pose",
        ),
        ("[[joint]]\njoint = 'hips'", "two_way"),
        ("[[event]]\ndrag = 'hips'", "two-way"),
        ("[[event]]\nstart = 2\nend = 1\nwind = [1, 0, 0]", "must end after"),
        ("[[event]]\nwind = [1, 0, 0]\ngravity = [1, 0, 0]", "exactly one"),
        ("[[event]]\npull = 'body'\nvertex = 999999999", "vertex"),
    ] {
        let scene = format!("character = \"sample\"\n[body]\ncells = 600\n{}", text.trim_start_matches("[body]\n"));
        std::fs::write(dir.path().join("bad.toml"), scene).unwrap();
        let (code, _, err) = said(&softrig(dir.path(), &["bake", "bad.toml", "-o", "x.pc2", "--frames", "0..2"]));
        assert!(code == Some(1) && err.contains(says), "{text}: {code:?} {err}");
    }
}

/// The skeleton's secondary motion goes back into a copy of the character as an ordinary clip; a motion of the CMU library drives a
/// character whose joints are called otherwise, its bones as long as before.
#[test]
fn a_captured_walk_drives_cesium_man_both_ways() {
    let (Some(man), Some(walk)) =
        (real_file("data/characters/CesiumMan.glb"), real_file("data/mocap/cmu_02_01_walk.bvh"))
    else {
        return;
    };
    let dir = folder();
    let (man, walk) = (man.display().to_string(), walk.display().to_string());
    let args = [
        "bake",
        &man,
        "--clip",
        &walk,
        "--cells",
        "800",
        "--frames",
        "0..12",
        "-o",
        "m.pc2",
        "--report",
        "m.json",
        "--two-way",
        "--skeleton",
        "m.glb",
    ];
    let report = bake(dir.path(), &args);
    assert!(report["bone_length_error_max"].as_f64().unwrap() < 1e-6, "{report}");
    let options = ImportOptions::default();
    let (before, after) =
        (import(Path::new(&man), &options).unwrap(), import(&dir.path().join("m.glb"), &options).unwrap());
    assert_eq!(after.clips.len(), before.clips.len() + 1);
    let clip = after.clips.last().unwrap();
    assert!(clip.name.ends_with("(softrig)") && clip.tracks.len() > 10, "{}", clip.name);
    // the sample too
    let report = bake(
        dir.path(),
        &[
            "bake",
            "sample",
            "--clip",
            &walk,
            "--cells",
            "600",
            "--frames",
            "0..4",
            "-o",
            "s.pc2",
            "--report",
            "s.json",
            "--two-way",
        ],
    );
    assert!(report["bone_length_error_max"].as_f64().unwrap() < 1e-6, "{report}");
}

/// Bones are as long as the clip has them, also where the file scales joints differently along their axes (by 1e-5 in some of these).
#[test]
fn bones_of_real_characters_keep_their_length() {
    for name in ["Cow", "Horse", "Knight", "RobotExpressive"] {
        let Some(file) = real_file(&format!("data/characters/{name}.glb")) else { continue };
        let (dir, file) = (folder(), file.display().to_string());
        let args = ["bake", &file, "--two-way", "--drive", "0.5", "--cells", "400", "--frames", "0..6"];
        let report = bake(dir.path(), &[&args[..], &["-o", "a.pc2", "--report", "a.json"]].concat());
        assert!(report["bone_length_error_max"].as_f64().unwrap() < 1e-12, "{name}: {report}");
        assert!(report["joint_unknowns"].as_u64().unwrap() > 10, "{name}: {report}");
    }
}

/// And the two joints that it is held by.
fn limp(character: &Character) -> (Simulation<f64>, [JointId; 2]) {
    let options = LatticeOptions { resolution: Resolution::Cells(700), ..LatticeOptions::default() };
    let volume = mesh::voxelize(&character.surface(true), &options).unwrap();
    let binding = Binding::new(character, &volume, &BindSettings::default()).unwrap();
    let settings = SimulationSettings { tolerance: 1e-4, preroll: 0.1, ..SimulationSettings::default() };
    let mut sim =
        Simulation::new(character, volume, binding, &MaterialMap::uniform(Material::default()), settings).unwrap();
    let bones: Vec<JointId> = sim.binding.bones.iter().map(|b| b.joint).collect();
    let mut joints = vec![JointSetup::default(); character.skeleton.joint_count()];
    for choice in automatic(&character.skeleton, &bones, &character.clips) {
        joints[choice.joint.index()] = choice.setup;
    }
    // the two joints furthest apart, of those at an end
    let below = |b: usize| sim.binding.bones.iter().any(|c| c.parent == Some(b));
    let ends: Vec<JointId> = (0..bones.len()).filter(|b| !below(*b)).map(|b| bones[b]).collect();
    let at = |j: JointId| character.skeleton.joint(j).rest.translation;
    let distance = |a: [f64; 3], b: [f64; 3]| (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f64>();
    let mut best = (bones[0], bones[0], -1.0);
    for a in &ends {
        for b in &ends {
            let d = distance(at(*a), at(*b));
            if d > best.2 {
                best = (*a, *b, d);
            }
        }
    }
    let hold = |joint| Event {
        start: 0.0,
        end: f64::INFINITY,
        action: Action::DragJoint { joint, path: vec![], stiffness: None },
    };
    let two = TwoWay { scheme: TwoWayScheme::Monolithic, joints, root: RootKind::Free };
    sim.couple(&Coupling::TwoWay(two), vec![hold(best.0), hold(best.1)]).unwrap();
    (sim, [best.0, best.1])
}

/// A character hangs limp from two of its ends for so many frames, its limits held, its flesh on its bones. Says in words how it went.
fn hang(name: &str, frames: usize) -> String {
    let Some(file) = real_file(&format!("data/characters/{name}")) else { return String::new() };
    let character = import(&file, &ImportOptions::default()).unwrap();
    let motion = RestMotion(&character.skeleton);
    let (mut sim, held) = limp(&character);
    sim.start(&motion).unwrap();
    let height = character.height();
    for f in 1..=frames {
        sim.advance(&motion, f as f64 / 30.0).unwrap_or_else(|e| panic!("{name} frame {f}: {e}"));
        assert!(sim.limit_violation() <= 1e-6, "{name} frame {f}: {}", sim.limit_violation());
        assert!(sim.attachment_gap() <= 1e-6 * height, "{name} frame {f}: {}", sim.attachment_gap());
    }
    // bones that share none above them are pieces of their own: one that is not held falls, no faster than anything does
    let root_of = |joint: JointId| {
        let above = std::iter::successors(Some(joint), |j| character.skeleton.joint(*j).parent);
        above.filter(|j| sim.free_roots().contains(j)).last()
    };
    let held_roots = held.map(root_of);
    let time = frames as f64 / 30.0;
    let (mut fell, mut far) = (0.0f64, 0.0f64);
    for (n, (p, r)) in sim.state.position.iter().zip(&sim.body.mesh.nodes).enumerate() {
        let d = (0..3).map(|k| (p[k] - r[k]).powi(2)).sum::<f64>().sqrt();
        assert!(d.is_finite(), "{name}");
        if held_roots.contains(&root_of(sim.binding.joint(sim.binding.owner[n]))) {
            (fell, far) = (fell.max(r[1] - p[1]), far.max(d));
        } else {
            assert!(d < 4.0 * height + 0.5 * 9.81 * (time + 0.1).powi(2), "{name}: a piece flew {d} m");
        }
    }
    assert!(fell > 0.02 * height && far < 4.0 * height, "{name}: {fell} {far} of {height}");
    let [a, b] = held.map(|j| &character.skeleton.joint(j).name);
    format!("{name}, held by {a} and {b}: fell {fell:.2} m of its {height:.2}, nothing further than {far:.2}")
}

#[test]
fn a_character_hangs_limp() {
    eprintln!("{}", hang("CesiumMan.glb", 20));
}

/// A skeleton and a clip that have nothing to say to each other: refused, with what to do about it.
#[test]
fn a_clip_of_other_joints_is_refused() {
    let dir = folder();
    let bvh = "HIERARCHY\nROOT wing\n{\nOFFSET 0 0 0\nCHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation\n\
               JOINT feather\n{\nOFFSET 0 1 0\nCHANNELS 3 Zrotation Xrotation Yrotation\nEnd Site\n{\nOFFSET 0 1 0\n}\n}\n}\n\
               MOTION\nFrames: 2\nFrame Time: 0.033\n0 0 0 0 0 0 0 0 0\n0 0 0 10 0 0 0 10 0\n";
    std::fs::write(dir.path().join("bird.bvh"), bvh).unwrap();
    let args =
        ["bake", "sample", "--clip", "bird.bvh", "--cells", "600", "--two-way", "-o", "b.pc2", "--frames", "0..2"];
    let (code, _, err) = said(&softrig(dir.path(), &args));
    assert!(code == Some(1) && err.contains("bird.bvh") && err.contains("joint"), "{code:?} {err}");
}

/// Every real character for five seconds, or the one that `CHARACTER` names: minutes.
#[test]
#[ignore = "takes minutes"]
fn every_character_hangs_limp() {
    let all =
        ["CesiumMan.glb", "Fox.glb", "Cow.glb", "Horse.glb", "Knight.glb", "RobotExpressive.glb", "RiggedSimple.gltf"];
    let wanted = std::env::var("CHARACTER").unwrap_or_default();
    let some: Vec<&str> = all.into_iter().filter(|name| name.starts_with(&wanted)).collect();
    assert!(!some.is_empty(), "no character is called {wanted}");
    for name in some {
        eprintln!("{}", hang(name, 150));
    }
}
