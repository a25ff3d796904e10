//! The volume mesh over time for ParaView: one VTU file for each frame with displacement, stress and strain, and a PVD file
//! that lists them with their times.
//!
//! `walk.vtu` makes `walk.pvd` and the folder `walk_vtu`.

use super::colors::principal;
use super::output::{Folder, frame_name, write_file};
use super::{ExportError, ExportOptions, ExportReport};
use crate::journal::{Existing, JournalFrame, JournalReader, JournalVolume};
use crate::volume::{DataArray, VtuData, write_vtu};
use softrig::force::cell_stress;
use std::fs::File;
use std::io::{self, BufWriter, Read, Seek, Write};
use std::path::Path;

pub(super) fn write<S: Read + Seek>(
    journal: &mut JournalReader<S>,
    out: &Path,
    options: &ExportOptions,
) -> Result<ExportReport, ExportError> {
    let Some(volume) = journal.header().volume.clone() else {
        let instead = String::from("bake with a .vtu output, so that the journal keeps the volume mesh");
        return Err(ExportError::Unsupported { what: "a journal without nodes as VTU files".into(), instead });
    };
    let stem = out.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let folder_name = format!("{stem}_vtu");
    let list = out.with_extension("pvd");
    if options.existing == Existing::Refuse && list.symlink_metadata().is_ok() {
        return Err(ExportError::Exists { file: list });
    }
    let folder = Folder::new(&out.with_file_name(&folder_name), options.existing, &["vtu"])?;
    let (frames, fps) = (journal.frame_count(), journal.header().fps);
    let mut report = ExportReport { frames, files: vec![list.clone()], ..ExportReport::default() };
    let mut frame = JournalFrame::default();
    for t in 0..frames {
        journal.read_frame(t, &mut frame)?;
        let name = frame_name(t, frames, "vtu");
        let write = || {
            let mut w = BufWriter::with_capacity(1 << 16, File::create(folder.path(&name))?);
            vtu(&mut w, &volume, &frame.nodes)?;
            w.flush()
        };
        write().map_err(|source| ExportError::Io { file: folder.final_path(&name), source })?;
        report.files.push(folder.final_path(&name));
    }
    folder.finish(options.existing)?;
    write_file(&list, options.existing, |w| {
        pvd(w, &folder_name, frames, fps).map_err(|source| ExportError::Io { file: list.clone(), source })
    })?;
    Ok(report)
}

fn pvd(w: &mut impl Write, folder: &str, frames: usize, fps: f64) -> io::Result<()> {
    let folder = folder.replace('&', "&amp;").replace('<', "&lt;").replace('"', "&quot;");
    writeln!(w, "<?xml version=\"1.0\"?>\n<VTKFile type=\"Collection\" version=\"0.1\">\n<Collection>")?;
    for t in 0..frames {
        let name = frame_name(t, frames, "vtu");
        writeln!(w, "<DataSet timestep=\"{}\" part=\"0\" file=\"{folder}/{name}\"/>", t as f64 / fps)?;
    }
    writeln!(w, "</Collection>\n</VTKFile>")
}

fn vtu(w: &mut dyn Write, volume: &JournalVolume, nodes: &[[f32; 3]]) -> io::Result<()> {
    let mesh = &volume.mesh;
    let positions: Vec<[f64; 3]> = nodes.iter().map(|p| p.map(f64::from)).collect();
    let cells = cell_stress(mesh, &volume.materials, &positions);
    let moved: Vec<f64> =
        positions.as_flattened().iter().zip(mesh.nodes.as_flattened()).map(|(x, rest)| x - rest).collect();
    // whole matrices: viewers do not agree on the order of six components
    let matrix = |[xx, yy, zz, xy, yz, zx]: [f64; 6]| [xx, xy, zx, xy, yy, yz, zx, yz, zz];
    let stress: Vec<f64> = cells.iter().flat_map(|c| matrix(c.stress)).collect();
    let strain: Vec<f64> = cells.iter().flat_map(|c| matrix(c.strain)).collect();
    let principal_strains: Vec<f64> = cells.iter().flat_map(|c| principal(c.strain)).collect();
    let von_mises: Vec<f64> = cells.iter().map(|c| c.von_mises).collect();
    let volume_ratio: Vec<f64> = cells.iter().map(|c| c.volume_ratio).collect();
    let data = VtuData {
        positions: Some(&positions),
        point_data: &[DataArray { name: "displacement [m]", components: 3, values: &moved }],
        cell_data: &[
            DataArray { name: "von Mises stress [Pa]", components: 1, values: &von_mises },
            DataArray { name: "stress [Pa]", components: 9, values: &stress },
            DataArray { name: "strain", components: 9, values: &strain },
            DataArray { name: "principal strains", components: 3, values: &principal_strains },
            DataArray { name: "volume ratio", components: 1, values: &volume_ratio },
        ],
    };
    write_vtu(w, mesh, &data)
}
