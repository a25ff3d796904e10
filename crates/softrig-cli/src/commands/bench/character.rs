//! The built-in character walking, with the defaults of a bake.

use super::measure::{Measurement, Record, hash, since};
use super::stages::{Absent, Clocks, TimedModel, TimedSolver};
use crate::commands::bake::Prepared;
use crate::failure::Failure;
use crate::load::{self, SAMPLE};
use crate::scene::Scene;
use softrig::simulation::{ClipMotion, Simulation, SolverKind};
use std::sync::Arc;
use std::time::Instant;

/// Frames of 1/60 s.
pub const FRAMES: usize = 31;
/// Frame length [s].
pub const FRAME: f64 = 1.0 / 60.0;

/// Measures `name` with about so many cells, written as a number of thousands and a k, or plainly.
///
/// # Errors
/// As [`super::run`].
pub fn measure(name: &str, cells: &str, solver: SolverKind) -> Result<Measurement, Failure> {
    let cells = cell_count(name, "character_", cells)?;
    let mut scene = Scene { character: SAMPLE.into(), ..Scene::default() };
    scene.body.cells = Some(cells);
    let prepared = Prepared::new(&scene, load::scene_character(&scene)?)?;
    let failed = |e: &dyn std::error::Error| Failure::Simulation(format!("bench {name}: {e}"));
    let size = [prepared.volume.cell_count(), prepared.volume.node_count()];
    let mut settings = prepared.settings.clone();
    settings.solver = solver;
    let character = &prepared.character;
    let mut simulation = Simulation::<f64>::new(
        character,
        prepared.volume.clone(),
        prepared.bones().clone(),
        &prepared.materials,
        settings,
    )
    .map_err(|e| failed(&e))?;
    let clocks = Arc::new(Clocks::default());
    let model = std::mem::replace(&mut simulation.body.model, Box::new(Absent));
    simulation.body.model = Box::new(TimedModel { inner: model, clocks: clocks.clone() });
    simulation.wrap_solver(|inner| Box::new(TimedSolver { inner, clocks: clocks.clone() }));
    let clip = character.clips.first().ok_or_else(|| Failure::Input("the character has no clip".into()))?;
    let motion = ClipMotion::new(&character.skeleton, clip);
    simulation.start(&motion).map_err(|e| failed(&e))?;
    let mut record = Record::default();
    for frame in 0..FRAMES {
        clocks.take();
        let start = Instant::now();
        let report = simulation.advance(&motion, (frame + 1) as f64 * FRAME).map_err(|e| failed(&e))?;
        let stepped = Instant::now();
        simulation.frame(frame);
        let embedding = since(stepped);
        if frame > 0 {
            let steps = report.substeps.max(1);
            let mut taken = clocks.take();
            taken.times = taken.times.map(|t| t / steps as f64);
            let whole = (since(start) - embedding) / steps as f64 + embedding;
            record.add(whole, embedding, taken, report.iterations / steps, report.residual);
        }
    }
    let position = simulation.state.position.clone();
    let m = record.measurement(name, size, solver.name(), &clocks, None);
    Ok(Measurement { state_hash: hash(&position), ..m })
}

/// The number of cells after a prefix.
///
/// # Errors
/// [`Failure::Usage`] when it is none.
pub fn cell_count(name: &str, prefix: &str, cells: &str) -> Result<usize, Failure> {
    let (digits, factor) = cells.strip_suffix('k').map_or((cells, 1), |d| (d, 1000));
    let cells =
        digits.parse::<usize>().ok().and_then(|n| n.checked_mul(factor)).filter(|n| (100..=1_000_000).contains(n));
    cells.ok_or_else(|| {
        Failure::Usage(format!("`{name}`: after {prefix} comes a number of cells from 100 to 1000k, as in {prefix}8k"))
    })
}
