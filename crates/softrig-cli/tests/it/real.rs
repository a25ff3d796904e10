//! Real and bad files through the whole program.

use crate::shared::{real_file, real_files};
use crate::{folder, said, softrig};
use std::path::Path;
use std::process::{Command, Output};

/// What becomes of every bad file: what its refusal says, or nothing where it works.
const BAD: [(&str, Option<&str>); 22] = [
    // six tetrahedra, one of them inside out: turned over and counted
    ("6_tetra_bad.msh", None),
    ("Armadillo_Tetra_4406_broken.vtu", Some("the piece says 1445 points, but has 4338 coordinates")),
    // surfaces that are open, doubled, in pieces or badly wound have an inside all the same
    ("chair_model.obj", None),
    ("cloth100.obj", None),
    ("cycloidal.ply", None),
    ("demosthenes_scan_open.obj", None),
    ("gltf/BoxWithInfinites.glb", Some("vertex 0 has no finite position")),
    ("gltf/IndexOutOfRange.gltf", Some("it names vertex 255, but there are 24")),
    ("gltf/RecursiveNodes.gltf", Some("the node is its own ancestor")),
    ("gltf/integer-out-of-bounds.gltf", Some("the JSON is wrong")),
    ("gltf/invalid-buffer-index.gltf", Some("no node of its scene shows a mesh")),
    ("gltf/invalid-primitive-indices.gltf", Some("no node of its scene shows a mesh")),
    // one inverse bind matrix is garbage: replaced and said
    ("gltf/unassigned-skeleton.gltf", None),
    ("human_neutral_eyes.obj", None),
    ("joined_tetrahedra.obj", None),
    ("multibody.stl", None),
    ("negative_indices.obj", None),
    // the face with two corners is left out and said
    ("notenoughindices.obj", None),
    ("rabbit.obj", None),
    ("soup.stl", None),
    ("teapot.stl", None),
    ("wallhole.obj", None),
];

/// Runs `softrig` with so many seconds of processor time, over all its threads, and 500 MiB of addresses: what needs more is killed
/// by the system. What merely waits for a busy machine is not.
fn bounded(folder: &Path, seconds: u32, args: &[&str]) -> Output {
    if cfg!(not(unix)) {
        return softrig(folder, args);
    }
    let mut command = Command::new("sh");
    let limits = format!("ulimit -t {seconds} && ulimit -v 512000 && exec \"$@\"");
    command.current_dir(folder).args(["-c", &limits, "sh"]);
    command.args([env!("CARGO_BIN_EXE_softrig"), "--threads", "2"]).args(args);
    command.output().expect("sh starts")
}

/// Every bad file works, or is refused with exit code 1 and one line that names it and says why; within 2 s and 500 MiB.
#[test]
fn bad_files_work_or_are_refused_as_the_table_says() {
    let files = real_files("data/bad", &["obj", "ply", "stl", "glb", "gltf", "msh", "vtu"]);
    let Some(first) = files.first() else { return };
    // no file of the folder is forgotten
    assert_eq!(files.len(), BAD.len(), "{files:?}");
    let dir = folder();
    let bad = first.ancestors().find(|p| p.ends_with("bad")).unwrap();
    for (name, refusal) in BAD {
        let file = bad.join(name);
        let path = file.to_str().unwrap();
        let refused = |args: &[&str], because: &str| {
            let (code, _, err) = said(&bounded(dir.path(), 2, args));
            assert_eq!(code, Some(1), "{args:?}: {err}");
            let errors: Vec<_> = err.lines().filter(|l| !l.starts_with("note: ")).collect();
            assert!(errors.len() == 1 && errors[0].contains(path) && errors[0].contains(because), "{args:?}: {err}");
        };
        let mesh = ["mesh", path, "-o", "out.vtu", "--cells", "1000", "--force"];
        let bake = ["bake", path, "-o", "out.pc2"];
        if let Some(because) = refusal {
            refused(&["inspect", path], because);
            refused(&mesh, because);
            if !name.ends_with(".vtu") {
                refused(&bake, because);
            }
            continue;
        }
        let (code, _, err) = said(&bounded(dir.path(), 2, &["inspect", path]));
        assert_eq!(code, Some(0), "{name}: {err}");
        let (code, _, err) = said(&bounded(dir.path(), 10, &mesh));
        assert_eq!(code, Some(0), "{name}: {err}");
        if !name.ends_with(".gltf") && !name.ends_with(".msh") {
            refused(&bake, "is a surface without a rig");
        }
    }
}

/// A pipe that nobody writes to and a device without an end are refused before they are read.
#[test]
#[cfg(unix)]
fn what_never_ends_is_refused() {
    let dir = folder();
    let made = Command::new("mkfifo").current_dir(dir.path()).arg("pipe").status();
    for ending in ["pc2", "mdd", "toml", "softrig-journal", "glb", "obj", "bvh", "vtu"] {
        for (kind, target) in [("zero", Path::new("/dev/zero")), ("pipe", &dir.path().join("pipe"))] {
            if kind == "pipe" && !made.as_ref().is_ok_and(std::process::ExitStatus::success) {
                continue;
            }
            let name = format!("{kind}.{ending}");
            std::os::unix::fs::symlink(target, dir.path().join(&name)).unwrap();
            let (code, _, err) = said(&bounded(dir.path(), 2, &["inspect", &name]));
            assert!(matches!(code, Some(1 | 3)) && err.contains(&name), "{name}: {code:?} {err}");
            assert!(err.contains("not a regular file"), "{name}: {err}");
        }
    }
}

/// Inspecting says what is in every character, and the scene it prints is one.
#[test]
fn characters_are_inspected_and_their_scenes_read_back() {
    for name in ["CesiumMan.glb", "Fox.glb", "Cow.glb", "Knight.glb", "RobotExpressive.glb", "RiggedSimple.gltf"] {
        let Some(file) = real_file(&format!("data/characters/{name}")) else { continue };
        let dir = folder();
        let path = file.to_str().unwrap();
        let (code, out, err) = said(&softrig(dir.path(), &["inspect", path, "--json"]));
        assert_eq!(code, Some(0), "{err}");
        let info: serde_json::Value = serde_json::from_str(&out).unwrap();
        assert!(info["bones"].as_array().unwrap().len() > 1 && !info["clips"].as_array().unwrap().is_empty(), "{name}");
        let (code, out, err) = said(&softrig(dir.path(), &["inspect", path, "--scene"]));
        assert_eq!(code, Some(0), "{err}");
        std::fs::copy(&file, dir.path().join(name)).unwrap();
        std::fs::write(dir.path().join("s.toml"), out).unwrap();
        let (code, out, err) = said(&softrig(dir.path(), &["inspect", "s.toml", "--json"]));
        assert_eq!(code, Some(0), "{name}: {err}");
        let again: serde_json::Value = serde_json::from_str(&out).unwrap();
        assert_eq!(again["bones"], info["bones"], "{name}");
    }
}

/// One cache for each mesh, in a folder, with as many points as the file has vertices.
#[test]
fn a_character_of_several_meshes_makes_a_folder_of_caches() {
    let Some(file) = real_file("data/characters/Knight.glb") else { return };
    let dir = folder();
    let path = file.to_str().unwrap();
    let args = ["bake", path, "-o", "knight.pc2", "--cells", "1000", "--frames", "0..2", "--json"];
    let (code, out, err) = said(&softrig(dir.path(), &args));
    assert_eq!(code, Some(0), "{err}");
    let report: serde_json::Value = serde_json::from_str(&out).unwrap();
    let outputs = report["outputs"].as_array().unwrap();
    assert_eq!(outputs.len(), 15, "{outputs:?}");
    let mut points = 0;
    for output in outputs {
        let cache = std::fs::read(dir.path().join(output.as_str().unwrap())).unwrap();
        points += u32::from_le_bytes(cache[16..20].try_into().unwrap());
    }
    assert_eq!(points, 7024);
    assert_eq!(report["skin_vertices"], 7024);
}

/// A clip that stops a head of a metre within a frame: flesh is made stiff enough and the report says so. Left soft it is crushed,
/// and the report names the bone and what helps.
#[test]
fn flesh_is_stiff_enough_for_the_clip_or_said_to_be_crushed() {
    let Some(file) = real_file("data/characters/Knight.glb") else { return };
    let dir = folder();
    let bake = |name: &str, more: &str| -> (serde_json::Value, String) {
        let scene = format!(
            "character = {:?}\n[motion]\nclip = \"1H_Melee_Attack_Chop\"\n[body]\ncells = 1000\n{more}",
            file.canonicalize().unwrap()
        );
        std::fs::write(dir.path().join(format!("{name}.toml")), scene).unwrap();
        let args = ["bake", &format!("{name}.toml"), "-o", &format!("{name}.pc2"), "--json"];
        let (code, out, err) = said(&softrig(dir.path(), &args));
        assert_eq!(code, Some(0), "{err}");
        (serde_json::from_str(&out).unwrap(), err)
    };
    let inverted = |report: &serde_json::Value| report["inverted_cells_max"].as_u64().unwrap();
    let (stiff, err) = bake("stiff", "");
    assert!(inverted(&stiff) <= 3 && stiff["volume_ratio_min"].as_f64().unwrap() > 0.9, "{stiff}");
    assert!(stiff["stiffened_max"].as_f64().unwrap() > 3.0 && err.contains("on the bone `head`"), "{err}");
    let (soft, err) = bake("soft", "[simulation]\nstiffen = false\n");
    assert!(inverted(&soft) > 20 && soft["stiffened_max"] == 1.0, "{soft}");
    assert!(err.contains("on the bone `head`") && err.contains("whole = true"), "{err}");
    assert!(soft["notes"].to_string().contains("on the bone `head`"), "{soft}");
}
