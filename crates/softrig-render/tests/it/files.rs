//! Pictures on disk, read back by an independent decoder.

use super::{camera, draw, square};
use image::AnimationDecoder;
use softrig_render::{GifWriter, Image, PngSeries, RenderError};

/// A bright square that moves over a gradient.
fn frame(i: u32) -> Image {
    let mut image = Image::filled(96, 64, [0; 3]);
    for y in 0..64u32 {
        for x in 0..96u32 {
            let moving = (10 + 6 * i..26 + 6 * i).contains(&x) && (20..40).contains(&y);
            image.pixels[(y * 96 + x) as usize] =
                if moving { [250, 120, 20] } else { [40 + x as u8, 60 + y as u8, 150] };
        }
    }
    image
}

#[test]
fn a_png_holds_the_picture() {
    let dir = tempfile::tempdir().unwrap();
    let image = draw(square(), &camera(6.0));
    image.write_png(dir.path().join("a.png")).unwrap();
    let back = image::open(dir.path().join("a.png")).unwrap().to_rgb8();
    assert_eq!(back.into_raw(), image.pixels.as_flattened());
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 1, "nothing else is left");
    let refused = image.write_png(dir.path().join("none/a.png")).unwrap_err();
    assert!(matches!(refused, RenderError::Write { .. }) && refused.to_string().contains("none"), "{refused}");
}

/// Frames that a decoder puts back together equal what was drawn to a few levels: what changed is drawn, what did not is kept.
#[test]
fn a_gif_plays_what_was_drawn() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.gif");
    let mut gif = GifWriter::create(&path, 30.0).unwrap();
    for i in 0..9 {
        gif.frame(&frame(i)).unwrap();
        assert!(!path.exists(), "the file appears when it is whole");
    }
    gif.finish().unwrap();
    let decoder =
        image::codecs::gif::GifDecoder::new(std::io::BufReader::new(std::fs::File::open(&path).unwrap())).unwrap();
    let frames = decoder.into_frames().collect_frames().unwrap();
    assert_eq!(frames.len(), 9);
    let time: u32 = frames.iter().map(|f| f.delay().numer_denom_ms()).map(|(n, d)| n / d).sum();
    assert_eq!(time, 300, "nine frames at 30 per second");
    for (i, f) in frames.iter().enumerate() {
        let drawn = frame(i as u32);
        for (p, q) in f.buffer().pixels().zip(&drawn.pixels) {
            assert!((0..3).all(|k| p.0[k].abs_diff(q[k]) <= 10), "frame {i}: {:?} for {q:?}", p.0);
        }
    }
}

#[test]
fn a_gif_that_is_given_up_leaves_nothing() {
    let dir = tempfile::tempdir().unwrap();
    let mut gif = GifWriter::create(dir.path().join("a.gif"), f64::NAN).unwrap();
    gif.frame(&frame(0)).unwrap();
    let other = Image::filled(10, 10, [0; 3]);
    assert!(matches!(gif.frame(&other), Err(RenderError::FrameSize { frame: 1, .. })));
    drop(gif);
    assert!(matches!(GifWriter::create(dir.path().join("b.gif"), 25.0).unwrap().finish(), Err(RenderError::Empty)));
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0);
}

#[test]
fn a_series_is_numbered() {
    let dir = tempfile::tempdir().unwrap();
    let mut series = PngSeries::create(dir.path().join("new/folder"), "walk").unwrap();
    series.frame(&frame(0)).unwrap();
    let second = series.frame(&frame(1)).unwrap();
    assert!(second.ends_with("new/folder/walk.0001.png") && second.exists());
}
