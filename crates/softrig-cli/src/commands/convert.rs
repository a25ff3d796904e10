//! `softrig convert`: between formats, and from the journal of a stopped bake to any cache.

use super::bake::{
    Policy, Target, check_folder_of, clips, export_failure, journal_failure, make_folder_of, refuse_existing,
    refuse_input, write_whole,
};
use super::mesh;
use super::render::{Frames, journal_scene};
use crate::args::ConvertArgs;
use crate::failure::{Failure, Outcome};
use crate::load::{self, FileKind};
use crate::scene::Scene;
use crate::ui;
use softrig::character::Character;
use softrig::frame::{Frame, FrameSink};
use softrig_io::bvh;
use softrig_io::export;
use softrig_io::journal::{Existing, JournalHeader, JournalMesh, JournalReader, JournalWriter};
use std::path::Path;

/// Converts a file.
///
/// # Errors
/// [`Failure`] with the exit code.
pub fn run(args: &ConvertArgs) -> Outcome {
    let (input, output) = (&args.input, &args.output);
    refuse_existing(output, policy(args))?;
    refuse_input(output, [input.as_path()].into_iter().chain(args.with.as_deref()))?;
    check_folder_of(output)?;
    let to_bvh = crate::scene::is_bvh(output);
    match load::kind(input) {
        FileKind::Journal => from_journal(args)?,
        FileKind::PointCache => from_cache(args)?,
        FileKind::Volume => {
            let format = mesh::format(output)?;
            mesh::write(&load::volume(input)?, format, output)?;
        }
        FileKind::Motion if to_bvh => {
            let motion = bvh::read(input).map_err(|e| load::import_failure(&e))?;
            motion.notes.iter().for_each(ui::warn);
            let frame_time = args.fps.map_or(motion.frame_time, f64::recip);
            write_whole(output, bvh::to_text(&motion.skeleton, &motion.clip, frame_time).as_bytes())?;
        }
        FileKind::Scene | FileKind::Character if to_bvh => character_to_bvh(args)?,
        FileKind::Motion => {
            return Err(unsupported(args, "a motion becomes .bvh; to move a character use bake --clip"));
        }
        FileKind::Scene | FileKind::Character => {
            return Err(unsupported(
                args,
                "a character's clip becomes .bvh; `softrig mesh` fills it with cells, `softrig bake` makes a cache",
            ));
        }
    }
    ui::result(output.display());
    Ok(())
}

fn policy(args: &ConvertArgs) -> Policy {
    if args.force { Policy::Replace } else { Policy::Refuse }
}

fn unsupported(args: &ConvertArgs, instead: &str) -> Failure {
    Failure::Usage(format!("unsupported: {} to {}: {instead}", args.input.display(), args.output.display()))
}

fn character_to_bvh(args: &ConvertArgs) -> Outcome {
    let mut scene = load::scene(&args.input)?;
    scene.override_import(&args.import);
    if args.clip.is_some() {
        scene.motion.clip.clone_from(&args.clip);
    }
    let character = load::scene_character(&scene)?;
    let clip = clips(&scene, &character)?.swap_remove(0);
    let fps = args.fps.unwrap_or(scene.motion.fps);
    write_whole(&args.output, bvh::to_text(&character.skeleton, &clip, 1.0 / fps).as_bytes())
}

fn from_journal(args: &ConvertArgs) -> Outcome {
    let mut journal = JournalReader::open(&args.input).map_err(|e| journal_failure(&e))?;
    let character = match &args.with {
        Some(with) => with_character(args, with)?.1,
        None => journal_scene(&journal)?.1,
    };
    if (journal.frame_count() as u64) < journal.header().frame_count {
        ui::warn(format_args!(
            "{} holds {} of {} frames; `softrig bake --resume` makes the others",
            args.input.display(),
            journal.frame_count(),
            journal.header().frame_count
        ));
    }
    export_journal(args, &mut journal, &character)
}

fn with_character(args: &ConvertArgs, with: &Path) -> Result<(Scene, Character), Failure> {
    let mut scene = load::scene(with)?;
    scene.override_import(&args.import);
    let character = load::scene_character(&scene)?;
    Ok((scene, character))
}

fn export_journal(args: &ConvertArgs, journal: &mut JournalReader, character: &Character) -> Outcome {
    // the input itself may be the journal that a bake to this output would use
    let mut target = Target::new(&args.output, Policy::Replace, args.morphs)?;
    target.color(args.colors.map(Into::into))?;
    let Some(format) = target.format else {
        return Err(unsupported(args, "journals are made by bakes only"));
    };
    let options = target.export_options_as(policy(args));
    make_folder_of(&args.output)?;
    let report = export::write(journal, character, format, &args.output, &options).map_err(|e| export_failure(&e))?;
    report.notes.iter().for_each(ui::warn);
    Ok(())
}

/// A cache becomes a journal for a moment, and that becomes anything.
fn from_cache(args: &ConvertArgs) -> Outcome {
    let Some(with) = &args.with else {
        return Err(Failure::Usage(format!(
            "{} has positions only; say which character it is of: --with CHARACTER|SCENE",
            args.input.display()
        )));
    };
    let (scene, character) = with_character(args, with)?;
    let mut frames = Frames::of_caches(&args.input, scene, character, args.fps)?;
    let meshes = frames.character.meshes.iter();
    let header = JournalHeader {
        fps: frames.fps,
        frame_count: frames.count as u64,
        joint_count: frames.character.skeleton.joint_count() as u32,
        meshes: meshes.map(|m| JournalMesh { name: m.name.clone(), vertex_count: m.positions.len() as u32 }).collect(),
        ..JournalHeader::default()
    };
    let folder = tempfile::tempdir().map_err(|e| Failure::writing(&std::env::temp_dir(), &e))?;
    let path = folder.path().join("cache.softrig-journal");
    let mut journal = JournalWriter::create(&path, header, Existing::Refuse).map_err(|e| journal_failure(&e))?;
    let still = vec![[0.0; 3]; frames.character.skeleton.joint_count()];
    for index in 0..frames.count {
        let shape = frames.shape(index)?;
        let time = index as f64 / frames.fps;
        let frame =
            Frame { index, time, skin: &shape.skin, pose: &shape.pose, nodes: &shape.nodes, joint_force: &still };
        journal.frame(&frame).map_err(|e| journal_failure(&e))?;
    }
    journal.finish().map_err(|e| journal_failure(&e))?;
    drop(journal);
    let mut journal = JournalReader::open(&path).map_err(|e| journal_failure(&e))?;
    export_journal(args, &mut journal, &frames.character)
}
