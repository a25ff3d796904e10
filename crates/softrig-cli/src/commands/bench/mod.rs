//! `softrig bench`.

use crate::failure::{Failure, Outcome};
use std::path::Path;

/// Measures the named bodies (all without names).
///
/// # Errors
/// [`Failure::Usage`] for a name that is no body.
pub fn run(names: &[String], _threads: usize, _json: bool, _shared: &Path) -> Outcome {
    Err(Failure::Usage(format!("there is no benchmark body {names:?} in this build")))
}
