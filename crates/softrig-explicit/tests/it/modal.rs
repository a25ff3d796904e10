//! Modes against a dense eigensolver, and all of them against the whole.

use crate::constraint::Random;
use faer::{Mat, Side};
use softrig::body::Body;
use softrig::force::ElasticModel;
use softrig::integrate::State;
use softrig::material::{Material, MaterialMap};
use softrig::mesh::VolumeMesh;
use softrig_explicit::clustered::Clustered;
use softrig_explicit::modal::{ModalError, ModalIntegrator, Modes};
use softrig_explicit::sample::five_tets;
use softrig_explicit::scheme::Scheme;
use softrig_explicit::stepper::Stepper;
use softrig_linalg::DofConstraints;

fn bar() -> VolumeMesh {
    five_tets([6, 2, 2], false, |p| [0.6 * p[0], 0.2 * p[1], 0.2 * p[2]])
}

fn body(mesh: &VolumeMesh, held: bool) -> Body<f64> {
    let mask = mesh.nodes.iter().map(|p| held && p[0] == 0.0).collect();
    let m = Material { mass_damping: 0.5, stiffness_damping: 0.002, ..Material::default() };
    Body::new(mesh.clone(), &MaterialMap::uniform(m), ElasticModel::Linear, DofConstraints::from_mask(mask)).unwrap()
}

/// All frequencies, by a dense solver on M^-1/2 K M^-1/2.
fn dense(body: &mut Body<f64>) -> Vec<f64> {
    let clustered = Clustered::new(body);
    let k = clustered.matrix();
    let free: Vec<usize> = (0..body.mass.len()).filter(|i| !body.constraints.is_constrained(*i)).collect();
    let mut a = Mat::<f64>::zeros(3 * free.len(), 3 * free.len());
    for (r, &i) in free.iter().enumerate() {
        for (c, &j) in free.iter().enumerate() {
            if let Some(at) = k.pattern.find(i, j) {
                let s = (body.mass[i] * body.mass[j]).sqrt();
                (0..9).for_each(|e| a[(3 * r + e / 3, 3 * c + e % 3)] = k.values[at][e] / s);
            }
        }
    }
    a.self_adjoint_eigenvalues(Side::Lower).unwrap().iter().map(|v| v.max(0.0).sqrt()).collect()
}

/// Also of a square bar, which bends both ways alike, and of a free one, whose six lowest modes are rigid.
#[test]
fn frequencies_are_those_of_a_dense_solver() {
    for held in [true, false] {
        let mut body = body(&bar(), held);
        let exact = dense(&mut body);
        let modes = Modes::new(&mut body, 30).unwrap();
        assert!(modes.basis < exact.len(), "{} of {}", modes.basis, exact.len());
        // the rigid ones are zero to the root of the rounding of the stiffest
        let slack = if held { 0.0 } else { 2e-7 * exact.last().unwrap() };
        for (k, (a, b)) in modes.frequency.iter().zip(&exact).enumerate() {
            assert!((a - b).abs() <= 1e-8 * b + slack, "held {held}, mode {k}: {a} {b}");
        }
        assert!(exact[8] > 10.0);
        // mass-orthonormal shapes
        for i in 0..30 {
            for j in 0..30 {
                let s: f64 = (0..body.mass.len())
                    .map(|n| (0..3).map(|k| body.mass[n] * modes.shape[i][n][k] * modes.shape[j][n][k]).sum::<f64>())
                    .sum();
                assert!((s - f64::from(u8::from(i == j))).abs() < 1e-9, "{i} {j} {s}");
            }
        }
    }
}

/// With all modes, the sum of M φ ω² φᵀ M is the stiffness, and the motion is that of the clustered evaluation.
#[test]
fn all_modes_are_the_whole_body() {
    let mesh = five_tets([3, 1, 1], false, |p| [0.3 * p[0], 0.1 * p[1], 0.1 * p[2]]);
    let mut body = body(&mesh, true);
    let free = 3 * body.constraints.mask().iter().filter(|c| !**c).count();
    let mut clustered = Clustered::new(&mut body);
    let mut modal = ModalIntegrator::new(&mut body, free, (0.5, 0.002)).unwrap();
    let n = mesh.node_count();
    let mut random = Random::new(12);
    let x: Vec<[f64; 3]> = (0..n)
        .map(|i| {
            let r = random.point();
            let by = if body.constraints.is_constrained(i) { 0.0 } else { 0.01 };
            std::array::from_fn(|k| mesh.nodes[i][k] + by * r[k])
        })
        .collect();
    let zero = vec![[0.0; 3]; n];
    let mut force = zero.clone();
    clustered.internal_force(&x, &zero, 0.0, &mut force);
    let modes = modal.modes().clone();
    let mut sum = zero.clone();
    for (w, s) in modes.frequency.iter().zip(&modes.shape) {
        let q: f64 =
            (0..n).map(|i| (0..3).map(|k| body.mass[i] * s[i][k] * (x[i][k] - mesh.nodes[i][k])).sum::<f64>()).sum();
        (0..n).for_each(|i| (0..3).for_each(|k| sum[i][k] += body.mass[i] * s[i][k] * w * w * q));
    }
    let scale = force.iter().flatten().fold(0.0f64, |m, f| m.max(f.abs()));
    for i in (0..n).filter(|i| !body.constraints.is_constrained(*i)) {
        (0..3).for_each(|k| assert!((sum[i][k] - force[i][k]).abs() < 1e-9 * scale, "{} {}", sum[i][k], force[i][k]));
    }
    // released from there under gravity; the clustered body with short steps of second order
    let weight = body.weight([0.0, -9.81, 0.0]);
    let masses: Vec<f64> =
        (0..n).map(|i| if body.constraints.is_constrained(i) { 0.0 } else { body.mass[i] }).collect();
    let (full, load) = (body.mass.clone(), weight.clone());
    let mut law = |x: &[[f64; 3]], v: &[[f64; 3]], f: &mut [[f64; 3]]| {
        clustered.internal_force(x, v, 0.0, f);
        (0..n).for_each(|i| (0..3).for_each(|k| f[i][k] = load[i][k] - f[i][k] - 0.5 * full[i] * v[i][k]));
    };
    let mut stepper = Stepper::new(Scheme::RungeKutta2, &masses, &mesh.nodes, &mut law, 0.5).unwrap();
    let mut state = State::at_rest(x.clone());
    for _ in 0..20_000 {
        stepper.step(&mut law, None, &mut state, 1e-5).unwrap();
    }
    let mut other = State::at_rest(x);
    modal.set_state(&body, &other);
    for _ in 0..10 {
        modal.advance(0.02, &weight, &mut other.position, &mut other.velocity);
    }
    for i in 0..n {
        for k in 0..3 {
            let (a, b) = (state.position[i][k], other.position[i][k]);
            assert!((a - b).abs() < 1e-7, "{a} {b}");
        }
    }
    assert!((0..n).any(|i| (state.position[i][1] - mesh.nodes[i][1]).abs() > 1e-3), "it moved");
}

/// A bar that bends far: linear modes swell it, warped ones keep its length.
#[test]
fn warped_modes_keep_lengths() {
    let mesh = five_tets([12, 2, 2], false, |p| [1.2 * p[0], 0.1 * p[1], 0.1 * p[2]]);
    let length = |warp: bool| {
        let mut body = body(&mesh, true);
        let mut modal = ModalIntegrator::new(&mut body, 12, (4.0, 0.01)).unwrap();
        if warp {
            modal = modal.warped(&body);
        }
        let load = body.weight([0.0, -0.35, 0.0]);
        let (mut x, mut v) = (mesh.nodes.clone(), vec![[0.0; 3]; mesh.node_count()]);
        for _ in 0..400 {
            modal.advance(0.02, &load, &mut x, &mut v);
        }
        // along one edge of the bar: nodes are stored slice by slice
        let line: Vec<[f64; 3]> = (0..13).map(|i| x[i * 9 + 4]).collect();
        let sag = mesh.nodes[12 * 9 + 4][1] - line[12][1];
        let length: f64 =
            line.windows(2).map(|p| (0..3).map(|k| (p[1][k] - p[0][k]).powi(2)).sum::<f64>().sqrt()).sum();
        (length, sag)
    };
    let (linear, warped) = (length(false), length(true));
    assert!(linear.1 > 0.3 && warped.1 > 0.3, "{linear:?} {warped:?}");
    assert!(linear.0 > 1.2 * 1.05, "{linear:?}");
    assert!((warped.0 - 1.2).abs() < 1.2 * 0.03, "{warped:?}");
}

#[test]
fn more_modes_than_unknowns_are_refused() {
    let mut body = body(&bar(), true);
    for wanted in [0, 10_000] {
        assert!(matches!(Modes::new(&mut body, wanted), Err(ModalError::Count { .. })));
    }
}
