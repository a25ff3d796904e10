//! Animated GIF files: a palette per frame, and only what changed since the frame before.

use crate::error::RenderError;
use crate::image::{Image, PartFile};
use crate::palette::Palette;
use std::path::Path;

/// The palette entry that lets the frame before show through.
const CLEAR: u8 = 255;

/// Levels by which a pixel may differ from what is on the screen before it is drawn anew: below what the palette resolves.
const CLOSE: u8 = 3;

/// Writes an animation frame by frame; the file appears, whole, at [`GifWriter::finish`].
pub struct GifWriter {
    part: PartFile,
    fps: f64,
    frames: usize,
    encoder: Option<gif::Encoder<Vec<u8>>>,
    /// What a viewer shows after the last frame.
    shown: Image,
    /// Hundredths of a second given to frames so far.
    elapsed: u64,
}

impl std::fmt::Debug for GifWriter {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("GifWriter").field("fps", &self.fps).field("frames", &self.frames).finish_non_exhaustive()
    }
}

impl GifWriter {
    /// An animation that loops, at `fps` frames per second (held within 1 to 50, what the format and viewers can do).
    ///
    /// # Errors
    /// [`RenderError::Write`] when the file cannot be made.
    pub fn create(path: impl AsRef<Path>, fps: f64) -> Result<Self, RenderError> {
        let fps = if fps.is_finite() { fps.clamp(1.0, 50.0) } else { 25.0 };
        let part = PartFile::create(path.as_ref())?;
        Ok(Self { part, fps, frames: 0, encoder: None, shown: Image::filled(0, 0, [0; 3]), elapsed: 0 })
    }

    /// Adds a frame. All frames have one size.
    ///
    /// # Errors
    /// [`RenderError::FrameSize`] when the size changes, [`RenderError::Size`] beyond what the format holds, [`RenderError::Write`] when the
    /// file system refuses.
    pub fn frame(&mut self, image: &Image) -> Result<(), RenderError> {
        let limit = u32::from(u16::MAX);
        if !(1..=limit).contains(&image.width) || !(1..=limit).contains(&image.height) {
            return Err(RenderError::Size { width: image.width, height: image.height, samples: 1, limit });
        }
        if self.encoder.is_none() {
            let mut encoder = gif::Encoder::new(Vec::new(), image.width as u16, image.height as u16, &[])
                .map_err(|e| self.refuse(e))?;
            encoder.set_repeat(gif::Repeat::Infinite).map_err(|e| self.refuse(e))?;
            self.encoder = Some(encoder);
        } else if (image.width, image.height) != (self.shown.width, self.shown.height) {
            return Err(RenderError::FrameSize {
                frame: self.frames,
                width: image.width,
                height: image.height,
                expected_width: self.shown.width,
                expected_height: self.shown.height,
            });
        }
        let first = self.frames == 0;
        if first {
            self.shown = image.clone();
        }
        let changed = |p: &[u8; 3], s: &[u8; 3]| first || (0..3).any(|k| p[k].abs_diff(s[k]) > CLOSE);
        // the part of the picture that changed
        let (w, h) = (image.width as usize, image.height as usize);
        let differs = |x: usize, y: usize| changed(&image.pixels[y * w + x], &self.shown.pixels[y * w + x]);
        let rows: Vec<usize> = (0..h).filter(|y| (0..w).any(|x| differs(x, *y))).collect();
        let columns: Vec<usize> = (0..w).filter(|x| (0..h).any(|y| differs(*x, y))).collect();
        let (y0, y1) = (rows.first().copied().unwrap_or(0), rows.last().map_or(1, |y| y + 1));
        let (x0, x1) = (columns.first().copied().unwrap_or(0), columns.last().map_or(1, |x| x + 1));
        let inside = || (y0..y1).flat_map(|y| (x0..x1).map(move |x| y * w + x));
        let mut palette = Palette::new(
            inside().filter(|i| changed(&image.pixels[*i], &self.shown.pixels[*i])).map(|i| image.pixels[i]),
            usize::from(CLEAR),
        );
        let mut indices = Vec::with_capacity((x1 - x0) * (y1 - y0));
        for i in inside() {
            if changed(&image.pixels[i], &self.shown.pixels[i]) {
                let index = palette.index(image.pixels[i]);
                self.shown.pixels[i] = palette.colors[usize::from(index)];
                indices.push(index);
            } else {
                indices.push(CLEAR);
            }
        }
        let mut table: Vec<u8> = palette.colors.iter().flatten().copied().collect();
        table.resize(3 * 256, 0);
        let until = ((self.frames + 1) as f64 * 100.0 / self.fps).round() as u64;
        let frame = gif::Frame {
            delay: (until - self.elapsed) as u16,
            dispose: gif::DisposalMethod::Keep,
            transparent: Some(CLEAR),
            left: x0 as u16,
            top: y0 as u16,
            width: (x1 - x0) as u16,
            height: (y1 - y0) as u16,
            palette: Some(table),
            buffer: indices.into(),
            ..gif::Frame::default()
        };
        self.elapsed = until;
        self.frames += 1;
        let encoder = self.encoder.as_mut().expect("made with the first frame");
        let written = encoder.write_frame(&frame);
        let bytes = std::mem::take(encoder.get_mut());
        written.map_err(|e| self.refuse(e))?;
        self.put(&bytes)
    }

    /// Ends the animation and puts the file in its place.
    ///
    /// # Errors
    /// [`RenderError::Empty`] without frames, [`RenderError::Write`] when the file system refuses; either way no file is left.
    pub fn finish(mut self) -> Result<(), RenderError> {
        let encoder = self.encoder.take().ok_or(RenderError::Empty)?;
        let bytes = encoder.into_inner().map_err(|e| self.refuse(e))?;
        self.put(&bytes)?;
        self.part.finish()
    }

    fn put(&mut self, bytes: &[u8]) -> Result<(), RenderError> {
        std::io::Write::write_all(&mut self.part.file, bytes).map_err(|e| self.part.refuse(e))
    }

    fn refuse(&self, e: gif::EncodingError) -> RenderError {
        self.part.refuse(match e {
            gif::EncodingError::Io(e) => e,
            other => std::io::Error::other(other),
        })
    }
}
