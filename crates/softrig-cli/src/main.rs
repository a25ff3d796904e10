//! The `softrig` command.

use std::process::ExitCode;

fn main() -> ExitCode {
    softrig_cli::run(std::env::args_os())
}
