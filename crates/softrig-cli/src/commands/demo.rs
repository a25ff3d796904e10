//! `softrig demo`.

use crate::args::DemoArgs;
use crate::failure::{Failure, Outcome};

/// Runs the command.
///
/// # Errors
/// [`Failure`] with the exit code.
pub fn run(_args: &DemoArgs) -> Outcome {
    Err(Failure::Usage("unsupported: `demo` is not in this build yet".into()))
}
