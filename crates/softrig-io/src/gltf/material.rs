//! Looks and their pictures.
//!
//! A picture that cannot be had is no reason to refuse a character: it becomes a note.

use super::accessor::Accessors;
use super::container::{Loader, resource, shown};
use super::document::{Document, Image};
use image::{ImageDecoder, ImageFormat, ImageReader, Limits};
use softrig::character::{Look, Texture};
use std::io::Cursor;

/// Most pixels of one picture (4096 squared), and of all together: 64 and 256 MiB.
const MAX_PIXELS: u64 = 1 << 24;
const MAX_PIXELS_TOGETHER: u64 = 1 << 26;

/// Looks of all materials, then that of triangles without one; and the pictures they use.
pub(super) fn looks(
    document: &Document,
    accessors: &Accessors<'_>,
    loader: &mut Loader<'_>,
    notes: &mut Vec<String>,
) -> (Vec<Look>, Vec<Texture>) {
    let (mut looks, mut textures) = (Vec::new(), Vec::new());
    // picture of the file to texture of ours; `Some(None)`: it could not be had
    let mut known: Vec<Option<Option<usize>>> = vec![None; document.images.len()];
    let mut pixels_left = MAX_PIXELS_TOGETHER;
    for (i, material) in document.materials.iter().enumerate() {
        let name = material.name.clone().unwrap_or_else(|| format!("material {i}"));
        let pbr = material.pbr_metallic_roughness.as_ref();
        let factor = pbr.and_then(|p| p.base_color_factor).unwrap_or([1.0; 4]);
        let base_color = factor.map(|c| if c.is_finite() { c.clamp(0.0, 1.0) } else { 1.0 });
        let texture = pbr.and_then(|p| p.base_color_texture.as_ref()).and_then(|info| {
            let Some(source) = document.textures.get(info.index).and_then(|t| t.source) else {
                notes.push(format!("material `{}` has a texture without a png or jpeg picture", shown(&name)));
                return None;
            };
            let slot = known.get_mut(source)?;
            *slot.get_or_insert_with(|| {
                let image = &document.images[source];
                match picture(image, source, accessors, loader, &mut pixels_left) {
                    Ok(texture) => {
                        textures.push(texture);
                        Some(textures.len() - 1)
                    }
                    Err(reason) => {
                        let name = image.name.as_deref().map_or_else(|| format!("{source}"), shown);
                        notes.push(format!("left out picture `{name}`: {reason}"));
                        None
                    }
                }
            })
        });
        looks.push(Look { name, base_color, texture });
    }
    looks.push(Look { name: "default".into(), base_color: [1.0; 4], texture: None });
    (looks, textures)
}

fn picture(
    image: &Image,
    index: usize,
    accessors: &Accessors<'_>,
    loader: &mut Loader<'_>,
    pixels_left: &mut u64,
) -> Result<Texture, String> {
    let place = format!("/images/{index}");
    let owned;
    let bytes: &[u8] = match (&image.uri, image.buffer_view) {
        (Some(uri), _) => {
            owned = resource(uri, &place, loader).map_err(|f| f.reason().to_owned())?;
            &owned
        }
        (None, Some(view)) => accessors.view(view, &place).map_err(|f| f.reason().to_owned())?,
        (None, None) => return Err("it has no data".into()),
    };
    let format = image::guess_format(bytes).map_err(|_| "it is neither png nor jpeg".to_owned())?;
    if !matches!(format, ImageFormat::Png | ImageFormat::Jpeg) {
        return Err("it is neither png nor jpeg".into());
    }
    let mut reader = ImageReader::with_format(Cursor::new(bytes), format);
    let mut limits = Limits::default();
    // 16 bits per channel at most
    limits.max_alloc = Some(8 * MAX_PIXELS + (1 << 20));
    reader.limits(limits);
    let decoder = reader.into_decoder().map_err(|e| e.to_string())?;
    let (width, height) = decoder.dimensions();
    let pixels = u64::from(width) * u64::from(height);
    if pixels > MAX_PIXELS.min(*pixels_left) {
        return Err(format!("{width} x {height} pixels are more than fit (4096 x 4096 each, four of them together)"));
    }
    let decoded = image::DynamicImage::from_decoder(decoder).map_err(|e| e.to_string())?.into_rgba8();
    *pixels_left -= pixels;
    Ok(Texture { width, height, rgba: decoded.pixels().map(|p| p.0).collect() })
}
