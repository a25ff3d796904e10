//! Appending to a journal.

use super::format::{
    JournalHeader, MAGIC, PREFIX_LENGTH, RECORD_HEAD, VERSION, decode_header, encode_header, kind, record,
};
use super::reader::{JournalReader, Tail};
use super::{JournalError, StoredCheckpoint};
use crate::export::temporary_beside;
use softrig::frame::{Frame, FrameSink};
use std::fs::{File, OpenOptions, TryLockError};
use std::io::{Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

/// What to do about a journal that is there already.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Existing {
    /// Leave it alone and fail.
    #[default]
    Refuse,
    /// Replace it.
    Replace,
}

/// Where a resumed bake goes on.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ResumePoint {
    /// Frames the journal holds.
    pub frames: usize,
    /// The newest state to start again from; `None`: from the beginning. Frames from its `frames_done` on are computed and
    /// handed in again; those the journal has are compared, not written.
    pub checkpoint: Option<StoredCheckpoint>,
    /// Nothing is left to do.
    pub finished: bool,
}

/// Writes a journal. On `Err` the file still ends with the last whole record.
#[derive(Debug)]
pub struct JournalWriter {
    file: File,
    path: PathBuf,
    header: JournalHeader,
    /// Bytes of the file that hold whole records.
    length: u64,
    /// Checksums of the frames already there when the writer was opened.
    old_frames: Vec<u64>,
    /// Index the next frame must have.
    next: usize,
    /// Frames in the file.
    frames: usize,
    /// `frames_done` of the newest checkpoint in the file.
    last_checkpoint: Option<usize>,
    finished: bool,
    payload: Vec<u8>,
    record: Vec<u8>,
}

impl JournalWriter {
    /// Begins a journal.
    ///
    /// # Errors
    /// [`JournalError`] when it exists already and must not be replaced, is in use, or cannot be written.
    pub fn create(path: &Path, header: JournalHeader, existing: Existing) -> Result<Self, JournalError> {
        let io = |source| JournalError::Io { file: path.to_owned(), source };
        let taken = || JournalError::Exists { file: path.to_owned() };
        let payload = encode_header(&header);
        // what was written must be readable: refuses counts beyond the format and rates that are no numbers
        match decode_header(&payload) {
            Ok(back) if back.difference(&header).is_none() => {}
            Ok(_) => return Err(bad_header(path, "its header is larger than the format allows")),
            Err(reason) => return Err(bad_header(path, reason)),
        }
        match (existing, File::open(path)) {
            (Existing::Refuse, Ok(_)) => return Err(taken()),
            // never pull a journal from under a running bake
            (Existing::Replace, Ok(old)) => lock(&old, path)?,
            (_, Err(_)) => {}
        }
        let mut bytes = Vec::new();
        record(kind::HEADER, &payload, &mut bytes);
        // the header appears whole or not at all
        let mut temporary = temporary_beside(path).map_err(io)?;
        temporary.write_all(&MAGIC).map_err(io)?;
        temporary.write_all(&VERSION.to_le_bytes()).map_err(io)?;
        temporary.write_all(&bytes).map_err(io)?;
        temporary.as_file().sync_data().map_err(io)?;
        lock(temporary.as_file(), path)?;
        let file = match existing {
            Existing::Replace => temporary.persist(path).map_err(|e| io(e.error))?,
            Existing::Refuse => temporary.persist_noclobber(path).map_err(|e| match e.error.kind() {
                std::io::ErrorKind::AlreadyExists => taken(),
                _ => io(e.error),
            })?,
        };
        Ok(Self {
            file,
            path: path.to_owned(),
            header,
            length: PREFIX_LENGTH + bytes.len() as u64,
            old_frames: Vec::new(),
            next: 0,
            frames: 0,
            last_checkpoint: None,
            finished: false,
            payload: Vec::new(),
            record: Vec::new(),
        })
    }

    /// Goes on with a journal begun with the same header: drops a torn tail and says where to start.
    ///
    /// # Errors
    /// [`JournalError::OtherInputs`] when the headers differ; [`JournalError`] when the file cannot be read or written.
    pub fn resume(path: &Path, header: JournalHeader) -> Result<(Self, ResumePoint), JournalError> {
        let io = |source| JournalError::Io { file: path.to_owned(), source };
        let file = OpenOptions::new().read(true).write(true).open(path).map_err(io)?;
        lock(&file, path)?;
        let mut reader = JournalReader::from_source(file, path)?;
        if let Some(what) = header.difference(reader.header()) {
            return Err(JournalError::OtherInputs { file: path.to_owned(), what });
        }
        let checkpoint = reader.last_checkpoint()?;
        let old_frames = reader.frame_checksums();
        let (frames, finished) = (reader.frame_count(), reader.tail() == Tail::Finished);
        let length = reader.valid_length();
        let mut file = reader.into_source();
        file.set_len(length).map_err(io)?;
        file.seek(SeekFrom::Start(length)).map_err(io)?;
        let next = checkpoint.as_ref().map_or(0, |c| c.frames_done);
        let writer = Self {
            file,
            path: path.to_owned(),
            header,
            length,
            old_frames,
            next: if finished { frames } else { next },
            frames,
            last_checkpoint: checkpoint.as_ref().map(|c| c.frames_done),
            finished,
            payload: Vec::new(),
            record: Vec::new(),
        };
        Ok((writer, ResumePoint { frames, checkpoint, finished }))
    }

    /// Frames in the journal.
    #[must_use]
    pub fn frame_count(&self) -> usize {
        self.frames
    }

    /// The file.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Keeps the state of the simulation after the frames handed in so far, and flushes the disk. One that the journal has
    /// already (after resuming) is not written again.
    ///
    /// # Errors
    /// [`JournalError::Io`]; the file then ends as before.
    pub fn checkpoint(&mut self, state: &[u8]) -> Result<(), JournalError> {
        if self.finished || self.next < self.frames || self.last_checkpoint >= Some(self.next) {
            return Ok(());
        }
        self.payload.clear();
        self.payload.extend_from_slice(&(self.next as u64).to_le_bytes());
        self.payload.extend_from_slice(state);
        self.append(kind::CHECKPOINT)?;
        self.last_checkpoint = Some(self.next);
        self.sync()
    }

    /// Marks the bake as complete and flushes the disk.
    ///
    /// # Errors
    /// [`JournalError::Io`]; [`JournalError::Mismatch`] when frames are missing.
    pub fn finish(&mut self) -> Result<(), JournalError> {
        if self.finished {
            return Ok(());
        }
        if self.frames as u64 != self.header.frame_count {
            return Err(JournalError::Mismatch {
                frame: self.frames,
                what: "the number of frames",
                found: self.frames as u64,
                expected: self.header.frame_count,
            });
        }
        self.payload.clear();
        self.payload.extend_from_slice(&(self.frames as u64).to_le_bytes());
        self.append(kind::END)?;
        self.finished = true;
        self.sync()
    }

    fn sync(&self) -> Result<(), JournalError> {
        self.file.sync_data().map_err(|source| JournalError::Io { file: self.path.clone(), source })
    }

    /// Appends `payload` as one record; takes back what was written when that fails half way.
    fn append(&mut self, kind: u32) -> Result<(), JournalError> {
        record(kind, &self.payload, &mut self.record);
        let written = self.file.seek(SeekFrom::Start(self.length)).and_then(|_| self.file.write_all(&self.record));
        match written {
            Ok(()) => {
                self.length += self.record.len() as u64;
                Ok(())
            }
            Err(source) => {
                // readers pass over a torn record anyway, so failing to remove it is no second error
                let _ = self.file.set_len(self.length);
                Err(JournalError::Io { file: self.path.clone(), source })
            }
        }
    }

    /// Encodes a frame into `payload`.
    fn encode(&mut self, frame: &Frame<'_>) -> Result<(), JournalError> {
        let index = frame.index;
        let fit = |what, found: usize, expected: usize| {
            let (found, expected) = (found as u64, expected as u64);
            if found == expected { Ok(()) } else { Err(JournalError::Mismatch { frame: index, what, found, expected }) }
        };
        let joints = self.header.joint_count as usize;
        fit("the number of meshes", frame.skin.len(), self.header.meshes.len())?;
        for (skin, mesh) in frame.skin.iter().zip(&self.header.meshes) {
            fit("the number of skin vertices", skin.len(), mesh.vertex_count as usize)?;
        }
        fit("the number of joints", frame.pose.world.len(), joints)?;
        fit("the number of joint forces", frame.joint_force.len(), joints)?;
        let nodes = if self.header.volume.is_some() { frame.nodes } else { &[] };
        fit("the number of nodes", nodes.len(), self.header.node_count())?;

        self.payload.clear();
        self.payload.extend_from_slice(&(index as u64).to_le_bytes());
        self.payload.extend_from_slice(&frame.time.to_le_bytes());
        let mut finite = frame.time.is_finite();
        for world in &frame.pose.world {
            finite &= world.is_finite();
            let numbers = world.linear.iter().flatten().chain(&world.translation);
            numbers.for_each(|v| self.payload.extend_from_slice(&v.to_le_bytes()));
        }
        for v in frame.skin.iter().flatten().chain(nodes).chain(frame.joint_force).flatten() {
            // a finite f64 beyond the range of f32 is no position either
            let v = *v as f32;
            finite &= v.is_finite();
            self.payload.extend_from_slice(&v.to_le_bytes());
        }
        if finite { Ok(()) } else { Err(JournalError::NotFinite { frame: index, what: "a position, frame or force" }) }
    }
}

impl FrameSink for JournalWriter {
    type Error = JournalError;

    fn frame(&mut self, frame: &Frame<'_>) -> Result<(), JournalError> {
        let in_order = frame.index == self.next && (frame.index as u64) < self.header.frame_count && !self.finished;
        if !in_order {
            return Err(JournalError::Mismatch {
                frame: frame.index,
                what: "its number",
                found: frame.index as u64,
                expected: self.next as u64,
            });
        }
        self.encode(frame)?;
        match self.old_frames.get(frame.index) {
            Some(old) => {
                record(kind::FRAME, &self.payload, &mut self.record);
                let checksum = &self.record[RECORD_HEAD as usize - 8..RECORD_HEAD as usize];
                if checksum != old.to_le_bytes() {
                    return Err(JournalError::Diverged { frame: frame.index });
                }
            }
            None => {
                self.append(kind::FRAME)?;
                self.frames += 1;
            }
        }
        self.next += 1;
        Ok(())
    }
}

/// Takes the journal for this process. File systems that know no locks let everyone in.
fn lock(file: &File, path: &Path) -> Result<(), JournalError> {
    match file.try_lock() {
        Err(TryLockError::WouldBlock) => Err(JournalError::Busy { file: path.to_owned() }),
        Ok(()) | Err(TryLockError::Error(_)) => Ok(()),
    }
}

fn bad_header(path: &Path, reason: &str) -> JournalError {
    JournalError::NotAJournal { file: path.to_owned(), reason: reason.to_owned() }
}
