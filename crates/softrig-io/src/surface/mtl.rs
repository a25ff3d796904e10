//! Base colours from the material files beside an OBJ.

use super::{Parsed, srgb_to_linear};
use crate::source::read_file;
use crate::text::{name, parse_number};
use std::path::{Component, Path};

/// Gives the looks of a surface the diffuse colours of its material files. Only files below the surface's own folder are opened; what
/// is missing or unreadable is noted, colours being no reason to refuse a shape.
pub(super) fn color_looks(parsed: &mut Parsed, obj: &Path) {
    let folder = obj.parent().unwrap_or(Path::new(""));
    let mut files = std::mem::take(&mut parsed.material_files);
    files.dedup();
    // nobody has more; a hostile file may
    files.truncate(16);
    for file in files {
        let relative = Path::new(&file);
        let stays = relative.components().all(|c| matches!(c, Component::Normal(_) | Component::CurDir));
        match stays.then(|| read_file(&folder.join(relative))) {
            Some(Ok(bytes)) => apply(parsed, &bytes),
            _ => parsed.notes.push(format!("materials are plain: no file `{file}` beside the surface")),
        }
    }
}

fn apply(parsed: &mut Parsed, bytes: &[u8]) {
    let mut current = None;
    for line in bytes.split(|b| *b == b'\n') {
        let mut words = line.split(u8::is_ascii_whitespace).filter(|w| !w.is_empty());
        match words.next() {
            Some(b"newmtl") => {
                let material = name(line.trim_ascii_start().get(6..).unwrap_or_default());
                current = parsed.looks.iter().position(|l| l.name == material);
            }
            Some(b"Kd") => {
                let Some(look) = current.and_then(|i| parsed.looks.get_mut(i)) else { continue };
                for (channel, word) in look.base_color.iter_mut().zip(words.take(3)) {
                    *channel = parse_number(word).map_or(*channel, |v| srgb_to_linear(v as f32));
                }
            }
            Some(b"d") => {
                let Some(look) = current.and_then(|i| parsed.looks.get_mut(i)) else { continue };
                if let Some(v) = words.next().and_then(parse_number) {
                    look.base_color[3] = v.clamp(0.0, 1.0) as f32;
                }
            }
            _ => {}
        }
    }
}
