//! softrig on the command line: [`run`] is the whole program.
//!
//! Exit codes: 0 only when the work is done, 1 the input's fault, 2 usage, 3 the machine's fault (disk full, no permission),
//! 4 the simulation could not be kept valid, 130 after Ctrl-C.

pub mod args;
pub mod commands;
pub mod docs;
pub mod failure;
pub mod interrupt;
pub mod load;
pub mod report;
pub mod scene;
pub mod ui;

use args::{Cli, Command};
use clap::Parser;
use failure::{Failure, Outcome};
use std::ffi::OsString;
use std::process::ExitCode;

/// Runs one command line (the first argument is the program's name) and says how it went.
pub fn run(args: impl IntoIterator<Item = OsString>) -> ExitCode {
    let cli = match Cli::try_parse_from(args) {
        Ok(cli) => cli,
        Err(e) => {
            // help and version are results; printing fails only when nobody listens
            let _ = e.print();
            return ExitCode::from(if e.use_stderr() { 2 } else { 0 });
        }
    };
    interrupt::install();
    match on_threads(cli.threads, || execute(&cli)) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            ui::error(&failure);
            ExitCode::from(failure.exit_code())
        }
    }
}

/// Runs everything inside one thread pool: results do not depend on its size.
fn on_threads(threads: Option<usize>, work: impl FnOnce() -> Outcome + Send) -> Outcome {
    let count = threads.unwrap_or(0); // 0: as many as the machine has
    // as much stack as a main thread has
    let pool = rayon::ThreadPoolBuilder::new().num_threads(count).stack_size(8 << 20).build();
    pool.map_err(|e| Failure::Machine(format!("cannot start {count} threads: {e}; ask for fewer with --threads")))?
        .install(work)
}

fn execute(cli: &Cli) -> Outcome {
    match &cli.command {
        Command::Demo(a) => commands::demo::run(a),
        Command::Inspect(a) => commands::inspect::run(a),
        Command::Mesh(a) => commands::mesh::run(a),
        Command::Bake(a) => commands::bake::run(a),
        Command::Render(a) => commands::render::run(a),
        Command::Convert(a) => commands::convert::run(a),
        Command::Bench(a) => commands::bench::run(a),
        Command::Papers(a) => commands::papers::run(a),
        Command::Completions(a) => commands::completions::run(a),
    }
}

/// The library example of the README is run as a test.
#[cfg(doctest)]
#[doc = include_str!("../../../README.md")]
struct Readme;
