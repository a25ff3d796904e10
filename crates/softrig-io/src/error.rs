//! What can be wrong with a file.

use std::fmt;
use std::path::{Path, PathBuf};

/// Why a file could not be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ImportError {
    /// The operating system would not give the bytes.
    #[error("cannot read {}: {}", file.display(), in_words(source))]
    Io {
        /// The file asked for.
        file: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// Neither the ending nor the first bytes belong to a format softrig reads.
    #[error("{} is in no format softrig reads here; {remedy}", file.display())]
    UnknownFormat {
        /// The file.
        file: PathBuf,
        /// What to do about it.
        remedy: String,
    },
    /// The file breaks the rules of its format.
    #[error("{}{place}: {reason}; {remedy}", file.display())]
    Malformed {
        /// The file.
        file: PathBuf,
        /// Where in it.
        place: Place,
        /// What is wrong there.
        reason: String,
        /// What to do about it.
        remedy: String,
    },
    /// The file is right but uses something softrig does not have.
    #[error("{}{place}: {reason}; {remedy}", file.display())]
    Unsupported {
        /// The file.
        file: PathBuf,
        /// Where in it.
        place: Place,
        /// What softrig does not have.
        reason: String,
        /// What to do about it.
        remedy: String,
    },
    /// The file, or something in it, is larger than softrig takes.
    #[error("{}{place}: {reason}; softrig takes at most {limit}", file.display())]
    TooLarge {
        /// The file.
        file: PathBuf,
        /// Where in it.
        place: Place,
        /// What is too large, and how large it is.
        reason: String,
        /// The most that would be read.
        limit: u64,
    },
}

/// Where in a file.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Place {
    /// The file as a whole.
    Whole,
    /// A line of a text file, from 1.
    Line(usize),
    /// A byte of a binary file, from 0.
    Byte(usize),
    /// A pointer into a JSON document, such as `/nodes/3/children`.
    Json(String),
    /// A named part, such as an XML element or a section.
    Part(String),
}

impl fmt::Display for Place {
    /// Written right behind a file name.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Whole => Ok(()),
            Self::Line(n) => write!(f, ", line {n}"),
            Self::Byte(n) => write!(f, ", byte {n}"),
            Self::Json(path) => write!(f, ", {path}"),
            Self::Part(name) => write!(f, ", {name}"),
        }
    }
}

impl ImportError {
    /// A broken rule of the format.
    pub(crate) fn malformed(file: &Path, place: Place, reason: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self::Malformed { file: file.into(), place, reason: reason.into(), remedy: remedy.into() }
    }

    /// Something softrig does not have.
    pub(crate) fn unsupported(file: &Path, place: Place, reason: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self::Unsupported { file: file.into(), place, reason: reason.into(), remedy: remedy.into() }
    }

    /// The file the error is about.
    #[must_use]
    pub fn file(&self) -> &Path {
        match self {
            Self::Io { file, .. }
            | Self::UnknownFormat { file, .. }
            | Self::Malformed { file, .. }
            | Self::Unsupported { file, .. }
            | Self::TooLarge { file, .. } => file,
        }
    }

    /// Whether the machine is at fault (no permission, broken disk) and not the file. A missing file is the caller's fault.
    #[must_use]
    pub fn is_machine_fault(&self) -> bool {
        use std::io::ErrorKind::{InvalidInput, IsADirectory, NotADirectory, NotFound};
        matches!(self, Self::Io { source, .. } if !matches!(source.kind(), NotFound | InvalidInput | IsADirectory | NotADirectory))
    }
}

/// What the system said, without its numbers and our temporary names.
#[must_use]
pub fn in_words(error: &std::io::Error) -> String {
    use std::io::ErrorKind as K;
    match error.kind() {
        K::NotFound => "no such file or folder".into(),
        K::PermissionDenied => "permission denied".into(),
        K::IsADirectory => "is a folder, a file is needed".into(),
        K::NotADirectory => "a part of this path is a file, not a folder".into(),
        K::StorageFull => "the disk is full".into(),
        K::QuotaExceeded => "the quota of this disk is used up".into(),
        K::FileTooLarge => "the file may not grow any larger here".into(),
        K::ReadOnlyFilesystem => "the disk can only be read".into(),
        _ => {
            let text = error.to_string();
            text.split(" (os error").next().unwrap_or(&text).to_owned()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_error_reads_as_one_line_with_file_place_reason_and_remedy() {
        let e =
            ImportError::malformed(Path::new("a.obj"), Place::Line(7), "vertex 9 does not exist", "export it again");
        assert_eq!(e.to_string(), "a.obj, line 7: vertex 9 does not exist; export it again");
        let e = ImportError::malformed(Path::new("a.obj"), Place::Whole, "it is empty", "export it again");
        assert_eq!(e.to_string(), "a.obj: it is empty; export it again");
    }
}
