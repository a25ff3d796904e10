//! One door for all characters and surfaces.

use crate::error::{ImportError, Place};
use crate::gltf;
use crate::source::read_file;
use crate::surface::{self, SurfaceFormat};
use crate::units::UpAxis;
use softrig::character::Character;
use std::path::Path;

/// What the user knows better than the file.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ImportOptions {
    /// Height of the character [m]. Default: from the unit.
    pub height: Option<f64>,
    /// Metres per file unit; goes before `height`. Default: guessed, see [`crate::units`].
    pub unit: Option<f64>,
    /// Axis of the file that points up. Default: what the format says, or what its tools use.
    pub up: Option<UpAxis>,
}

/// The formats behind [`import`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Format {
    Gltf,
    Surface(SurfaceFormat),
}

/// Reads a character (`.glb`, `.gltf`) or a bare surface (`.obj`, `.ply`, `.stl`), in metres and Y up. The first bytes decide
/// where they can, the ending where they cannot.
///
/// # Errors
/// [`ImportError`] with the file, the place, and what to change.
pub fn import(path: &Path, options: &ImportOptions) -> Result<Character, ImportError> {
    let bytes = read_file(path)?;
    if bytes.is_empty() {
        return Err(ImportError::malformed(path, Place::Whole, "it is empty", "export it again"));
    }
    match format_of(path, &bytes)? {
        Format::Surface(format) => surface::read_bytes(&bytes, path, format, options),
        Format::Gltf => gltf::read_beside(&bytes, path, options),
    }
}

/// Format by content, then by ending.
fn format_of(path: &Path, bytes: &[u8]) -> Result<Format, ImportError> {
    let ending = path.extension().and_then(|e| e.to_str()).unwrap_or_default().to_ascii_lowercase();
    if bytes.starts_with(b"glTF") {
        return Ok(Format::Gltf);
    }
    if bytes.starts_with(b"ply\n") || bytes.starts_with(b"ply\r") {
        return Ok(Format::Surface(SurfaceFormat::Ply));
    }
    match ending.as_str() {
        "glb" | "gltf" | "vrm" => Ok(Format::Gltf),
        "obj" => Ok(Format::Surface(SurfaceFormat::Obj)),
        "ply" => Ok(Format::Surface(SurfaceFormat::Ply)),
        "stl" => Ok(Format::Surface(SurfaceFormat::Stl)),
        _ => Err(ImportError::UnknownFormat { file: path.into(), remedy: remedy_for(&ending) }),
    }
}

/// What to do with a file of a foreign ending.
fn remedy_for(ending: &str) -> String {
    match ending {
        "fbx" | "blend" | "dae" | "usd" | "usda" | "usdc" | "usdz" | "abc" | "max" | "ma" | "mb" => {
            format!(
                "open the .{ending} file in Blender (or the program it is from) and export it as glTF binary (.glb)"
            )
        }
        "bvh" => "a .bvh file is a motion without a body: give it with --clip".into(),
        _ => "give a .glb, .gltf, .obj, .ply or .stl file".into(),
    }
}
