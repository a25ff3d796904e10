//! What is wrong inside a glTF file, before the file's name is added.

use crate::error::{ImportError, Place};
use std::path::Path;

/// Result of the functions of this folder.
pub(super) type Checked<T> = Result<T, Fault>;

/// One thing wrong with the file.
#[derive(Debug)]
pub(super) struct Fault {
    kind: Kind,
    place: Place,
    reason: String,
    remedy: String,
}

#[derive(Debug)]
enum Kind {
    Malformed,
    Unsupported,
    TooLarge(u64),
}

/// What to do about files that break the rules.
pub(super) const EXPORT_AGAIN: &str = "export it again from the program that made it";

impl Fault {
    /// A broken rule at a JSON pointer such as `/nodes/3`; empty for the whole file.
    pub fn malformed(place: impl Into<String>, reason: impl Into<String>) -> Self {
        Self { kind: Kind::Malformed, place: json(place), reason: reason.into(), remedy: EXPORT_AGAIN.into() }
    }

    /// Something the file needs and softrig does not have.
    pub fn unsupported(place: impl Into<String>, reason: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self { kind: Kind::Unsupported, place: json(place), reason: reason.into(), remedy: remedy.into() }
    }

    /// More than softrig takes.
    pub fn too_large(place: impl Into<String>, reason: impl Into<String>, limit: u64) -> Self {
        Self { kind: Kind::TooLarge(limit), place: json(place), reason: reason.into(), remedy: String::new() }
    }

    /// With what to do about it.
    pub fn with_remedy(mut self, remedy: impl Into<String>) -> Self {
        self.remedy = remedy.into();
        self
    }

    /// What is wrong.
    pub fn reason(&self) -> &str {
        &self.reason
    }

    /// The error for the user.
    pub fn of_file(self, file: &Path) -> ImportError {
        match self.kind {
            Kind::Malformed => ImportError::malformed(file, self.place, self.reason, self.remedy),
            Kind::Unsupported => ImportError::unsupported(file, self.place, self.reason, self.remedy),
            Kind::TooLarge(limit) => {
                ImportError::TooLarge { file: file.into(), place: self.place, reason: self.reason, limit }
            }
        }
    }
}

fn json(place: impl Into<String>) -> Place {
    let place = place.into();
    if place.is_empty() { Place::Whole } else { Place::Json(place) }
}
