//! Volume meshes of tetrahedra and hexahedra: TetGen, Gmsh, Medit, VEGA, VTK.
//!
//! Meshes keep the unit and axes of their file and the order of its nodes and cells (tetrahedra first). Points, lines
//! and surface elements are stepped over; cells softrig does not compute with (prisms, pyramids, cells with nodes on their edges) are refused,
//! because leaving them out would leave holes. Regions, physical groups and materials become [`VolumeMesh::region`].

mod builder;
mod gmsh;
mod medit;
mod tetgen;
mod vega;
mod vtk;
mod vtu;
mod write;

pub use write::{DataArray, VtuData, write_msh41, write_vtu};

use crate::error::{ImportError, Place};
use crate::source::read_file;
use crate::text::{REMEDY, shown};
use softrig::mesh::{MeshError, MeshReport, VolumeMesh, check};
use std::path::{Component, Path};

/// The volume formats.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum VolumeFormat {
    /// A TetGen `.node` file, with its `.ele` file beside it.
    TetgenNodes,
    /// A TetGen `.ele` file, with its `.node` file beside it.
    TetgenCells,
    /// Gmsh 1, 2.x or 4.1, ASCII or binary.
    Gmsh,
    /// Medit `.mesh`.
    Medit,
    /// VEGA `.veg`.
    Vega,
    /// Legacy VTK, ASCII or binary.
    Vtk,
    /// VTK XML unstructured grid.
    Vtu,
}

impl VolumeFormat {
    /// By the ending of a file name; `None` for all others.
    #[must_use]
    pub fn of(path: &Path) -> Option<Self> {
        Some(match path.extension()?.to_str()?.to_ascii_lowercase().as_str() {
            "node" => Self::TetgenNodes,
            "ele" => Self::TetgenCells,
            "msh" => Self::Gmsh,
            "mesh" => Self::Medit,
            "veg" => Self::Vega,
            "vtk" => Self::Vtk,
            "vtu" => Self::Vtu,
            _ => return None,
        })
    }
}

/// Gives the bytes of a file beside the one being read, by its relative name.
pub type Loader<'a> = dyn FnMut(&str) -> Result<Vec<u8>, ImportError> + 'a;

/// Reads a volume mesh; the ending picks the format.
///
/// # Errors
/// [`ImportError`].
pub fn read(path: &Path) -> Result<VolumeMesh, ImportError> {
    let Some(format) = VolumeFormat::of(path) else {
        let remedy = "give a .node, .ele, .msh, .mesh, .veg, .vtk or .vtu file".into();
        return Err(ImportError::UnknownFormat { file: path.into(), remedy });
    };
    let bytes = read_file(path)?;
    from_bytes(&bytes, path, format, &mut |name| beside(path, name))
}

/// As [`read`], with inverted cells turned over; the report says which could not be repaired.
///
/// # Errors
/// [`ImportError`].
pub fn read_checked(path: &Path) -> Result<(VolumeMesh, MeshReport), ImportError> {
    let mut mesh = read(path)?;
    let wrong = |e: MeshError| ImportError::malformed(path, Place::Whole, e.to_string(), REMEDY);
    let report = check(&mut mesh).map_err(wrong)?;
    Ok((mesh, report))
}

/// As [`read`], from bytes; `file` is only a name, `loader` gives the files that this one names.
///
/// # Errors
/// [`ImportError`].
pub fn from_bytes(
    bytes: &[u8],
    file: &Path,
    format: VolumeFormat,
    loader: &mut Loader<'_>,
) -> Result<VolumeMesh, ImportError> {
    let loader: &mut Loader<'_> = &mut |name| loader(name).map_err(|e| not_beside(file, name, e));
    match format {
        VolumeFormat::TetgenNodes => {
            let cells = loader(&other_half(file, "ele"))?;
            tetgen::parse(bytes, file, &cells, &file.with_extension("ele"))
        }
        VolumeFormat::TetgenCells => {
            let nodes = loader(&other_half(file, "node"))?;
            tetgen::parse(&nodes, &file.with_extension("node"), bytes, file)
        }
        VolumeFormat::Gmsh => gmsh::parse(bytes, file),
        VolumeFormat::Medit => medit::parse(bytes, file),
        VolumeFormat::Vega => vega::parse(bytes, file, loader),
        VolumeFormat::Vtk => vtk::parse(bytes, file),
        VolumeFormat::Vtu => vtu::parse(bytes, file),
    }
}

/// Name of the file of the same stem with another ending.
fn other_half(file: &Path, ending: &str) -> String {
    file.with_extension(ending).file_name().map_or_else(String::new, |n| n.to_string_lossy().into_owned())
}

/// A file that is not there is a fault of the one that names it.
fn not_beside(file: &Path, name: &str, error: ImportError) -> ImportError {
    match error {
        ImportError::Io { source, .. } if !error.is_machine_fault() => ImportError::malformed(
            file,
            Place::Whole,
            format!("it needs the file `{}`, which cannot be read: {source}", shown(name.as_bytes())),
            "put both files into one folder",
        ),
        other => other,
    }
}

/// A file below the folder of another one.
fn beside(file: &Path, name: &str) -> Result<Vec<u8>, ImportError> {
    let relative = Path::new(name);
    if name.is_empty() || !relative.components().all(|c| matches!(c, Component::Normal(_) | Component::CurDir)) {
        return Err(ImportError::unsupported(
            file,
            Place::Whole,
            format!("it includes `{}`, which is not below its own folder", shown(name.as_bytes())),
            "put both files into one folder",
        ));
    }
    read_file(&file.parent().unwrap_or(Path::new("")).join(relative))
}
