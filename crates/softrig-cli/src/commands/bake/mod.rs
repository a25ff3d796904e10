//! `softrig bake`: a character and a clip go in, moving flesh comes out.

mod measure;
mod method;
mod objects;
mod output;
mod prepare;
mod resume;
mod session;
mod skeleton;
mod stiffen;
mod subject;

pub use objects::character as objects_character;
pub use output::{
    Policy, Target, check_folder_of, make_folder_of, refuse_existing, refuse_input, write_whole, write_whole_with,
};
pub use prepare::{Prepared, clips, volume};
pub use session::{Job, Sides, bake_clip, export_failure, journal_failure};

use crate::args::BakeArgs;
use crate::failure::{Failure, Outcome};
use crate::load;
use crate::scene::{Scene, template};
use crate::ui;
use std::path::{Path, PathBuf};

/// Bakes one clip of a character, or all of them.
///
/// # Errors
/// [`Failure`] with the exit code; finished frames stay valid whatever happens.
pub fn run(args: &BakeArgs) -> Outcome {
    let mut scene = load::scene(&args.file)?;
    scene.override_with(args);
    scene.check().map_err(|e| Failure::reading(&args.file, &e))?;
    let clip_file = scene.motion.clip.clone().map(PathBuf::from).filter(|p| crate::scene::is_bvh(p));
    let inputs = || [&args.file, &scene.character].into_iter().chain(&clip_file).map(PathBuf::as_path);
    let sides = [&args.report, &args.forces, &args.skeleton, &args.reactions];
    for result in [&args.output, &args.write_scene].into_iter().chain(sides).flatten() {
        refuse_input(result, inputs())?;
    }
    if let Some(path) = &args.write_scene {
        return write_scene(path, scene, args.force);
    }
    let Some(out) = &args.output else {
        return Err(Failure::Usage("say what to write: -o OUT".into()));
    };
    let policy = match (args.resume, args.force) {
        (true, _) => Policy::Resume,
        (false, true) => Policy::Replace,
        (false, false) => Policy::Refuse,
    };
    // what is there already is refused before any long work, side results included
    let colors = args.colors.map(Into::into);
    Target::new(out, policy, args.morphs)?.color(colors)?;
    for side in sides.into_iter().flatten() {
        refuse_existing(side, policy)?;
        check_folder_of(side)?;
    }
    let character = load::scene_character(&scene)?;
    character.notes.iter().for_each(ui::warn);
    let clips = clips(&scene, &character)?;
    let names: Vec<_> = clips.iter().map(|c| c.name.clone()).collect();
    let mut targets = Vec::new();
    for name in &names {
        let path = if clips.len() > 1 { output::for_clip(out, name, &names) } else { out.clone() };
        refuse_input(&path, inputs())?;
        let mut target = Target::new(&path, policy, args.morphs)?;
        target.color(colors)?;
        targets.push(target);
    }
    if let Some(path) = &args.skeleton {
        skeleton::check(path, &scene)?;
    }
    method::check_sides(&scene, args)?;
    let prepared = Prepared::new(&scene, character)?;
    let mut reports = Vec::new();
    let mut forces = args.forces.as_ref().map(|_| output::Forces::new(clips.len() > 1));
    let mut reactions = args.reactions.as_ref().map(|_| skeleton::Reactions::new(clips.len() > 1));
    for (clip, target) in clips.iter().zip(&targets) {
        let own = |path: &PathBuf| match clips.len() {
            1 => path.clone(),
            _ => output::for_clip(path, &clip.name, &names),
        };
        let moved = args.skeleton.as_ref().map(own);
        let sides = Sides { skeleton: moved.as_deref() };
        let job = Job { scene: &scene, prepared: &prepared, clip, target, sides };
        if let Some(report) = bake_clip(&job, forces.as_mut(), reactions.as_mut())? {
            reports.push(report);
        }
    }
    if reports.is_empty() {
        // all done by an earlier run, with its reports
        return Ok(());
    }
    // one clip: one object; several: a list of them
    let json = match &reports[..] {
        [one] if clips.len() == 1 => serde_json::to_string_pretty(one),
        all => serde_json::to_string_pretty(all),
    };
    let json = json.expect("a report is plain data");
    if let Some(path) = &args.report {
        write_whole(path, format!("{json}\n").as_bytes())?;
    }
    if let (Some(path), Some(forces)) = (&args.forces, forces) {
        write_whole(path, forces.text().as_bytes())?;
    }
    if let (Some(path), Some(reactions)) = (&args.reactions, reactions) {
        write_whole(path, reactions.text().as_bytes())?;
    }
    if args.json {
        ui::result(json);
    } else {
        reports.iter().flat_map(|r| &r.outputs).for_each(ui::result);
    }
    Ok(())
}

/// Writes the settings as a scene file beside which its character is found again.
fn write_scene(path: &Path, mut scene: Scene, force: bool) -> Outcome {
    refuse_existing(path, if force { Policy::Replace } else { Policy::Refuse })?;
    let character = load::scene_character(&scene)?;
    scene.character = output::relative_to(&scene.character, path.parent().unwrap_or(Path::new("")));
    if let Some(clip) = &mut scene.motion.clip
        && crate::scene::is_bvh(Path::new(clip))
    {
        let relative = output::relative_to(Path::new(clip), path.parent().unwrap_or(Path::new("")));
        *clip = relative.to_string_lossy().into_owned();
    }
    write_whole(path, template(&scene, Some(&character)).as_bytes())?;
    ui::result(path.display());
    Ok(())
}
