//! The journal of a bake: every finished frame, written once, never touched again.
//!
//! A bake appends to a journal beside its output; cache formats are made from it at the end ([`crate::export`]), or later from
//! the journal of a bake that was killed. Cut off at any byte, everything before the cut stays valid.
//!
//! ```text
//! file    = magic "softrigJ"  version u32  header record  record*
//! record  = kind u32  length u64  XxHash64 of kind, length and payload u64  payload
//! kinds   : 1 header, 2 frame, 3 checkpoint, 4 end
//! ```
//! All numbers are little-endian. Positions are in the world [m] as `f32` (1e-7 of their distance from the origin); frames of
//! joints are `f64`, so that any local space can still be had from the journal alone.
//!
//! What survives: a frame is handed to the operating system in one write, so killing the process loses at most the frame
//! being written. The disk is flushed at creation, at checkpoints and at the end, so a power cut loses at most what came
//! after the last checkpoint.

mod format;
mod reader;
mod writer;

pub use format::{JournalHeader, JournalMesh, JournalVolume};
pub use reader::{JournalFrame, JournalReader, Tail};
pub use writer::{Existing, JournalWriter, ResumePoint};

use crate::error::in_words;
use std::path::{Path, PathBuf};

/// State of the simulation after some frames, as its owner wrote it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StoredCheckpoint {
    /// Number of frames finished when it was taken; the next frame has this index.
    pub frames_done: usize,
    /// Whatever the simulation needs to go on.
    pub state: Vec<u8>,
}

/// Why a journal could not be written or read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum JournalError {
    /// The operating system refused.
    #[error("{}: {}; frames already written stay valid, {} and go on with --resume", file.display(), in_words(source), remedy(source))]
    Io {
        /// The journal.
        file: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// There is none.
    #[error("there is no journal {}; a finished bake leaves only its result, a stopped one its journal beside it", file.display())]
    Missing {
        /// The journal asked for.
        file: PathBuf,
    },
    /// There is one already.
    #[error(
        "{} is there from an earlier bake; go on with it (--resume), replace it (--force), or choose another output", file.display()
    )]
    Exists {
        /// The journal.
        file: PathBuf,
    },
    /// Another process is writing to it.
    #[error("{} is being written by another process; wait for it, or choose another output", file.display())]
    Busy {
        /// The journal.
        file: PathBuf,
    },
    /// Not a journal, or not a byte of it can be trusted.
    #[error("{} is no softrig journal: {reason}", file.display())]
    NotAJournal {
        /// The file.
        file: PathBuf,
        /// What was found.
        reason: String,
    },
    /// Made by another version of the format.
    #[error("{} has journal version {found}, this program reads {}; bake again with --force", file.display(), format::VERSION)]
    Version {
        /// The journal.
        file: PathBuf,
        /// Its version.
        found: u32,
    },
    /// Resumed with other inputs or settings than it was begun with.
    #[error(
        "{} was begun with other inputs or settings ({what} differs); resume with the same ones, or start over with --force",
        file.display()
    )]
    OtherInputs {
        /// The journal.
        file: PathBuf,
        /// What differs.
        what: &'static str,
    },
    /// A frame or checkpoint does not fit the header or the frames before it.
    #[error("frame {frame}: {what} is {found}, the journal expects {expected}")]
    Mismatch {
        /// Number of the frame.
        frame: usize,
        /// What does not fit.
        what: &'static str,
        /// What came.
        found: u64,
        /// What fits.
        expected: u64,
    },
    /// A frame computed again after resuming is not the frame computed before.
    #[error(
        "frame {frame} computed again differs from the one in the journal: the program or the machine is not the one that began it; \
         start over with --force"
    )]
    Diverged {
        /// Number of the frame.
        frame: usize,
    },
    /// A number is infinite or not a number.
    #[error("frame {frame}: {what} is not finite")]
    NotFinite {
        /// Number of the frame.
        frame: usize,
        /// First such quantity.
        what: &'static str,
    },
    /// The frame asked for is not in the journal.
    #[error("frame {frame} is not in the journal, which holds {count}")]
    NoSuchFrame {
        /// Number of the frame.
        frame: usize,
        /// Frames there are.
        count: usize,
    },
}

impl JournalError {
    /// Whether the machine is at fault (disk full, no permission) and not what was asked for.
    #[must_use]
    pub fn is_machine_fault(&self) -> bool {
        matches!(self, Self::Io { .. })
    }
}

/// What to do about a refusal of the system before a bake can go on.
fn remedy(error: &std::io::Error) -> &'static str {
    use std::io::ErrorKind as K;
    match error.kind() {
        K::StorageFull | K::QuotaExceeded | K::FileTooLarge => "make room",
        K::PermissionDenied | K::ReadOnlyFilesystem => "make it writable",
        _ => "put it right",
    }
}

/// Where the journal of an output lies: beside it, with `.softrig-journal` after its name.
#[must_use]
pub fn journal_path(out: &Path) -> PathBuf {
    let mut name = out.file_name().unwrap_or_default().to_os_string();
    name.push(".softrig-journal");
    out.with_file_name(name)
}
