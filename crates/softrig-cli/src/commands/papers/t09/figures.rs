//! Figures 4 and 5: displacements and stresses of the three methods under the same load.

use super::picture::{self, Look};
use super::{Job, Outcome, Results, body, failed, free_mass, material};
use softrig::body::Body;
use softrig::force::{CellStress, cell_stress};
use softrig::integrate::State;
use softrig::material::MaterialMap;
use softrig_explicit::clustered::Clustered;
use softrig_explicit::elastic::{ElasticLaw, InternalForce};
use softrig_explicit::element::{ElementWise, Warping};
use softrig_explicit::modal::ModalIntegrator;
use softrig_explicit::sample::Shape;
use softrig_explicit::scheme::Scheme;
use softrig_explicit::stepper::Stepper;
use softrig_explicit::stress::principal_strains;
use softrig_io::volume::{DataArray, VtuData, write_vtu};
use softrig_render::View;

/// Sideways and down: bends and twists what is held at its lowest nodes [m/s2].
const LOAD: [f64; 3] = [1.5, -1.0, 0.6];

pub fn run(job: &Job, results: &Results) -> Outcome {
    let seconds = if job.quick { 0.1 } else { 2.0 };
    let mut rows = Vec::new();
    for shape in Shape::ALL {
        let mut body = body(shape)?;
        let map = MaterialMap::uniform(material());
        let load: Vec<[f64; 3]> = body.weight(LOAD);
        let cells = ElementWise::new(&body.mesh, &map, Warping::None).map_err(|e| failed(&e))?;
        let clustered = Clustered::new(&mut body);
        let standard = advance(&body, Box::new(cells), &load, seconds)?;
        let clustered = advance(&body, Box::new(clustered), &load, seconds)?;
        let m = material();
        let modal = ModalIntegrator::new(&mut body, 30, (m.mass_damping, m.stiffness_damping));
        let mut modal = modal.map_err(|e| failed(&e))?;
        let mut other = State::at_rest(body.mesh.nodes.clone());
        for _ in 0..1000 {
            modal.advance(seconds / 1000.0, &load, &mut other.position, &mut other.velocity);
        }
        let states = [("standard", standard), ("clustered", clustered), ("modal, 30 modes", other.position)];
        let rest = &body.mesh.nodes;
        let length = |a: [f64; 3], b: [f64; 3]| (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f64>().sqrt();
        let moved = (0..rest.len()).map(|i| length(states[0].1[i], rest[i])).fold(0.0, f64::max);
        let stresses = states.each_ref().map(|s| cell_stress(&body.mesh, &map, &s.1));
        let reference = stresses[0].iter().map(|s| s.von_mises).fold(0.0, f64::max);
        let (mut differences, mut fields) = (Vec::new(), Vec::new());
        for (s, stress) in states.iter().zip(&stresses) {
            let apart: Vec<f64> = (0..rest.len()).map(|i| length(s.1[i], states[0].1[i])).collect();
            let of_cell: Vec<f64> = stress.iter().map(|s| s.von_mises).collect();
            let worst = of_cell.iter().zip(&stresses[0]).map(|(a, b)| (a - b.von_mises).abs()).fold(0.0, f64::max);
            rows.push(vec![
                shape.name().into(),
                s.0.replace(',', ""),
                format!("{moved:.4}"),
                format!("{:.2e}", apart.iter().fold(0.0f64, |m, a| m.max(*a)) / moved),
                format!("{:.2e}", apart.iter().sum::<f64>() / apart.len() as f64 / moved),
                format!("{:.1}", of_cell.iter().fold(0.0f64, |m, s| m.max(*s))),
                format!("{:.2e}", worst / reference),
            ]);
            differences.push(apart.iter().map(|a| *a as f32).collect::<Vec<f32>>());
            fields.push(picture::on_nodes(&body.mesh, &of_cell));
        }
        let show = |title, range, values: &[Vec<f32>], name: String| {
            let list: Vec<_> = states.iter().zip(values).map(|(s, v)| (s.0, &s.1[..], Some(v.clone()))).collect();
            picture::states(results, &name, &body.mesh, &Look { title, range, view: View::ThreeQuarter }, &list)
        };
        let largest = |v: &[Vec<f32>]| v.iter().flatten().fold(1e-9f32, |m, x| m.max(*x));
        let stress = [0.0, largest(&fields)];
        show("von Mises [Pa]", stress, &fields, format!("figure4_{}.png", shape.name()))?;
        let apart = [0.0, largest(&differences)];
        show("difference [m]", apart, &differences, format!("figure5_{}.png", shape.name()))?;
        write_fields(results, shape, &body, &states[0].1, &stresses[0])?;
    }
    let columns = [
        "body",
        "method",
        "largest_displacement_m",
        "largest_difference_to_standard",
        "mean_difference_to_standard",
        "largest_von_mises_pa",
        "largest_von_mises_difference",
    ];
    results.table("figures_4_and_5", &columns, &rows)
}

/// Where the body is after so many seconds of load from rest.
fn advance(
    body: &Body<f64>,
    internal: Box<dyn InternalForce<f64>>,
    load: &[[f64; 3]],
    seconds: f64,
) -> Result<Vec<[f64; 3]>, crate::failure::Failure> {
    let mut law = ElasticLaw { internal, external: load.to_vec(), drag: body.drag.clone() };
    let (mass, rest) = (free_mass(body), &body.mesh.nodes);
    let made = Stepper::new(Scheme::Verlet, &mass, rest, &mut law, material().mass_damping);
    let mut stepper = made.map_err(|e| failed(&e))?;
    let mut state = State::at_rest(rest.clone());
    stepper.start(&mut law, &mut state).map_err(|e| failed(&e))?;
    // the same steps for all methods, short enough that modes, which are exact in time, may be compared
    let steps = 4.0 * (seconds / stepper.limit()).ceil();
    for _ in 0..steps as usize {
        stepper.step(&mut law, None, &mut state, seconds / steps).map_err(|e| failed(&e))?;
    }
    Ok(state.position)
}

/// Displacement, von Mises stress and principal strains for ParaView.
fn write_fields(
    results: &Results,
    shape: Shape,
    body: &Body<f64>,
    position: &[[f64; 3]],
    stress: &[CellStress],
) -> Outcome {
    let path = results.path(&format!("{}.vtu", shape.name()))?;
    let displacement: Vec<f64> =
        position.iter().zip(&body.mesh.nodes).flat_map(|(x, p)| [x[0] - p[0], x[1] - p[1], x[2] - p[2]]).collect();
    let von_mises: Vec<f64> = stress.iter().map(|s| s.von_mises).collect();
    let principal: Vec<f64> = stress.iter().flat_map(|s| principal_strains(&s.strain)).collect();
    let point = [DataArray { name: "displacement [m]", components: 3, values: &displacement }];
    let cell = [
        DataArray { name: "von Mises stress [Pa]", components: 1, values: &von_mises },
        DataArray { name: "principal strains [-]", components: 3, values: &principal },
    ];
    let data = VtuData { positions: Some(position), point_data: &point, cell_data: &cell };
    let failed = |e: &std::io::Error| crate::failure::Failure::writing(&path, e);
    let mut bytes = Vec::new();
    write_vtu(&mut bytes, &body.mesh, &data).map_err(|e| failed(&e))?;
    std::fs::write(&path, bytes).map_err(|e| failed(&e))?;
    crate::ui::note(format_args!("wrote {}", path.display()));
    Ok(())
}
