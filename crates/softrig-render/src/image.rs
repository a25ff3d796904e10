//! Finished pictures, and PNG files of them.

use crate::error::RenderError;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

/// A picture.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Image {
    /// Pixels across.
    pub width: u32,
    /// Pixels down.
    pub height: u32,
    /// sRGB, row by row from the top; `len == width * height`.
    pub pixels: Vec<[u8; 3]>,
}

impl Image {
    /// A picture of one colour.
    #[must_use]
    pub fn filled(width: u32, height: u32, color: [u8; 3]) -> Self {
        Self { width, height, pixels: vec![color; width as usize * height as usize] }
    }

    /// Colour of a pixel; black outside.
    #[must_use]
    pub fn pixel(&self, x: u32, y: u32) -> [u8; 3] {
        if x < self.width && y < self.height {
            self.pixels[y as usize * self.width as usize + x as usize]
        } else {
            [0; 3]
        }
    }

    /// Mixes a colour into a pixel; outside, nothing happens.
    pub(crate) fn mix(&mut self, x: i64, y: i64, color: [u8; 3], share: f32) {
        if (0..i64::from(self.width)).contains(&x) && (0..i64::from(self.height)).contains(&y) {
            let p = &mut self.pixels[y as usize * self.width as usize + x as usize];
            let s = share.clamp(0.0, 1.0);
            for k in 0..3 {
                p[k] = (f32::from(p[k]) + s * (f32::from(color[k]) - f32::from(p[k])) + 0.5) as u8;
            }
        }
    }

    /// Copies `other` in, its upper left corner at (x, y); what does not fit is cut off.
    pub(crate) fn paste(&mut self, other: &Self, x: u32, y: u32) {
        for row in 0..other.height.min(self.height.saturating_sub(y)) {
            let count = other.width.min(self.width.saturating_sub(x)) as usize;
            let from = row as usize * other.width as usize;
            let to = (y + row) as usize * self.width as usize + x as usize;
            self.pixels[to..to + count].copy_from_slice(&other.pixels[from..from + count]);
        }
    }

    /// Writes a PNG. The file appears whole or not at all.
    ///
    /// # Errors
    /// [`RenderError::Write`] when the file system refuses.
    pub fn write_png(&self, path: impl AsRef<Path>) -> Result<(), RenderError> {
        let path = path.as_ref();
        let bytes: &[u8] = self.pixels.as_flattened();
        let refuse = |source| RenderError::Write { path: path.into(), source };
        let mut part = PartFile::create(path)?;
        let encoder = image::codecs::png::PngEncoder::new_with_quality(
            &mut part.file,
            image::codecs::png::CompressionType::Default,
            image::codecs::png::FilterType::Adaptive,
        );
        image::ImageEncoder::write_image(encoder, bytes, self.width, self.height, image::ExtendedColorType::Rgb8)
            .map_err(|e| refuse(into_io(e)))?;
        part.finish()
    }
}

fn into_io(e: image::ImageError) -> std::io::Error {
    match e {
        image::ImageError::IoError(e) => e,
        other => std::io::Error::other(other),
    }
}

/// A folder of numbered PNG files: `NAME.0000.png`, `NAME.0001.png`, ...
#[derive(Clone, Debug)]
pub struct PngSeries {
    folder: PathBuf,
    name: String,
    next: usize,
}

impl PngSeries {
    /// A series in `folder`, which is made when it is not there.
    ///
    /// # Errors
    /// [`RenderError::Write`] when the folder cannot be made.
    pub fn create(folder: impl Into<PathBuf>, name: impl Into<String>) -> Result<Self, RenderError> {
        let folder = folder.into();
        std::fs::create_dir_all(&folder).map_err(|source| RenderError::Write { path: folder.clone(), source })?;
        Ok(Self { folder, name: name.into(), next: 0 })
    }

    /// Writes the next picture and returns where it is.
    ///
    /// # Errors
    /// [`RenderError::Write`] when the file system refuses.
    pub fn frame(&mut self, image: &Image) -> Result<PathBuf, RenderError> {
        let path = self.folder.join(format!("{}.{:04}.png", self.name, self.next));
        image.write_png(&path)?;
        self.next += 1;
        Ok(path)
    }
}

/// A file that is written beside its place and renamed into it when it is whole; dropped earlier, it leaves nothing behind.
#[derive(Debug)]
pub(crate) struct PartFile {
    pub(crate) file: BufWriter<std::fs::File>,
    part: PathBuf,
    path: PathBuf,
    done: bool,
}

impl PartFile {
    pub(crate) fn create(path: &Path) -> Result<Self, RenderError> {
        let refuse = |source| RenderError::Write { path: path.into(), source };
        let mut name = std::ffi::OsString::from(".");
        name.push(path.file_name().ok_or_else(|| refuse(std::io::Error::other("this names no file")))?);
        name.push(".part");
        let part = path.with_file_name(name);
        let file = std::fs::File::create(&part).map_err(refuse)?;
        Ok(Self { file: BufWriter::new(file), part, path: path.into(), done: false })
    }

    pub(crate) fn refuse(&self, source: std::io::Error) -> RenderError {
        RenderError::Write { path: self.path.clone(), source }
    }

    pub(crate) fn finish(mut self) -> Result<(), RenderError> {
        self.file.flush().map_err(|e| self.refuse(e))?;
        std::fs::rename(&self.part, &self.path).map_err(|e| self.refuse(e))?;
        self.done = true;
        Ok(())
    }
}

impl Drop for PartFile {
    fn drop(&mut self) {
        if !self.done {
            // nothing can be done about a file that will not go
            let _ = std::fs::remove_file(&self.part);
        }
    }
}
