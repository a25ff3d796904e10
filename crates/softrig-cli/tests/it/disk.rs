//! Disks that are full: nothing finished is lost, the answer is clear, and with room again a bake ends with the same bytes.
#![cfg(unix)]

use crate::{command, folder, said, softrig};
use std::path::Path;
use std::process::{Command, Output};

/// Long enough for checkpoints, in a coarse body.
const BAKE: [&str; 12] =
    ["bake", "sample", "--cells", "600", "--clip", "walk", "--fps", "60", "--frames", "0..45", "--threads", "1"];

fn bake(more: &[&'static str]) -> Vec<&'static str> {
    BAKE.iter().chain(more).copied().collect()
}

/// The result of a bake that nothing disturbed, and the size of its journal.
fn undisturbed(dir: &Path) -> (Vec<u8>, u64) {
    let (code, _, err) = said(&softrig(dir, &bake(&["-o", "whole.pc2.softrig-journal"])));
    assert_eq!(code, Some(0), "{err}");
    let length = dir.join("whole.pc2.softrig-journal").metadata().unwrap().len();
    let (code, _, err) = said(&softrig(dir, &["convert", "whole.pc2.softrig-journal", "whole.pc2"]));
    assert_eq!(code, Some(0), "{err}");
    (std::fs::read(dir.join("whole.pc2")).unwrap(), length)
}

/// The machine's fault, said in one line that names the file and the way on.
fn refused(output: &Output, what: &str) {
    let (code, out, err) = said(output);
    assert_eq!((code, out.as_str()), (Some(3), ""), "{what}: {err}");
    let errors: Vec<_> = err.lines().filter(|l| l.starts_with("error: ")).collect();
    assert!(errors.len() == 1 && errors[0].contains("o.pc2") && !errors[0].contains("os error"), "{what}: {err}");
    assert!(errors[0].contains("--resume") || errors[0].contains("make room"), "{what}: {err}");
}

/// What a stopped bake has is the beginning of the undisturbed one; returns the number of whole frames.
fn beginning_of(part: &[u8], whole: &[u8]) -> usize {
    let points = u32::from_le_bytes(whole[16..20].try_into().unwrap()) as usize;
    assert!(part.len() >= 32 && (part.len() - 32).is_multiple_of(12 * points));
    assert!(whole[32..].starts_with(&part[32..]), "finished frames differ");
    (part.len() - 32) / (12 * points)
}

/// A limit on the size of files stops a bake wherever it bites: in the header, in a frame, in a checkpoint, in the result.
#[test]
fn a_bake_that_may_not_write_more_keeps_its_frames() {
    let dir = folder();
    let (whole, journal) = undisturbed(dir.path());
    // in blocks of 512 bytes, as POSIX has it (bash counts 1024): from the header to just short of the end
    let blocks = journal / 512;
    let mut kept = Vec::new();
    for limit in [1, blocks / 7, blocks / 3, blocks * 2 / 3, blocks * 19 / 20] {
        for name in ["o.pc2", "o.pc2.softrig-journal", "part.pc2"] {
            let _ = std::fs::remove_file(dir.path().join(name));
        }
        // the signal that a limit sends is ignored, as a full disk sends none
        let script = format!("trap '' XFSZ; ulimit -f {limit}; exec \"$@\"");
        let mut shell = Command::new("/bin/sh");
        shell.current_dir(dir.path()).args(["-c", &script, "sh", env!("CARGO_BIN_EXE_softrig")]);
        let stopped = shell.args(bake(&["-o", "o.pc2"])).output().unwrap();
        if stopped.status.success() {
            continue; // this shell counts larger blocks
        }
        refused(&stopped, &format!("limit of {limit} blocks"));
        assert!(!dir.path().join("o.pc2").exists());
        if dir.path().join("o.pc2.softrig-journal").exists() {
            let (code, _, err) = said(&softrig(dir.path(), &["convert", "o.pc2.softrig-journal", "part.pc2"]));
            assert!(code == Some(0) || err.contains("no finished frame"), "{err}");
            if code == Some(0) {
                kept.push(beginning_of(&std::fs::read(dir.path().join("part.pc2")).unwrap(), &whole));
            }
        }
        let (code, _, err) = said(&softrig(dir.path(), &bake(&["-o", "o.pc2", "--resume"])));
        assert_eq!(code, Some(0), "{err}");
        assert!(std::fs::read(dir.path().join("o.pc2")).unwrap() == whole, "after a limit of {limit} blocks");
    }
    assert!(kept.iter().any(|n| *n > 0), "no limit stopped a bake among its frames: {kept:?}");
}

/// The same on a disk that is really full, where a small one may be made.
#[cfg(target_os = "linux")]
#[test]
fn a_bake_on_a_full_disk_keeps_its_frames() {
    use std::io::Write;
    let dir = folder();
    let mount = dir.path().join("disk");
    std::fs::create_dir(&mount).unwrap();
    // a disk of this process tree alone: the kernel takes it away at the end
    let may = "mount -t tmpfs -o size=64k tmpfs disk";
    let tried = Command::new("unshare").current_dir(dir.path()).args(["-rm", "sh", "-c", may]).output();
    if !tried.is_ok_and(|o| o.status.success()) {
        let _ = writeln!(std::io::stderr(), "skipped: a bake on a full disk, no disk may be made here");
        return;
    }
    let (whole, journal) = undisturbed(dir.path());
    // too small for the journal; for the journal and the result beside it
    for (size, what) in [(journal / 2, "journal"), (journal + whole.len() as u64 / 2, "result")] {
        // what the full disk holds is kept outside before there is room again
        let script = format!(
            "mount -t tmpfs -o size={} tmpfs disk || exit 99
             \"$@\" > out 2> err; echo $? > code
             ls -A disk > names; cp disk/o.pc2.softrig-journal torn.softrig-journal
             mount -o remount,size=64m disk || exit 98
             \"$@\" --resume > out2 2> err2 || exit 97
             cp disk/o.pc2 again.pc2",
            size.next_multiple_of(4096)
        );
        let mut shell = Command::new("unshare");
        shell.current_dir(dir.path()).args(["-rm", "sh", "-c", &script, "sh", env!("CARGO_BIN_EXE_softrig")]);
        let ran = shell.args(bake(&["-o", "disk/o.pc2"])).output().unwrap();
        let text = |name: &str| std::fs::read_to_string(dir.path().join(name)).unwrap_or_default();
        assert!(ran.status.success(), "{what}: {:?} {} {}", said(&ran), text("err"), text("err2"));
        assert_eq!(text("names"), "o.pc2.softrig-journal\n", "{what}: nothing but the journal stays");
        let errors: Vec<_> = text("err").lines().filter(|l| l.starts_with("error: ")).map(String::from).collect();
        assert_eq!((text("code").trim(), text("out").as_str(), errors.len()), ("3", "", 1), "{what}: {errors:?}");
        assert!(errors[0].contains("the disk is full") && errors[0].contains("--resume"), "{what}: {errors:?}");
        assert!(errors[0].contains("disk/o.pc2") && !errors[0].contains("os error"), "{what}: {errors:?}");
        let mut convert = command(dir.path(), &["convert", "torn.softrig-journal", "part.pc2", "--force"]);
        let (code, _, err) = said(&convert.output().unwrap());
        assert_eq!(code, Some(0), "{err}");
        let frames = beginning_of(&std::fs::read(dir.path().join("part.pc2")).unwrap(), &whole);
        assert!(if what == "journal" { (1..45).contains(&frames) } else { frames == 45 }, "{what}: {frames} frames");
        assert!(std::fs::read(dir.path().join("again.pc2")).unwrap() == whole, "{what}");
    }
}
