//! Tang, Wan, Niquin, Schildknecht 2009: the table, Figures 4 and 5, the jelly man. `docs/methods/t09.md` maps the equations to our
//! files.

mod figures;
mod jelly;
mod table;

use super::{Job, Results, picture, timing};
use crate::failure::{Failure, Outcome};
use picture::failed;
use softrig::body::Body;
use softrig::force::ElasticModel;
use softrig::material::{Material, MaterialMap};
use softrig_explicit::sample::Shape;
use softrig_linalg::DofConstraints;
use timing::Times;

/// All of it.
pub fn run(job: &Job, results: &Results) -> Outcome {
    table::run(job, results)?;
    figures::run(job, results)?;
    jelly::run(job, results)
}

/// The bodies' material: Rayleigh damping with both coefficients.
fn material() -> Material {
    Material { young_modulus: 2e4, poisson_ratio: 0.4, density: 1000.0, mass_damping: 1.0, stiffness_damping: 0.001 }
}

/// A body of the table, its lowest nodes held.
fn body(shape: Shape) -> Result<Body<f64>, Failure> {
    let mesh = shape.mesh();
    let low = mesh.nodes.iter().fold(f64::INFINITY, |m, p| m.min(p[1]));
    let mask = mesh.nodes.iter().map(|p| p[1] < low + 0.08).collect();
    let map = MaterialMap::uniform(material());
    Body::new(mesh, &map, ElasticModel::Linear, DofConstraints::from_mask(mask)).map_err(|e| failed(&e))
}

/// Masses with those of held nodes zero.
fn free_mass(body: &Body<f64>) -> Vec<f64> {
    let held = body.constraints.mask();
    body.mass.iter().zip(held).map(|(m, held)| if *held { 0.0 } else { *m }).collect()
}
