//! `softrig demo`: the built-in character, baked and drawn beside plain skinning.

use super::bake::{self, Job, Policy, Prepared, Target, bake_clip, export_failure, journal_failure, refuse_existing};
use super::render::{self, Frames, Overlays, Painter};
use crate::args::{DemoArgs, PictureSize};
use crate::failure::{Failure, Outcome};
use crate::load::{self, SAMPLE};
use crate::scene::{Bone, Scene};
use crate::ui::{self, Progress};
use softrig_io::export::{self, ExportOptions, Format};
use softrig_io::journal::{Existing, JournalReader};
use softrig_render::{GifWriter, View, side_by_side};
use std::path::Path;

/// Frames per second: four hundredths of a second each, which a GIF holds exactly.
const FPS: f64 = 25.0;

/// Bakes the built-in character and draws it.
///
/// # Errors
/// [`Failure`] with the exit code.
pub fn run(args: &DemoArgs) -> Outcome {
    let folder = &args.output;
    let file = |ending: &str| folder.join(format!("{}.{ending}", args.clip));
    let (gif, glb, pc2) = (file("gif"), file("glb"), file("pc2"));
    let policy = if args.force { Policy::Replace } else { Policy::Refuse };
    for path in [&gif, &glb, &pc2] {
        refuse_existing(path, policy)?;
    }
    let mut scene = Scene { character: SAMPLE.into(), ..Scene::default() };
    scene.body.cells = Some(args.cells);
    scene.motion.fps = FPS;
    scene.motion.clip = Some(args.clip.clone());
    // there is a skull in it: a face of flesh alone slides about when the character lands
    scene.bone.push(Bone { joint: "head".into(), whole: true, ..Bone::default() });
    // its flesh survives its own clips as it is, and shall swing
    scene.simulation.stiffen = false;
    let character = load::scene_character(&scene)?;
    let clips = bake::clips(&scene, &character)?;
    std::fs::create_dir_all(folder).map_err(|e| Failure::writing(folder, &e))?;

    ui::note(format_args!("filling the built-in character with {} cells", args.cells));
    let prepared = Prepared::new(&scene, character)?;
    // frames stay in the journal until all results are made from it
    let target = Target::new(&file("softrig-journal"), Policy::Replace, None)?;
    let Some(clip) = clips.first() else { return Ok(()) };
    let sides = bake::Sides::default();
    bake_clip(&Job { scene: &scene, prepared: &prepared, clip, target: &target, sides }, None, None)?;
    ui::note("drawing");
    draw(&target.journal, &gif)?;
    for (format, path) in [(Format::Pc2, &pc2), (Format::Glb, &glb)] {
        let mut journal = JournalReader::open(&target.journal).map_err(|e| journal_failure(&e))?;
        let options = ExportOptions { existing: Existing::Replace, ..ExportOptions::default() };
        export::write(&mut journal, &prepared.character, format, path, &options).map_err(|e| export_failure(&e))?;
    }
    std::fs::remove_file(&target.journal).map_err(|e| Failure::writing(&target.journal, &e))?;
    ui::result(format_args!(
        "{}  the skeleton alone beside softrig: open it in a web browser\n\
         {}  moving character: drag it onto https://gltf-viewer.donmccurdy.com, or import it in Blender\n\
         {}  point cache for a Mesh Cache modifier\n\
         Your own character next: softrig bake CHARACTER.glb -o OUT.glb",
        gif.display(),
        glb.display(),
        pc2.display()
    ));
    Ok(())
}

/// A moving picture: plain skinning on the left, flesh on the right.
fn draw(journal: &Path, gif: &Path) -> Outcome {
    let mut frames = Frames::of_journal(journal, None)?;
    let size = PictureSize { width: 320, height: 400 };
    let range = 0..frames.count;
    let painter = Painter::looking(&mut frames, Overlays::default(), View::ThreeQuarter, size, range.clone())?;
    let refuse = |e| render::failure(gif, &e);
    let mut writer = GifWriter::create(gif, frames.fps).map_err(refuse)?;
    let mut progress = Progress::new("pictures", 0, range.len());
    for index in range {
        let mut shape = frames.shape(index)?;
        let flesh = painter.paint(&frames, &shape).map_err(refuse)?;
        let meshes = 0..frames.character.meshes.len();
        shape.skin = meshes.map(|m| frames.character.blend_skin(m, &shape.pose)).collect();
        let plain = painter.paint(&frames, &shape).map_err(refuse)?;
        let both = side_by_side(&[plain, flesh], &["skinning", "softrig"]).map_err(refuse)?;
        writer.frame(&both).map_err(refuse)?;
        progress.step();
    }
    progress.finish();
    writer.finish().map_err(refuse)
}
