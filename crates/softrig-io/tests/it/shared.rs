//! Where the real files are.

#![allow(dead_code, reason = "not every topic uses every helper")]

use std::io::Write;
use std::path::{Path, PathBuf};

/// The folder of sample data; `None`, said past the test harness's capture, when it is not there.
pub fn data() -> Option<PathBuf> {
    let root = std::env::var_os("SOFTRIG_SHARED")
        .map_or_else(|| Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared")).into(), PathBuf::from);
    // relative paths count from the workspace root; cargo runs tests inside the package folder
    let root = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../..")).join(root);
    let data = root.join("data");
    if data.is_dir() {
        return Some(data);
    }
    let test = std::thread::current().name().unwrap_or("a test").to_owned();
    let _ = writeln!(std::io::stderr(), "skipped: {test}, no folder {}", data.display());
    None
}

/// All files below a folder with one of the endings, sorted.
pub fn files(folder: &Path, endings: &[&str]) -> Vec<PathBuf> {
    let mut found = Vec::new();
    let mut folders = vec![folder.to_path_buf()];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(&folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|e| endings.iter().any(|w| e == *w)) {
                found.push(path);
            }
        }
    }
    found.sort();
    found
}
