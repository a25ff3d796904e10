//! Where the real files are.

use std::io::Write;
use std::path::{Path, PathBuf};

/// The folder of sample data. What is used of it is written to the file that `SOFTRIG_EXERCISED` names, so that `.ci/run` can
/// count it.
#[derive(Clone, Debug)]
pub struct Data(PathBuf);

/// The folder of sample data; `None`, said past the test harness's capture, when it is not there.
pub fn data() -> Option<Data> {
    let root = std::env::var_os("SOFTRIG_SHARED")
        .map_or_else(|| Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared")).into(), PathBuf::from);
    // relative paths count from the workspace root; cargo runs tests inside the package folder
    let root = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../..")).join(root);
    let data = root.join("data");
    if data.is_dir() {
        return Some(Data(data));
    }
    let test = std::thread::current().name().unwrap_or("a test").to_owned();
    let _ = writeln!(std::io::stderr(), "skipped: {test}, no folder {}", data.display());
    None
}

impl Data {
    /// One file of it.
    pub fn file(&self, path: impl AsRef<Path>) -> PathBuf {
        let file = self.0.join(path);
        self.exercised(&file);
        file
    }

    /// All files below one of its folders with one of the endings, sorted.
    pub fn files(&self, folder: &str, endings: &[&str]) -> Vec<PathBuf> {
        let mut found = Vec::new();
        let mut folders = vec![self.0.join(folder)];
        while let Some(folder) = folders.pop() {
            for entry in std::fs::read_dir(&folder).unwrap() {
                let path = entry.unwrap().path();
                if path.is_dir() {
                    folders.push(path);
                } else if path.extension().is_some_and(|e| endings.iter().any(|w| e == *w)) {
                    self.exercised(&path);
                    found.push(path);
                }
            }
        }
        found.sort();
        found
    }

    /// Writes down that a file was used.
    fn exercised(&self, file: &Path) {
        if let Some(log) = std::env::var_os("SOFTRIG_EXERCISED") {
            let mut log = std::fs::OpenOptions::new().create(true).append(true).open(log).unwrap();
            // as other crates name it, so that it counts once; one write, so that tests at the same time do not mix
            let name = Path::new("data").join(file.strip_prefix(&self.0).unwrap_or(file));
            log.write_all(format!("{}\n", name.display()).as_bytes()).unwrap();
        }
    }
}
