//! What journals hold: enough to go on and to bake again, and no more than the result needs.

use crate::{folder, said, softrig};
use softrig_io::journal::JournalReader;
use std::path::Path;

const BAKE: [&str; 8] = ["bake", "sample", "--cells", "600", "--frames", "0..6", "--clip", "walk"];

fn bake(dir: &Path, more: &[&str]) {
    let (code, _, err) = said(&softrig(dir, &[&BAKE[..], more].concat()));
    assert_eq!(code, Some(0), "{more:?}: {err}");
}

/// Leaves the journal of a bake to `out` where it would be if the bake had been stopped before the export.
fn stopped(dir: &Path, out: &str) -> std::path::PathBuf {
    // a folder in the place of the result, with something in it that is not replaced
    std::fs::create_dir_all(dir.join(out).join("mine")).unwrap();
    let output = softrig(dir, &[&BAKE[..], &["-o", out, "--force"]].concat());
    assert_ne!(output.status.code(), Some(0), "{:?}", said(&output));
    std::fs::remove_dir_all(dir.join(out)).unwrap();
    dir.join(format!("{out}.softrig-journal"))
}

/// Nodes of the volume mesh make up most of a frame; only .vtu files show them.
#[test]
fn only_results_that_show_nodes_keep_them() {
    let dir = folder();
    let slim = stopped(dir.path(), "o.pc2");
    bake(dir.path(), &["-o", "all.softrig-journal"]);
    let length = |p: &Path| p.metadata().unwrap().len();
    let (slim_bytes, all_bytes) = (length(&slim), length(&dir.path().join("all.softrig-journal")));
    println!("journal of 6 frames: {slim_bytes} bytes for a .pc2, {all_bytes} with nodes");
    assert!(JournalReader::open(&slim).unwrap().header().volume.is_none());
    assert!(JournalReader::open(&dir.path().join("all.softrig-journal")).unwrap().header().volume.is_some());
    assert!(slim_bytes < all_bytes);
    // what has no nodes says how to get them
    let (code, _, err) = said(&softrig(dir.path(), &["convert", "o.pc2.softrig-journal", "o.vtu"]));
    assert!(code == Some(1) && err.contains("bake with a .vtu output"), "{err}");
    let (code, _, err) = said(&softrig(dir.path(), &["convert", "all.softrig-journal", "o.vtu"]));
    assert_eq!(code, Some(0), "{err}");
    // both go on to the same bytes, each as it was begun
    bake(dir.path(), &["-o", "o.pc2", "--resume"]);
    std::fs::rename(dir.path().join("all.softrig-journal"), dir.path().join("b.pc2.softrig-journal")).unwrap();
    bake(dir.path(), &["-o", "b.pc2", "--resume"]);
    let read = |name: &str| std::fs::read(dir.path().join(name)).unwrap();
    assert!(read("o.pc2") == read("b.pc2"));
}

/// The words of a journal are a scene that bakes the same frames: program, clip and every setting.
#[test]
fn a_journal_says_how_to_bake_it_again() {
    let dir = folder();
    let settings = ["--preset", "fat", "--dynamics", "calm", "--fps", "24", "--tolerance", "1e-5", "--no-sag"];
    bake(dir.path(), &[&settings[..], &["-o", "o.softrig-journal"]].concat());
    let journal = JournalReader::open(&dir.path().join("o.softrig-journal")).unwrap();
    let origin = &journal.header().origin;
    assert!(origin.starts_with(&format!("# softrig {}", env!("CARGO_PKG_VERSION"))), "{origin}");
    assert!(origin.contains("clip = \"walk\""), "{origin}");
    std::fs::write(dir.path().join("again.toml"), origin).unwrap();
    let (code, _, err) = said(&softrig(dir.path(), &["bake", "again.toml", "-o", "again.pc2"]));
    assert_eq!(code, Some(0), "{err}");
    let (code, _, err) = said(&softrig(dir.path(), &["convert", "o.softrig-journal", "first.pc2"]));
    assert_eq!(code, Some(0), "{err}");
    let read = |name: &str| std::fs::read(dir.path().join(name)).unwrap();
    assert!(read("again.pc2") == read("first.pc2"));
    // people find it by looking
    let (code, out, err) = said(&softrig(dir.path(), &["inspect", "o.softrig-journal"]));
    assert!(code == Some(0) && out.contains("preset = \"fat\""), "{out} {err}");
}

/// Without a clip's name the first one is baked, and the journal says which that was.
#[test]
fn a_journal_names_its_clip() {
    let dir = folder();
    let args = ["bake", "sample", "--cells", "600", "--frames", "0..2", "-o", "o.softrig-journal"];
    let (code, _, err) = said(&softrig(dir.path(), &args));
    assert_eq!(code, Some(0), "{err}");
    let origin = JournalReader::open(&dir.path().join("o.softrig-journal")).unwrap().header().origin.clone();
    let first = softrig::sample::character().clips[0].name.clone();
    assert!(origin.contains(&format!("clip = \"{first}\"")), "{origin}");
}
