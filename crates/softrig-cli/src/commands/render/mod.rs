//! `softrig render`: pictures without any graphics hardware.

mod frames;
mod picture;

pub use frames::{Frames, Shape, journal_scene};
pub use picture::{Overlays, Painter};

use crate::args::RenderArgs;
use crate::commands::bake::{Policy, check_folder_of, make_folder_of, refuse_existing, refuse_input};
use crate::failure::{Failure, Outcome};
use crate::ui::{self, Progress};
use softrig_render::{GifWriter, Image, PngSeries, RenderError};
use std::path::Path;

/// What is written.
enum Output {
    Still,
    Gif(GifWriter),
    Series(PngSeries),
}

/// Draws what the command line names.
///
/// # Errors
/// [`Failure`] with the exit code.
pub fn run(args: &RenderArgs) -> Outcome {
    let ending = args.output.extension().map(|e| e.to_string_lossy().to_lowercase());
    let still = ending.as_deref() == Some("png");
    if !matches!(ending.as_deref(), None | Some("png" | "gif")) {
        return Err(Failure::Usage(format!(
            "{}: write a .png, a .gif, or a folder (a name without an ending)",
            args.output.display()
        )));
    }
    refuse_existing(&args.output, if args.force { Policy::Replace } else { Policy::Refuse })?;
    refuse_input(&args.output, [args.file.as_path()].into_iter().chain(args.with.as_deref()))?;
    check_folder_of(&args.output)?;
    let mut frames = Frames::open(args, still)?;
    frames.character.notes.iter().for_each(ui::warn);
    let range = range(args, frames.count, still)?;
    let painter = Painter::new(&mut frames, args, range.clone())?;
    let fps = args.fps.unwrap_or(frames.fps);
    make_folder_of(&args.output)?;
    let mut output = match ending.as_deref() {
        Some("png") => Output::Still,
        Some(_) => Output::Gif(GifWriter::create(&args.output, fps).map_err(|e| failure(&args.output, &e))?),
        None => Output::Series(PngSeries::create(&args.output, "frame").map_err(|e| failure(&args.output, &e))?),
    };
    let mut progress = Progress::new("pictures", 0, range.len());
    for index in range {
        let shape = frames.shape(index)?;
        let image = painter.paint(&frames, &shape).map_err(|e| failure(&args.output, &e))?;
        put(&mut output, &image, &args.output)?;
        progress.step();
    }
    progress.finish();
    if let Output::Gif(gif) = output {
        gif.finish().map_err(|e| failure(&args.output, &e))?;
    }
    ui::result(args.output.display());
    Ok(())
}

fn put(output: &mut Output, image: &Image, path: &Path) -> Outcome {
    match output {
        Output::Still => image.write_png(path),
        Output::Gif(gif) => gif.frame(image),
        Output::Series(series) => series.frame(image).map(|_| ()),
    }
    .map_err(|e| failure(path, &e))
}

/// A picture that could not be made or written.
pub fn failure(path: &Path, error: &RenderError) -> Failure {
    Failure::writing(path, error)
}

/// Frames to draw.
fn range(args: &RenderArgs, count: usize, still: bool) -> Result<std::ops::Range<usize>, Failure> {
    let missing = |what: String| {
        Err(Failure::Input(format!("{}: {what} is not there; it has frames 0..{count}", args.file.display())))
    };
    match (args.frame, args.frames) {
        (Some(n), _) if n < count => Ok(n..n + 1),
        (Some(n), _) => missing(format!("frame {n}")),
        (None, Some(r)) if r.start < count && r.end.unwrap_or(count) <= count => {
            let end = r.end.unwrap_or(count);
            Ok(r.start..if still { r.start + 1 } else { end })
        }
        (None, Some(r)) => missing(format!("part of the frames {r}")),
        (None, None) => Ok(0..if still { 1 } else { count }),
    }
}
