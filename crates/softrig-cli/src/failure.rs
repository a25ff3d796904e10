//! Why a command ended without doing its work, and the exit code that says so.

use softrig_io::in_words;
use std::error::Error;
use std::io;
use std::path::Path;

/// What the work is not done for. The message is the whole answer a user gets: it names the file, the place, and what to change.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Failure {
    /// The input cannot be used as it is: exit 1.
    #[error("{0}")]
    Input(String),
    /// The command was called in a way that makes no sense: exit 2.
    #[error("{0}")]
    Usage(String),
    /// The machine did not let us (disk full, no permission): exit 3.
    #[error("{0}")]
    Machine(String),
    /// The simulation could not be kept valid: exit 4.
    #[error("{0}")]
    Simulation(String),
    /// Ctrl-C: exit 130.
    #[error("{0}")]
    Interrupted(String),
}

/// What every command returns.
pub type Outcome = Result<(), Failure>;

impl Failure {
    /// The process's exit code.
    #[must_use]
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Input(_) => 1,
            Self::Usage(_) => 2,
            Self::Machine(_) => 3,
            Self::Simulation(_) => 4,
            Self::Interrupted(_) => 130,
        }
    }

    /// A failed read of `path`: the input's fault, unless something in the chain of causes is the machine's.
    #[must_use]
    pub fn reading(path: &Path, error: &(dyn Error + 'static)) -> Self {
        let message = at(path, error);
        if blames_machine(error) { Self::Machine(message) } else { Self::Input(message) }
    }

    /// A failed write of `path`: the machine's fault when the system refused, the input's where the content does not fit the format.
    #[must_use]
    pub fn writing(path: &Path, error: &(dyn Error + 'static)) -> Self {
        let message = at(path, error);
        let io = chain(error).any(|e| e.downcast_ref::<io::Error>().is_some());
        if io { Self::Machine(message) } else { Self::Input(message) }
    }
}

/// An error and its causes, outermost first.
fn chain<'a>(error: &'a (dyn Error + 'static)) -> impl Iterator<Item = &'a (dyn Error + 'static)> {
    std::iter::successors(Some(error), |&e| e.source())
}

/// Permission, disk and memory are the machine's; a file that is missing or malformed is not.
fn blames_machine(error: &(dyn Error + 'static)) -> bool {
    use io::ErrorKind as K;
    chain(error).filter_map(|e| e.downcast_ref::<io::Error>()).any(|e| {
        matches!(
            e.kind(),
            K::PermissionDenied | K::StorageFull | K::QuotaExceeded | K::ReadOnlyFilesystem | K::OutOfMemory
        )
    })
}

/// The message with the file it is about, unless it names that itself.
fn at(path: &Path, error: &(dyn Error + 'static)) -> String {
    let (path, text) = (path.display().to_string(), plain(error));
    if text.contains(&path) { text } else { format!("{path}: {text}") }
}

/// The message on one line, with the causes that it does not already contain.
fn plain(error: &(dyn Error + 'static)) -> String {
    let mut text = String::new();
    for e in chain(error) {
        let part = match e.downcast_ref::<io::Error>() {
            Some(e) => in_words(e),
            None => e.to_string(),
        };
        if text.is_empty() {
            text = part;
        } else if !text.contains(&part) && !text.contains(&e.to_string()) {
            text = format!("{text}: {part}");
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, thiserror::Error)]
    #[error("cannot read the buffer")]
    struct Outer(#[source] io::Error);

    #[test]
    fn a_missing_file_is_the_inputs_fault_and_a_locked_one_the_machines() {
        let at = Path::new("a.glb");
        let missing = Failure::reading(at, &Outer(io::ErrorKind::NotFound.into()));
        assert_eq!(
            (missing.exit_code(), missing.to_string().as_str()),
            (1, "a.glb: cannot read the buffer: no such file or folder")
        );
        let locked = Failure::reading(at, &Outer(io::ErrorKind::PermissionDenied.into()));
        assert_eq!(locked.exit_code(), 3);
    }

    #[test]
    fn whatever_the_system_refuses_to_write_is_the_machines_fault() {
        assert_eq!(Failure::writing(Path::new("a"), &io::Error::from(io::ErrorKind::NotFound)).exit_code(), 3);
        assert_eq!(Failure::writing(Path::new("a"), &std::fmt::Error).exit_code(), 1);
    }
}
