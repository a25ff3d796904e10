//! `softrig mesh`.

use crate::args::MeshArgs;
use crate::failure::{Failure, Outcome};

/// Runs the command.
///
/// # Errors
/// [`Failure`] with the exit code.
pub fn run(_args: &MeshArgs) -> Outcome {
    Err(Failure::Usage("unsupported: `mesh` is not in this build yet".into()))
}
