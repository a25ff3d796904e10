//! USD point cache as text (.usda): one Mesh prim for each mesh, with points and extent over time.
//!
//! One time code is one frame. Metres, Y up.

use super::output::write_file;
use super::{ExportError, ExportOptions, ExportReport};
use crate::journal::{JournalFrame, JournalReader};
use softrig::character::{Character, CharacterMesh, Look};
use std::collections::HashSet;
use std::fmt::Display;
use std::io::{self, Read, Seek, Write};
use std::path::Path;

pub(super) fn write<S: Read + Seek>(
    journal: &mut JournalReader<S>,
    character: &Character,
    out: &Path,
    options: &ExportOptions,
) -> Result<ExportReport, ExportError> {
    let frames = journal.frame_count();
    write_file(out, options.existing, |w| {
        let io = |source| ExportError::Io { file: out.to_owned(), source };
        let root = identifiers([character.name.as_str()]).remove(0);
        head(w, &root, journal.header().fps, frames).map_err(io)?;
        let names = identifiers(character.meshes.iter().map(|m| m.name.as_str()));
        let mut frame = JournalFrame::default();
        for (index, (mesh, name)) in character.meshes.iter().zip(&names).enumerate() {
            topology(w, name, mesh, character).map_err(io)?;
            let mut extents = Vec::with_capacity(frames);
            writeln!(w, "        point3f[] points.timeSamples = {{").map_err(io)?;
            for t in 0..frames {
                journal.read_frame(t, &mut frame)?;
                let points = &frame.skin[index];
                write!(w, "            {t}: ").map_err(io)?;
                list(w, points.iter().map(tuple)).map_err(io)?;
                writeln!(w, ",").map_err(io)?;
                extents.push(extent(points));
            }
            writeln!(w, "        }}\n        float3[] extent.timeSamples = {{").map_err(io)?;
            for (t, [lo, hi]) in extents.iter().enumerate() {
                writeln!(w, "            {t}: [{}, {}],", tuple(lo), tuple(hi)).map_err(io)?;
            }
            writeln!(w, "        }}\n    }}").map_err(io)?;
        }
        writeln!(w, "}}").map_err(io)
    })?;
    Ok(ExportReport { frames, files: vec![out.to_owned()], ..ExportReport::default() })
}

fn head(w: &mut impl Write, root: &str, fps: f64, frames: usize) -> io::Result<()> {
    writeln!(w, "#usda 1.0\n(\n    defaultPrim = \"{root}\"")?;
    writeln!(w, "    doc = \"softrig {}\"", env!("CARGO_PKG_VERSION"))?;
    writeln!(w, "    startTimeCode = 0\n    endTimeCode = {}", frames - 1)?;
    writeln!(w, "    timeCodesPerSecond = {fps}\n    framesPerSecond = {fps}")?;
    writeln!(w, "    metersPerUnit = 1\n    upAxis = \"Y\"\n)\n\ndef Xform \"{root}\"\n{{")
}

/// Everything about a mesh that does not move.
fn topology(w: &mut impl Write, name: &str, mesh: &CharacterMesh, character: &Character) -> io::Result<()> {
    writeln!(w, "    def Mesh \"{name}\"\n    {{")?;
    write!(w, "        int[] faceVertexCounts = ")?;
    list(w, mesh.triangles.iter().map(|_| 3))?;
    write!(w, "\n        int[] faceVertexIndices = ")?;
    list(w, mesh.triangles.iter().flatten())?;
    writeln!(w, "\n        uniform token subdivisionScheme = \"none\"\n        uniform bool doubleSided = 1")?;
    let count = mesh.positions.len();
    let colors: Vec<[f32; 3]> = match (mesh.colors.len() == count, mesh.look.len() == mesh.triangles.len()) {
        (true, _) => mesh.colors.iter().map(|c| [c[0], c[1], c[2]]).collect(),
        (false, true) => {
            let of_look: Vec<[f32; 3]> = character.looks.iter().map(|l| display_color(l, character)).collect();
            mesh.look.iter().map(|l| of_look.get(*l as usize).copied().unwrap_or(GREY)).collect()
        }
        (false, false) => vec![GREY],
    };
    let interpolation = match colors.len() {
        1 => "constant",
        n if n == count && mesh.colors.len() == count => "vertex",
        _ => "uniform",
    };
    write!(w, "        color3f[] primvars:displayColor = ")?;
    list(w, colors.iter().map(tuple))?;
    writeln!(w, " (\n            interpolation = \"{interpolation}\"\n        )")?;
    if mesh.texture_coordinates.len() == count {
        write!(w, "        texCoord2f[] primvars:st = ")?;
        // USD counts from the lower left
        list(w, mesh.texture_coordinates.iter().map(|[u, v]| format!("({}, {})", number(*u), number(1.0 - v))))?;
        writeln!(w, " (\n            interpolation = \"vertex\"\n        )")?;
    }
    Ok(())
}

const GREY: [f32; 3] = [0.5; 3];

/// Base colour of a look, its picture averaged.
fn display_color(look: &Look, character: &Character) -> [f32; 3] {
    let mut color = [look.base_color[0], look.base_color[1], look.base_color[2]];
    if let Some(texture) = look.texture.and_then(|t| character.textures.get(t)).filter(|t| !t.rgba.is_empty()) {
        let linear = |v: u8| {
            let v = f64::from(v) / 255.0;
            if v <= 0.04045 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) }
        };
        for k in 0..3 {
            let sum: f64 = texture.rgba.iter().map(|p| linear(p[k])).sum();
            color[k] *= (sum / texture.rgba.len() as f64) as f32;
        }
    }
    color
}

fn extent(points: &[[f32; 3]]) -> [[f32; 3]; 2] {
    let Some(first) = points.first() else { return [[0.0; 3]; 2] };
    points.iter().fold([*first; 2], |[mut lo, mut hi], p| {
        for k in 0..3 {
            lo[k] = lo[k].min(p[k]);
            hi[k] = hi[k].max(p[k]);
        }
        [lo, hi]
    })
}

fn list<T: Display>(w: &mut impl Write, items: impl Iterator<Item = T>) -> io::Result<()> {
    write!(w, "[")?;
    for (i, item) in items.enumerate() {
        write!(w, "{}{item}", if i == 0 { "" } else { ", " })?;
    }
    write!(w, "]")
}

fn tuple(v: &[f32; 3]) -> String {
    format!("({}, {}, {})", number(v[0]), number(v[1]), number(v[2]))
}

fn number(v: f32) -> f32 {
    if v.is_finite() { v } else { 0.0 }
}

/// Names as USD wants them: letters, digits, underscores, not beginning with a digit, no two alike.
fn identifiers<'a>(names: impl IntoIterator<Item = &'a str>) -> Vec<String> {
    let mut taken = HashSet::new();
    let mut out = Vec::new();
    for name in names {
        let mut id: String = name.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '_' }).collect();
        if id.is_empty() || id.starts_with(|c: char| c.is_ascii_digit()) {
            id.insert(0, '_');
        }
        let mut unique = id.clone();
        let mut n = 2;
        while !taken.insert(unique.clone()) {
            unique = format!("{id}_{n}");
            n += 1;
        }
        out.push(unique);
    }
    out
}
