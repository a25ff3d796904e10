//! Bytes of a file, with a cap on how many.

use crate::error::{ImportError, Place};
use std::fs::File;
use std::io::{Error, ErrorKind, Read};
use std::path::Path;

/// Most bytes of any one file: far beyond real characters, and keeps every index of every format within 32 bits.
pub(crate) const MAX_FILE_BYTES: u64 = 2 << 30;

/// All bytes of a regular file of at most [`MAX_FILE_BYTES`].
///
/// # Errors
/// [`ImportError::Io`] when it cannot be read or is no regular file (a pipe may never end), [`ImportError::TooLarge`].
pub(crate) fn read_file(path: &Path) -> Result<Vec<u8>, ImportError> {
    let io = |source| ImportError::Io { file: path.into(), source };
    let file = open_regular(path).map_err(io)?;
    let length = file.metadata().map_err(io)?.len();
    check_size(path, length)?;
    let mut bytes = Vec::with_capacity(length as usize);
    // a file may grow while it is read
    file.take(MAX_FILE_BYTES + 1).read_to_end(&mut bytes).map_err(io)?;
    check_size(path, bytes.len() as u64)?;
    Ok(bytes)
}

/// Opens a regular file for reading.
///
/// # Errors
/// What the system says, [`ErrorKind::IsADirectory`], or [`ErrorKind::InvalidInput`] for a pipe or device, which may never end.
pub fn open_regular(path: &Path) -> std::io::Result<File> {
    // asked before opening: opening a pipe without a writer blocks
    let about = std::fs::metadata(path)?;
    if about.is_dir() {
        return Err(Error::from(ErrorKind::IsADirectory));
    }
    if !about.is_file() {
        return Err(Error::new(ErrorKind::InvalidInput, "not a regular file"));
    }
    File::open(path)
}

fn check_size(path: &Path, len: u64) -> Result<(), ImportError> {
    if len <= MAX_FILE_BYTES {
        return Ok(());
    }
    Err(ImportError::TooLarge {
        file: path.into(),
        place: Place::Whole,
        reason: format!("it has {len} bytes"),
        limit: MAX_FILE_BYTES,
    })
}
