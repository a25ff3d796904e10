//! glTF 2.0 (.glb, .gltf with its files, .vrm) to a [`Character`].
//!
//! | file | does |
//! |---|---|
//! | `container` | bytes to JSON and buffers |
//! | `document` | the JSON as structures, untrusted |
//! | `accessor` | numbers out of buffers, checked |
//! | `nodes` | the hierarchy; every node becomes the joint of its number |
//! | `mesh` | vertices, triangles, attributes, in the order of Blender's importer |
//! | `skin` | rest frames from inverse bind matrices |
//! | `animation` | clips |
//! | `material` | looks and pictures |
//! | `assemble` | all of it into a character, in metres |

mod accessor;
mod animation;
mod assemble;
mod container;
mod document;
mod fault;
mod material;
mod mesh;
mod nodes;
mod skin;

pub use container::Loader;

use crate::error::ImportError;
use crate::import::ImportOptions;
use crate::source::read_file;
use softrig::character::Character;
use std::path::Path;

/// Reads a .glb, .gltf or .vrm file; a .gltf may name files that lie below its own folder.
///
/// # Errors
/// [`ImportError`] with the file, the place in its JSON, and what to change.
pub fn read(path: &Path, options: &ImportOptions) -> Result<Character, ImportError> {
    read_beside(&read_file(path)?, path, options)
}

/// As [`read`], for bytes already read from `path`.
///
/// # Errors
/// As [`read`].
pub fn read_beside(bytes: &[u8], path: &Path, options: &ImportOptions) -> Result<Character, ImportError> {
    let folder = path.parent().unwrap_or(Path::new(""));
    let mut load = |name: &str| {
        read_file(&folder.join(name)).map_err(|e| match e {
            ImportError::Io { source, .. } => source.to_string(),
            other => other.to_string(),
        })
    };
    read_bytes(bytes, path, &mut load, options)
}

/// Reads a glTF file from memory; `loader` gives the files it names. `path` only names it, in errors and as the character's name.
///
/// # Errors
/// As [`read`].
pub fn read_bytes(
    bytes: &[u8],
    path: &Path,
    loader: &mut Loader<'_>,
    options: &ImportOptions,
) -> Result<Character, ImportError> {
    let name = path.file_stem().map(|s| s.to_string_lossy().into_owned()).unwrap_or_default();
    assemble::character(bytes, name, loader, options).map_err(|fault| fault.of_file(path))
}
