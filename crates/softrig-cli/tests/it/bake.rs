//! Bakes of the built-in character: what comes out, that nothing is damaged, and that a stopped bake goes on with the same bytes.

use crate::{command, folder, said, softrig};
use serde_json::Value;
use std::path::Path;
use std::process::Stdio;
use std::time::Duration;

/// A short bake of a coarse body.
const SHORT: [&str; 8] = ["bake", "sample", "--cells", "600", "--frames", "0..6", "--clip", "walk"];

fn with<'a>(more: &[&'a str]) -> Vec<&'a str> {
    SHORT.iter().chain(more).copied().collect()
}

fn read(folder: &Path, name: &str) -> Vec<u8> {
    std::fs::read(folder.join(name)).unwrap_or_else(|e| panic!("{name}: {e}"))
}

#[test]
fn a_bake_reports_every_documented_key_and_writes_a_cache() {
    let dir = folder();
    let args = with(&["-o", "out.pc2", "--report", "r.json", "--forces", "f.csv"]);
    let (code, out, err) = said(&softrig(dir.path(), &args));
    assert_eq!(code, Some(0), "{err}");
    assert!(out.contains("out.pc2"), "{out}");
    let report: Value = serde_json::from_slice(&read(dir.path(), "r.json")).unwrap();
    for key in [
        "frames",
        "cells",
        "nodes",
        "skin_vertices",
        "solver",
        "threads",
        "step_ms_median",
        "step_ms_p95",
        "residual_max",
        "attachment_gap_max_m",
        "bone_length_error_max",
        "clip_bone_length_change_max",
        "start_time_s",
        "frame_ms_median",
        "frame_ms_p95",
        "steps_per_second",
        "volume_ratio_min",
        "volume_ratio_max",
        "inverted_cells_max",
        "peak_rss_mib",
        "state_hash",
        "guarded_steps",
        "substeps",
        "cell_volume_ratio_p01",
        "cell_volume_ratio_p99",
    ] {
        assert!(!report[key].is_null(), "{key} is missing from {report}");
    }
    assert_eq!(report["frames"], 6);
    assert!(report["attachment_gap_max_m"].as_f64().unwrap() < 1e-9, "{report}");
    assert!(report["residual_max"].as_f64().unwrap() <= 1e-6, "{report}");
    // one way the bones are those of the clip; what the clip does to them is another number
    assert!(report["bone_length_error_max"].as_f64().unwrap() < 1e-12, "{report}");
    // a second of work holds the steps it says
    let time = |key: &str| report[key].as_f64().unwrap();
    assert!(time("step_ms_median") <= time("frame_ms_median") && time("step_ms_p95") <= time("frame_ms_p95"));
    let per_second = report["steps"].as_f64().unwrap() / time("simulation_seconds");
    assert!((time("steps_per_second") - per_second).abs() <= 1e-6 * per_second, "{report}");
    let volume = (report["volume_ratio_min"].as_f64().unwrap(), report["volume_ratio_max"].as_f64().unwrap());
    assert!(volume.0 > 0.9 && volume.1 < 1.1, "{volume:?}");
    // the documented keys are those of the report
    let documented = softrig_cli::docs::pages().into_iter().find(|p| p.0 == "docs/report.md").unwrap().1;
    for key in report.as_object().unwrap().keys() {
        assert!(documented.contains(&format!("| `{key}` |")), "{key} is not documented");
    }
    // PC2: magic, version, points, start, rate, frames
    let cache = read(dir.path(), "out.pc2");
    assert_eq!(&cache[..12], b"POINTCACHE2\0");
    let number = |at: usize| u32::from_le_bytes(cache[at..at + 4].try_into().unwrap()) as usize;
    assert_eq!((number(16), number(28)), (report["skin_vertices"].as_u64().unwrap() as usize, 6));
    assert_eq!(cache.len(), 32 + 12 * number(16) * number(28));
    let forces = String::from_utf8(read(dir.path(), "f.csv")).unwrap();
    assert!(forces.starts_with("frame,time_s,joint,force_x_n") && forces.lines().count() > 6 * 5, "{forces}");
    assert!(!dir.path().join("out.pc2.softrig-journal").exists());
}

/// Results do not depend on the number of threads.
#[test]
fn one_thread_and_two_give_the_same_bytes() {
    let dir = folder();
    for (threads, out) in [("1", "a.pc2"), ("2", "b.pc2")] {
        let (code, _, err) = said(&softrig(dir.path(), &with(&["--threads", threads, "-o", out])));
        assert_eq!(code, Some(0), "{err}");
    }
    assert!(read(dir.path(), "a.pc2") == read(dir.path(), "b.pc2"));
}

#[test]
fn an_existing_result_is_refused_at_once_and_stays_as_it_is() {
    let dir = folder();
    for name in ["out.pc2", "r.json"] {
        std::fs::write(dir.path().join(name), "mine").unwrap();
    }
    for args in [with(&["-o", "out.pc2"]), with(&["-o", "new.pc2", "--report", "r.json"])] {
        let (code, _, err) = said(&softrig(dir.path(), &args));
        assert!(code == Some(1) && err.contains("exists") && err.contains("--force"), "{err}");
    }
    assert_eq!((read(dir.path(), "out.pc2"), read(dir.path(), "r.json")), (b"mine".to_vec(), b"mine".to_vec()));
    let (code, _, err) = said(&softrig(dir.path(), &with(&["-o", "out.pc2", "--force"])));
    assert_eq!(code, Some(0), "{err}");
    assert!(read(dir.path(), "out.pc2").starts_with(b"POINTCACHE2"));
}

#[test]
fn what_is_missing_is_said() {
    let dir = folder();
    std::fs::write(dir.path().join("tri.obj"), "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n").unwrap();
    for (args, code, part) in [
        (&["bake", "tri.obj", "-o", "o.pc2"][..], 1, "surface without a rig"),
        (&["bake", "sample", "-o", "o.pc2", "--clip", "fly"], 1, "it has: "),
        (&["bake", "sample", "-o", "o.xyz"], 2, ".pc2"),
        (&["bake", "sample", "-o", "tri.obj/o.pc2"], 1, "tri.obj is a file"),
        (&["bake", "sample", "-o", "o.usdc"], 2, "usdcat"),
        (&["convert", "gone.softrig-journal", "o.pc2"], 1, "gone.softrig-journal"),
        (&["bake", "sample", "-o", "o.pc2", "--frames", "90000.."], 1, "has frames 0.."),
    ] {
        let (got, _, err) = said(&softrig(dir.path(), args));
        assert!(got == Some(code) && err.contains(part) && err.contains("error: "), "{args:?}: {got:?} {err}");
    }
}

/// Killed at many moments and resumed until done, a bake ends with the bytes of one that was not disturbed.
#[cfg(unix)]
#[test]
fn killed_and_resumed_a_bake_ends_with_the_same_bytes() {
    let dir = folder();
    // long enough for checkpoints
    let long =
        |out| ["bake", "sample", "--cells", "600", "--clip", "walk", "--fps", "60", "--frames", "0..50", "-o", out];
    let (code, _, err) = said(&softrig(dir.path(), &long("whole.pc2")));
    assert_eq!(code, Some(0), "{err}");
    let resume: Vec<_> = long("torn.pc2").into_iter().chain(["--resume"]).collect();
    let mut kills = 0;
    // moments spread over a bake, whatever the speed of the machine
    for round in 0..40u64 {
        let mut child = command(dir.path(), &resume).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
        std::thread::sleep(Duration::from_millis(60 * (round + 1)));
        if let Some(status) = child.try_wait().unwrap() {
            assert!(status.success());
            break;
        }
        child.kill().unwrap(); // SIGKILL
        child.wait().unwrap();
        kills += 1;
        // nothing half-written ever stands in the place of the result
        assert!(!dir.path().join("torn.pc2").exists() || read(dir.path(), "torn.pc2") == read(dir.path(), "whole.pc2"));
    }
    let (code, _, err) = said(&softrig(dir.path(), &resume));
    assert_eq!(code, Some(0), "{err}");
    assert!(kills > 0);
    assert!(read(dir.path(), "torn.pc2") == read(dir.path(), "whole.pc2"), "after {kills} kills");
}

/// Ctrl-C ends the frame, says how to go on, and loses nothing.
#[cfg(unix)]
#[test]
fn interrupted_a_bake_keeps_its_frames_and_goes_on() {
    let dir = folder();
    let long = |out| ["bake", "sample", "--cells", "600", "--clip", "jump", "--fps", "100", "-o", out];
    let child = command(dir.path(), &long("o.pc2")).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
    // the journal is there once the first frame is being simulated
    let journal = dir.path().join("o.pc2.softrig-journal");
    while !journal.exists() {
        std::thread::sleep(Duration::from_millis(5));
    }
    let kill = std::process::Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap();
    assert!(kill.success());
    let (code, _, err) = said(&child.wait_with_output().unwrap());
    assert!(code == Some(130) && err.contains("--resume"), "{code:?} {err}");
    assert!(journal.exists() && !dir.path().join("o.pc2").exists());
    let (code, _, err) = said(&softrig(dir.path(), &["convert", "o.pc2.softrig-journal", "part.pc2"]));
    assert_eq!(code, Some(0), "{err}");
    let part = read(dir.path(), "part.pc2");
    let resume: Vec<_> = long("o.pc2").into_iter().chain(["--resume"]).collect();
    let (code, _, err) = said(&softrig(dir.path(), &resume));
    assert_eq!(code, Some(0), "{err}");
    let whole = read(dir.path(), "o.pc2");
    assert!(part.len() > 32 && whole.len() > part.len() && whole[32..part.len()] == part[32..]);
}

#[cfg(target_os = "linux")]
#[test]
fn a_folder_that_cannot_be_written_is_the_machines_fault() {
    let dir = folder();
    let (code, _, err) = said(&softrig(dir.path(), &with(&["-o", "/proc/out.pc2"])));
    assert!(code == Some(3) && err.contains("/proc/out.pc2"), "{code:?} {err}");
}

/// Other settings are another bake: resuming with them is refused.
#[test]
fn a_journal_is_resumed_with_its_own_settings_only() {
    let dir = folder();
    let journal = "o.pc2.softrig-journal";
    let (code, _, err) = said(&softrig(dir.path(), &with(&["-o", journal])));
    assert_eq!(code, Some(0), "{err}");
    let (code, _, err) = said(&softrig(dir.path(), &with(&["-o", "o.pc2"])));
    assert!(code == Some(1) && err.contains("--resume"), "{err}");
    let (code, _, err) = said(&softrig(dir.path(), &with(&["-o", "o.pc2", "--resume", "--preset", "fat"])));
    assert!(code == Some(1) && err.contains("other inputs or settings"), "{err}");
    let (code, _, err) = said(&softrig(dir.path(), &["convert", journal, "c.mdd"]));
    assert_eq!(code, Some(0), "{err}");
    assert!(!read(dir.path(), "c.mdd").is_empty());
    let (code, _, err) = said(&softrig(dir.path(), &with(&["-o", "o.pc2", "--resume"])));
    assert_eq!(code, Some(0), "{err}");
    assert!(!dir.path().join(journal).exists());
}

/// A scene written from a command line bakes the same flesh as that command line.
#[test]
fn a_written_scene_bakes_the_same() {
    let dir = folder();
    let args = with(&["--preset", "fat", "--dynamics", "calm", "--write-scene", "s.toml"]);
    let (code, _, err) = said(&softrig(dir.path(), &args));
    assert_eq!(code, Some(0), "{err}");
    let (code, _, err) = said(&softrig(dir.path(), &["bake", "s.toml", "-o", "a.pc2"]));
    assert_eq!(code, Some(0), "{err}");
    let (code, _, err) = said(&softrig(dir.path(), &with(&["--preset", "fat", "--dynamics", "calm", "-o", "b.pc2"])));
    assert_eq!(code, Some(0), "{err}");
    assert!(read(dir.path(), "a.pc2") == read(dir.path(), "b.pc2"));
}

#[test]
fn a_cache_is_drawn_with_its_character() {
    let dir = folder();
    let (code, _, err) = said(&softrig(dir.path(), &with(&["-o", "o.pc2"])));
    assert_eq!(code, Some(0), "{err}");
    let (code, _, err) = said(&softrig(dir.path(), &["render", "o.pc2", "-o", "o.png"]));
    assert!(code == Some(2) && err.contains("--with"), "{err}");
    for out in ["o.png", "o.gif"] {
        let args = ["render", "o.pc2", "--with", "sample", "-o", out, "--size", "96x96", "--map", "displacement"];
        let (code, _, err) = said(&softrig(dir.path(), &args));
        assert_eq!(code, Some(0), "{err}");
    }
    assert!(read(dir.path(), "o.png").starts_with(b"\x89PNG") && read(dir.path(), "o.gif").starts_with(b"GIF89a"));
}

/// A result may go where no folder is yet; nothing is left there when the input is wrong.
#[test]
fn the_folder_of_a_result_is_made() {
    let dir = folder();
    let args = with(&["-o", "new/deep/o.pc2", "--report", "reports/r.json", "--forces", "forces/f.csv"]);
    let (code, _, err) = said(&softrig(dir.path(), &args));
    assert_eq!(code, Some(0), "{err}");
    for file in ["new/deep/o.pc2", "reports/r.json", "forces/f.csv"] {
        assert!(dir.path().join(file).is_file(), "{file}");
    }
    for (args, out) in [
        (&["convert", "new/deep/o.pc2", "c/o.usda", "--with", "sample"][..], "c/o.usda"),
        (&["convert", "sample", "b/o.bvh"], "b/o.bvh"),
        (&["mesh", "sample", "-o", "m/o.vtu", "--cells", "1000"], "m/o.vtu"),
        (&["render", "sample", "-o", "p/o.png", "--size", "64x64"], "p/o.png"),
        (&["render", "sample", "-o", "g/o.gif", "--size", "64x64", "--frames", "0..2"], "g/o.gif"),
        (&["bake", "sample", "--write-scene", "s/o.toml"], "s/o.toml"),
    ] {
        let (code, _, err) = said(&softrig(dir.path(), args));
        assert!(code == Some(0) && dir.path().join(out).is_file(), "{args:?}: {err}");
    }
    let (code, _, _) = said(&softrig(dir.path(), &["bake", "nobody.glb", "-o", "empty/o.pc2"]));
    assert!(code == Some(1) && !dir.path().join("empty").exists());
}

/// The start of a window of a clip is said in the clip's own time.
#[test]
fn the_report_says_where_in_the_clip_it_starts() {
    let dir = folder();
    let args = ["bake", "sample", "--cells", "600", "--clip", "walk", "--frames", "6..8", "--speed", "2", "--json"];
    let (code, out, err) = said(&softrig(dir.path(), &[&args[..], &["-o", "o.pc2"]].concat()));
    assert_eq!(code, Some(0), "{err}");
    let report: Value = serde_json::from_str(&out).unwrap();
    assert_eq!(report["start_time_s"].as_f64().unwrap(), 2.0 * 6.0 / 30.0);
}
