//! One clip, from the first frame to the last: simulate, keep in the journal, export.

use super::measure::Measures;
use super::output::{self, Forces, Policy, Target};
use super::prepare::Prepared;
use super::resume::{self, Snapshot};
use super::skeleton::{Reactions, write_skeleton};
use super::stiffen::Stiffened;
use super::subject::{Flesh, Subject, Things};
use crate::args::{MethodName, Precision};
use crate::failure::Failure;
use crate::interrupt::{self, Graceful};
use crate::report::{BakeReport, peak_rss_mib};
use crate::scene::Scene;
use crate::ui::{self, Progress};
use softrig::couple::Binding;
use softrig::material::MaterialMap;
use softrig::mesh::components;
use softrig::rig::{Clip, Pose, Transform};
use softrig::simulation::{ClipMotion, Motion, Simulation};
use softrig_io::export::{self, ExportError, ExportReport, Format};
use softrig_io::journal::{
    Existing, JournalError, JournalFrame, JournalHeader, JournalMesh, JournalReader, JournalVolume, JournalWriter,
};
use softrig_linalg::Scalar;
use std::hash::Hasher;
use std::time::Instant;
use twox_hash::XxHash64;

/// One clip to bake.
#[derive(Clone, Copy, Debug)]
pub struct Job<'a> {
    /// All settings.
    pub scene: &'a Scene,
    /// The character and its body.
    pub prepared: &'a Prepared,
    /// What moves it.
    pub clip: &'a Clip,
    /// Where the result goes.
    pub target: &'a Target,
    /// What else is wanted.
    pub sides: Sides<'a>,
}

/// Results beside the main one.
#[derive(Clone, Copy, Debug, Default)]
pub struct Sides<'a> {
    /// Where the moved skeleton goes.
    pub skeleton: Option<&'a std::path::Path>,
}

/// Frames between two checkpoints: a resumed bake repeats at most so many, and checkpoints stay smaller than the frames.
const CHECKPOINT_EVERY: usize = 20;

/// A clip played from one of its frames on.
struct Window<'a> {
    motion: ClipMotion<'a>,
    offset: f64,
}

impl Motion for Window<'_> {
    fn pose(&self, time: f64) -> Pose {
        self.motion.pose(time + self.offset)
    }

    fn pose_into(&self, time: f64, locals: &mut Vec<Transform>, pose: &mut Pose) {
        self.motion.pose_into(time + self.offset, locals, pose);
    }
}

/// Bakes one clip; `None` when `--resume` finds it done already.
///
/// # Errors
/// [`Failure`]; finished frames are in the journal then.
pub fn bake_clip(
    job: &Job<'_>,
    forces: Option<&mut Forces>,
    reactions: Option<&mut Reactions>,
) -> Result<Option<BakeReport>, Failure> {
    let target = job.target;
    if target.policy == Policy::Resume && target.out.exists() && !target.journal.exists() {
        ui::note(format_args!("{} is complete: nothing to resume", target.out.display()));
        return Ok(None);
    }
    match job.scene.simulation.precision {
        Precision::F32 => bake::<f32>(job, forces, reactions),
        Precision::F64 => bake::<f64>(job, forces, reactions),
    }
    .map(Some)
}

fn bake<R: Scalar>(
    job: &Job<'_>,
    forces: Option<&mut Forces>,
    reactions: Option<&mut Reactions>,
) -> Result<BakeReport, Failure> {
    let begun = Instant::now();
    let (scene, prepared) = (job.scene, job.prepared);
    let skeleton = &prepared.character.skeleton;
    let fps = scene.motion.fps;
    let motion = ClipMotion { speed: scene.motion.speed, ..ClipMotion::new(skeleton, job.clip) };
    let range = frames(scene, &motion, &job.clip.name)?;
    let count = range.len();
    let from = Window { offset: range.start as f64 / fps, motion };

    let duration = count.saturating_sub(1) as f64 / fps;
    // mass points have one stiffness, objects no clip
    let whole = scene.has_objects() || scene.simulation.method == MethodName::MassPoints;
    let stiffen = scene.simulation.stiffen && !whole;
    let stiffened = Stiffened::new(prepared, stiffen, &from, duration);
    let (mut subject, notes) = subject::<R>(job, &stiffened.materials)?;
    notes.iter().for_each(ui::note);
    let setup = prepared.took + begun.elapsed();

    // where the first frame lies in the clip's own time
    let start_time = job.clip.start + from.offset * scene.motion.speed;
    let header = header(job, &stiffened.materials, start_time, count);
    // from here on there are frames to be kept
    let graceful = Graceful::begin();
    let (mut journal, mut measures, mut next, finished) =
        open(job, header, &stiffened.materials, &mut *subject, &from)?;
    if !finished {
        let mut progress = Progress::new("frames", next, count);
        while next < count {
            let start = Instant::now();
            let report = match next {
                0 => subject.start(&from),
                _ => subject.advance(&from, next as f64 / fps),
            };
            let report = report.map_err(|e| stopped(job, next, &e))?;
            measures.add_advance(&report, (next > 0).then(|| start.elapsed()));
            subject.record(job, next, start_time, &mut measures, &mut journal)?;
            next += 1;
            progress.step();
            let interrupted = interrupt::requested();
            if next % CHECKPOINT_EVERY == 0 || interrupted {
                let state = resume::encode(&subject.checkpoint(), &measures);
                journal.checkpoint(&state).map_err(|e| journal_failure(&e))?;
            }
            if interrupted && next < count {
                progress.finish();
                return Err(Failure::Interrupted(format!(
                    "stopped after {next} of {count} frames, kept in {}; the same command with --resume goes on",
                    target_journal(job)
                )));
            }
        }
        progress.finish();
        // what the report says is kept with the last frame: resumed after it, the export still has it
        let state = resume::encode(&subject.checkpoint(), &measures);
        journal.checkpoint(&state).map_err(|e| journal_failure(&e))?;
        journal.finish().map_err(|e| journal_failure(&e))?;
    }
    drop((journal, graceful));
    let (state_hash, exported) = deliver(job, forces)?;
    if let Some(table) = reactions {
        table.add(job, measures.reactions());
    }

    let mut report = BakeReport {
        version: env!("CARGO_PKG_VERSION").into(),
        character: scene.character.display().to_string(),
        clip: job.clip.name.clone(),
        outputs: exported.files.iter().map(|f| f.display().to_string()).collect(),
        frames: count,
        fps,
        start_time_s: start_time,
        cells: prepared.volume.cell_count(),
        cell_kind: if prepared.volume.tets.is_empty() { "hex" } else { "tet" }.into(),
        spacing_m: prepared.volume.lattice.as_ref().map_or(0.0, |l| l.spacing),
        nodes: prepared.volume.node_count(),
        bound_nodes: prepared.binding.as_ref().map_or(0, Binding::bound_count),
        bones: prepared.binding.as_ref().map_or(0, |b| b.bones.len()),
        parts: components(&prepared.volume).count,
        skin_vertices: prepared.character.vertex_count(),
        height_m: prepared.character.height(),
        method: scene.simulation.method.name().into(),
        solver: super::method::solver(scene, &prepared.settings).into(),
        dynamics: super::method::dynamics(scene, &prepared.settings).into(),
        precision: R::NAME.into(),
        threads: rayon::current_num_threads(),
        stiffened_max: stiffened.factor,
        two_way: scene.coupling.two_way,
        joint_unknowns: subject.joint_unknowns(),
        unassigned_mass_kg: subject.unassigned_mass(),
        morph_error_max: exported.morphs.as_ref().map(|m| m.error),
        peak_rss_mib: peak_rss_mib().unwrap_or(0.0),
        setup_seconds: setup.as_secs_f64(),
        total_seconds: (prepared.took + begun.elapsed()).as_secs_f64(),
        state_hash: format!("{state_hash:016x}"),
        notes: prepared.character.notes.iter().chain(&notes).chain(&exported.notes).cloned().collect(),
        ..BakeReport::default()
    };
    measures.report(&mut report);
    say(&report);
    if let Some(note) = stiffened.note() {
        ui::note(&note);
        report.notes.push(note);
    }
    if let Some(note) = measures.lost_shape(report.cells) {
        ui::warn(&note);
        report.notes.push(note);
    }
    exported.notes.iter().for_each(ui::warn);
    if let Some(fit) = exported.morphs.filter(|fit| fit.error > fit.tolerance) {
        ui::warn(format_args!(
            "{} morph targets show the motion to {:.1e} of the height; --morphs {} show it to {:.0e}",
            fit.used, fit.error, fit.needed, fit.tolerance
        ));
    }
    Ok(report)
}

/// What is simulated, and what was chosen for it, in words.
fn subject<R: Scalar>(job: &Job<'_>, materials: &MaterialMap) -> Result<(Box<dyn Subject>, Vec<String>), Failure> {
    let (scene, prepared) = (job.scene, job.prepared);
    if scene.has_objects() {
        return Ok((Box::new(Things::new(scene, materials, &prepared.settings)?), Vec::new()));
    }
    let mut simulation = Simulation::<R>::new(
        &prepared.character,
        prepared.volume.clone(),
        prepared.bones().clone(),
        materials,
        prepared.settings.clone(),
    )
    .map_err(|e| Failure::reading(&scene.character, &e))?;
    super::method::choose(scene, materials, &mut simulation)?;
    let chosen = scene
        .chosen_coupling(&prepared.character, prepared.bones(), job.clip)
        .map_err(|e| Failure::Input(format!("{}: {e}", scene.character.display())))?;
    simulation.couple(&chosen.coupling, chosen.events).map_err(|e| Failure::reading(&scene.character, &e))?;
    Ok((Box::new(Flesh(simulation)), chosen.notes))
}

/// Which frames of the clip are baked.
fn frames(scene: &Scene, motion: &ClipMotion<'_>, name: &str) -> Result<std::ops::Range<usize>, Failure> {
    let all = motion.frame_count(scene.motion.fps);
    let wanted = scene.motion.frames.unwrap_or_default();
    let end = wanted.end.unwrap_or(all);
    if scene.has_objects() && wanted.start > 0 {
        return Err(Failure::Input(format!("frames {wanted}: objects start from rest with frame 0; say 0..{end}")));
    }
    if wanted.start >= all || end > all {
        return Err(Failure::Input(format!(
            "frames {wanted}: the clip `{name}` has frames 0..{all} at {} frames per second",
            scene.motion.fps
        )));
    }
    Ok(wanted.start..end)
}

fn header(job: &Job<'_>, materials: &MaterialMap, start_time: f64, count: usize) -> JournalHeader {
    let prepared = job.prepared;
    let meshes = prepared.character.meshes.iter();
    JournalHeader {
        input_hash: resume::input_hash(job),
        origin: resume::origin(job),
        fps: job.scene.motion.fps,
        start_time,
        frame_count: count as u64,
        joint_count: prepared.character.skeleton.joint_count() as u32,
        meshes: meshes.map(|m| JournalMesh { name: m.name.clone(), vertex_count: m.positions.len() as u32 }).collect(),
        // most of a frame would be nodes: they are kept for results that show them, and for a journal that is the result
        volume: keeps_nodes(job.target).then(|| volume(job, materials)),
    }
}

/// Whether a result shows more than the skin.
fn keeps_nodes(target: &Target) -> bool {
    matches!(target.format, Some(Format::Vtu) | None) || target.colors.is_some()
}

/// The volume mesh as a journal keeps it.
fn volume(job: &Job<'_>, materials: &MaterialMap) -> JournalVolume {
    JournalVolume { mesh: job.prepared.volume.clone(), materials: materials.clone() }
}

/// Begins the journal, or goes on with it: then the simulation is where the journal's last checkpoint was.
fn open(
    job: &Job<'_>,
    mut header: JournalHeader,
    materials: &MaterialMap,
    subject: &mut dyn Subject,
    motion: &dyn Motion,
) -> Result<(JournalWriter, Measures, usize, bool), Failure> {
    let target = job.target;
    if target.policy != Policy::Resume || !target.journal.exists() {
        output::make_folder_of(&target.journal)?;
        let existing = if target.policy == Policy::Refuse { Existing::Refuse } else { Existing::Replace };
        let journal = JournalWriter::create(&target.journal, header, existing).map_err(|e| journal_failure(&e))?;
        return Ok((journal, Measures::default(), 0, false));
    }
    let begun = JournalReader::open(&target.journal).map_err(|e| journal_failure(&e))?;
    // a journal is gone on with as it was begun, with nodes or without, where the result can do with either
    if target.format != Some(Format::Vtu) && target.colors.is_none() {
        let wanted = begun.header().volume.is_some();
        header.volume = wanted.then(|| volume(job, materials));
    }
    drop(begun);
    let (journal, point) = JournalWriter::resume(&target.journal, header).map_err(|e| journal_failure(&e))?;
    let Some(stored) = point.checkpoint else {
        return Ok((journal, Measures::default(), 0, point.finished));
    };
    let broken = |what: &str| Failure::Input(format!("{}: {what}; start over with --force", target.journal.display()));
    let Snapshot { state, measures } =
        resume::decode(&stored.state).ok_or_else(|| broken("its checkpoint cannot be read"))?;
    subject.restore(state, motion).map_err(|e| broken(&e))?;
    if !point.finished {
        ui::note(format_args!("going on from frame {}", stored.frames_done));
    }
    Ok((journal, measures, stored.frames_done, point.finished))
}

/// Makes the result from the journal, and takes the journal away.
fn deliver(job: &Job<'_>, forces: Option<&mut Forces>) -> Result<(u64, ExportReport), Failure> {
    let target = job.target;
    let mut journal = JournalReader::open(&target.journal).map_err(|e| journal_failure(&e))?;
    let hash = read_through(job, &mut journal, forces)?;
    if let Some(path) = job.sides.skeleton {
        write_skeleton(job, &mut journal, path)?;
    }
    let Some(format) = target.format else {
        let report = ExportReport { files: vec![target.out.clone()], ..ExportReport::default() };
        return Ok((hash, report));
    };
    let character = &job.prepared.character;
    let report =
        export::write(&mut journal, character, format, &target.out, &target.export_options()).map_err(|e| {
            if e.is_machine_fault() { Failure::Machine(e.to_string()) } else { Failure::Input(e.to_string()) }
        })?;
    drop(journal);
    if let Err(e) = std::fs::remove_file(&target.journal) {
        ui::warn(format_args!("{} is no longer needed but could not be removed: {e}", target.journal.display()));
    }
    Ok((hash, report))
}

/// Hash of all skin positions; writes down the forces on the way.
fn read_through(job: &Job<'_>, journal: &mut JournalReader, mut forces: Option<&mut Forces>) -> Result<u64, Failure> {
    let joints: Vec<_> = job.prepared.character.skeleton.joints().iter().map(|j| j.name.clone()).collect();
    let mut hasher = XxHash64::with_seed(0);
    let mut frame = JournalFrame::default();
    for index in 0..journal.frame_count() {
        journal.read_frame(index, &mut frame).map_err(|e| journal_failure(&e))?;
        for v in frame.skin.iter().flatten().flatten() {
            hasher.write(&v.to_le_bytes());
        }
        if let Some(forces) = forces.as_deref_mut() {
            forces.add(&job.clip.name, index, frame.time, &joints, &frame.joint_force);
        }
    }
    Ok(hasher.finish())
}

fn target_journal(job: &Job<'_>) -> String {
    job.target.journal.display().to_string()
}

/// A frame that could not be simulated.
fn stopped(job: &Job<'_>, frame: usize, error: &str) -> Failure {
    let kept = match frame {
        0 => String::new(),
        n => format!(
            "; the {n} frames before it are kept in {}, `softrig convert` makes a cache of them",
            target_journal(job)
        ),
    };
    Failure::Simulation(format!("frame {frame} of `{}`: {error}{kept}", job.clip.name))
}

/// A journal that could not be read or written, with its exit code.
pub fn journal_failure(error: &JournalError) -> Failure {
    if error.is_machine_fault() { Failure::Machine(error.to_string()) } else { Failure::Input(error.to_string()) }
}

/// A result that could not be made, with its exit code.
pub fn export_failure(error: &ExportError) -> Failure {
    if error.is_machine_fault() { Failure::Machine(error.to_string()) } else { Failure::Input(error.to_string()) }
}

/// What a user wants to know at once.
fn say(report: &BakeReport) {
    ui::note(format_args!(
        "`{}`: {} frames, {} {} cells, {} nodes, {} of them on {} bones",
        report.clip, report.frames, report.cells, report.cell_kind, report.nodes, report.bound_nodes, report.bones
    ));
    let speed = match report.steps {
        0 => String::new(),
        _ => format!("{:.1} ms a frame ({:.1} steps a second), ", report.frame_ms_median, report.steps_per_second),
    };
    ui::note(format_args!(
        "{speed}volume {:.3} to {:.3} of rest, at most {} inverted cells",
        report.volume_ratio_min, report.volume_ratio_max, report.inverted_cells_max
    ));
    // a limb of one cell is all bone
    if 2 * report.bound_nodes > report.nodes {
        ui::warn(format_args!(
            "{} of {} nodes hang on bones, so little can swing; more cells leave more flesh free (--cells, 8000 by default)",
            report.bound_nodes, report.nodes
        ));
    }
    let odd = [
        (report.guarded_steps, "steps were done again with implicit Euler (the growth guard)"),
        (report.unconverged_steps, "steps did not reach the tolerance"),
        (report.teleports, "jumps of the clip were not simulated through"),
    ];
    for (count, what) in odd.into_iter().filter(|(count, _)| *count > 0) {
        ui::warn(format_args!("{count} {what}"));
    }
    if report.clip_bone_length_change_max > 1e-3 {
        ui::warn(format_args!(
            "the clip moves joints: bones change their length by up to {:.1} %, and flesh follows",
            100.0 * report.clip_bone_length_change_max
        ));
    }
}
