//! Scenes of objects: those of the repository bake, constraints come and go in them, and nonsense is refused by name.

use crate::{command, folder, root, said, softrig};
use serde_json::Value;
use std::path::Path;
use std::process::Stdio;
use std::time::Duration;

fn bake(dir: &Path, scene: &str, out: &str, more: &[&str]) -> Value {
    let args: Vec<&str> = ["bake", scene, "-o", out, "--json", "--force"].iter().chain(more).copied().collect();
    let (code, text, err) = said(&softrig(dir, &args));
    assert_eq!(code, Some(0), "{scene}: {err}");
    serde_json::from_str(&text).unwrap()
}

/// Every scene file of the repository bakes, and is drawn, as it is written; only briefly here.
#[test]
fn every_scene_of_the_repository_bakes_and_renders() {
    let dir = folder();
    let mut count = 0;
    for entry in std::fs::read_dir(root().join("scenes")).unwrap() {
        let path = entry.unwrap().path();
        let scene = path.to_str().unwrap();
        if !scene.ends_with(".toml") {
            continue;
        }
        count += 1;
        let report = bake(dir.path(), scene, "out.softrig-journal", &["--frames", "0..2"]);
        assert_eq!((&report["method"], &report["frames"]), (&"mass-points".into(), &2.into()), "{scene}");
        assert!(report["explicit_steps"].as_u64() > Some(1), "{report}");
        let volume = (report["volume_ratio_min"].as_f64().unwrap(), report["volume_ratio_max"].as_f64().unwrap());
        assert!(volume.0 > 0.8 && volume.1 < 1.2, "{scene}: {volume:?}");
        for (from, to) in [("out.softrig-journal", "out.png"), (scene, "rest.png")] {
            let (code, _, err) =
                said(&softrig(dir.path(), &["render", from, "-o", to, "--force", "--size", "160x120"]));
            assert_eq!(code, Some(0), "{scene}: {err}");
        }
    }
    assert!(count >= 5, "{count} scenes");
}

/// The counts of the paper are those of the scene file.
#[test]
fn figure_1_has_the_counts_of_the_paper() {
    let dir = folder();
    let scene = root().join("scenes/s06-figure1.toml");
    let report = bake(dir.path(), scene.to_str().unwrap(), "out.softrig-journal", &["--frames", "0..1"]);
    assert_eq!(report["cells"], 3950, "{report}");
}

/// Two cubes apart; the upper one is nailed, moved aside, and joined to the lower one, which falls until then and again at the end.
const CUBES: &str = r#"
[motion]
fps = 50.0
duration = 0.6
[simulation]
method = "METHOD"
[material]
young_modulus = 1e5
[[object]]
name = "upper"
position = [0.0, 0.1, 0.0]
[[object]]
name = "lower"
[[constraint]]
object = "upper"
at = [[0.0, 0.1, 0.0], [0.0, 0.1, 0.1], [0.1, 0.1, 0.0], [0.1, 0.1, 0.1]]
path = [[0.2, 0.0, 0.0, 0.0], [0.4, 0.05, 0.0, 0.0]]
[[constraint]]
kind = "join"
object = "lower"
at = [[0.0, 0.1, 0.0], [0.0, 0.1, 0.1], [0.1, 0.1, 0.0], [0.1, 0.1, 0.1]]
to = "upper"
to_at = [[0.0, 0.0, 0.0], [0.0, 0.0, 0.1], [0.1, 0.0, 0.0], [0.1, 0.0, 0.1]]
end = 0.4
"#;

/// By every method: joined corners are one place while they are joined, nails move as told, what is let go falls.
#[test]
fn constraints_come_go_and_move_in_a_scene() {
    let dir = folder();
    for method in ["mass-points", "elements", "clustered", "implicit"] {
        std::fs::write(dir.path().join("cubes.toml"), CUBES.replace("METHOD", method)).unwrap();
        bake(dir.path(), "cubes.toml", "out", &[]);
        let at = |frame: usize| -> Vec<[f64; 3]> {
            let text = std::fs::read_to_string(dir.path().join(format!("out/frame_{frame:04}.obj"))).unwrap();
            let line =
                |l: &str| l.split(' ').skip(1).map(|n| n.parse().unwrap()).collect::<Vec<f64>>().try_into().unwrap();
            text.lines().filter(|l| l.starts_with("v ")).map(line).collect()
        };
        // corners are 4 x + 2 y + z, the lower cube's eight after the upper one's
        for frame in [1, 10, 18] {
            let x = at(frame);
            for (a, b) in [(0, 10), (1, 11), (4, 14), (5, 15)] {
                let gap = (0..3).map(|k| (x[a][k] - x[b][k]).abs()).fold(0.0, f64::max);
                assert!(gap < 1e-6, "{method} frame {frame}: {gap}");
            }
            assert!(x[8][1] > -0.05, "{method} frame {frame}: {:?}", x[8]);
        }
        let (moved, last) = (at(20), at(30));
        assert!((moved[2][0] - 0.05).abs() < 1e-6 && (last[2][0] - 0.05).abs() < 1e-6, "{method}: {:?}", moved[2]);
        assert!(last[8][1] < moved[8][1] - 0.05, "{method}: {:?} {:?}", moved[8], last[8]);
    }
}

/// Implicit steps eliminate: a node may be nailed, joined and joined again, and is exactly there; what contradicts is named.
#[test]
fn implicit_objects_have_several_constraints_on_a_node() {
    let dir = folder();
    let again = "[[constraint]]\nkind = 'join'\nobject = 'lower'\nat = [[0.0, 0.1, 0.0]]\nto = 'upper'\nto_at = [[0.0, 0.0, 0.0]]\n";
    let nail = "[[constraint]]\nobject = 'lower'\nat = [[0.0, 0.1, 0.0]]\nend = 0.2\n";
    let text = format!("{}{again}{nail}", CUBES.replace("METHOD", "implicit"));
    std::fs::write(dir.path().join("cubes.toml"), &text).unwrap();
    let report = bake(dir.path(), "cubes.toml", "out", &["--frames", "0..6"]);
    assert_eq!((&report["solver"], &report["explicit_steps"]), (&"pcg".into(), &0.into()), "{report}");
    // what the nail of the lower cube holds is pulled away by that of the upper one, which moves
    let far = text.replace("end = 0.2\n", "");
    let rigid =
        far.replace("at = [[0.0, 0.1, 0.0]]\nto = 'upper'", "at = [[0.0, 0.1, 0.0]]\nstart = 0.1\nto = 'upper'");
    let apart = rigid.replace("to_at = [[0.0, 0.0, 0.0]]\n", "to_at = [[0.0, 0.1, 0.0]]\n");
    std::fs::write(dir.path().join("apart.toml"), apart).unwrap();
    let (code, _, err) = said(&softrig(dir.path(), &["bake", "apart.toml", "-o", "apart"]));
    assert!(code != Some(0) && err.contains("contradict one another by 1.000e-1 m"), "{code:?} {err}");
    assert!(err.contains("nail") && err.contains("points-to-point"), "{err}");
}

/// Vertices of a series carry the stress of the flesh below: none in a cube at rest, more where nails hold it up.
#[test]
fn series_are_coloured_by_stress_and_strain() {
    let dir = folder();
    std::fs::write(dir.path().join("cubes.toml"), CUBES.replace("METHOD", "elements")).unwrap();
    for by in ["stress", "strain"] {
        bake(dir.path(), "cubes.toml", "out", &["--colors", by, "--frames", "0..12"]);
        let colors = |frame: usize| -> Vec<[f64; 3]> {
            let text = std::fs::read_to_string(dir.path().join(format!("out/frame_{frame:04}.obj"))).unwrap();
            let line =
                |l: &str| l.split(' ').skip(4).map(|n| n.parse().unwrap()).collect::<Vec<f64>>().try_into().unwrap();
            text.lines().filter(|l| l.starts_with("v ")).map(line).collect()
        };
        let (rest, held) = (colors(0), colors(11));
        assert_eq!(rest.len(), 16);
        assert!(rest.iter().all(|c| *c == rest[0] && c[2] > c[0]), "{by}: {rest:?}");
        assert!(held.iter().any(|c| c[0] > c[2]) && held.iter().any(|c| *c != held[0]), "{by}: {held:?}");
    }
    for (out, why) in [("o.pc2", "name a folder"), ("o.usda", "name a folder"), ("o.vtu", "leave --colors out")] {
        let (code, _, err) = said(&softrig(dir.path(), &["bake", "cubes.toml", "-o", out, "--colors", "stress"]));
        assert!(code == Some(2) && err.contains(why), "{code:?} {err}");
    }
}

/// A .ply is a folder of PLY files whose vertices carry the value of each frame, a .glb has the colours of the largest values in COLOR_0 and a
/// material that shows them.
#[test]
fn ply_series_and_glb_files_have_colours() {
    let dir = folder();
    std::fs::write(dir.path().join("cubes.toml"), CUBES.replace("METHOD", "elements")).unwrap();
    bake(dir.path(), "cubes.toml", "out.ply", &["--colors", "stress", "--frames", "0..12"]);
    let values = |frame: usize| -> Vec<f64> {
        let bytes = std::fs::read(dir.path().join(format!("out.ply/frame_{frame:04}.ply"))).unwrap();
        let end = bytes.windows(11).position(|w| w == b"end_header\n").unwrap() + 11;
        let header = String::from_utf8_lossy(&bytes[..end]).into_owned();
        assert!(header.contains("von_mises") && header.contains("uchar red"), "{header}");
        // x y z, three bytes, the value
        bytes[end..].chunks(19).take(16).map(|v| f64::from(f32::from_le_bytes(v[15..19].try_into().unwrap()))).collect()
    };
    let (rest, held) = (values(0), values(11));
    assert!(rest.iter().all(|v| v.abs() < 1.0) && held.iter().any(|v| *v > 10.0), "{rest:?} {held:?}");
    bake(dir.path(), "cubes.toml", "out.glb", &["--colors", "stress", "--frames", "0..12"]);
    let bytes = std::fs::read(dir.path().join("out.glb")).unwrap();
    let size = u32::from_le_bytes(bytes[12..16].try_into().unwrap()) as usize;
    let json: Value = serde_json::from_slice(&bytes[20..20 + size]).unwrap();
    for mesh in json["meshes"].as_array().unwrap() {
        for primitive in mesh["primitives"].as_array().unwrap() {
            let accessor = &json["accessors"][primitive["attributes"]["COLOR_0"].as_u64().unwrap() as usize];
            assert_eq!(accessor["type"], "VEC4");
            let material = &json["materials"][primitive["material"].as_u64().unwrap() as usize];
            assert_eq!(material["name"], "colors");
        }
    }
    let character = softrig_io::gltf::read(&dir.path().join("out.glb"), &softrig_io::ImportOptions::default()).unwrap();
    let colors: Vec<[f32; 4]> = character.meshes.iter().flat_map(|m| m.colors.clone()).collect();
    assert!(
        colors.len() == 16 && colors.iter().any(|c| c[0] > c[2]) && colors.iter().any(|c| c[2] > c[0]),
        "{colors:?}"
    );
}

/// A stopped bake of objects goes on with the same bytes, ramps and switches included.
#[cfg(unix)]
#[test]
fn stopped_bakes_of_objects_end_with_the_same_bytes() {
    let dir = folder();
    for method in ["mass-points", "elements"] {
        let text =
            CUBES.replace("METHOD", method).replace("end = 0.4", "end = 0.4\nramp = 0.2").replace("50.0", "1000.0");
        std::fs::write(dir.path().join("cubes.toml"), text).unwrap();
        let args = |out: &'static str| vec!["bake", "cubes.toml", "-o", out];
        let (code, _, err) = said(&softrig(dir.path(), &[args("whole.softrig-journal"), vec!["--force"]].concat()));
        assert_eq!(code, Some(0), "{err}");
        let torn = ["bake", "cubes.toml", "-o", "torn.softrig-journal", "--force"];
        let child = command(dir.path(), &torn).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
        let journal = dir.path().join("torn.softrig-journal");
        while std::fs::metadata(&journal).map_or(0, |m| m.len()) < 40_000 {
            std::thread::sleep(Duration::from_millis(1));
        }
        std::process::Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap();
        let (code, _, err) = said(&child.wait_with_output().unwrap());
        if code == Some(130) {
            let (code, _, err) =
                said(&softrig(dir.path(), &["bake", "cubes.toml", "-o", "torn.softrig-journal", "--resume"]));
            assert!(code == Some(0) && err.contains("going on from frame"), "{method}: {err}");
        } else {
            // a machine that was done before it could be stopped
            assert_eq!(code, Some(0), "{err}");
        }
        for name in ["whole", "torn"] {
            let journal = format!("{name}.softrig-journal");
            let (code, _, err) = said(&softrig(dir.path(), &["convert", &journal, name, "--force"]));
            assert_eq!(code, Some(0), "{err}");
        }
        let last = |name: &str| std::fs::read(dir.path().join(name).join("frame_0600.obj")).unwrap();
        assert!(last("whole") == last("torn"), "{method}");
        for name in ["whole", "torn"] {
            std::fs::remove_dir_all(dir.path().join(name)).unwrap();
            std::fs::remove_file(dir.path().join(format!("{name}.softrig-journal"))).unwrap();
        }
    }
}

#[test]
fn nonsense_in_a_scene_of_objects_is_refused_by_name() {
    let dir = folder();
    let object = "[[object]]\nname = 'a'\n[[object]]\nname = 'b'\nposition = [0.0, 1.0, 0.0]\n";
    let points = "[simulation]\nmethod = 'mass-points'\n";
    let nail = "[[constraint]]\nobject = 'a'\n";
    let cases = [
        (format!("{points}{nail}"), "there is no [[object]]"),
        (format!("{points}{object}[[constraint]]\nobject = 'c'\n"), "there is no object `c`; the objects are: a, b"),
        (format!("{points}{object}{nail}at = [[0.05, 0.0, 0.0]]\n"), "no node of `a` is at"),
        (format!("{points}{object}{nail}copies = [[1, 0, 0], [2, 1, 1]]\n"), "it holds no node"),
        (format!("{points}{object}{nail}kind = 'join'\n"), "either `to` or `next`"),
        (format!("{points}{object}{nail}kind = 'tetrahedron'\nto = 'b'\n"), "lies in no tetrahedron of `b`"),
        (format!("{points}{object}{nail}{nail}"), "is held by nail 0 and by nail"),
        (format!("{points}{object}{nail}to = 'b'\n"), "`to` names what nodes are held by"),
        (format!("[simulation]\nmethod = 'modal'\n{object}"), "unsupported: modes of objects"),
        (format!("character = 'sample'\n{points}{object}"), "`character` is for characters"),
        (format!("{points}{object}[[event]]\ngravity = [0, 0, 0]\n"), "[[event]] is for characters"),
        (format!("[simulation]\nmethod = 'mass-points'\ntoo_long = 'refuse'\n{object}"), "beyond the stability limit"),
        (
            format!("[simulation]\nmethod = 'mass-points'\nscheme = 'explicit-euler'\n{object}{nail}"),
            "`explicit-euler` cannot enforce a nail",
        ),
        (format!("{points}{object}[[object]]\nname = 'a'\n"), "a name of its own"),
        (format!("{points}[[object]]\nname = 'a'\nsize = [0, 1, 1]\n"), "edges must be between"),
        (format!("{points}[[object]]\nname = 'a'\ncells = [2000, 2000, 2000]\n"), "2000000 cubes"),
    ];
    for (text, message) in cases {
        std::fs::write(dir.path().join("bad.toml"), &text).unwrap();
        let (code, _, err) = said(&softrig(dir.path(), &["bake", "bad.toml", "-o", "out.pc2"]));
        assert!(code != Some(0) && err.contains(message), "{text}\n{code:?} {err}");
        let _ = std::fs::remove_file(dir.path().join("out.pc2.softrig-journal"));
        assert!(!dir.path().join("out.pc2").exists());
    }
}
