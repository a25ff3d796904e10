//! `softrig inspect`.

use crate::args::InspectArgs;
use crate::failure::{Failure, Outcome};

/// Runs the command.
///
/// # Errors
/// [`Failure`] with the exit code.
pub fn run(_args: &InspectArgs) -> Outcome {
    Err(Failure::Usage("unsupported: `inspect` is not in this build yet".into()))
}
