//! Writing point caches: PC2 and MDD, one file for each mesh.
//!
//! ```text
//! PC2 (little-endian)  "POINTCACHE2\0"  version i32 = 1  points i32  start f32  rate f32  frames i32  then x y z f32, frame by frame
//! MDD (big-endian)     frames i32  points i32  time f32 [s] of each frame  then x y z f32, frame by frame
//! ```
//! PC2 counts in frames: start 0 and one frame per sample, so that sample i plays at frame i of a scene with the bake's frame
//! rate.

use super::output::{Folder, file_stems, write_file};
use super::space::{LocalSpaces, map_points};
use super::{ExportError, ExportOptions, ExportReport, Format};
use crate::journal::{JournalFrame, JournalReader};
use softrig::character::Character;
use std::fs::File;
use std::io::{BufWriter, Read, Seek, Write};
use std::path::Path;

/// Meshes written in one pass over the journal: far below the number of files a process may have open.
const FILES_AT_ONCE: usize = 64;

pub(super) fn write<S: Read + Seek>(
    journal: &mut JournalReader<S>,
    character: &Character,
    format: Format,
    out: &Path,
    options: &ExportOptions,
) -> Result<ExportReport, ExportError> {
    let mut spaces = LocalSpaces::new(character);
    let mut report = ExportReport { frames: journal.frame_count(), ..ExportReport::default() };
    match character.meshes.len() {
        0 => {
            let instead = String::from("name a character that has a mesh");
            return Err(ExportError::Unsupported { what: "a cache without a mesh".into(), instead });
        }
        1 => {
            write_file(out, options.existing, |w| write_meshes(journal, &mut spaces, format, 0, &mut [w], out))?;
            report.files.push(out.to_owned());
        }
        count => {
            let ending = if format == Format::Pc2 { "pc2" } else { "mdd" };
            let names: Vec<String> = file_stems(character.meshes.iter().map(|m| m.name.as_str()))
                .iter()
                .map(|s| format!("{s}.{ending}"))
                .collect();
            let folder = Folder::new(out, options.existing, &["pc2", "mdd"])?;
            for first in (0..count).step_by(FILES_AT_ONCE) {
                let group = &names[first..count.min(first + FILES_AT_ONCE)];
                let open = |name: &String| {
                    let io = |source| ExportError::Io { file: folder.final_path(name), source };
                    Ok(BufWriter::with_capacity(1 << 16, File::create(folder.path(name)).map_err(io)?))
                };
                let mut writers = group.iter().map(open).collect::<Result<Vec<_>, ExportError>>()?;
                let mut borrowed: Vec<&mut BufWriter<File>> = writers.iter_mut().collect();
                write_meshes(journal, &mut spaces, format, first, &mut borrowed, out)?;
                for (mut writer, name) in writers.into_iter().zip(group) {
                    let io = |source| ExportError::Io { file: folder.final_path(name), source };
                    writer.flush().and_then(|()| writer.get_ref().sync_data()).map_err(io)?;
                }
            }
            report.files = names.iter().map(|n| folder.final_path(n)).collect();
            folder.finish(options.existing)?;
        }
    }
    if spaces.singular > 0 {
        report.notes.push(format!(
            "{} times a mesh object was scaled to nothing by its node; its cache repeats the local space it had before",
            spaces.singular
        ));
    }
    Ok(report)
}

/// Writes meshes `first..first + writers.len()`, reading the journal once.
fn write_meshes<S: Read + Seek, W: Write>(
    journal: &mut JournalReader<S>,
    spaces: &mut LocalSpaces<'_>,
    format: Format,
    first: usize,
    writers: &mut [&mut W],
    out: &Path,
) -> Result<(), ExportError> {
    let io = |source| ExportError::Io { file: out.to_owned(), source };
    let frames = journal.frame_count();
    let mut frame = JournalFrame::default();
    for (i, writer) in writers.iter_mut().enumerate() {
        let points = journal.header().meshes[first + i].vertex_count;
        let (points, count) = (to_i32(u64::from(points), "vertices")?, to_i32(frames as u64, "frames")?);
        match format {
            Format::Pc2 => {
                writer.write_all(b"POINTCACHE2\0").map_err(io)?;
                for field in [
                    1i32.to_le_bytes(),
                    points.to_le_bytes(),
                    0f32.to_le_bytes(),
                    1f32.to_le_bytes(),
                    count.to_le_bytes(),
                ] {
                    writer.write_all(&field).map_err(io)?;
                }
            }
            _ => {
                writer.write_all(&count.to_be_bytes()).map_err(io)?;
                writer.write_all(&points.to_be_bytes()).map_err(io)?;
                let fps = journal.header().fps;
                for k in 0..frames {
                    writer.write_all(&((k as f64 / fps) as f32).to_be_bytes()).map_err(io)?;
                }
            }
        }
    }
    let (mut local, mut bytes) = (Vec::new(), Vec::new());
    for k in 0..frames {
        journal.read_frame(k, &mut frame)?;
        for (i, writer) in writers.iter_mut().enumerate() {
            let map = spaces.of(first + i, &frame.pose);
            map_points(&map, &frame.skin[first + i], &mut local);
            bytes.clear();
            let little = format == Format::Pc2;
            let encode = |v: &f32| if little { v.to_le_bytes() } else { v.to_be_bytes() };
            local.iter().flatten().for_each(|v| bytes.extend_from_slice(&encode(v)));
            writer.write_all(&bytes).map_err(io)?;
        }
    }
    Ok(())
}

fn to_i32(n: u64, what: &str) -> Result<i32, ExportError> {
    i32::try_from(n).map_err(|_| ExportError::TooLarge {
        what: format!("{n} {what}"),
        format: "a point cache",
        limit: i32::MAX as u64,
        instead: "split the mesh or the bake",
    })
}
