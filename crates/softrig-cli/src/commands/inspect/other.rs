//! Files that are no characters: volume meshes, motions, journals, caches.

use crate::commands::bake::journal_failure;
use crate::commands::mesh::VolumeInfo;
use crate::failure::Failure;
use crate::load;
use serde::Serialize;
use softrig::mesh::check;
use softrig_io::bvh;
use softrig_io::export::PointCache;
use softrig_io::journal::{JournalReader, Tail};
use std::path::Path;

/// What `--json` prints. Keys are stable.
#[derive(Debug, Serialize)]
#[serde(tag = "kind", rename_all = "lowercase")]
pub enum OtherInfo {
    /// A volume mesh.
    Volume {
        /// Counts.
        #[serde(flatten)]
        info: VolumeInfo,
        /// Sum of the volumes of all cells, in file units cubed.
        volume: f64,
        /// Cells that were inside out and are turned over.
        flipped: usize,
        /// Whether only some were.
        mixed_orientation: bool,
        /// Cells without volume.
        degenerate: usize,
        /// Hexahedra that are partly inside out.
        folded: usize,
        /// Nodes that no cell uses.
        unused_nodes: usize,
    },
    /// A motion.
    Motion {
        /// Joints.
        joints: usize,
        /// Frames.
        frames: usize,
        /// Frames per second.
        fps: f64,
        /// Length [s].
        seconds: f64,
        /// What was assumed.
        notes: Vec<String>,
    },
    /// A journal of a bake.
    Journal {
        /// Frames in it.
        frames: usize,
        /// Frames of the whole bake.
        of: u64,
        /// Frames per second.
        fps: f64,
        /// Whether the bake is complete.
        finished: bool,
        /// Names of the meshes.
        meshes: Vec<String>,
        /// Whether frames hold the nodes of the cells too, as .vtu files need them.
        nodes: bool,
        /// The scene that bakes it again, with the version of the program that began it.
        origin: String,
    },
    /// A point cache.
    Cache {
        /// Points.
        points: usize,
        /// Frames.
        frames: usize,
        /// Frames per second, where the file says so.
        fps: Option<f64>,
    },
}

/// Reads a volume mesh.
///
/// # Errors
/// [`Failure`] when it cannot be read.
pub fn volume(path: &Path) -> Result<OtherInfo, Failure> {
    let mut mesh = load::volume(path)?;
    let report = check(&mut mesh).map_err(|e| Failure::reading(path, &e))?;
    Ok(OtherInfo::Volume {
        info: VolumeInfo::of(&mesh),
        volume: report.volume,
        flipped: report.flipped,
        mixed_orientation: report.mixed_orientation,
        degenerate: report.degenerate.len(),
        folded: report.folded.len(),
        unused_nodes: report.unused_nodes,
    })
}

/// Reads a motion.
///
/// # Errors
/// [`Failure`] when it cannot be read.
pub fn motion(path: &Path) -> Result<OtherInfo, Failure> {
    let motion = bvh::read(path).map_err(|e| load::import_failure(&e))?;
    Ok(OtherInfo::Motion {
        joints: motion.skeleton.joint_count(),
        frames: motion.frame_count,
        fps: 1.0 / motion.frame_time,
        seconds: motion.clip.duration(),
        notes: motion.notes,
    })
}

/// Reads a journal.
///
/// # Errors
/// [`Failure`] when it cannot be read.
pub fn journal(path: &Path) -> Result<OtherInfo, Failure> {
    let journal = JournalReader::open(path).map_err(|e| journal_failure(&e))?;
    let header = journal.header();
    Ok(OtherInfo::Journal {
        frames: journal.frame_count(),
        of: header.frame_count,
        fps: header.fps,
        finished: journal.tail() == Tail::Finished,
        meshes: header.meshes.iter().map(|m| m.name.clone()).collect(),
        nodes: header.volume.is_some(),
        origin: header.origin.clone(),
    })
}

/// Reads the head of a cache.
///
/// # Errors
/// [`Failure`] when it cannot be read.
pub fn cache(path: &Path) -> Result<OtherInfo, Failure> {
    let cache = PointCache::open(path).map_err(|e| Failure::reading(path, &e))?;
    Ok(OtherInfo::Cache { points: cache.point_count(), frames: cache.frame_count(), fps: cache.fps() })
}

impl OtherInfo {
    /// In words.
    #[must_use]
    pub fn text(&self) -> String {
        match self {
            Self::Volume { info, volume, flipped, mixed_orientation, degenerate, folded, unused_nodes } => {
                let mut text = format!("volume mesh: {}, volume {volume:.6}", info.text());
                let turned = if *mixed_orientation { "cells inside out among others" } else { "cells inside out, all" };
                for (count, what) in [
                    (flipped, turned),
                    (degenerate, "cells without volume"),
                    (folded, "hexahedra partly inside out"),
                    (unused_nodes, "nodes without a cell"),
                ] {
                    if *count > 0 {
                        text += &format!("\n  {count} {what}");
                    }
                }
                text
            }
            Self::Motion { joints, frames, fps, seconds, notes } => {
                let mut text = format!("motion: {joints} joints, {frames} frames, {fps:.2} a second, {seconds:.2} s");
                notes.iter().for_each(|n| text += &format!("\n  note: {n}"));
                text
            }
            Self::Journal { frames, of, fps, finished, meshes, nodes, origin } => {
                let state = if *finished { "complete" } else { "stopped; `softrig bake --resume` goes on" };
                let nodes = if *nodes { " and the nodes of the cells" } else { "" };
                format!(
                    "journal of a bake: {frames} of {of} frames at {fps} a second, {} meshes{nodes}, {state}\n\n{}",
                    meshes.len(),
                    origin.trim_end()
                )
            }
            Self::Cache { points, frames, fps } => {
                let fps = fps.map_or(String::new(), |f| format!(", {f} a second"));
                format!("point cache: {points} points, {frames} frames{fps}")
            }
        }
    }
}
