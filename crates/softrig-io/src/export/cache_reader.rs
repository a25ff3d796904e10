//! Reading point caches back: PC2 and MDD.

use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

/// Why a point cache could not be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CacheError {
    /// The operating system would not give the bytes.
    #[error("cannot read {}: {source}", file.display())]
    Io {
        /// The cache.
        file: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The file is no point cache, or its header and its size do not agree.
    #[error("{}: {reason}; write the cache again", file.display())]
    Malformed {
        /// The cache.
        file: PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// The frame asked for is not in the cache.
    #[error("{} has {count} frames, numbered from 0; frame {frame} is not among them", file.display())]
    NoSuchFrame {
        /// The cache.
        file: PathBuf,
        /// Number of the frame.
        frame: usize,
        /// Frames there are.
        count: usize,
    },
}

/// A point cache open for reading: positions as stored, in the local space of the mesh object. Frames are read one at a time.
#[derive(Debug)]
pub struct PointCache<S = File> {
    source: BufReader<S>,
    path: PathBuf,
    big_endian: bool,
    points: usize,
    frames: usize,
    /// Offset of the first frame.
    start: u64,
    /// Frames per second, where the file says so.
    fps: Option<f64>,
    buffer: Vec<u8>,
}

const PC2_MAGIC: &[u8; 12] = b"POINTCACHE2\0";
const PC2_HEADER: u64 = 32;

impl PointCache<File> {
    /// Opens a `.pc2` or `.mdd` file; which of the two is seen from its first bytes.
    ///
    /// # Errors
    /// [`CacheError`].
    pub fn open(path: &Path) -> Result<Self, CacheError> {
        let file =
            crate::source::open_regular(path).map_err(|source| CacheError::Io { file: path.to_owned(), source })?;
        Self::from_source(file, path)
    }
}

impl<S: Read + Seek> PointCache<S> {
    /// A cache from anything that can be read and searched; `path` is for messages.
    ///
    /// # Errors
    /// [`CacheError`].
    pub fn from_source(source: S, path: &Path) -> Result<Self, CacheError> {
        let io = |source| CacheError::Io { file: path.to_owned(), source };
        let bad = |reason: String| CacheError::Malformed { file: path.to_owned(), reason };
        let mut source = BufReader::new(source);
        let size = source.seek(SeekFrom::End(0)).map_err(io)?;
        source.seek(SeekFrom::Start(0)).map_err(io)?;
        let mut head = Vec::new();
        source.by_ref().take(PC2_HEADER).read_to_end(&mut head).map_err(io)?;
        let word = |at: usize| head.get(at..at + 4).map(|b| [b[0], b[1], b[2], b[3]]);
        let pc2 = head.starts_with(PC2_MAGIC);
        let (points, frames) = if pc2 {
            let version = word(12).map(i32::from_le_bytes);
            if version != Some(1) {
                return Err(bad(format!("it has PC2 version {}, only 1 is known", version.unwrap_or(0))));
            }
            (word(16).map(i32::from_le_bytes), word(28).map(i32::from_le_bytes))
        } else {
            (word(4).map(i32::from_be_bytes), word(0).map(i32::from_be_bytes))
        };
        let (Some(Ok(points)), Some(Ok(frames))) = (points.map(u64::try_from), frames.map(u64::try_from)) else {
            return Err(bad("its header is no header of a PC2 or MDD file".into()));
        };
        let start = if pc2 { PC2_HEADER } else { 8 + 4 * frames };
        // at most 2^31 * 2^31 * 12: counts in 128 bits cannot overflow
        let expected = u128::from(start) + u128::from(points) * u128::from(frames) * 12;
        if expected != u128::from(size) {
            return Err(bad(format!("{frames} frames of {points} points need {expected} bytes, the file has {size}")));
        }
        let mut cache = Self {
            source,
            path: path.to_owned(),
            big_endian: !pc2,
            points: points as usize,
            frames: frames as usize,
            start,
            fps: None,
            buffer: Vec::new(),
        };
        if !pc2 && frames > 1 {
            let mut times = [0; 8];
            cache.source.seek(SeekFrom::Start(8)).and_then(|_| cache.source.read_exact(&mut times)).map_err(io)?;
            let time = |at: usize| f32::from_be_bytes([times[at], times[at + 1], times[at + 2], times[at + 3]]);
            let step = f64::from(time(4)) - f64::from(time(0));
            cache.fps = (step > 0.0 && step.is_finite()).then_some(1.0 / step);
        }
        Ok(cache)
    }

    /// Points in each frame.
    #[must_use]
    pub fn point_count(&self) -> usize {
        self.points
    }

    /// Frames.
    #[must_use]
    pub fn frame_count(&self) -> usize {
        self.frames
    }

    /// Frames per second: an MDD file gives times, a PC2 file does not.
    #[must_use]
    pub fn fps(&self) -> Option<f64> {
        self.fps
    }

    /// Reads the points of frame `index` into `points`.
    ///
    /// # Errors
    /// [`CacheError`] when there is no such frame, or it holds numbers that are not finite.
    pub fn read_frame(&mut self, index: usize, points: &mut Vec<[f32; 3]>) -> Result<(), CacheError> {
        if index >= self.frames {
            return Err(CacheError::NoSuchFrame { file: self.path.clone(), frame: index, count: self.frames });
        }
        let length = self.points as u64 * 12;
        let io = |source| CacheError::Io { file: self.path.clone(), source };
        self.buffer.clear();
        self.source.seek(SeekFrom::Start(self.start + index as u64 * length)).map_err(io)?;
        self.source.by_ref().take(length).read_to_end(&mut self.buffer).map_err(io)?;
        if self.buffer.len() as u64 != length {
            return Err(io(std::io::ErrorKind::UnexpectedEof.into()));
        }
        let big = self.big_endian;
        let number = |b: &[u8]| {
            let b = [b[0], b[1], b[2], b[3]];
            if big { f32::from_be_bytes(b) } else { f32::from_le_bytes(b) }
        };
        points.clear();
        points.extend(self.buffer.chunks_exact(12).map(|p| [number(p), number(&p[4..]), number(&p[8..])]));
        match points.iter().position(|p| !p.iter().all(|v| v.is_finite())) {
            None => Ok(()),
            Some(i) => {
                let reason = format!("point {i} of frame {index} is not finite");
                Err(CacheError::Malformed { file: self.path.clone(), reason })
            }
        }
    }
}
