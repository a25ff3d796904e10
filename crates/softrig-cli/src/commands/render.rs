//! `softrig render`.

use crate::args::RenderArgs;
use crate::failure::{Failure, Outcome};

/// Runs the command.
///
/// # Errors
/// [`Failure`] with the exit code.
pub fn run(_args: &RenderArgs) -> Outcome {
    Err(Failure::Usage("unsupported: `render` is not in this build yet".into()))
}
