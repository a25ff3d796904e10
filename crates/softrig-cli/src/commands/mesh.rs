//! `softrig mesh`: a volume mesh around a surface or character, or one of another format.

use super::bake::{Policy, check_folder_of, refuse_existing, refuse_input, volume, write_whole_with};
use crate::args::MeshArgs;
use crate::failure::{Failure, Outcome};
use crate::load::{self, FileKind};
use crate::ui;
use serde::Serialize;
use softrig::mesh::{VolumeMesh, components};
use softrig_io::volume as files;
use std::path::Path;

/// What `--json` prints. Keys are stable.
#[derive(Debug, Serialize)]
pub struct VolumeInfo {
    /// Tetrahedra.
    pub tets: usize,
    /// Hexahedra.
    pub hexes: usize,
    /// Nodes.
    pub nodes: usize,
    /// Parts that are not connected.
    pub parts: usize,
    /// Edge of a voxel [m]; only for voxel bodies.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub spacing_m: Option<f64>,
    /// Names of the regions.
    pub regions: Vec<String>,
}

impl VolumeInfo {
    /// Counts a mesh.
    #[must_use]
    pub fn of(mesh: &VolumeMesh) -> Self {
        Self {
            tets: mesh.tets.len(),
            hexes: mesh.hexes.len(),
            nodes: mesh.node_count(),
            parts: components(mesh).count,
            spacing_m: mesh.lattice.as_ref().map(|l| l.spacing),
            regions: mesh.region_names.clone(),
        }
    }

    /// In words.
    #[must_use]
    pub fn text(&self) -> String {
        let spacing = self.spacing_m.map_or(String::new(), |s| format!(", edge {:.4} m", s));
        let parts = if self.parts == 1 { "one part".into() } else { format!("{} parts", self.parts) };
        format!("{} tetrahedra, {} hexahedra, {} nodes, {parts}{spacing}", self.tets, self.hexes, self.nodes)
    }
}

/// Makes and writes the mesh.
///
/// # Errors
/// [`Failure`] with the exit code.
pub fn run(args: &MeshArgs) -> Outcome {
    let format = format(&args.output)?;
    refuse_existing(&args.output, if args.force { Policy::Replace } else { Policy::Refuse })?;
    refuse_input(&args.output, [args.file.as_path()])?;
    check_folder_of(&args.output)?;
    let mesh = match load::kind(&args.file) {
        FileKind::Volume => load::volume(&args.file)?,
        _ => {
            let mut scene = load::scene(&args.file)?;
            scene.override_import(&args.import);
            scene.override_body(&args.body);
            let character = load::scene_character(&scene)?;
            character.notes.iter().for_each(ui::warn);
            volume(&scene, &character).map_err(|e| Failure::reading(&scene.character, &e))?
        }
    };
    write(&mesh, format, &args.output)?;
    let info = VolumeInfo::of(&mesh);
    if args.json {
        ui::result(serde_json::to_string_pretty(&info).expect("counts are plain data"));
    } else {
        ui::result(format_args!("{}: {}", args.output.display(), info.text()));
    }
    Ok(())
}

/// Formats of volume meshes that are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum VolumeFormat {
    /// VTK XML.
    Vtu,
    /// Gmsh 4.1.
    Msh,
}

/// The format an ending stands for.
///
/// # Errors
/// [`Failure::Usage`] names the endings there are.
pub fn format(path: &Path) -> Result<VolumeFormat, Failure> {
    match path.extension().map(|e| e.to_string_lossy().to_lowercase()).as_deref() {
        Some("vtu") => Ok(VolumeFormat::Vtu),
        Some("msh") => Ok(VolumeFormat::Msh),
        _ => Err(Failure::Usage(format!("{}: volume meshes are written as .vtu or .msh", path.display()))),
    }
}

/// Writes a volume mesh.
///
/// # Errors
/// [`Failure::Machine`] when the system refuses.
pub fn write(mesh: &VolumeMesh, format: VolumeFormat, path: &Path) -> Result<(), Failure> {
    write_whole_with(path, |out| match format {
        VolumeFormat::Vtu => files::write_vtu(out, mesh, &files::VtuData::default()),
        VolumeFormat::Msh => files::write_msh41(out, mesh),
    })
}
