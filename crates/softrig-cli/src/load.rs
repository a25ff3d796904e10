//! Files named on the command line: what kind they are, and reading them.

use crate::failure::Failure;
use crate::scene::{self, Import, Scene};
use softrig::character::Character;
use softrig::mesh::VolumeMesh;
use softrig_io::{ImportError, ImportOptions, UpAxis};
use std::path::{Path, PathBuf};

/// What a file is, by its ending.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FileKind {
    /// Scene file.
    Scene,
    /// Motion capture.
    Motion,
    /// Volume mesh.
    Volume,
    /// PC2 or MDD point cache.
    PointCache,
    /// Journal of a bake.
    Journal,
    /// Character or surface; also whatever is unknown, so that the importer says what it takes.
    Character,
}

/// Kind of a file.
#[must_use]
pub fn kind(path: &Path) -> FileKind {
    let ending = path.extension().and_then(|e| e.to_str()).unwrap_or("").to_ascii_lowercase();
    match ending.as_str() {
        "toml" => FileKind::Scene,
        "bvh" => FileKind::Motion,
        "msh" | "mesh" | "node" | "ele" | "veg" | "vtk" | "vtu" => FileKind::Volume,
        "pc2" | "mdd" => FileKind::PointCache,
        "softrig-journal" => FileKind::Journal,
        _ => FileKind::Character,
    }
}

/// The folder of files that measurements and papers use and that are not part of softrig: as given, or named by the environment.
#[must_use]
pub fn shared_folder(given: Option<&Path>) -> PathBuf {
    let named = || std::env::var_os("SOFTRIG_SHARED").map(PathBuf::from);
    given.map(Path::to_owned).or_else(named).unwrap_or_else(|| "../shared".into())
}

/// The scene a file stands for: itself, or the defaults for a bare character.
///
/// # Errors
/// [`Failure`] when a scene file cannot be used.
pub fn scene(path: &Path) -> Result<Scene, Failure> {
    match kind(path) {
        FileKind::Scene => scene::read(path).map_err(|e| Failure::reading(path, &e)),
        _ => Ok(Scene { character: path.to_owned(), ..Scene::default() }),
    }
}

/// Reads a character or surface.
///
/// # Errors
/// [`Failure`] when it cannot be read.
pub fn character(path: &Path, import: &Import) -> Result<Character, Failure> {
    let options = ImportOptions {
        height: import.height,
        unit: import.unit,
        up: import.up.map(|up| match up {
            crate::args::UpAxis::Y => UpAxis::Y,
            crate::args::UpAxis::Z => UpAxis::Z,
        }),
    };
    if path == Path::new(SAMPLE) && !path.exists() {
        return Ok(softrig::sample::character());
    }
    softrig_io::import(path, &options).map_err(|e| import_failure(&e))
}

/// Name that stands for the built-in character wherever a character is expected and no file of that name is there.
pub const SAMPLE: &str = "sample";

/// An import that failed, with its exit code.
#[must_use]
pub fn import_failure(error: &ImportError) -> Failure {
    if error.is_machine_fault() { Failure::Machine(error.to_string()) } else { Failure::Input(error.to_string()) }
}

/// Reads a volume mesh.
///
/// # Errors
/// [`Failure`] when it cannot be read.
pub fn volume(path: &Path) -> Result<VolumeMesh, Failure> {
    softrig_io::volume::read(path).map_err(|e| import_failure(&e))
}

/// Reads a scene's character, with the meshes that the scene makes rigid.
///
/// # Errors
/// [`Failure`] when it cannot be read, or the scene names a mesh or joint that it does not have.
pub fn scene_character(scene: &Scene) -> Result<Character, Failure> {
    if scene.has_objects() {
        return Ok(crate::commands::bake::objects_character(scene));
    }
    let mut character = character(&scene.character, &scene.import)?;
    scene.make_rigid(&mut character).map_err(|e| Failure::Input(format!("{}: {e}", scene.character.display())))?;
    Ok(character)
}
