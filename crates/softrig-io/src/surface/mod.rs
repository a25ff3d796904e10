//! Bare surfaces: OBJ, PLY, STL.
//!
//! All three have own readers. The libraries of the field either lose the file's vertex order (tobj splits vertices by object and
//! knows no line continuations), or loop over whatever count a header claims; here every count is held against the bytes
//! that are there before anything is allocated.

mod mtl;
mod obj;
mod ply;
mod stl;

use crate::error::{ImportError, Place};
use crate::import::ImportOptions;
use crate::source::read_file;
use crate::units::{Units, UpAxis, box_size};
use softrig::character::{Character, CharacterMesh, Look, Skin};
use softrig::rig::Skeleton;
use std::path::Path;

/// The surface formats.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum SurfaceFormat {
    /// Wavefront OBJ.
    Obj,
    /// Polygon file format, ASCII or binary.
    Ply,
    /// Stereolithography, ASCII or binary.
    Stl,
}

/// A surface in the units and axes of its file.
#[derive(Default)]
struct Parsed {
    positions: Vec<[f64; 3]>,
    triangles: Vec<[u32; 3]>,
    /// Empty, or one per triangle.
    look: Vec<u32>,
    looks: Vec<Look>,
    /// Empty, or one per vertex; (0, 0) at the upper left.
    texture_coordinates: Vec<[f32; 2]>,
    /// Empty, or one per vertex; linear.
    colors: Vec<[f32; 4]>,
    groups: Vec<(String, Vec<f32>)>,
    /// Files of materials the surface names.
    material_files: Vec<String>,
    notes: Vec<String>,
}

/// Reads a surface as a character without a skeleton.
///
/// Vertices keep the order of the file. STL has no vertices of its own: corners at exactly the same position become one
/// vertex, numbered by first appearance.
///
/// # Errors
/// [`ImportError`].
pub fn read(path: &Path, format: SurfaceFormat, options: &ImportOptions) -> Result<Character, ImportError> {
    read_bytes(&read_file(path)?, path, format, options)
}

/// As [`read`], for a file whose bytes are at hand.
pub(crate) fn read_bytes(
    bytes: &[u8],
    path: &Path,
    format: SurfaceFormat,
    options: &ImportOptions,
) -> Result<Character, ImportError> {
    let mut parsed = parse(bytes, path, format)?;
    mtl::color_looks(&mut parsed, path);
    finish(parsed, path, format, options)
}

/// As [`read`], from bytes; `file` is named in errors only, and no material file is looked for.
///
/// # Errors
/// [`ImportError`].
pub fn from_bytes(
    bytes: &[u8],
    file: &Path,
    format: SurfaceFormat,
    options: &ImportOptions,
) -> Result<Character, ImportError> {
    finish(parse(bytes, file, format)?, file, format, options)
}

fn parse(bytes: &[u8], file: &Path, format: SurfaceFormat) -> Result<Parsed, ImportError> {
    match format {
        SurfaceFormat::Obj => obj::parse(bytes, file),
        SurfaceFormat::Ply => ply::parse(bytes, file),
        SurfaceFormat::Stl => stl::parse(bytes, file),
    }
}

/// Checks, units and axes.
fn finish(
    mut parsed: Parsed,
    file: &Path,
    format: SurfaceFormat,
    options: &ImportOptions,
) -> Result<Character, ImportError> {
    drop_repeated_corners(&mut parsed);
    if parsed.triangles.is_empty() {
        let reason = format!("it has {} points but no triangle", parsed.positions.len());
        return Err(ImportError::malformed(
            file,
            Place::Whole,
            reason,
            "export it again with faces, not as points or curves",
        ));
    }
    let used = parsed.triangles.iter().flatten().map(|v| parsed.positions[*v as usize]);
    let usual_up = if format == SurfaceFormat::Stl { UpAxis::Z } else { UpAxis::Y };
    let units = Units::choose(box_size(used), usual_up, options);
    let to_world = units.to_world();
    let name = file.file_stem().map_or_else(|| "surface".into(), |s| s.to_string_lossy().into_owned());
    let skeleton = Skeleton::new(Vec::new(), to_world).expect("no joints, no cycle");
    let mesh = CharacterMesh {
        name: name.clone(),
        positions: parsed.positions.iter().map(|p| to_world.point(*p)).collect(),
        triangles: parsed.triangles,
        look: parsed.look,
        texture_coordinates: parsed.texture_coordinates,
        colors: parsed.colors,
        skin: Skin::Free,
        object: None,
        groups: parsed.groups,
    };
    let mut notes = units.notes;
    notes.append(&mut parsed.notes);
    Ok(Character {
        name,
        meshes: vec![mesh],
        skeleton,
        clips: Vec::new(),
        looks: parsed.looks,
        textures: Vec::new(),
        notes,
    })
}

/// Triangles that use a vertex twice bound nothing and have no direction.
fn drop_repeated_corners(parsed: &mut Parsed) {
    let before = parsed.triangles.len();
    let keep = |t: &[u32; 3]| t[0] != t[1] && t[1] != t[2] && t[2] != t[0];
    if !parsed.look.is_empty() {
        let kept = parsed.triangles.iter().zip(&parsed.look).filter(|(t, _)| keep(t)).map(|(_, l)| *l);
        parsed.look = kept.collect();
    }
    parsed.triangles.retain(keep);
    let dropped = before - parsed.triangles.len();
    if dropped > 0 {
        parsed.notes.push(format!("dropped {dropped} triangles that use a vertex twice"));
    }
}

/// Cuts a polygon into triangles: a fan from its first corner, or from its second one for a quad with a dent at the other two.
fn triangulate(corners: &[u32], positions: &[[f64; 3]], triangles: &mut Vec<[u32; 3]>) {
    if let [a, b, c, d] = *corners
        && is_folded([a, b, c, d].map(|v| positions[v as usize]))
    {
        triangles.extend([[b, c, d], [b, d, a]]);
        return;
    }
    triangles.extend((2..corners.len()).map(|k| [corners[0], corners[k - 1], corners[k]]));
}

/// Whether the two triangles along the diagonal 0-2 face away from each other.
fn is_folded(p: [[f64; 3]; 4]) -> bool {
    let minus = |a: [f64; 3], b: [f64; 3]| [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
    let cross =
        |a: [f64; 3], b: [f64; 3]| [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
    let (n, m) = (cross(minus(p[1], p[0]), minus(p[2], p[0])), cross(minus(p[2], p[0]), minus(p[3], p[0])));
    n[0] * m[0] + n[1] * m[1] + n[2] * m[2] < 0.0
}

/// Colours of files are meant for screens.
fn srgb_to_linear(v: f32) -> f32 {
    let v = v.clamp(0.0, 1.0);
    if v <= 0.04045 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// An arrow head: the diagonal 0-2 lies outside of it, the diagonal 1-3 inside.
    #[test]
    fn a_dented_quad_is_cut_along_its_inner_diagonal() {
        let p = [[0.0, 0.0, 0.0], [2.0, 1.0, 0.0], [0.0, 2.0, 0.0], [0.5, 1.0, 0.0]];
        let mut t = Vec::new();
        triangulate(&[0, 1, 2, 3], &p, &mut t);
        assert_eq!(t, [[1, 2, 3], [1, 3, 0]]);
        t.clear();
        triangulate(&[1, 2, 3, 0], &p, &mut t);
        assert_eq!(t, [[1, 2, 3], [1, 3, 0]]);
    }
}
