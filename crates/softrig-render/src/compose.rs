//! Captions, legends, pictures beside each other.

use crate::color::{ColorMap, srgb};
use crate::error::RenderError;
use crate::font;
use crate::image::Image;

/// Where a caption goes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Align {
    /// In the middle of the upper edge.
    #[default]
    Top,
    /// In the middle of the lower edge.
    Bottom,
    /// In the upper left corner.
    TopLeft,
}

/// Colour of all writing: dark slate, softer than black.
const INK: [u8; 3] = [38, 46, 56];

/// Height of capital letters for a picture: readable at a glance, never the main thing.
fn letter_size(image: &Image) -> f32 {
    (image.width.min(image.height) as f32 * 0.026).clamp(9.0, 40.0)
}

/// Writes a line of text into a picture, on a soft light field that keeps it readable over anything.
pub fn caption(image: &mut Image, text: &str, align: Align) {
    if text.is_empty() {
        return;
    }
    let size = letter_size(image);
    let (w, pad) = (font::width(text, size), 0.75 * size);
    let x = if align == Align::TopLeft { 1.6 * size } else { 0.5 * (image.width as f32 - w) };
    let y = if align == Align::Bottom { image.height as f32 - 2.3 * size } else { 1.3 * size };
    field(image, [x - pad, y - pad, x + w + pad, y + size + pad]);
    font::write(image, text, x, y, size, INK);
}

/// Draws a bar of the colours with numbers beside it, lower right; `title` says what they mean, with the unit.
pub fn legend(image: &mut Image, map: ColorMap, range: [f32; 2], title: &str) {
    let size = letter_size(image) * 0.9;
    let (high, wide) = ((image.height as f32 * 0.34).max(6.0 * size), 1.3 * size);
    let steps = 4;
    let numbers: Vec<String> =
        (0..=steps).map(|i| number(range[0] + (range[1] - range[0]) * i as f32 / steps as f32, range)).collect();
    let text = numbers.iter().map(|n| font::width(n, size)).fold(0.0, f32::max);
    let broad = (wide + 0.9 * size + text).max(font::width(title, size));
    let right = image.width as f32 - 1.6 * size;
    let (left, bottom) = (right - broad, image.height as f32 - 2.0 * size);
    let top = bottom - high;
    field(image, [left - size, top - 3.0 * size, right + size, bottom + size]);
    font::write(image, title, left, top - 2.1 * size, size, INK);
    for y in 0..high as i64 {
        let color = srgb(map.at(1.0 - (y as f32 + 0.5) / high));
        for x in 0..wide as i64 {
            image.mix(left as i64 + x, top as i64 + y, color, 1.0);
        }
    }
    for (i, n) in numbers.iter().enumerate() {
        let y = bottom - high * i as f32 / steps as f32;
        for x in 0..(0.35 * size) as i64 + 1 {
            image.mix((left + wide) as i64 + x, (y.min(bottom - 1.0)) as i64, INK, 1.0);
        }
        font::write(image, n, left + wide + 0.9 * size, y - 0.5 * size, size, INK);
    }
}

/// A number with as many digits as tell the steps of a legend apart.
fn number(value: f32, range: [f32; 2]) -> String {
    let span = (range[1] - range[0]).abs();
    if !(value.is_finite() && span > 0.0) {
        return format!("{value}");
    }
    if !(1e-3..1e6).contains(&range[0].abs().max(range[1].abs())) {
        return format!("{value:.1e}");
    }
    let decimals = (1.5 - span.log10()).ceil().clamp(0.0, 5.0) as usize;
    let text = format!("{value:.decimals$}");
    // -0.0 is 0
    if text.trim_start_matches('-').chars().all(|c| c == '0' || c == '.') {
        text.trim_start_matches('-').into()
    } else {
        text
    }
}

/// A light, half-transparent field with soft corners: left, top, right, bottom.
fn field(image: &mut Image, [x0, y0, x1, y1]: [f32; 4]) {
    let round = (0.35 * (y1 - y0)).min(0.02 * image.width.min(image.height) as f32 + 3.0);
    for y in y0.floor() as i64..=y1.ceil() as i64 {
        for x in x0.floor() as i64..=x1.ceil() as i64 {
            let (px, py) = (x as f32 + 0.5, y as f32 + 0.5);
            let dx = (x0 + round - px).max(px - x1 + round).max(0.0);
            let dy = (y0 + round - py).max(py - y1 + round).max(0.0);
            let cover = (round - (dx * dx + dy * dy).sqrt() + 0.5).clamp(0.0, 1.0);
            image.mix(x, y, [255; 3], 0.62 * cover);
        }
    }
}

/// Pictures in a row. With labels, each has its own on a strip above it, in the colour of its upper corner; pictures that are less high
/// than others are filled up below.
///
/// # Errors
/// [`RenderError::Empty`] without pictures, [`RenderError::Size`] when the row is too wide.
pub fn side_by_side(images: &[Image], labels: &[&str]) -> Result<Image, RenderError> {
    let first = images.first().ok_or(RenderError::Empty)?;
    const GAP: u32 = 2;
    let height = images.iter().map(|i| i.height).max().unwrap_or(first.height);
    let total: u64 = images.iter().map(|i| u64::from(i.width + GAP)).sum::<u64>() - u64::from(GAP);
    let width = u32::try_from(total).ok().filter(|w| *w <= 65_535).ok_or(RenderError::Size {
        width: total.min(u64::from(u32::MAX)) as u32,
        height,
        samples: 1,
        limit: 65_535,
    })?;
    let size = images.iter().map(letter_size).fold(f32::MAX, f32::min);
    let strip = if labels.iter().any(|l| !l.is_empty()) { (2.4 * size) as u32 } else { 0 };
    let mut out = Image::filled(width, height + strip, [255; 3]);
    let mut x = 0;
    for (i, image) in images.iter().enumerate() {
        let mut cell = Image::filled(image.width, height, image.pixel(0, image.height.saturating_sub(1)));
        cell.paste(image, 0, 0);
        let label = labels.get(i).copied().unwrap_or("");
        let mut above = Image::filled(image.width, strip, image.pixel(0, 0));
        let left = 0.5 * (image.width as f32 - font::width(label, size));
        font::write(&mut above, label, left.max(0.5 * size), 0.7 * size, size, INK);
        out.paste(&above, x, 0);
        out.paste(&cell, x, strip);
        x += image.width + GAP;
    }
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_tell_the_steps_apart() {
        assert_eq!(number(0.25, [0.0, 1.0]), "0.25");
        assert_eq!(number(1.125, [0.0, 1.5]), "1.12");
        assert_eq!(number(12_500.0, [0.0, 50_000.0]), "12500");
        assert_eq!(number(-0.0, [-1.0, 1.0]), "0.00".replace("0.00", &number(0.0, [-1.0, 1.0])));
        assert_eq!(number(2.5e-7, [0.0, 1e-6]), "2.5e-7");
    }

    /// The bar shows the map's ends where the legend says they are.
    #[test]
    fn legend_has_the_ends_of_the_map() {
        let mut image = Image::filled(400, 400, [255; 3]);
        legend(&mut image, ColorMap::Amount, [0.0, 30.0], "stress [kPa]");
        let has = |t: f32| {
            let c = srgb(ColorMap::Amount.at(t));
            image.pixels.iter().any(|p| (0..3).all(|k| p[k].abs_diff(c[k]) <= 3))
        };
        assert!(has(0.0) && has(0.5) && has(1.0));
        assert!(image.pixels.contains(&INK), "no writing");
    }

    #[test]
    fn side_by_side_keeps_every_picture() {
        let (a, b) = (Image::filled(40, 30, [9, 0, 0]), Image::filled(20, 50, [0, 9, 0]));
        let row = side_by_side(&[a, b], &[]).unwrap();
        assert_eq!((row.width, row.height), (62, 50));
        assert_eq!((row.pixel(39, 49), row.pixel(42, 0)), ([9, 0, 0], [0, 9, 0]));
        let labelled = side_by_side(&[row.clone(), row.clone()], &["a", "b"]).unwrap();
        let strip = labelled.height - row.height;
        assert!(strip > 10 && labelled.pixel(39, strip + 49) == [9, 0, 0], "labels cover nothing");
        assert!(matches!(side_by_side(&[], &[]), Err(RenderError::Empty)));
    }
}
