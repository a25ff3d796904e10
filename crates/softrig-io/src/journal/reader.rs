//! Reading a journal, whole or torn.

use super::format::{
    Bytes, JournalHeader, MAGIC, PREFIX_LENGTH, RECORD_HEAD, VERSION, decode_header, kind, record_hasher,
};
use super::{JournalError, StoredCheckpoint};
use softrig::rig::{Affine, Pose};
use std::fs::File;
use std::hash::Hasher;
use std::io::{BufReader, ErrorKind, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

/// How a journal ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Tail {
    /// The bake was completed.
    Finished,
    /// The bake stopped between two records, or is still running.
    Open,
    /// The bytes after the last whole record are not one; frames before them are valid.
    Torn {
        /// How many bytes.
        bytes: u64,
    },
}

/// One frame read back. Buffers are reused from frame to frame.
#[derive(Clone, Debug, PartialEq)]
pub struct JournalFrame {
    /// Number of the frame, from 0.
    pub index: usize,
    /// Time since the first frame [s].
    pub time: f64,
    /// World frame of each joint [m].
    pub pose: Pose,
    /// Skin of each mesh in the world [m].
    pub skin: Vec<Vec<[f32; 3]>>,
    /// Nodes of the volume mesh [m]; empty when the journal has none.
    pub nodes: Vec<[f32; 3]>,
    /// Force of the flesh on each joint's bone [N].
    pub joint_force: Vec<[f32; 3]>,
}

impl Default for JournalFrame {
    fn default() -> Self {
        Self {
            index: 0,
            time: 0.0,
            pose: Pose { world: Vec::new() },
            skin: Vec::new(),
            nodes: Vec::new(),
            joint_force: Vec::new(),
        }
    }
}

/// Where a record's payload lies.
#[derive(Clone, Copy, Debug)]
struct Place {
    offset: u64,
    length: u64,
    checksum: u64,
}

/// A journal open for reading: any frame, in any order. Memory: one frame, and 24 bytes for each frame there is.
#[derive(Debug)]
pub struct JournalReader<S = File> {
    source: BufReader<S>,
    path: PathBuf,
    header: JournalHeader,
    frames: Vec<Place>,
    checkpoint: Option<(usize, Place)>,
    valid_length: u64,
    tail: Tail,
    buffer: Vec<u8>,
}

impl JournalReader<File> {
    /// Opens a journal and checks every record of it.
    ///
    /// # Errors
    /// [`JournalError`] when the file cannot be read or its header cannot be trusted; a torn tail is no error.
    pub fn open(path: &Path) -> Result<Self, JournalError> {
        let file = crate::source::open_regular(path).map_err(|source| match source.kind() {
            ErrorKind::NotFound => JournalError::Missing { file: path.to_owned() },
            _ => JournalError::Io { file: path.to_owned(), source },
        })?;
        Self::from_source(file, path)
    }
}

impl<S: Read + Seek> JournalReader<S> {
    /// A journal from anything that can be read and searched; `path` is for messages.
    ///
    /// # Errors
    /// As [`JournalReader::open`].
    pub fn from_source(source: S, path: &Path) -> Result<Self, JournalError> {
        let io = |source| JournalError::Io { file: path.to_owned(), source };
        let broken = |reason: &str| JournalError::NotAJournal { file: path.to_owned(), reason: reason.to_owned() };
        let mut source = BufReader::with_capacity(1 << 16, source);
        let end = source.seek(SeekFrom::End(0)).map_err(io)?;
        source.seek(SeekFrom::Start(0)).map_err(io)?;
        let mut prefix = [0; PREFIX_LENGTH as usize];
        match source.read_exact(&mut prefix) {
            Ok(()) => {}
            Err(e) if e.kind() == ErrorKind::UnexpectedEof => return Err(broken("it is too short")),
            Err(e) => return Err(io(e)),
        }
        if prefix[..8] != MAGIC {
            return Err(broken("it does not begin like one"));
        }
        let version = u32::from_le_bytes([prefix[8], prefix[9], prefix[10], prefix[11]]);
        if version != VERSION {
            return Err(JournalError::Version { file: path.to_owned(), found: version });
        }
        let mut at = PREFIX_LENGTH;
        let header = match next_record(&mut source, at, end).map_err(io)? {
            Some((kind::HEADER, place)) => {
                let mut bytes = Vec::new();
                source.seek(SeekFrom::Start(place.offset)).map_err(io)?;
                source.by_ref().take(place.length).read_to_end(&mut bytes).map_err(io)?;
                at = place.offset + place.length;
                decode_header(&bytes).map_err(broken)?
            }
            _ => return Err(broken("its header is damaged")),
        };
        let frame_length = header.frame_length().ok_or_else(|| broken("its frames would be too large"))?;
        let mut reader = Self {
            source,
            path: path.to_owned(),
            header,
            frames: Vec::new(),
            checkpoint: None,
            valid_length: at,
            tail: Tail::Open,
            buffer: Vec::new(),
        };
        reader.scan(at, end, frame_length).map_err(io)?;
        Ok(reader)
    }

    /// Finds all records from `at` on, and where the first damaged one begins.
    fn scan(&mut self, mut at: u64, end: u64, frame_length: u64) -> std::io::Result<()> {
        while let Some((kind, place)) = next_record(&mut self.source, at, end)? {
            let number = self.leading_number(place)?;
            let fits = number.is_some_and(|n| n == self.frames.len() as u64);
            match kind {
                kind::FRAME if fits && place.length == frame_length => self.frames.push(place),
                kind::CHECKPOINT if fits => {
                    let state = Place { offset: place.offset + 8, length: place.length - 8, ..place };
                    self.checkpoint = Some((self.frames.len(), state));
                }
                kind::END if fits && place.length == 8 => self.tail = Tail::Finished,
                // whole, but not what a writer would have put here
                _ => break,
            }
            at = place.offset + place.length;
            if self.tail == Tail::Finished {
                break;
            }
        }
        self.valid_length = at;
        if at < end && self.tail != Tail::Finished {
            self.tail = Tail::Torn { bytes: end - at };
        }
        Ok(())
    }

    /// The count every record but the header begins with.
    fn leading_number(&mut self, place: Place) -> std::io::Result<Option<u64>> {
        if place.length < 8 {
            return Ok(None);
        }
        let mut bytes = [0; 8];
        self.source.seek(SeekFrom::Start(place.offset))?;
        self.source.read_exact(&mut bytes)?;
        Ok(Some(u64::from_le_bytes(bytes)))
    }

    /// What the journal is about.
    #[must_use]
    pub fn header(&self) -> &JournalHeader {
        &self.header
    }

    /// The file.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Valid frames.
    #[must_use]
    pub fn frame_count(&self) -> usize {
        self.frames.len()
    }

    /// How the journal ends.
    #[must_use]
    pub fn tail(&self) -> Tail {
        self.tail
    }

    pub(super) fn valid_length(&self) -> u64 {
        self.valid_length
    }

    pub(super) fn into_source(self) -> S {
        self.source.into_inner()
    }

    pub(super) fn frame_checksums(&self) -> Vec<u64> {
        self.frames.iter().map(|p| p.checksum).collect()
    }

    /// The newest checkpoint.
    ///
    /// # Errors
    /// [`JournalError::Io`].
    pub fn last_checkpoint(&mut self) -> Result<Option<StoredCheckpoint>, JournalError> {
        let Some((frames_done, place)) = self.checkpoint else { return Ok(None) };
        self.fill(place)?;
        Ok(Some(StoredCheckpoint { frames_done, state: std::mem::take(&mut self.buffer) }))
    }

    /// Reads frame `index` into `frame`.
    ///
    /// # Errors
    /// [`JournalError`] when there is no such frame, or the file changed under the reader.
    pub fn read_frame(&mut self, index: usize, frame: &mut JournalFrame) -> Result<(), JournalError> {
        let count = self.frames.len();
        let place = *self.frames.get(index).ok_or(JournalError::NoSuchFrame { frame: index, count })?;
        self.fill(place)?;
        let mut bytes = Bytes(&self.buffer);
        let finite = decode_frame(&self.header, &mut bytes, frame);
        frame.index = index;
        match finite {
            Some(true) => Ok(()),
            _ => Err(JournalError::NotFinite { frame: index, what: "a position, frame or force" }),
        }
    }

    fn fill(&mut self, place: Place) -> Result<(), JournalError> {
        let io = |source| JournalError::Io { file: self.path.clone(), source };
        self.buffer.clear();
        self.source.seek(SeekFrom::Start(place.offset)).map_err(io)?;
        self.source.by_ref().take(place.length).read_to_end(&mut self.buffer).map_err(io)?;
        if self.buffer.len() as u64 == place.length {
            Ok(())
        } else {
            Err(io(std::io::Error::new(ErrorKind::UnexpectedEof, "the file became shorter while it was read")))
        }
    }
}

/// The whole record at `at`, if there is one with a matching checksum. Reads its payload in pieces and keeps none of it.
fn next_record<S: Read + Seek>(source: &mut BufReader<S>, at: u64, end: u64) -> std::io::Result<Option<(u32, Place)>> {
    if end.saturating_sub(at) < RECORD_HEAD {
        return Ok(None);
    }
    source.seek(SeekFrom::Start(at))?;
    let mut head = [0; RECORD_HEAD as usize];
    source.read_exact(&mut head)?;
    let mut head = Bytes(&head);
    let (Some(kind), Some(length), Some(checksum)) = (head.u32(), head.u64(), head.u64()) else { return Ok(None) };
    let offset = at + RECORD_HEAD;
    if length > end - offset {
        return Ok(None);
    }
    let mut hasher = record_hasher(kind, length);
    let mut piece = [0; 8192];
    let mut left = length;
    while left > 0 {
        let n = left.min(piece.len() as u64) as usize;
        source.read_exact(&mut piece[..n])?;
        hasher.write(&piece[..n]);
        left -= n as u64;
    }
    Ok((hasher.finish() == checksum).then_some((kind, Place { offset, length, checksum })))
}

/// Fills `frame` and says whether all its numbers are finite; `None` when bytes are missing.
fn decode_frame(header: &JournalHeader, bytes: &mut Bytes<'_>, frame: &mut JournalFrame) -> Option<bool> {
    let _index = bytes.u64()?;
    frame.time = bytes.f64()?;
    let mut finite = frame.time.is_finite();
    frame.pose.world.clear();
    for _ in 0..header.joint_count {
        let mut world = Affine::IDENTITY;
        for v in world.linear.iter_mut().flatten().chain(&mut world.translation) {
            *v = bytes.f64()?;
        }
        finite &= world.is_finite();
        frame.pose.world.push(world);
    }
    let mut vectors = |count: usize, out: &mut Vec<[f32; 3]>| -> Option<()> {
        out.clear();
        let numbers = bytes.take(count.checked_mul(12)?)?;
        out.extend(numbers.chunks_exact(12).map(|c| {
            let at = |i: usize| f32::from_le_bytes([c[i], c[i + 1], c[i + 2], c[i + 3]]);
            [at(0), at(4), at(8)]
        }));
        finite &= out.iter().flatten().all(|v| v.is_finite());
        Some(())
    };
    frame.skin.resize_with(header.meshes.len(), Vec::new);
    for (skin, mesh) in frame.skin.iter_mut().zip(&header.meshes) {
        vectors(mesh.vertex_count as usize, skin)?;
    }
    vectors(header.node_count(), &mut frame.nodes)?;
    vectors(header.joint_count as usize, &mut frame.joint_force)?;
    Some(finite)
}
