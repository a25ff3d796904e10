//! `softrig completions`.

use crate::args::{Cli, CompletionsArgs};
use crate::failure::Outcome;
use crate::ui;
use clap::CommandFactory;

/// Prints a completion script to stdout.
///
/// # Errors
/// None.
pub fn run(args: &CompletionsArgs) -> Outcome {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut Cli::command(), "softrig", &mut script);
    ui::result_bytes(&script);
    Ok(())
}
