//! Mass points with distance, area and volume energies.

use crate::constraint::Random;
use softrig::integrate::State;
use softrig::mesh::VolumeMesh;
use softrig_explicit::constraint::Constraints;
use softrig_explicit::mass_point::{Energies, MassPointError, MassPoints};
use softrig_explicit::sample::{Shape, five_tets, hanging_cubes};
use softrig_explicit::scheme::Scheme;
use softrig_explicit::stepper::{ForceLaw, Stepper};
use std::collections::BTreeSet;

/// The energy by its definition: sizes of every edge, surface triangle and tetrahedron against those at rest.
fn energy(mesh: &VolumeMesh, e: &Energies, x: &[[f64; 3]]) -> f64 {
    let sub = |a: [f64; 3], b: [f64; 3]| -> [f64; 3] { std::array::from_fn(|k| a[k] - b[k]) };
    let cross = |a: [f64; 3], b: [f64; 3]| -> [f64; 3] {
        std::array::from_fn(|k| a[(k + 1) % 3] * b[(k + 2) % 3] - a[(k + 2) % 3] * b[(k + 1) % 3])
    };
    let dot = |a: [f64; 3], b: [f64; 3]| (0..3).map(|k| a[k] * b[k]).sum::<f64>();
    let length = |p: &[[f64; 3]], a: u32, b: u32| {
        dot(sub(p[b as usize], p[a as usize]), sub(p[b as usize], p[a as usize])).sqrt()
    };
    let area = |p: &[[f64; 3]], t: [u32; 3]| {
        let [a, b, c] = t.map(|n| p[n as usize]);
        let n = cross(sub(b, a), sub(c, a));
        0.5 * dot(n, n).sqrt()
    };
    let volume = |p: &[[f64; 3]], t: [u32; 4]| {
        let [a, b, c, d] = t.map(|n| p[n as usize]);
        dot(sub(b, a), cross(sub(c, a), sub(d, a))) / 6.0
    };
    let part = |k: f64, now: f64, rest: f64| 0.5 * k * ((now - rest) / rest).powi(2);
    let mut edges = BTreeSet::new();
    let mut sum = 0.0;
    for t in &mesh.tets {
        sum += part(e.volume, volume(x, *t), volume(&mesh.nodes, *t));
        for i in 0..4 {
            for j in 0..i {
                edges.insert([t[i].min(t[j]), t[i].max(t[j])]);
            }
        }
    }
    for [a, b] in edges {
        sum += part(e.distance, length(x, a, b), length(&mesh.nodes, a, b));
    }
    let surface = softrig::mesh::boundary_faces(mesh);
    for t in surface.triangles.iter() {
        sum += part(e.area, area(x, *t), area(&mesh.nodes, *t));
    }
    sum
}

fn stirred(mesh: &VolumeMesh, by: f64, seed: u8) -> Vec<[f64; 3]> {
    let mut random = Random::new(seed);
    let x = mesh.nodes.iter().map(|p| {
        let r = random.point();
        std::array::from_fn(|k| p[k] + by * r[k])
    });
    x.collect()
}

/// Forces are minus the derivative of the energy, and the damping takes energy away.
#[test]
fn forces_are_the_gradient_of_the_energies() {
    let mesh = five_tets([2, 2, 3], false, |p| p);
    let e = Energies { distance: 3.0, area: 2.0, volume: 5.0, damping: 0.0, density: 1000.0 };
    let mut body = MassPoints::<f64>::new(&mesh, &e).unwrap();
    let mut x = stirred(&mesh, 0.1, 4);
    let zero = vec![[0.0; 3]; x.len()];
    let mut f = zero.clone();
    body.force(&x, &zero, &mut f);
    let scale = f.iter().flatten().fold(0.0f64, |m, f| m.max(f.abs()));
    for node in 0..x.len() {
        for k in 0..3 {
            let (at, h) = (x[node][k], 1e-5);
            x[node][k] = at + h;
            let up = energy(&mesh, &e, &x);
            x[node][k] = at - h;
            let down = energy(&mesh, &e, &x);
            x[node][k] = at;
            let slope = (up - down) / (2.0 * h);
            assert!((f[node][k] + slope).abs() < 1e-7 * scale, "{} {slope}", f[node][k]);
        }
    }
    let mut damped = MassPoints::<f64>::new(&mesh, &Energies { damping: 0.01, ..e }).unwrap();
    let v = stirred(&mesh, 1.0, 6);
    let mut g = zero;
    damped.force(&x, &v, &mut g);
    let power: f64 = (0..x.len()).map(|i| (0..3).map(|k| (g[i][k] - f[i][k]) * v[i][k]).sum::<f64>()).sum();
    assert!(power < -1e-3, "{power}");
}

/// A free body, deformed and thrown: its momentum after ten thousand steps is that at the start, to rounding, with several parts and joints.
#[test]
fn momentum_is_kept_over_ten_thousand_steps() {
    let (mesh, list) = hanging_cubes(120);
    let mut body = MassPoints::<f64>::new(&mesh, &Energies::default()).unwrap();
    let mass = body.mass().to_vec();
    let mut set = Constraints::new(mesh.node_count());
    // joints only: nails hold momentum of their own
    list.into_iter().filter(|c| c.kind() != "nail").for_each(|c| _ = set.add(c).unwrap());
    let mut state = State::at_rest(stirred(&mesh, 0.01, 8));
    state.velocity = stirred(&mesh, 1.0, 9);
    let momentum =
        |v: &[[f64; 3]]| -> [f64; 3] { std::array::from_fn(|k| mass.iter().zip(v).map(|(m, v)| m * v[k]).sum()) };
    let before = momentum(&state.velocity);
    let mut stepper = Stepper::new(Scheme::Verlet, &mass, &mesh.nodes, &mut body, 0.0).unwrap();
    stepper.start(&mut body, &mut state).unwrap();
    let dt = stepper.limit().min(1e-3);
    for _ in 0..10_000 {
        stepper.step(&mut body, Some(&mut set), &mut state, dt).unwrap();
    }
    // each step rounds every node's velocity a few times, by at most half an ulp of the fastest
    let total: f64 = mass.iter().sum();
    let fastest = state.velocity.iter().flatten().fold(10.0f64, |m, v| m.max(v.abs()));
    for (a, b) in momentum(&state.velocity).iter().zip(before) {
        assert!((a - b).abs() < 1e4 * f64::EPSILON * fastest * total, "{a} {b} of {total} kg");
    }
}

/// Steps of a body of several parts are the same on one thread and on two.
#[test]
fn threads_do_not_show_in_steps() {
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let (mesh, list) = hanging_cubes(900);
            let mut body = MassPoints::<f64>::new(&mesh, &Energies::default()).unwrap();
            body.gravity = [0.0, -9.81, 0.0];
            let mut set = Constraints::new(mesh.node_count());
            list.into_iter().for_each(|c| _ = set.add(c).unwrap());
            let mut state = State::at_rest(mesh.nodes.clone());
            let mass = body.mass().to_vec();
            let mut stepper = Stepper::new(Scheme::Verlet, &mass, &mesh.nodes, &mut body, 0.0).unwrap();
            let dt = stepper.limit();
            for _ in 0..20 {
                stepper.step(&mut body, Some(&mut set), &mut state, dt).unwrap();
            }
            state
        })
    };
    assert_eq!(run(1), run(2));
}

/// The spectrum by power iteration is that of the same stiffness, found by differences and a dense eigensolver.
#[test]
fn the_limit_of_a_body_is_that_of_its_operator() {
    let mesh = five_tets([2, 1, 1], false, |p| p);
    let mut body = MassPoints::<f64>::new(&mesh, &Energies { damping: 0.0, ..Energies::default() }).unwrap();
    let mass = body.mass().to_vec();
    let n = 3 * mesh.node_count();
    let mut a = faer::Mat::<f64>::zeros(n, n);
    let zero = vec![[0.0; 3]; mesh.node_count()];
    for j in 0..n {
        let mut column = vec![0.0; n];
        for s in [1.0, -1.0] {
            let mut x = mesh.nodes.clone();
            x[j / 3][j % 3] += s * 1e-6;
            let mut f = zero.clone();
            body.force(&x, &zero, &mut f);
            (0..n).for_each(|i| column[i] -= s * f[i / 3][i % 3] / 2e-6);
        }
        (0..n).for_each(|i| a[(i, j)] = column[i] / (mass[i / 3] * mass[j / 3]).sqrt());
    }
    let values = a.self_adjoint_eigenvalues(faer::Side::Lower).unwrap();
    let exact = values.last().unwrap().sqrt();
    let stepper = Stepper::new(Scheme::Verlet, &mass, &mesh.nodes, &mut body, 0.0).unwrap();
    let found = stepper.spectrum().frequency;
    assert!((found - exact).abs() < 1e-3 * exact, "{found} {exact}");
}

#[test]
fn what_is_no_body_is_refused() {
    let mesh = Shape::Cube.mesh();
    let e = Energies::default();
    let new = |mesh: &VolumeMesh, e: &Energies| MassPoints::<f64>::new(mesh, e).err().unwrap();
    let mut flat = mesh.clone();
    flat.tets[3].swap(0, 1);
    assert!(matches!(new(&flat, &e), MassPointError::BadCell { cell: 3, .. }));
    let mut missing = mesh.clone();
    missing.tets[5][0] = 9999;
    assert!(matches!(new(&missing, &e), MassPointError::MissingNode { cell: 5, node: 9999, .. }));
    assert_eq!(new(&VolumeMesh::default(), &e), MassPointError::Empty);
    let bad = new(&mesh, &Energies { density: 0.0, ..e });
    assert!(matches!(bad, MassPointError::OutOfRange { field: "density", .. }));
    let bad = new(&mesh, &Energies { area: f64::NAN, ..e });
    assert!(matches!(bad, MassPointError::OutOfRange { field: "area", .. }));
}
