//! Real and bad files through the whole program.

use crate::shared::{real_file, real_files};
use crate::{folder, said, softrig};

/// Every bad file either works or is refused with one line that names it; none ends in a crash.
#[test]
fn bad_files_are_refused_in_one_line_or_work() {
    let files = real_files("data/bad", &["obj", "ply", "stl", "glb", "gltf", "msh", "vtu"]);
    let dir = folder();
    let mut refused = 0;
    for file in &files {
        let path = file.to_str().unwrap();
        let surface = !(path.ends_with(".msh") || path.ends_with(".vtu"));
        let out = format!("{refused}.vtu");
        let mesh = vec!["mesh", path, "-o", &out, "--cells", "1000", "--force"];
        for args in [vec!["inspect", path], if surface { mesh } else { vec!["inspect", path, "--json"] }] {
            let (code, _, err) = said(&softrig(dir.path(), &args));
            assert!(matches!(code, Some(0 | 1)), "{args:?}: {code:?} {err}");
            if code == Some(1) {
                refused += 1;
                let name = file.file_name().unwrap().to_str().unwrap();
                let errors: Vec<_> = err.lines().filter(|l| !l.starts_with("note: ")).collect();
                assert!(errors.len() == 1 && errors[0].contains(name), "{args:?}: {err}");
            }
        }
    }
    assert!(files.is_empty() || refused > 0);
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

/// A blow that crushes a head as large as the rest of the body is said, with the bone and the way out; that way out works.
#[test]
fn crushed_flesh_is_said_with_its_bone() {
    let Some(file) = real_file("data/characters/Knight.glb") else { return };
    let dir = folder();
    let chop = ["--clip", "1H_Melee_Attack_Chop", "--cells", "1000"];
    let args = [&["bake", file.to_str().unwrap(), "-o", "k.pc2", "--json"][..], &chop].concat();
    let (code, out, err) = said(&softrig(dir.path(), &args));
    assert_eq!(code, Some(0), "{err}");
    let crushed: serde_json::Value = serde_json::from_str(&out).unwrap();
    let inverted = |report: &serde_json::Value| report["inverted_cells_max"].as_u64().unwrap();
    assert!(err.contains("on the bone `head`") && err.contains("whole = true"), "{err}");
    assert!(crushed["notes"].to_string().contains("on the bone `head`"), "{crushed}");
    let scene = format!(
        "character = {:?}\n[motion]\nclip = \"{}\"\n[body]\ncells = 1000\n[[bone]]\njoint = \"head\"\nwhole = true\n",
        file.canonicalize().unwrap(),
        chop[1]
    );
    std::fs::write(dir.path().join("k.toml"), scene).unwrap();
    let (code, out, err) = said(&softrig(dir.path(), &["bake", "k.toml", "-o", "whole.pc2", "--json"]));
    assert_eq!(code, Some(0), "{err}");
    let whole: serde_json::Value = serde_json::from_str(&out).unwrap();
    assert!(10 * inverted(&whole) < inverted(&crushed), "{whole} {crushed}");
    assert!(whole["volume_ratio_min"].as_f64().unwrap() > 0.9, "{whole}");
}
