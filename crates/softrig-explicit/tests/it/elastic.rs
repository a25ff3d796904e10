//! Clustered rows, single cells and the core's own model are the same elasticity.

use crate::constraint::Random;
use softrig::body::Body;
use softrig::force::{ElasticModel, ForceModel, Increment};
use softrig::material::{Material, MaterialMap};
use softrig::mesh::VolumeMesh;
use softrig_explicit::clustered::Clustered;
use softrig_explicit::element::{ElementWise, Warping};
use softrig_explicit::sample::{Shape, five_tets};
use softrig_linalg::{BlockCsr, DofConstraints, Scalar};

fn body<R: Scalar>(mesh: &VolumeMesh, map: &MaterialMap, model: ElasticModel) -> Body<R> {
    Body::new(mesh.clone(), map, model, DofConstraints::none(mesh.node_count())).unwrap()
}

/// Positions and velocities: the rest shape, stirred.
fn stirred(mesh: &VolumeMesh, by: f64, random: &mut Random) -> (Vec<[f64; 3]>, Vec<[f64; 3]>) {
    let x = mesh.nodes.iter().map(|p| {
        let r = random.point();
        std::array::from_fn(|k| p[k] + by * r[k])
    });
    let x = x.collect();
    let v = mesh.nodes.iter().map(|_| random.point()).collect();
    (x, v)
}

fn largest(f: &[[f64; 3]]) -> f64 {
    f.iter().flatten().fold(0.0, |m, x| m.max(x.abs()))
}

fn difference(a: &[[f64; 3]], b: &[[f64; 3]]) -> f64 {
    a.iter().flatten().zip(b.iter().flatten()).fold(0.0, |m, (a, b)| f64::max(m, (a - b).abs()))
}

/// Several parts with copies, one part, and cells of many materials.
fn bodies() -> Vec<(VolumeMesh, MaterialMap)> {
    let mut out: Vec<_> = Shape::ALL
        .iter()
        .map(|s| (s.mesh(), MaterialMap::uniform(Material { stiffness_damping: 0.004, ..Material::default() })))
        .collect();
    let mut random = Random::new(5);
    let mut mesh = five_tets([9, 12, 25], false, |p| [0.3 * p[0], 0.4 * p[1], 0.8 * p[2]]);
    let h = 0.2 * 0.032;
    mesh.nodes.iter_mut().for_each(|p| *p = p.map(|x| x + h * (random.unit() - 0.5)));
    let m = |young_modulus: f64, stiffness_damping: f64| Material {
        young_modulus,
        stiffness_damping,
        ..Material::default()
    };
    let map = MaterialMap {
        materials: vec![m(1e4, 0.01), m(3e5, 0.0), m(5e4, 0.002)],
        of_cell: (0..mesh.tets.len()).map(|_| random.below(3) as u32).collect(),
        stiffness_factor: Vec::new(),
    };
    out.push((mesh, map));
    out
}

/// [Tang2009 §3] "lossless": rows, cells and the core's assembled model give the same forces, damping and all.
#[test]
fn clustered_and_element_forces_are_equal() {
    let mut random = Random::new(1);
    for (mesh, map) in bodies() {
        let mut body = body::<f64>(&mesh, &map, ElasticModel::Linear);
        let mut clustered = Clustered::new(&mut body);
        let mut cells = ElementWise::<f64>::new(&mesh, &map, Warping::None).unwrap();
        for _ in 0..3 {
            let (x, v) = stirred(&mesh, 0.02, &mut random);
            let n = mesh.node_count();
            let (mut a, mut b, mut c) = (vec![[0.0; 3]; n], vec![[1.0; 3]; n], vec![[2.0; 3]; n]);
            clustered.internal_force(&x, &v, 0.001, &mut a);
            cells.internal_force(&x, &v, 0.001, &mut b);
            body.model.linearise(&x);
            let increment = Increment { displacement: None, velocity: Some(&v), damping: 0.001 };
            let energy = body.model.force(&x, increment, &mut c);
            let scale = largest(&c);
            assert!(scale > 1.0);
            assert!(difference(&a, &c) <= 1e-12 * scale, "{} {scale}", difference(&a, &c));
            assert!(difference(&b, &c) <= 1e-12 * scale, "{} {scale}", difference(&b, &c));
            // through the trait, with an increment, energies too
            let d: Vec<[f64; 3]> = v.iter().map(|v| v.map(|v| 0.01 * v)).collect();
            let increment = Increment { displacement: Some(&d), velocity: Some(&v), damping: 0.001 };
            body.model.force(&x, increment, &mut c);
            for model in [&mut clustered as &mut dyn ForceModel<f64>, &mut cells] {
                model.linearise(&x);
                let e = model.force(&x, increment, &mut a);
                assert!((e - energy).abs() <= 1e-12 * energy, "{e} {energy}");
                assert!(difference(&a, &c) <= 1e-12 * largest(&c), "{}", difference(&a, &c));
            }
            let mut k = [(); 3].map(|()| BlockCsr::zero(body.pattern.clone()));
            body.model.stiffness(2.0, 0.1, &mut k[0]);
            clustered.stiffness(2.0, 0.1, &mut k[1]);
            cells.stiffness(2.0, 0.1, &mut k[2]);
            let size = k[0].values.as_flattened().iter().fold(0.0, |m: f64, x| m.max(x.abs()));
            for other in &k[1..] {
                for (a, b) in k[0].values.as_flattened().iter().zip(other.values.as_flattened()) {
                    assert!((a - b).abs() <= 1e-12 * size);
                }
            }
        }
    }
}

/// Stiffness warping is the core's corotated model, also for large turns taken step by step.
#[test]
fn warped_cells_are_corotated() {
    let mut random = Random::new(2);
    for (mesh, map) in bodies() {
        let mut body = body::<f64>(&mesh, &map, ElasticModel::Corotated);
        let mut cells = ElementWise::<f64>::new(&mesh, &map, Warping::Stiffness).unwrap();
        for step in 1..5 {
            let (x, v) = stirred(&mesh, 0.002, &mut random);
            let (s, c) = (0.4 * f64::from(step)).sin_cos();
            let x: Vec<[f64; 3]> = x.iter().map(|p| [c * p[0] - s * p[1], s * p[0] + c * p[1], p[2]]).collect();
            let n = mesh.node_count();
            let (mut a, mut b) = (vec![[0.0; 3]; n], vec![[1.0; 3]; n]);
            body.model.linearise(&x);
            let d: Vec<[f64; 3]> = v.iter().map(|v| v.map(|v| 0.001 * v)).collect();
            let increment = Increment { displacement: Some(&d), velocity: Some(&v), damping: 0.0 };
            let energy = body.model.force(&x, increment, &mut a);
            cells.linearise(&x);
            let e = cells.force(&x, increment, &mut b);
            assert!((e - energy).abs() <= 1e-10 * energy, "{e} {energy}");
            assert!(difference(&a, &b) <= 1e-11 * largest(&a), "{} {}", difference(&a, &b), largest(&a));
            let history = cells.history();
            cells.save();
            cells.restore(&[]);
            assert_ne!(history, cells.history());
            cells.roll_back();
            assert_eq!(history, cells.history());
            cells.restore(&history);
            assert_eq!(history, cells.history());
        }
    }
}

/// Rotations that follow by one step a force stay with those found to rounding: a body that turns by θ between forces misses by some θ³ of
/// its strain's forces, and not at all after the next exact one.
#[test]
fn one_step_a_force_follows_a_turning_body() {
    let mut random = Random::new(12);
    let mesh = Shape::Cube.mesh();
    let map = MaterialMap::uniform(Material::default());
    let (shaken, v) = stirred(&mesh, 0.02, &mut random);
    for (turn, most) in [(0.005, 2e-6), (0.02, 1e-4)] {
        let mut exact = ElementWise::<f64>::new(&mesh, &map, Warping::Stiffness).unwrap();
        let mut lazy = ElementWise::<f64>::new(&mesh, &map, Warping::Stiffness).unwrap();
        lazy.refresh = 50;
        let (mut a, mut b) = (vec![[0.0; 3]; mesh.node_count()], vec![[0.0; 3]; mesh.node_count()]);
        let mut worst = 0.0f64;
        for k in 0..101 {
            let (s, c) = (turn * f64::from(k)).sin_cos();
            let x: Vec<[f64; 3]> = shaken.iter().map(|p| [c * p[0] - s * p[1], s * p[0] + c * p[1], p[2]]).collect();
            exact.internal_force(&x, &v, 0.0, &mut a);
            lazy.internal_force(&x, &v, 0.0, &mut b);
            let apart = difference(&a, &b) / largest(&a);
            worst = worst.max(apart);
            assert!(k % 50 != 0 || apart < 1e-11, "{k}: {apart}");
        }
        assert!(worst > 1e-12 && worst < most, "{turn}: {worst}");
    }
}

/// The same bits on one thread and on three; f32 is f64 to its own rounding.
#[test]
fn threads_do_not_show() {
    let mut random = Random::new(3);
    let (mesh, map) = bodies().pop().unwrap();
    let (x, v) = stirred(&mesh, 0.002, &mut random);
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let mut clustered = Clustered::new(&mut body::<f64>(&mesh, &map, ElasticModel::Linear));
            let mut cells = ElementWise::<f64>::new(&mesh, &map, Warping::Stiffness).unwrap();
            let mut out = vec![vec![[0.0; 3]; x.len()]; 2];
            clustered.internal_force(&x, &v, 0.0, &mut out[0]);
            cells.internal_force(&x, &v, 0.0, &mut out[1]);
            out
        })
    };
    let one = run(1);
    assert!(largest(&one[0]) > 0.0);
    assert_eq!(one, run(3));
    let single = |p: &[[f64; 3]]| p.iter().map(|p| p.map(|x| x as f32)).collect::<Vec<_>>();
    let mut clustered = Clustered::new(&mut body::<f32>(&mesh, &map, ElasticModel::Linear));
    let mut f = vec![[0.0f32; 3]; x.len()];
    clustered.internal_force(&single(&x), &single(&v), 0.0, &mut f);
    let f: Vec<_> = f.iter().map(|f| f.map(f64::from)).collect();
    // positions of 1 m carry 6e-8 m each, against displacements of 2e-3 m
    assert!(difference(&f, &one[0]) < 1e-3 * largest(&one[0]), "{}", difference(&f, &one[0]));
}
