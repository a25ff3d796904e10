//! The built-in character walking, its flesh moved by its bones alone and both moving each other, step by step in turn.

use super::character::{FRAME, FRAMES, cell_count};
use super::measure::{Time, hash, since};
use crate::commands::bake::Prepared;
use crate::failure::Failure;
use crate::load::{self, SAMPLE};
use crate::scene::Scene;
use serde::Serialize;
use softrig::simulation::{ClipMotion, Coupling, Simulation, SolverKind};
use std::time::Instant;

/// How far the clip leads the joints [-]: what an animator asks for who wants the walk kept and the flesh felt.
const DRIVE: f64 = 0.7;

/// What `softrig bench two_way_N --json` prints.
#[derive(Clone, Debug, Serialize)]
pub struct TwoWayMeasurement {
    /// Name of the body.
    pub name: String,
    /// Number of cells.
    pub cells: usize,
    /// Number of nodes.
    pub nodes: usize,
    /// Number of bones.
    pub bones: usize,
    /// Unknowns of the skeleton: what its joints leave free.
    pub joint_unknowns: usize,
    /// Threads used.
    pub threads: usize,
    /// Linear solver.
    pub solver: &'static str,
    /// Frames measured.
    pub frames: usize,
    /// A step in which the bones move the flesh [ms].
    pub one_way_ms: Time,
    /// A step in which the flesh moves the bones too [ms].
    pub two_way_ms: Time,
    /// Ratio of the medians [-].
    pub ratio: f64,
    /// Mean linear iterations of a one-way step.
    pub one_way_iterations: f64,
    /// Of a two-way step.
    pub two_way_iterations: f64,
    /// Hash of the bits of all positions of the two-way simulation at the end.
    pub state_hash: String,
}

/// Measures `name` with about so many cells, written as a number of thousands and a k, or plainly.
///
/// # Errors
/// As [`super::run`].
pub fn measure(name: &str, cells: &str, solver: SolverKind) -> Result<TwoWayMeasurement, Failure> {
    let failed = |e: &dyn std::error::Error| Failure::Simulation(format!("bench {name}: {e}"));
    let mut scene = Scene { character: SAMPLE.into(), ..Scene::default() };
    scene.body.cells = Some(cell_count(name, "two_way_", cells)?);
    (scene.coupling.two_way, scene.coupling.drive) = (true, DRIVE);
    let prepared = Prepared::new(&scene, load::scene_character(&scene)?)?;
    let character = &prepared.character;
    let clip = character.clips.first().ok_or_else(|| Failure::Input("the character has no clip".into()))?;
    let coupled = scene.chosen_coupling(character, prepared.bones(), clip).map_err(|e| failed(&e))?.coupling;
    let settings = softrig::simulation::SimulationSettings { solver, ..prepared.settings.clone() };
    let motion = ClipMotion::new(&character.skeleton, clip);
    let make = |coupling: &Coupling| {
        let (volume, bones) = (prepared.volume.clone(), prepared.bones().clone());
        let mut simulation = Simulation::<f64>::new(character, volume, bones, &prepared.materials, settings.clone())
            .map_err(|e| failed(&e))?;
        simulation.couple(coupling, Vec::new()).map_err(|e| failed(&e))?;
        simulation.start(&motion).map_err(|e| failed(&e))?;
        Ok::<_, Failure>(simulation)
    };
    let mut both = [make(&Coupling::OneWay)?, make(&coupled)?];
    let (mut times, mut iterations, mut steps) = ([Vec::new(), Vec::new()], [0; 2], [0; 2]);
    for frame in 1..=FRAMES {
        for (k, simulation) in both.iter_mut().enumerate() {
            let start = Instant::now();
            let report = simulation.advance(&motion, frame as f64 * FRAME).map_err(|e| failed(&e))?;
            // the first has to make what the others find there
            if frame > 1 {
                times[k].push(since(start) / report.substeps.max(1) as f64);
                iterations[k] += report.iterations;
                steps[k] += report.substeps;
            }
        }
    }
    let mean = |k: usize| (10.0 * iterations[k] as f64 / f64::max(steps[k] as f64, 1.0)).round() / 10.0;
    let [one_way_ms, two_way_ms] = times.map(Time::of);
    Ok(TwoWayMeasurement {
        name: name.into(),
        cells: prepared.volume.cell_count(),
        nodes: prepared.volume.node_count(),
        bones: prepared.bones().bones.len(),
        joint_unknowns: both[1].joint_unknowns(),
        threads: rayon::current_num_threads(),
        solver: solver.name(),
        frames: FRAMES - 1,
        one_way_ms,
        two_way_ms,
        ratio: (1e3 * two_way_ms.median / one_way_ms.median).round() / 1e3,
        one_way_iterations: mean(0),
        two_way_iterations: mean(1),
        state_hash: hash(&both[1].state.position),
    })
}

impl TwoWayMeasurement {
    /// In words.
    pub fn sentence(&self) -> String {
        let row = |what: &str, t: Time, iterations: f64| {
            format!("  {what} {:8.2} ms median, {:8.2} ms minimum, {iterations:.1} iterations a step", t.median, t.min)
        };
        [
            format!(
                "{}: {} cells, {} nodes, {} bones, {} unknowns of the skeleton, {} threads, {}",
                self.name, self.cells, self.nodes, self.bones, self.joint_unknowns, self.threads, self.solver
            ),
            row("one-way", self.one_way_ms, self.one_way_iterations),
            row("two-way", self.two_way_ms, self.two_way_iterations),
            format!("  ratio   {:8.3}", self.ratio),
            format!("  state {}", self.state_hash),
        ]
        .join("\n")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What the command promises of its numbers.
    #[test]
    fn a_walk_is_measured_both_ways() {
        let m = measure("two_way_400", "400", SolverKind::Multigrid).unwrap();
        assert!(m.joint_unknowns > 30 && m.bones > 15 && m.frames > 20, "{m:?}");
        assert!(m.one_way_ms.min > 0.0 && m.two_way_ms.min > 0.0, "{m:?}");
        assert!((m.ratio - m.two_way_ms.median / m.one_way_ms.median).abs() < 1e-3, "{m:?}");
        assert!(m.one_way_iterations >= 2.0 && m.two_way_iterations >= 2.0, "{m:?}");
        let json = serde_json::to_value(&m).unwrap();
        for key in ["cells", "one_way_ms", "two_way_ms", "ratio", "two_way_iterations", "joint_unknowns"] {
            assert!(json.get(key).is_some(), "{key} is missing");
        }
        assert!(measure("two_way_x", "x", SolverKind::Multigrid).unwrap_err().to_string().contains("two_way_"));
    }
}
