//! Figure 1: the jelly man walks; and what holding nodes by forces costs in place.

use super::picture::{self, Look};
use super::{Job, Outcome, Results, failed};
use crate::failure::Failure;
use glam::DQuat;
use softrig::body::Body;
use softrig::force::{ElasticModel, ForceModel};
use softrig::integrate::State;
use softrig::material::{Material, MaterialMap};
use softrig::mesh::Embedding;
use softrig::rig::Pose;
use softrig_explicit::awake;
use softrig_explicit::elastic::ElasticLaw;
use softrig_explicit::element::{ElementWise, Warping};
use softrig_explicit::sample::jelly_man;
use softrig_explicit::scheme::Scheme;
use softrig_explicit::skeleton::{Driven, ForceForm, Loaded, SkeletonConstraints};
use softrig_explicit::stepper::{Stepper, StepperError};
use softrig_linalg::{DofConstraints, Scalar};
use softrig_render::View;
use std::time::Instant;

/// Steps from the rest shape to the first pose, not timed.
const LEAD: i64 = 1000;
/// Length of a step [s].
const DT: f64 = 1e-3;

/// What the jelly man is made of, and how often it walks.
struct Held<'a> {
    body: &'a Body<f64>,
    map: &'a MaterialMap,
    bound: &'a SkeletonConstraints,
    steps: i64,
    rounds: usize,
}

/// What came of it.
struct Outcomes {
    /// Of each round, ascending [s].
    seconds: Vec<f64>,
    end: Vec<[f64; 3]>,
    miss: f64,
    limit: f64,
}

impl Held<'_> {
    /// Walks with bound nodes held exactly, in numbers `R` with `N` cells side by side, rotations to rounding every `refresh` steps.
    fn run<R: Scalar, const N: usize>(
        &self,
        refresh: u32,
        pose_at: &mut (dyn FnMut(i64, &mut Pose) + Send),
    ) -> Result<Outcomes, Failure> {
        let cast = |list: &[[f64; 3]]| -> Vec<[R; 3]> { list.iter().map(|p| p.map(R::from_f64)).collect() };
        let (body, rest) = (self.body, cast(&self.body.mesh.nodes));
        let made = ElementWise::<R, N>::side_by_side(&body.mesh, self.map, Warping::Stiffness);
        let mut internal = made.map_err(|e| failed(&e))?;
        internal.refresh = refresh;
        let drag = body.drag.iter().map(|d| R::from_f64(*d)).collect();
        let mut law = ElasticLaw { internal, external: cast(&body.weight([0.0, -9.81, 0.0])), drag };
        let mass: Vec<R> = self.bound.free_mass(&body.mass).into_iter().map(R::from_f64).collect();
        let made = Stepper::new(Scheme::EulerCromer, &mass, &rest, &mut law, self.map.get(0).mass_damping);
        let mut stepper = made.map_err(|e| failed(&e))?;
        let (mut pose, bound, steps) = (Pose::default(), self.bound, self.steps);
        let (mut seconds, mut state) = (Vec::new(), State::default());
        for _ in 0..self.rounds {
            state = State::at_rest(rest.clone());
            // rotations of the round before belong to its last pose
            law.internal.restore(&[]);
            let walk = || {
                let mut start = Instant::now();
                for k in -LEAD..steps {
                    if k == 0 {
                        start = Instant::now();
                    }
                    pose_at(k, &mut pose);
                    bound.place(&pose, DT, &mut state);
                    stepper.step(&mut law, None, &mut state, DT)?;
                }
                Ok(start.elapsed().as_secs_f64())
            };
            seconds.push(awake(walk).map_err(|e: StepperError| failed(&e))?);
        }
        seconds.sort_by(f64::total_cmp);
        let end = state.position.iter().map(|p| p.map(Scalar::to_f64)).collect();
        Ok(Outcomes { seconds, end, miss: self.bound.largest_miss(&pose, &state.position), limit: stepper.limit() })
    }
}

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
        let mut internal = ElementWise::<f64>::new(&body.mesh, &map, Warping::Stiffness).map_err(|e| failed(&e))?;
        internal.refresh = refresh;
        Ok(ElasticLaw { internal, external: body.weight([0.0, -9.81, 0.0]), drag: body.drag.clone() })
    };
    let rest = &body.mesh.nodes;
    let steps = if job.quick { 20 } else { 1000 };
    let rounds = if job.quick { 1 } else { 5 };
    // held exactly; rotations to rounding in every step, and in every sixteenth; and that in f32, eight cells at a time
    let held = Held { body: &body, map: &map, bound: &bound, steps, rounds };
    let mut rows = Vec::new();
    let every = held.run::<f64, 4>(1, &mut pose_at)?;
    let some = held.run::<f64, 4>(16, &mut pose_at)?;
    let single = held.run::<f32, 8>(16, &mut pose_at)?;
    let length = |a: [f64; 3], b: [f64; 3]| (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f64>().sqrt();
    let apart = |x: &[[f64; 3]]| x.iter().zip(&some.end).map(|(a, b)| length(*a, *b)).fold(0.0, f64::max);
    for (name, run) in [
        ("exact; f64; rotations to rounding every step", &every),
        ("exact; f64; rotations to rounding every 16 steps", &some),
        ("exact; f32; rotations to rounding every 16 steps", &single),
    ] {
        rows.push(vec![
            name.into(),
            steps.to_string(),
            format!("{:.4}", run.seconds[run.seconds.len() / 2]),
            format!("{:.4}", run.seconds[0]),
            format!("{:.2e}", run.miss),
            format!("{:.2e}", apart(&run.end)),
            format!("{:.2e}", run.limit),
        ]);
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
        rows.push(vec![
            format!("forces of eq. 9 {name}"),
            steps.to_string(),
            format!("{seconds:.4}"),
            format!("{seconds:.4}"),
            format!("{miss:.2e}"),
            format!("{:.2e}", apart(&state.position)),
            format!("{:.2e}", stepper.limit()),
        ]);
    }
    rows.push(vec![format!("{} nodes; {} tets; {} bound", n, body.mesh.tets.len(), bound.bound().len())]);
    rows[8].resize(7, String::new());
    let columns = [
        "held",
        "steps",
        "seconds_median",
        "seconds_min",
        "largest_miss_m",
        "largest_difference_to_exact_f64_m",
        "stable_step_s",
    ];
    results.table("jelly_man", &columns, &rows)?;
    // the skin, and the cells it lies in
    let points: Vec<[f64; 3]> = character.meshes.iter().flat_map(|m| m.positions.iter().copied()).collect();
    let embedding = Embedding::embed(&body.mesh, &points, None).map_err(|e| failed(&e))?;
    let skin = |nodes: &[[f64; 3]]| {
        let mut all = vec![[0.0; 3]; points.len()];
        embedding.apply(nodes, &mut all);
        let mut rest = &all[..];
        let mut take = |count: usize| {
            let (own, after) = rest.split_at(count);
            rest = after;
            own.to_vec()
        };
        character.meshes.iter().map(|m| take(m.positions.len())).collect::<Vec<_>>()
    };
    let (standing, walking) = (skin(rest), skin(&some.end));
    let view = View::ThreeQuarter;
    picture::skins(results, "figure1.png", &character, view, &[("rest", &standing), ("walking", &walking)])?;
    let look = Look { title: "", range: [0.0, 1.0], view };
    let shown = [("rest", &rest[..], None), ("walking", &some.end[..], None)];
    picture::states(results, "figure1_cells.png", &body.mesh, &look, &shown)
}
