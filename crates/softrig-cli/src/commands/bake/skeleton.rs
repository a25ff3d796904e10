//! What two-way coupling makes of the skeleton: its motion as a clip, and what its joints pass on.

use super::output::{quoted, write_whole};
use super::session::{Job, journal_failure};
use crate::failure::Failure;
use crate::scene::{Scene, is_bvh};
use softrig_io::bvh;
use softrig_io::export::{clip_of_poses, gltf_with_clip};
use softrig_io::journal::{JournalFrame, JournalReader};
use std::fmt::Write;
use std::path::Path;

/// Looks whether a moved skeleton can be written there, before any long work.
///
/// # Errors
/// [`Failure::Usage`] names what can.
pub fn check(path: &Path, scene: &Scene) -> Result<(), Failure> {
    let ending = |p: &Path| p.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default();
    match (ending(path).as_str(), ending(&scene.character).as_str()) {
        ("bvh", _) | ("glb", "glb") | ("gltf", "gltf") => Ok(()),
        (wanted @ ("glb" | "gltf"), from) => Err(Failure::Usage(format!(
            "--skeleton .{wanted} is a copy of the character with one more clip, and the character is a {}; write .{}",
            if from.is_empty() { "built-in one".into() } else { format!(".{from}") },
            if matches!(from, "glb" | "gltf") { from } else { "bvh" }
        ))),
        (other, _) => Err(Failure::Usage(format!("--skeleton cannot write .{other}; use .glb, .gltf or .bvh"))),
    }
}

/// Writes the poses of all frames as a clip.
///
/// # Errors
/// [`Failure`] when the journal cannot be read or the file not be written.
pub fn write_skeleton(job: &Job<'_>, journal: &mut JournalReader, path: &Path) -> Result<(), Failure> {
    let skeleton = &job.prepared.character.skeleton;
    let fps = job.scene.motion.fps;
    let mut frame = JournalFrame::default();
    let mut poses = Vec::with_capacity(journal.frame_count());
    for index in 0..journal.frame_count() {
        journal.read_frame(index, &mut frame).map_err(|e| journal_failure(&e))?;
        poses.push(frame.pose.clone());
    }
    let clip = clip_of_poses(skeleton, &poses, fps, &format!("{} (softrig)", job.clip.name));
    if is_bvh(path) {
        return write_whole(path, bvh::to_text(skeleton, &clip, 1.0 / fps).as_bytes());
    }
    let file = &job.scene.character;
    let source = std::fs::read(file).map_err(|e| Failure::reading(file, &e))?;
    let copy = gltf_with_clip(&source, skeleton, &clip).map_err(|e| Failure::Input(e.to_string()))?;
    write_whole(path, &copy)
}

/// Forces and torques that joints pass on, as the text of a CSV file.
#[derive(Debug)]
pub struct Reactions {
    text: String,
    clips: bool,
}

impl Reactions {
    /// With a first column for the clip when there are several.
    #[must_use]
    pub fn new(clips: bool) -> Self {
        let clip = if clips { "clip," } else { "" };
        let text =
            format!("{clip}frame,time_s,joint,force_x_n,force_y_n,force_z_n,torque_x_nm,torque_y_nm,torque_z_nm\n");
        Self { text, clips }
    }

    /// One row for each joint and frame that passes anything on.
    pub fn add(&mut self, job: &Job<'_>, frames: &[Vec<[f32; 6]>]) {
        let joints = job.prepared.character.skeleton.joints();
        for (index, rows) in frames.iter().enumerate() {
            let time = index as f64 / job.scene.motion.fps;
            for (joint, r) in joints.iter().zip(rows).filter(|(_, r)| **r != [0.0; 6]) {
                if self.clips {
                    let _ = write!(self.text, "{},", quoted(&job.clip.name));
                }
                let [fx, fy, fz, tx, ty, tz] = r;
                let _ = writeln!(self.text, "{index},{time},{},{fx},{fy},{fz},{tx},{ty},{tz}", quoted(&joint.name));
            }
        }
    }

    /// The file.
    #[must_use]
    pub fn text(&self) -> &str {
        &self.text
    }
}
