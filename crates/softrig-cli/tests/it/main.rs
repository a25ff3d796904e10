//! The command line from outside: the binary is run as a user runs it.

#![allow(clippy::unwrap_used, reason = "helpers of tests fail as tests do")]

mod bake;
mod characters;
mod disk;
mod docs;
mod journal;
mod methods;
mod objects;
mod papers;
mod real;
mod shared;
mod slivers;
mod twoway;
mod usage;

use std::path::Path;
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
