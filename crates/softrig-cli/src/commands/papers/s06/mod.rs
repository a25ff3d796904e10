//! Gissler, Becker, Teschner 2006: Figures 1 to 4, and self-assembly. `docs/methods/s06.md` maps the equations to our files.

mod assembly;
mod bridge;
mod cubes;
mod ropes;

use super::{Curve, Job, Plot, Results, picture, timing};
use crate::failure::Outcome;
use picture::failed;
use softrig::mesh::VolumeMesh;
use softrig_explicit::mass_point::Energies;
use timing::Times;

/// All of it.
pub fn run(job: &Job, results: &Results) -> Outcome {
    cubes::run(job, results)?;
    ropes::run(job, results)?;
    bridge::run(job, results)?;
    assembly::run(job, results)
}

/// Stiff and light enough to hang in columns of 250 cubes; damped as jelly.
fn energies() -> Energies {
    Energies { distance: 200.0, area: 50.0, volume: 200.0, damping: 5e-4, density: 200.0 }
}

/// Adds a mesh, moved, to another; returns its first node.
fn add(to: &mut VolumeMesh, mesh: &VolumeMesh, place: impl Fn([f64; 3]) -> [f64; 3]) -> u32 {
    let first = to.node_count() as u32;
    to.nodes.extend(mesh.nodes.iter().map(|p| place(*p)));
    to.tets.extend(mesh.tets.iter().map(|t| t.map(|n| n + first)));
    first
}
