//! Exit codes and messages that need no character.

use crate::{folder, said, softrig};

#[test]
fn help_and_version_are_results() {
    let dir = folder();
    for args in [&["--help"][..], &["--version"], &["bake", "--help"], &["help", "render"]] {
        let (code, out, err) = said(&softrig(dir.path(), args));
        assert_eq!((code, err.as_str()), (Some(0), ""), "{args:?}");
        assert!(out.contains("softrig"), "{args:?}");
    }
}

#[test]
fn nonsense_is_a_usage_error() {
    let dir = folder();
    for args in [
        &[][..],
        &["knead"],
        &["bake", "a.glb"],
        &["bake", "a.glb", "-o", "b.pc2", "--cells", "0"],
        &["bake", "a.glb", "-o", "b.pc2", "--cells", "10", "--spacing", "0.1"],
        &["bake", "a.glb", "-o", "b.pc2", "--frames", "9..3"],
        &["bake", "a.glb", "-o", "b.pc2", "--resume", "--force"],
        &["bake", "a.glb", "-o", "b.pc2", "--preset", "jelly"],
        &["bake", "a.glb", "-o", "b.pc2", "--fps", "nan"],
        &["render", "a.glb", "-o", "b.png", "--size", "big"],
        &["demo", "--threads", "0"],
    ] {
        let (code, out, err) = said(&softrig(dir.path(), args));
        assert_eq!((code, out.as_str()), (Some(2), ""), "{args:?}");
        assert!(!err.is_empty(), "{args:?}");
    }
}

/// Tetrahedra and hexahedra, falling and walking, have the same bits whatever the instructions; those that a machine lacks are refused.
#[test]
fn every_instruction_set_gives_the_same_bits() {
    let dir = folder();
    let measured = |instructions: &str| {
        let args = ["bench", "bar_s", "character_500", "--json", "--threads", "1", "--instructions", instructions];
        let (code, out, err) = said(&softrig(dir.path(), &args));
        if code == Some(2) {
            assert!(err.contains(&format!("this machine has no {instructions}; it has portable")), "{err}");
            eprintln!("skipped: {instructions}, which this machine does not have");
            return None;
        }
        assert_eq!((code, err.as_str()), (Some(0), ""), "{instructions}");
        let all = out.lines().map(|line| serde_json::from_str::<serde_json::Value>(line).unwrap());
        let hashes: Vec<_> = all.inspect(|m| assert_eq!(m["instructions"], instructions)).collect();
        assert_eq!(hashes.len(), 2);
        Some(hashes.into_iter().map(|m| m["state_hash"].clone()).collect::<Vec<_>>())
    };
    let plain = measured("portable").expect("every machine has these");
    assert!(plain.iter().all(serde_json::Value::is_string));
    for wide in ["avx2", "avx512"].into_iter().filter_map(measured) {
        assert_eq!(wide, plain);
    }
}

/// A number that cannot be is said to be one, not taken for an option.
#[test]
fn a_negative_number_is_a_wrong_value() {
    let dir = folder();
    for (flag, value) in
        [("--height", "-1"), ("--cells", "-5"), ("--fps", "-30"), ("--spacing", "-0.1"), ("--preroll", "-1")]
    {
        let (code, _, err) = said(&softrig(dir.path(), &["bake", "a.glb", "-o", "b.pc2", flag, value]));
        assert!(code == Some(2) && err.contains(&format!("invalid value '{value}' for '{flag}")), "{flag}: {err}");
    }
}

/// Nothing a result is made from is ever replaced by it, whatever the name it goes by.
#[test]
fn an_input_is_never_replaced() {
    let dir = folder();
    let name = |n: &str| dir.path().join(n);
    let character = "character = \"sample\"\n";
    std::fs::write(name("scene.toml"), character).unwrap();
    for file in ["hero.glb", "hero.pc2", "walk.bvh", "hero.softrig-journal", "hero.vtu", "hero.gif"] {
        std::fs::write(name(file), "mine").unwrap();
    }
    for args in [
        &["bake", "hero.glb", "-o", "hero.glb", "--force"][..],
        &["bake", "hero.glb", "-o", "./hero.glb", "--resume"],
        &["bake", "hero.glb", "-o", "o.pc2", "--report", "hero.glb", "--force"],
        &["bake", "hero.glb", "-o", "o.pc2", "--clip", "walk.bvh", "--forces", "walk.bvh", "--force"],
        &["bake", "scene.toml", "--write-scene", "scene.toml", "--force"],
        &["convert", "hero.softrig-journal", "hero.softrig-journal", "--force"],
        &["convert", "hero.pc2", "hero.glb", "--with", "hero.glb", "--force"],
        &["convert", "walk.bvh", "walk.bvh", "--force"],
        &["mesh", "hero.vtu", "-o", "hero.vtu", "--force"],
        &["render", "hero.gif", "-o", "hero.gif", "--force"],
    ] {
        let (code, _, err) = said(&softrig(dir.path(), args));
        assert!(code == Some(2) && err.contains("made from"), "{args:?}: {code:?} {err}");
    }
    for file in ["hero.glb", "hero.pc2", "walk.bvh", "hero.softrig-journal", "hero.vtu", "hero.gif"] {
        assert_eq!(std::fs::read_to_string(name(file)).unwrap(), "mine", "{file}");
    }
    assert_eq!(std::fs::read_to_string(name("scene.toml")).unwrap(), character);
}

#[test]
fn a_missing_file_is_named_and_the_inputs_fault() {
    let dir = folder();
    for file in ["nowhere.glb", "nowhere.toml"] {
        let (code, out, err) = said(&softrig(dir.path(), &["inspect", file]));
        assert_eq!((code, out.as_str()), (Some(1), ""));
        assert!(err.starts_with("error: ") && err.contains(file) && err.lines().count() == 1, "{err}");
    }
}

#[test]
fn a_scene_with_a_typo_names_the_line() {
    let dir = folder();
    std::fs::write(dir.path().join("s.toml"), "character = \"a.glb\"\n[motion]\nfsp = 24\n").unwrap();
    let (code, _, err) = said(&softrig(dir.path(), &["inspect", "s.toml"]));
    assert_eq!(code, Some(1));
    assert!(err.starts_with("error: s.toml: line 3, column 1: unknown field `fsp`"), "{err}");
}

#[test]
fn completions_know_the_commands() {
    let dir = folder();
    for shell in ["bash", "zsh", "fish", "powershell", "elvish"] {
        let (code, out, _) = said(&softrig(dir.path(), &["completions", shell]));
        assert!(code == Some(0) && out.contains("inspect") && out.contains("preroll"), "{shell}");
    }
}

/// `softrig ... | head` must not end in a broken-pipe panic.
#[test]
fn a_reader_that_goes_away_is_no_error() {
    let dir = folder();
    let mut child = crate::command(dir.path(), &["completions", "bash"])
        .stdout(std::process::Stdio::piped())
        .stderr(std::process::Stdio::piped())
        .spawn()
        .unwrap();
    drop(child.stdout.take());
    let output = child.wait_with_output().unwrap();
    assert_eq!(said(&output).2, "");
}
