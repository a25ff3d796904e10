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
    if file.is_file() {
        exercised(path);
    }
    Some(file)
}

/// All files below a folder of the shared folder with one of the endings, sorted; empty, said, when it is not there.
pub fn real_files(start: &str, endings: &[&str]) -> Vec<PathBuf> {
    let mut found = Vec::new();
    let top = real_file(start);
    let mut folders: Vec<PathBuf> = top.iter().cloned().collect();
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(&folder).expect("a readable folder").flatten() {
            let path = entry.path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|e| endings.iter().any(|w| e == *w)) {
                let name = top.as_ref().and_then(|top| path.strip_prefix(top).ok()).unwrap_or(&path);
                exercised(&Path::new(start).join(name).display().to_string());
                found.push(path);
            }
        }
    }
    found.sort();
    found
}

/// Writes down that a file was used.
fn exercised(path: &str) {
    if let Some(log) = std::env::var_os("SOFTRIG_EXERCISED") {
        let mut log = std::fs::OpenOptions::new().create(true).append(true).open(log).expect("the list of files opens");
        // one write, so that tests at the same time do not mix
        log.write_all(format!("{path}\n").as_bytes()).expect("the list of files grows");
    }
}
