//! `softrig bake`.

use crate::args::BakeArgs;
use crate::failure::{Failure, Outcome};

/// Runs the command.
///
/// # Errors
/// [`Failure`] with the exit code.
pub fn run(_args: &BakeArgs) -> Outcome {
    Err(Failure::Usage("unsupported: `bake` is not in this build yet".into()))
}
