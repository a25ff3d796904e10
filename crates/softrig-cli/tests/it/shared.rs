//! Real files, where they are.

#![allow(dead_code, reason = "not every topic uses every helper")]

use std::io::Write;
use std::path::{Path, PathBuf};

/// A file of the shared folder; `None`, said past the test harness's capture, when it is not there. What is used is written
/// to the file that `SOFTRIG_EXERCISED` names, so that `.ci/run` can count it.
pub fn real_file(path: &str) -> Option<PathBuf> {
    let base = std::env::var_os("SOFTRIG_SHARED").map_or_else(|| "../shared".into(), PathBuf::from);
    // relative paths count from the workspace root; cargo runs tests inside the package folder
    let file = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../..")).join(base).join(path);
    if !file.exists() {
        let test = std::thread::current().name().unwrap_or("a test").to_owned();
        let _ = writeln!(std::io::stderr(), "skipped: {test}, no {}", file.display());
        return None;
    }
    if let Some(log) = std::env::var_os("SOFTRIG_EXERCISED") {
        let mut log = std::fs::OpenOptions::new().create(true).append(true).open(log).expect("the list of files opens");
        writeln!(log, "{path}").expect("the list of files grows");
    }
    Some(file)
}
