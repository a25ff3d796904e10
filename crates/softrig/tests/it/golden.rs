//! Reference values computed by independent routes: 50-digit energies, exact rational matrices, a dense time integrator.
#![allow(non_snake_case, reason = "symbols of the reference files")]

use crate::support::{Dense, body, force_at};
use serde_json::Value;
use softrig::body::{Body, consistent_mass};
use softrig::force::polar::{polar, polar_cold, rotation};
use softrig::force::{ElasticModel, cell_stress, stvk_hessian};
use softrig::integrate::{Implicit, Integrator, Scheme, State, StepInput, StepOutput, initial_acceleration};
use softrig::material::{Material, MaterialMap};
use softrig::mesh::VolumeMesh;
use softrig_linalg::{BlockCsr, DofConstraints, Mat3, Scalar, Wide};

fn load(name: &str) -> Value {
    let path = format!("{}/tests/golden/{name}.json", env!("CARGO_MANIFEST_DIR"));
    serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap()
}
fn num(v: &Value) -> f64 {
    v.as_f64().unwrap()
}
fn list(v: &Value) -> Vec<f64> {
    v.as_array().unwrap().iter().map(num).collect()
}
fn rows<const N: usize>(v: &Value) -> Vec<[f64; N]> {
    v.as_array().unwrap().iter().map(|r| list(r).try_into().unwrap()).collect()
}
fn table(v: &Value) -> Vec<Vec<f64>> {
    v.as_array().unwrap().iter().map(list).collect()
}

/// Largest difference over the largest expected number.
fn relative(found: impl IntoIterator<Item = f64>, expected: impl IntoIterator<Item = f64>) -> f64 {
    let (mut difference, mut scale) = (0.0f64, 0.0f64);
    let (mut a, mut b) = (found.into_iter(), expected.into_iter());
    loop {
        match (a.next(), b.next()) {
            (Some(x), Some(y)) => {
                assert!(x.is_finite());
                difference = difference.max((x - y).abs());
                scale = scale.max(y.abs());
            }
            (None, None) => return difference / scale,
            _ => panic!("lengths differ"),
        }
    }
}

fn one_tet<R: Scalar>(X: &[[f64; 3]], E: f64, nu: f64, rho: f64, model: ElasticModel) -> Body<R> {
    let mesh = VolumeMesh { nodes: X.to_vec(), tets: vec![[0, 1, 2, 3]], ..VolumeMesh::default() };
    let m = Material { young_modulus: E, poisson_ratio: nu, density: rho, mass_damping: 0.0, stiffness_damping: 0.0 };
    body(mesh, m, model, |_| false)
}

/// A small block matrix written out row by row.
fn dense<R: Scalar>(m: &BlockCsr<R>) -> Vec<f64> {
    let n = m.pattern.row_count();
    let mut out = vec![0.0; 9 * n * n];
    for i in 0..n {
        for k in m.pattern.row(i) {
            let j = m.pattern.column()[k] as usize;
            for e in 0..9 {
                out[(3 * i + e / 3) * 3 * n + 3 * j + e % 3] = m.values[k][e].to_f64();
            }
        }
    }
    out
}

fn stiffness<R: Scalar>(body: &mut Body<R>) -> Vec<f64> {
    let mut k = BlockCsr::zero(body.pattern.clone());
    body.model.stiffness(R::zero(), R::zero(), &mut k);
    dense(&k)
}

fn element_linear<R: Scalar>(tolerance: f64) {
    for case in load("element_linear")["cases"].as_array().unwrap() {
        let X = rows::<3>(&case["X"]);
        let (E, nu, rho) = (num(&case["E"]), num(&case["nu"]), num(&case["rho"]));
        for model in [ElasticModel::Linear, ElasticModel::Corotated] {
            let mut b = one_tet::<R>(&X, E, nu, rho, model);
            let e = relative(stiffness(&mut b), table(&case["K"]).concat());
            assert!(e < tolerance, "K: {e}");
            let e = relative(b.mass.iter().map(|m| m.to_f64()), list(&case["m_lumped"]));
            assert!(e < tolerance, "lumped mass: {e}");
            let material = Material { young_modulus: E, poisson_ratio: nu, density: rho, ..Material::default() };
            let m = consistent_mass::<R>(&b.mesh, &MaterialMap::uniform(material), &b.pattern).unwrap();
            let e = relative(dense(&m), table(&case["M_consistent"]).concat());
            assert!(e < tolerance, "consistent mass: {e}");
        }
    }
}

#[test]
fn stiffness_and_mass_of_a_tetrahedron_are_the_exact_ones() {
    element_linear::<f64>(1e-12);
    // a few roundings of the largest entry
    element_linear::<f32>(16.0 * f64::from(f32::EPSILON));
}

fn element_nonlinear<R: Scalar>(gradient: f64, energy: f64, matrix: f64) {
    let linear = load("element_linear");
    for case in load("element_nonlinear")["cases"].as_array().unwrap() {
        let tet = &linear["cases"][case["tet"].as_u64().unwrap() as usize];
        let X = rows::<3>(&tet["X"]);
        let x: Vec<[R; 3]> = rows::<3>(&case["x"]).iter().map(|p| p.map(R::from_f64)).collect();
        let kind = case["kind"].as_str().unwrap();
        for (model, key) in [(ElasticModel::Corotated, "corotated"), (ElasticModel::StVenantKirchhoff, "stvk")] {
            let mut b = one_tet::<R>(&X, num(&tet["E"]), num(&tet["nu"]), 1.0, model);
            let (f, w) = force_at(&mut b, &x);
            let e = relative(f.iter().flatten().map(|f| f.to_f64()), list(&case[key]["gradient"]));
            assert!(e < gradient, "{kind} {key} gradient: {e}");
            let e = (w / num(&case[key]["energy"]) - 1.0).abs();
            assert!(e < energy, "{kind} {key} energy: {e}");
            if key == "corotated" {
                let e = relative(stiffness(&mut b), table(&case["K_warped"]).concat());
                assert!(e < matrix, "{kind} warped stiffness: {e}");
            }
        }
    }
}

/// The f32 tolerance is what rounding the positions does to a strain of a few per cent.
#[test]
fn force_energy_and_stiffness_of_deformed_tetrahedra_are_the_exact_ones() {
    element_nonlinear::<f64>(1e-10, 1e-10, 1e-10);
    element_nonlinear::<f32>(2e-4, 2e-4, 2e-5);
}

#[test]
fn the_exact_hessian_of_st_venant_kirchhoff_is_the_second_derivative() {
    let linear = load("element_linear");
    for case in load("element_nonlinear")["cases"].as_array().unwrap() {
        let tet = &linear["cases"][case["tet"].as_u64().unwrap() as usize];
        let m = Material { young_modulus: num(&tet["E"]), poisson_ratio: num(&tet["nu"]), ..Material::default() };
        let (X, x) = (rows::<3>(&tet["X"]), rows::<3>(&case["x"]));
        let h = stvk_hessian(X.try_into().unwrap(), x.try_into().unwrap(), m.lambda(), m.shear_modulus());
        let flat = (0..144).map(|k| h[k / 12 / 3][k % 12 / 3][k / 12 % 3][k % 12 % 3]);
        let e = relative(flat, table(&case["stvk"]["hessian"]).concat());
        assert!(e < 1e-8, "{}: {e}", case["kind"]);
    }
}

#[test]
fn rotations_are_the_polar_ones_in_every_precision_and_width() {
    for case in load("polar")["cases"].as_array().unwrap() {
        let name = case["name"].as_str().unwrap();
        let F: [[f64; 3]; 3] = rows::<3>(&case["F"]).try_into().unwrap();
        // no rotation is named where several are right
        let unique = case["unique"].as_bool().unwrap();
        let R: [[f64; 3]; 3] = if unique { rows::<3>(&case["R"]).try_into().unwrap() } else { [[0.0; 3]; 3] };
        let identity = [0.0, 0.0, 0.0, 1.0];
        let cold = rotation(polar_cold(F, identity).unwrap());
        let warm = rotation(polar(Mat3(F), identity));
        let wide = rotation(polar(Mat3::<Wide<f64, 8>>::splat(F), identity.map(|c| Wide([c; 8])))).0;
        let wide = Mat3(wide.map(|r| r.map(|c| c.0[5])));
        let single = rotation(polar(Mat3(F.map(|r| r.map(|c| c as f32))), identity.map(|c| c as f32))).0;
        let single = Mat3(single.map(|r| r.map(f64::from)));
        assert_eq!(warm, wide, "{name}");
        for (what, found, tolerance) in [("cold", cold, 1e-9), ("warm", warm, 1e-9), ("f32", single, 2e-5)] {
            let orthogonal = (found.transpose() * found - Mat3::identity()).frobenius_norm();
            assert!(orthogonal < tolerance && (found.determinant() - 1.0).abs() < tolerance, "{name} {what}");
            let trace = (found.transpose() * Mat3(F)).trace();
            assert!(trace >= num(&case["max_trace"]) - tolerance, "{name} {what}: trace {trace}");
            if unique && what != "f32" {
                let e = (found - Mat3(R)).frobenius_norm();
                assert!(e < tolerance, "{name} {what}: {e}");
            }
        }
    }
}

fn patch<R: Scalar>(tolerance: f64) {
    let g = load("patch");
    let tets: Vec<[u32; 4]> = rows::<4>(&g["T"]).iter().map(|t| t.map(|n| n as u32)).collect();
    let mesh = VolumeMesh { nodes: rows::<3>(&g["V"]), tets, ..VolumeMesh::default() };
    let material = Material { young_modulus: num(&g["E"]), poisson_ratio: num(&g["nu"]), ..Material::default() };
    let mut b = body::<R>(mesh.clone(), material, ElasticModel::Linear, |_| false);
    let u = rows::<3>(&g["u"]);
    let x: Vec<[R; 3]> =
        u.iter().zip(&mesh.nodes).map(|(u, X)| std::array::from_fn(|k| R::from_f64(X[k] + u[k]))).collect();
    let (f, _) = force_at(&mut b, &x);
    let e = relative(f.iter().flatten().map(|f| f.to_f64()), rows::<3>(&g["reactions"]).concat());
    assert!(e < tolerance, "reactions: {e}");
    // displacements are small enough for the corotated stress to agree to first order only: compare the linear route
    let stress = table(&g["stress"]);
    let (small, origin) = (1e-6, u[0]);
    let x: Vec<[f64; 3]> =
        u.iter().zip(&mesh.nodes).map(|(u, X)| std::array::from_fn(|k| X[k] + small * (u[k] - origin[k]))).collect();
    for s in cell_stress(&mesh, &MaterialMap::uniform(material), &x) {
        let found = [s.stress[0], s.stress[3], s.stress[5], s.stress[1], s.stress[4], s.stress[2]];
        let expected = [stress[0][0], stress[0][1], stress[0][2], stress[1][1], stress[1][2], stress[2][2]];
        let e = relative(found.map(|s| s / small), expected);
        assert!(e < 1e-5, "stress: {e}");
    }
}

#[test]
fn a_distorted_mesh_holds_a_uniform_strain() {
    patch::<f64>(1e-9);
    patch::<f32>(1e-3);
}

fn newmark<R: Scalar>(tolerance: f64) {
    let g = load("newmark2tet");
    let X = rows::<3>(&g["X"]);
    for case in g["cases"].as_array().unwrap() {
        let name = case["name"].as_str().unwrap();
        let tets: Vec<[u32; 4]> = rows::<4>(&g["T"]).iter().map(|t| t.map(|n| n as u32)).collect();
        let mesh = VolumeMesh { nodes: X.clone(), tets, ..VolumeMesh::default() };
        let material = Material {
            young_modulus: num(&case["E"]),
            poisson_ratio: num(&case["nu"]),
            density: num(&case["rho"]),
            mass_damping: num(&case["ra"]),
            stiffness_damping: num(&case["rb"]),
        };
        let model = if case["corotated"] == true { ElasticModel::Corotated } else { ElasticModel::Linear };
        let held: Vec<usize> = list(&case["cons"]).iter().map(|c| *c as usize).collect();
        let mask = (0..5).map(|i| held.contains(&i)).collect();
        let materials = MaterialMap::uniform(material);
        let mut b = Body::<R>::new(mesh, &materials, model, DofConstraints::from_mask(mask)).unwrap();
        let consistent = case["mass"] == "consistent";
        let scheme = match case["scheme"].as_str().unwrap() {
            "ie" => Scheme::ImplicitEuler,
            _ => Scheme::Newmark { beta: 0.25, gamma: 0.5 },
        };
        let gravity: [f64; 3] = list(&case["gravity"]).try_into().unwrap();
        let force = b.weight(gravity);
        let h = num(&case["h"]);
        let moving = case["moving"].is_string();
        // R_z(2 t) X + (0.05 t, 0, 0)
        let target = |t: f64| -> (Vec<[R; 3]>, Vec<[R; 3]>) {
            let turn = |X: [f64; 3]| {
                let (s, c) = (2.0 * t).sin_cos();
                let x = [c * X[0] - s * X[1] + 0.05 * t, s * X[0] + c * X[1], X[2]];
                let v = [2.0 * (-s * X[0] - c * X[1]) + 0.05, 2.0 * (c * X[0] - s * X[1]), 0.0];
                if moving { (x, v) } else { (X, [0.0; 3]) }
            };
            X.iter().map(|p| turn(*p)).map(|(x, v)| (x.map(R::from_f64), v.map(R::from_f64))).unzip()
        };
        let mut state = State::at_rest(X.iter().map(|p| p.map(R::from_f64)).collect());
        if consistent {
            // the start needs a solve with the mass matrix, which the reference has done
            state.acceleration = rows::<3>(&case["a0"]).iter().map(|a| a.map(R::from_f64)).collect();
            b.consistent_mass = Some(consistent_mass(&b.mesh, &materials, &b.pattern).unwrap());
        } else {
            initial_acceleration(&mut b, &force, &mut state).unwrap();
            let a0 = rows::<3>(&case["a0"]).concat();
            let e = relative(state.acceleration.iter().flatten().map(|a| a.to_f64()), a0);
            assert!(e < 1e-9f64.max(1e4 * tolerance), "{name}: a0 {e}");
        }
        let mut method = Implicit::<R>::new(scheme, case["iters"].as_u64().unwrap() as usize);
        let (mut solver, mut output) = (Dense::default(), StepOutput::default());
        let steps: Vec<usize> = list(&case["steps"]).iter().map(|s| *s as usize).collect();
        let (xs, vs) = (case["x"].as_array().unwrap(), case["v"].as_array().unwrap());
        let close = |what: &str, found: &[[R; 3]], expected: &Value, scale: f64| {
            for (f, e) in found.iter().flatten().zip(rows::<3>(expected).concat()) {
                assert!((f.to_f64() - e).abs() < tolerance * scale, "{name}: {what} {f} instead of {e}");
            }
        };
        for step in 0..=50 {
            if let Some(k) = steps.iter().position(|s| *s == step) {
                close("x", &state.position, &xs[k], 1.0);
                // velocities are positions over a step
                close("v", &state.velocity, &vs[k], 10.0);
            }
            if step == 50 {
                break;
            }
            let (target_position, target_velocity) = target((step + 1) as f64 * h);
            let input = StepInput {
                target_position: &target_position,
                target_velocity: &target_velocity,
                external_force: &force,
                dt: h,
                tolerance: 1e-12,
                reactions: true,
            };
            method.step(&mut b, &mut solver, &input, &mut state, &mut output).unwrap();
        }
        if !case["f_int_step50"].is_null() {
            let expected = rows::<3>(&case["f_int_step50"]);
            for &i in &held {
                for k in 0..3 {
                    let e = (output.reaction[i][k].to_f64() - expected[i][k]).abs();
                    assert!(e < 1e3 * tolerance, "{name}: reaction of node {i} off by {e} N");
                }
            }
        }
        assert!((state.time - 50.0 * h).abs() < 1e-12);
    }
}

/// f32: positions of about 0.1 m carry 1e-8 m of rounding a step, and the motion is stable.
#[test]
fn two_tetrahedra_move_as_in_the_acceleration_form() {
    newmark::<f64>(1e-9);
    newmark::<f32>(2e-5);
}
