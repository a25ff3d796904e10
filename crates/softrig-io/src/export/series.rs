//! One OBJ or PLY file for each frame, in a folder; in the units and axes of the character's file, in its world. Colours of vertices, where they
//! are wanted, follow their positions: three numbers from 0 to 1 in OBJ files, three bytes and the value itself in PLY files.

use super::colors::Painter;
use super::output::{Folder, frame_name, png};
use super::space::{file_space, map_points};
use super::{ExportError, ExportOptions, ExportReport, Format};
use crate::journal::{JournalFrame, JournalReader};
use softrig::character::Character;
use std::fs::File;
use std::io::{self, BufWriter, Read, Seek, Write};
use std::path::Path;

pub(super) fn write<S: Read + Seek>(
    journal: &mut JournalReader<S>,
    character: &Character,
    format: Format,
    out: &Path,
    options: &ExportOptions,
) -> Result<ExportReport, ExportError> {
    let ending = if format == Format::PlySeries { "ply" } else { "obj" };
    let frames = journal.frame_count();
    let folder = Folder::new(out, options.existing, &["obj", "ply", "mtl", "png"])?;
    let create = |name: &str, content: &mut dyn FnMut(&mut BufWriter<File>) -> io::Result<()>| {
        let mut write = || {
            let mut w = BufWriter::with_capacity(1 << 16, File::create(folder.path(name))?);
            content(&mut w)?;
            w.flush()
        };
        write().map_err(|source| ExportError::Io { file: folder.final_path(name), source })
    };
    if format == Format::ObjSeries {
        create("materials.mtl", &mut |w| materials(w, character))?;
        for (i, texture) in character.textures.iter().enumerate() {
            let bytes = png(texture).unwrap_or_default();
            create(&format!("texture_{i}.png"), &mut |w| w.write_all(&bytes))?;
        }
    }
    let painter = options.colors.map(|field| Painter::new(journal, character, field)).transpose()?;
    let map = file_space(character);
    let mut frame = JournalFrame::default();
    let mut local: Vec<Vec<[f32; 3]>> = vec![Vec::new(); character.meshes.len()];
    let mut report = ExportReport { frames, ..ExportReport::default() };
    for t in 0..frames {
        journal.read_frame(t, &mut frame)?;
        for (out, skin) in local.iter_mut().zip(&frame.skin) {
            map_points(&map, skin, out);
        }
        let name = frame_name(t, frames, ending);
        let values = painter.as_ref().map(|p| (p, p.values(&frame)));
        let paint = values.as_ref().map(|(p, v)| (*p, &v[..]));
        create(&name, &mut |w| match ending {
            "ply" => ply(w, character, &local, paint),
            _ => obj(w, character, &local, paint),
        })?;
        report.files.push(folder.final_path(&name));
    }
    folder.finish(options.existing)?;
    Ok(report)
}

fn materials(w: &mut impl Write, character: &Character) -> io::Result<()> {
    for (i, look) in character.looks.iter().enumerate() {
        let [r, g, b, a] = look.base_color;
        writeln!(w, "newmtl look_{i}\nKd {r} {g} {b}\nd {a}\nillum 1")?;
        if let Some(texture) = look.texture.filter(|t| *t < character.textures.len()) {
            writeln!(w, "map_Kd texture_{texture}.png")?;
        }
    }
    Ok(())
}

/// Colours, and the values behind them, of the vertices of each mesh.
type Paint<'a> = Option<(&'a Painter, &'a [Vec<f64>])>;

fn obj(w: &mut impl Write, character: &Character, points: &[Vec<[f32; 3]>], paint: Paint<'_>) -> io::Result<()> {
    writeln!(w, "mtllib materials.mtl")?;
    // OBJ counts from 1, over all objects
    let (mut base, mut uv_base) = (1, 1);
    for (i, (mesh, points)) in character.meshes.iter().zip(points).enumerate() {
        let name: String = mesh.name.chars().map(|c| if c.is_control() { '_' } else { c }).collect();
        writeln!(w, "o {name}")?;
        for (k, [x, y, z]) in points.iter().enumerate() {
            match paint {
                Some((painter, values)) => {
                    let [r, g, b] = painter.color(values[i][k]);
                    writeln!(w, "v {x} {y} {z} {r:.4} {g:.4} {b:.4}")?;
                }
                None => writeln!(w, "v {x} {y} {z}")?,
            }
        }
        let uv = mesh.texture_coordinates.len() == points.len();
        for [u, v] in mesh.texture_coordinates.iter().filter(|_| uv) {
            // OBJ counts from the lower left
            writeln!(w, "vt {u} {}", 1.0 - v)?;
        }
        let mut look = None;
        for (i, triangle) in mesh.triangles.iter().enumerate() {
            let this = mesh.look.get(i).copied();
            if let Some(l) = this.filter(|_| this != look) {
                writeln!(w, "usemtl look_{l}")?;
                look = this;
            }
            let corner = |v: u32| match uv {
                true => format!("{}/{}", u64::from(v) + base, u64::from(v) + uv_base),
                false => format!("{}", u64::from(v) + base),
            };
            writeln!(w, "f {} {} {}", corner(triangle[0]), corner(triangle[1]), corner(triangle[2]))?;
        }
        base += points.len() as u64;
        uv_base += if uv { points.len() as u64 } else { 0 };
    }
    Ok(())
}

#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "colours are from 0 to 1")]
fn ply(w: &mut impl Write, character: &Character, points: &[Vec<[f32; 3]>], paint: Paint<'_>) -> io::Result<()> {
    let vertices: usize = points.iter().map(Vec::len).sum();
    let faces: usize = character.meshes.iter().map(|m| m.triangles.len()).sum();
    writeln!(w, "ply\nformat binary_little_endian 1.0\nelement vertex {vertices}")?;
    writeln!(w, "property float x\nproperty float y\nproperty float z")?;
    if let Some((painter, _)) = paint {
        writeln!(w, "property uchar red\nproperty uchar green\nproperty uchar blue")?;
        writeln!(w, "property float {}", painter.field.name())?;
    }
    writeln!(w, "element face {faces}\nproperty list uchar int vertex_indices\nend_header")?;
    for (i, points) in points.iter().enumerate() {
        for (k, point) in points.iter().enumerate() {
            for v in point {
                w.write_all(&v.to_le_bytes())?;
            }
            if let Some((painter, values)) = paint {
                w.write_all(&painter.color(values[i][k]).map(|c| (255.0 * c).round() as u8))?;
                w.write_all(&(values[i][k] as f32).to_le_bytes())?;
            }
        }
    }
    let mut base = 0;
    for mesh in &character.meshes {
        for triangle in &mesh.triangles {
            w.write_all(&[3])?;
            for v in triangle {
                w.write_all(&(v + base).to_le_bytes())?;
            }
        }
        base += mesh.positions.len() as u32;
    }
    Ok(())
}
