//! The command line from outside: the binary is run as a user runs it.

mod docs;
mod usage;

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// Root of the workspace.
fn root() -> &'static Path {
    Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../.."))
}

/// Runs `softrig` in a folder.
fn softrig(folder: &Path, args: &[&str]) -> Output {
    command(folder, args).output().expect("softrig starts")
}

/// A `softrig` command to be run in a folder.
fn command(folder: &Path, args: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_softrig"));
    command.current_dir(folder).args(args);
    command
}

/// Exit code, stdout, stderr.
fn said(output: &Output) -> (Option<i32>, String, String) {
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    (output.status.code(), text(&output.stdout), text(&output.stderr))
}

/// An empty folder that goes away with the test.
fn folder() -> tempfile::TempDir {
    tempfile::tempdir().expect("a temporary folder")
}

/// A file of the shared data, if that is there; its use is written down for `.ci/run`.
#[allow(dead_code, reason = "used by the tests on real files")]
fn shared(path: &str) -> Option<PathBuf> {
    use std::io::Write;
    let base = std::env::var_os("SOFTRIG_SHARED").map_or_else(|| root().join("../shared"), PathBuf::from);
    let file = base.join("data").join(path);
    if !file.exists() {
        // straight to stderr: the test harness must not swallow a skip
        let _ = writeln!(std::io::stderr(), "skipped: no shared data at {}", file.display());
        return None;
    }
    if let Some(log) = std::env::var_os("SOFTRIG_EXERCISED") {
        let log = std::fs::OpenOptions::new().create(true).append(true).open(log);
        let _ = writeln!(log.expect("the list of exercised files opens"), "{path}");
    }
    Some(file)
}
