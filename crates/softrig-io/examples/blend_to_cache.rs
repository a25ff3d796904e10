//! Plays a clip of a character by linear blend skinning, without any flesh, into every kind of output: `FILE OUT [CLIP] [FPS]`.
//! What Blender shows with the armature on must then be what it shows with this cache and the armature off
//! (tests/blender/check_cache.py).

#![allow(clippy::print_stdout, reason = "an example says what it did")]

use softrig::frame::{Frame, FrameSink};
use softrig_io::export::{ExportOptions, Format, write};
use softrig_io::journal::{Existing, JournalHeader, JournalMesh, JournalReader, JournalWriter, journal_path};
use std::path::Path;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [file, out, ..] = arguments.as_slice() else {
        return Err("usage: blend_to_cache FILE OUT [CLIP] [FPS]".into());
    };
    let character = softrig_io::import(Path::new(file), &softrig_io::ImportOptions::default())?;
    let clip = character.find_clip(arguments.get(2).map_or("0", |c| c)).ok_or("no such clip")?;
    let clip = &character.clips[clip];
    let fps: f64 = arguments.get(3).map_or(Ok(24.0), |f| f.parse())?;
    let count = (clip.duration() * fps + 1e-6) as usize + 1;
    let meshes = character.meshes.iter();
    let header = JournalHeader {
        fps,
        start_time: clip.start,
        frame_count: count as u64,
        joint_count: character.skeleton.joint_count() as u32,
        meshes: meshes.map(|m| JournalMesh { name: m.name.clone(), vertex_count: m.positions.len() as u32 }).collect(),
        ..JournalHeader::default()
    };
    let journal = journal_path(Path::new(out));
    let mut writer = JournalWriter::create(&journal, header, Existing::Replace)?;
    let joint_force = vec![[0.0; 3]; character.skeleton.joint_count()];
    for index in 0..count {
        let time = index as f64 / fps;
        let pose = character.skeleton.pose(&clip.sample(&character.skeleton, clip.start + time));
        let skin: Vec<_> = (0..character.meshes.len()).map(|m| character.blend_skin(m, &pose)).collect();
        writer.frame(&Frame { index, time, skin: &skin, pose: &pose, nodes: &[], joint_force: &joint_force })?;
    }
    writer.finish()?;
    let options = ExportOptions { existing: Existing::Replace, ..ExportOptions::default() };
    let report = write(
        &mut JournalReader::open(&journal)?,
        &character,
        Format::from_path(Path::new(out))?,
        Path::new(out),
        &options,
    )?;
    std::fs::remove_file(&journal)?;
    println!("start {} frames {count} files {} {:?}", clip.start, report.files.len(), report.morphs);
    Ok(())
}
