//! Figure 1: the jelly man walks; and what holding nodes by forces costs in place.

use super::picture::{self, Look};
use super::{Job, Outcome, Results, failed};
use glam::DQuat;
use softrig::body::Body;
use softrig::force::{ElasticModel, ForceModel};
use softrig::integrate::State;
use softrig::material::{Material, MaterialMap};
use softrig::rig::Pose;
use softrig_explicit::elastic::ElasticLaw;
use softrig_explicit::element::{ElementWise, Warping};
use softrig_explicit::sample::jelly_man;
use softrig_explicit::scheme::Scheme;
use softrig_explicit::skeleton::{Driven, ForceForm, Loaded};
use softrig_explicit::stepper::Stepper;
use softrig_linalg::DofConstraints;
use softrig_render::View;
use std::time::Instant;

/// Steps from the rest shape to the first pose, not timed.
const LEAD: i64 = 1000;
/// Length of a step [s].
const DT: f64 = 1e-3;

pub fn run(job: &Job, results: &Results) -> Outcome {
    let (character, mesh, bound) = jelly_man().map_err(|e| failed(&e))?;
    let m = Material { young_modulus: 2e4, mass_damping: 1.0, stiffness_damping: 0.0, ..Material::default() };
    let map = MaterialMap::uniform(m);
    let n = mesh.node_count();
    let body = Body::<f64>::new(mesh, &map, ElasticModel::Linear, DofConstraints::none(n)).map_err(|e| failed(&e))?;
    let Some(clip) = character.clips.iter().find(|c| c.name == "walk") else { return Ok(()) };
    let skeleton = &character.skeleton;
    let (mut locals, mut scratch) = (Vec::new(), Pose::default());
    let standing = skeleton.rest_locals();
    let mut pose_at = |k: i64, pose: &mut Pose| {
        let t = (k.max(0) as f64 * DT).rem_euclid(clip.duration());
        clip.sample_into(skeleton, clip.start + t, &mut locals);
        if k < 0 {
            // from the rest shape to the first pose of the clip, smoothly
            let s = 1.0 + k as f64 / LEAD as f64;
            let s = s * s * (3.0 - 2.0 * s);
            for (to, from) in locals.iter_mut().zip(&standing) {
                let (a, b) = (DQuat::from_array(from.rotation), DQuat::from_array(to.rotation));
                to.rotation = a.slerp(b, s).to_array();
                to.translation =
                    std::array::from_fn(|c| from.translation[c] + s * (to.translation[c] - from.translation[c]));
            }
        }
        skeleton.pose_into(&locals, pose);
    };
    let law = |refresh: u32| {
        let mut internal = ElementWise::new(&body.mesh, &map, Warping::Stiffness).map_err(|e| failed(&e))?;
        internal.refresh = refresh;
        Ok(ElasticLaw { internal, external: body.weight([0.0, -9.81, 0.0]), drag: body.drag.clone() })
    };
    let rest = &body.mesh.nodes;
    let steps = if job.quick { 20 } else { 1000 };
    let rounds = if job.quick { 1 } else { 5 };
    // held exactly; rotations to rounding in every step, and in every sixteenth
    let mut ends = Vec::new();
    let mut rows = Vec::new();
    for refresh in [1, 16] {
        let mut law = law(refresh)?;
        let made = Stepper::new(Scheme::EulerCromer, &bound.free_mass(&body.mass), rest, &mut law, m.mass_damping);
        let mut stepper = made.map_err(|e| failed(&e))?;
        let mut times = Vec::new();
        let mut state = State::at_rest(rest.clone());
        for _ in 0..rounds {
            state = State::at_rest(rest.clone());
            // rotations of the round before belong to its last pose
            law.internal.restore(&[]);
            for k in -LEAD..0 {
                pose_at(k, &mut scratch);
                bound.place(&scratch, DT, &mut state);
                stepper.step(&mut law, None, &mut state, DT).map_err(|e| failed(&e))?;
            }
            let start = Instant::now();
            for k in 0..steps {
                pose_at(k, &mut scratch);
                bound.place(&scratch, DT, &mut state);
                stepper.step(&mut law, None, &mut state, DT).map_err(|e| failed(&e))?;
            }
            times.push(start.elapsed().as_secs_f64());
        }
        times.sort_by(f64::total_cmp);
        let miss = bound.largest_miss(&scratch, &state.position);
        rows.push(vec![
            format!("exact; rotations to rounding every {refresh} steps"),
            steps.to_string(),
            format!("{:.4}", times[times.len() / 2]),
            format!("{:.4}", times[0]),
            format!("{miss:.2e}"),
            String::from("0"),
            format!("{:.2e}", stepper.limit()),
        ]);
        ends.push(state.position);
    }
    // held by the forces of eq. 9: added to weight and elastic forces as in eq. 5, balancing them, and pulled back to the pose as well
    let (printed, complete) = (ForceForm::Printed, ForceForm::Complete);
    let forms = [
        ("as printed; added to the other forces", printed, false, 0.0),
        ("complete; added to the other forces", complete, false, 0.0),
        ("as printed; in place of the other forces", printed, true, 0.0),
        ("complete; in place of the other forces", complete, true, 0.0),
        ("complete; in place of the other forces; corrected at 100/s", complete, true, 100.0),
    ];
    for (name, form, alone, rate) in forms {
        let mut law = law(16)?;
        let made = Stepper::new(Scheme::EulerCromer, &bound.free_mass(&body.mass), rest, &mut law, m.mass_damping);
        let mut lead = made.map_err(|e| failed(&e))?;
        let made = Stepper::new(Scheme::EulerCromer, &body.mass, rest, &mut law, m.mass_damping);
        let mut stepper = made.map_err(|e| failed(&e))?;
        let mut state = State::at_rest(rest.clone());
        for k in -LEAD..-1 {
            pose_at(k, &mut scratch);
            bound.place(&scratch, DT, &mut state);
            lead.step(&mut law, None, &mut state, DT).map_err(|e| failed(&e))?;
        }
        let mut poses = [Pose::default(), Pose::default(), Pose::default()];
        pose_at(-1, &mut poses[0]);
        bound.place(&poses[0], DT, &mut state);
        let mut before = state.position.clone();
        pose_at(0, &mut poses[1]);
        bound.place(&poses[1], DT, &mut state);
        let mut load = vec![[0.0; 3]; n];
        let mut miss = 0.0f64;
        let start = Instant::now();
        for k in 0..steps {
            pose_at(k + 1, &mut poses[2]);
            load.fill([0.0; 3]);
            let [a, b, c] = &poses;
            bound.add_forces(form, [a, b, c], DT, &body.mass, [&before, &state.position], &mut load);
            if rate > 0.0 {
                bound.add_corrections(rate, [a, b], DT, &body.mass, &state, &mut load);
            }
            before.clone_from(&state.position);
            let driven = &mut Driven { law: &mut law, bound: &bound, load: &load };
            let done = if alone {
                stepper.step(driven, None, &mut state, DT)
            } else {
                stepper.step(&mut Loaded { law: driven.law, load: &load }, None, &mut state, DT)
            };
            done.map_err(|e| failed(&e))?;
            poses.rotate_left(1);
            miss = miss.max(bound.largest_miss(&poses[1], &state.position));
        }
        let seconds = start.elapsed().as_secs_f64();
        let length = |a: [f64; 3], b: [f64; 3]| (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f64>().sqrt();
        let apart = state.position.iter().zip(&ends[1]).map(|(a, b)| length(*a, *b)).fold(0.0, f64::max);
        rows.push(vec![
            format!("forces of eq. 9 {name}"),
            steps.to_string(),
            format!("{seconds:.4}"),
            format!("{seconds:.4}"),
            format!("{miss:.2e}"),
            format!("{apart:.2e}"),
            format!("{:.2e}", stepper.limit()),
        ]);
    }
    rows.push(vec![format!("{} nodes; {} tets; {} bound", n, body.mesh.tets.len(), bound.bound().len())]);
    rows[7].resize(7, String::new());
    let columns = [
        "held",
        "steps",
        "seconds_median",
        "seconds_min",
        "largest_miss_m",
        "largest_difference_to_exact_m",
        "stable_step_s",
    ];
    results.table("jelly_man", &columns, &rows)?;
    let look = Look { title: "", range: [0.0, 1.0], view: View::ThreeQuarter };
    let shown = [("rest", &rest[..], None), ("walking", &ends[1][..], None)];
    picture::states(results, "figure1.png", &body.mesh, &look, &shown)
}
