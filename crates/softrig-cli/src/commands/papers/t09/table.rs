//! The table: time of one step by cells, by clustered rows, and in 30 modes.

use super::{Job, Outcome, Results, Times, body, failed, free_mass, material};
use softrig::integrate::State;
use softrig::material::MaterialMap;
use softrig_explicit::clustered::Clustered;
use softrig_explicit::elastic::{ElasticLaw, InternalForce};
use softrig_explicit::element::{ElementWise, Warping};
use softrig_explicit::modal::ModalIntegrator;
use softrig_explicit::sample::Shape;
use softrig_explicit::scheme::Scheme;
use softrig_explicit::stepper::Stepper;
use std::convert::Infallible;

pub fn run(job: &Job, results: &Results) -> Outcome {
    let rounds = if job.quick { 50 } else { 2000 };
    let mut rows = Vec::new();
    for shape in Shape::ALL {
        let mut body = body(shape)?;
        let n = body.mesh.node_count();
        let mut clustered = Clustered::new(&mut body);
        let map = MaterialMap::uniform(material());
        let mut cells = ElementWise::new(&body.mesh, &map, Warping::None).map_err(|e| failed(&e))?;
        // any displacement: the time does not depend on it
        let x: Vec<[f64; 3]> = body.mesh.nodes.iter().map(|p| p.map(|x| x + 0.01 * (40.0 * x).sin())).collect();
        let v: Vec<[f64; 3]> = x.iter().map(|p| p.map(f64::cos)).collect();
        let (mut a, mut b) = (vec![[0.0; 3]; n], vec![[0.0; 3]; n]);
        let force = |model: &mut dyn InternalForce<f64>, f: &mut [[f64; 3]]| {
            let Ok(t) = Times::of::<Infallible>(rounds, || {
                model.internal_force(&x, &v, f);
                Ok(())
            });
            t
        };
        let cells_force = force(&mut cells, &mut a);
        let clustered_force = force(&mut clustered, &mut b);
        let scale = a.iter().flatten().fold(0.0f64, |m, f| m.max(f.abs()));
        let apart = a.iter().flatten().zip(b.iter().flatten()).fold(0.0f64, |m, (a, b)| m.max((a - b).abs()));
        let external = body.weight([0.0, -9.81, 0.0]);
        let mass = free_mass(&body);
        let rest = body.mesh.nodes.clone();
        let mut steps = Vec::new();
        let laws: [Box<dyn InternalForce<f64>>; 2] = [Box::new(cells), Box::new(clustered)];
        for internal in laws {
            let mut law = ElasticLaw { internal, external: external.clone(), drag: body.drag.clone() };
            let made = Stepper::new(Scheme::EulerCromer, &mass, &rest, &mut law, material().mass_damping);
            let mut stepper = made.map_err(|e| failed(&e))?;
            let dt = stepper.limit();
            let mut state = State::at_rest(rest.clone());
            let step = || stepper.step(&mut law, None, &mut state, dt).map(|_| ());
            steps.push((Times::of(rounds, step).map_err(|e| failed(&e))?, dt));
        }
        let m = material();
        let modal = ModalIntegrator::new(&mut body, 30, (m.mass_damping, m.stiffness_damping));
        let mut modal = modal.map_err(|e| failed(&e))?;
        let mut state = State::at_rest(rest);
        let Ok(modal_step) = Times::of::<Infallible>(rounds, || {
            modal.advance(steps[0].1, &external, &mut state.position, &mut state.velocity);
            Ok(())
        });
        let number = |x: f64| format!("{x:.2}");
        let mut row = vec![shape.name().into(), n.to_string(), body.mesh.tets.len().to_string()];
        row.extend([cells_force.median, cells_force.least, clustered_force.median, clustered_force.least].map(number));
        row.push(number(clustered_force.median / cells_force.median));
        row.extend([steps[0].0.median, steps[1].0.median, modal_step.median].map(number));
        row.push(format!("{:.1e}", apart / scale));
        row.push(format!("{:.2e}", steps[0].1));
        rows.push(row);
    }
    let columns = [
        "body",
        "nodes",
        "tets",
        "cells_force_us_median",
        "cells_force_us_min",
        "clustered_force_us_median",
        "clustered_force_us_min",
        "force_ratio_of_medians",
        "cells_step_us",
        "clustered_step_us",
        "modal_30_step_us",
        "largest_force_difference",
        "stable_step_s",
    ];
    results.table("table", &columns, &rows)
}
