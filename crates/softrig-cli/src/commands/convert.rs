//! `softrig convert`.

use crate::args::ConvertArgs;
use crate::failure::{Failure, Outcome};

/// Runs the command.
///
/// # Errors
/// [`Failure`] with the exit code.
pub fn run(_args: &ConvertArgs) -> Outcome {
    Err(Failure::Usage("unsupported: `convert` is not in this build yet".into()))
}
