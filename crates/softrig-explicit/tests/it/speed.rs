//! Timings, on request: `cargo test --release -p softrig-explicit speed -- --ignored --nocapture`.

use crate::constraint::Random;
use softrig::body::Body;
use softrig::force::ElasticModel;
use softrig::integrate::State;
use softrig::material::{Material, MaterialMap};
use softrig_explicit::clustered::Clustered;
use softrig_explicit::constraint::Constraints;
use softrig_explicit::elastic::ElasticLaw;
use softrig_explicit::element::{ElementWise, Warping};
use softrig_explicit::mass_point::{Energies, MassPoints};
use softrig_explicit::sample::{Shape, hanging_cubes, jelly_man};
use softrig_explicit::scheme::Scheme;
use softrig_explicit::stepper::{ForceLaw, Stepper};
use softrig_linalg::DofConstraints;
use std::time::Instant;

/// Median and minimum of `rounds` times [us].
pub fn time(rounds: usize, mut work: impl FnMut()) -> (f64, f64) {
    let mut all: Vec<f64> = (0..rounds)
        .map(|_| {
            let start = Instant::now();
            work();
            start.elapsed().as_secs_f64() * 1e6
        })
        .collect();
    all.sort_by(f64::total_cmp);
    (all[rounds / 2], all[0])
}

#[test]
#[ignore = "a measurement"]
fn speed_of_forces() {
    for shape in Shape::ALL {
        let mesh = shape.mesh();
        let map = MaterialMap::uniform(Material::default());
        let n = mesh.node_count();
        let mut body = Body::<f64>::new(mesh.clone(), &map, ElasticModel::Linear, DofConstraints::none(n)).unwrap();
        let mut clustered = Clustered::new(&mut body);
        let mut cells = ElementWise::<f64>::new(&mesh, &map, Warping::None).unwrap();
        let mut warped = ElementWise::<f64>::new(&mesh, &map, Warping::Stiffness).unwrap();
        let mut random = Random::new(9);
        let x: Vec<[f64; 3]> = mesh.nodes.iter().map(|p| p.map(|x| x + 0.01 * random.unit())).collect();
        let v = x.clone();
        let mut f = vec![[0.0; 3]; n];
        let a = time(3000, || clustered.internal_force(&x, &v, 0.0, &mut f));
        let b = time(3000, || cells.internal_force(&x, &v, 0.0, &mut f));
        let c = time(1000, || warped.internal_force(&x, &v, 0.0, &mut f));
        println!(
            "{:7} {} nodes {} tets {:?}: clustered {a:.1?} us, cells {b:.1?} us, ratio {:.2} {:.2}, warped {c:.1?} us",
            shape.name(),
            n,
            mesh.tets.len(),
            clustered.clusters(),
            a.0 / b.0,
            a.1 / b.1
        );
    }
}

#[test]
#[ignore = "a measurement"]
fn speed_of_cubes() {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(2).build().unwrap();
    pool.install(|| {
        for cubes in [790, 2990, 9990] {
            let (mesh, list) = hanging_cubes(cubes);
            // stiff and light enough to hang in columns of 250 cubes
            let energies = Energies { distance: 1e4, area: 2e3, volume: 1e4, damping: 1e-4, density: 100.0 };
            let mut body = MassPoints::<f64>::new(&mesh, &energies).unwrap();
            body.gravity = [0.0, -9.81, 0.0];
            let count = list.len();
            let mut set = Constraints::new(mesh.node_count());
            list.into_iter().for_each(|c| _ = set.add(c).unwrap());
            let mut state = State::at_rest(mesh.nodes.clone());
            let mass = body.mass().to_vec();
            let mut stepper = Stepper::new(Scheme::Verlet, &mass, &mesh.nodes, &mut body, 0.0).unwrap();
            let dt = stepper.limit();
            let mut f = state.position.clone();
            let force = time(500, || body.force(&state.position, &state.velocity, &mut f));
            let inverse = stepper.inverse_mass().to_vec();
            let mut next = state.clone();
            let constraint = time(500, || set.enforce(Scheme::Verlet, dt, &inverse, &mut next).unwrap());
            let step = time(1000, || _ = stepper.step(&mut body, Some(&mut set), &mut state, dt).unwrap());
            println!(
                "{} tets {count} constraints, limit {dt:.2e} s, {:?}: force {force:.0?} constraints {constraint:.0?} step {step:.0?} us",
                mesh.tets.len(),
                body.energy_counts()
            );
        }
    });
}

#[test]
#[ignore = "a measurement"]
fn speed_of_the_jelly_man() {
    let (character, mesh, bound) = jelly_man().unwrap();
    let m = Material { young_modulus: 2e4, mass_damping: 1.0, stiffness_damping: 0.0, ..Material::default() };
    let map = MaterialMap::uniform(m);
    let n = mesh.node_count();
    let body = Body::<f64>::new(mesh.clone(), &map, ElasticModel::Linear, DofConstraints::none(n)).unwrap();
    let mut internal = ElementWise::<f64>::new(&mesh, &map, Warping::Stiffness).unwrap();
    internal.refresh = 16;
    let mut law = ElasticLaw { internal, external: body.weight([0.0, -9.81, 0.0]), drag: body.drag.clone() };
    let free = bound.free_mass(&body.mass);
    let mut stepper = Stepper::new(Scheme::EulerCromer, &free, &mesh.nodes, &mut law, 1.0).unwrap();
    let clip = character.clips.iter().find(|c| c.name == "walk").unwrap();
    let dt = stepper.limit().min(1e-3);
    let mut state = State::at_rest(mesh.nodes.clone());
    let (mut locals, mut pose) = (Vec::new(), softrig::rig::Pose::default());
    println!(
        "{n} nodes {} tets {} bound, limit {:.2e} s, {} joints",
        mesh.tets.len(),
        bound.bound().len(),
        stepper.limit(),
        character.skeleton.joint_count()
    );
    for _ in 0..5 {
        let (median, least) = time(1000, || {
            clip.sample_into(&character.skeleton, clip.start + state.time % clip.duration(), &mut locals);
            character.skeleton.pose_into(&locals, &mut pose);
            bound.place(&pose, dt, &mut state);
            assert_eq!(stepper.step(&mut law, None, &mut state, dt).unwrap(), 1);
        });
        println!("median {median:.0} us, least {least:.0} us: 1,000 steps {:.3} s", median / 1e3);
    }
}
