//! Where a step's first solve starts: with flesh that goes on as it moves.

use crate::support::{Dense, body, hex_box, material, noise, rest, tet_box};
use softrig::body::Body;
use softrig::force::ElasticModel;
use softrig::integrate::{Scheme, State, StepInput, StepOutput, implicit, initial_acceleration};
use softrig_linalg::LinearSolver;
use softrig_linalg::solver::Pcg;

const NEWMARK: Scheme = Scheme::Newmark { beta: 0.25, gamma: 0.5 };

fn step(
    body: &mut Body<f64>,
    solver: &mut dyn LinearSolver<f64>,
    (dt, tolerance): (f64, f64),
    linearisations: usize,
    state: &mut State<f64>,
) -> StepOutput<f64> {
    let target = state.position.clone();
    let zero = vec![[0.0; 3]; target.len()];
    let input = StepInput {
        target_position: &target,
        target_velocity: &zero,
        external_force: &zero,
        dt,
        tolerance,
        reactions: false,
    };
    let mut output = StepOutput::default();
    implicit(NEWMARK, linearisations).step(body, solver, &input, state, &mut output).unwrap();
    output
}

/// A body that only flies asks nothing of the solver; one that is also shaken a little asks for little.
#[test]
fn a_body_that_goes_on_as_it_moves_needs_hardly_a_solve() {
    for (mesh, linearisations) in
        [(hex_box([6, 2, 2], 0.1), 2), (tet_box([6, 2, 2], 0.1), 2), (tet_box([6, 2, 2], 0.1), 1)]
    {
        let mut iterations = Vec::new();
        for shaken in [0.0, 1e-4, 1.0] {
            let mut b = body::<f64>(mesh.clone(), material(2e6, 0.4), ElasticModel::Corotated, |_| false);
            let (mut state, mut r) = (rest(&b), noise(3));
            state.velocity.iter_mut().for_each(|v| *v = [1.0 + shaken * r(), 2.0 + shaken * r(), -1.0]);
            let start = state.position[5];
            let output = step(&mut b, &mut Pcg::default(), (1.0 / 60.0, 1e-3), linearisations, &mut state);
            assert!(output.converged && output.residual <= 1e-3);
            if shaken == 0.0 {
                for k in 0..3 {
                    let moved = state.position[5][k] - start[k];
                    // to the digits of the iteration, f32: far more than the residual asked for
                    assert!((moved - [1.0, 2.0, -1.0][k] / 60.0).abs() < 1e-8, "{moved}");
                }
            }
            iterations.push(output.iterations);
        }
        eprintln!("iterations: {iterations:?}");
        assert!(iterations[0] <= 1 && 2 * iterations[1] < iterations[2] && iterations[2] > 20, "{iterations:?}");
    }
}

/// Stiff flesh that vibrates faster than steps can follow: going on as it moves would be far off, and the step is still the one that
/// a dense solver finds.
#[test]
fn a_bad_guess_does_no_harm() {
    let dt = 1.0 / 30.0;
    for speed in [1e-3, 10.0] {
        let mut b = body::<f64>(tet_box([3, 1, 1], 0.1), material(3e7, 0.45), ElasticModel::Corotated, |x| x[0] == 0.0);
        let (mut r, mut state) = (noise(9), rest(&b));
        for (v, x) in state.velocity.iter_mut().zip(&b.mesh.nodes) {
            if x[0] > 0.0 {
                *v = [speed * r(), speed * r(), speed * r()];
            }
        }
        initial_acceleration(&mut b, &vec![[0.0; 3]; state.position.len()], &mut state).unwrap();
        let (mut one, mut other) = (state.clone(), state);
        step(&mut b, &mut Dense::default(), (dt, 1e-3), 2, &mut one);
        let output = step(&mut b, &mut Pcg::default(), (dt, 1e-10), 2, &mut other);
        assert!(output.converged, "{output:?}");
        for (i, (a, b)) in one.position.iter().zip(&other.position).enumerate() {
            (0..3).for_each(|k| assert!((a[k] - b[k]).abs() < 1e-9 * speed, "node {i}: {a:?} {b:?}"));
        }
    }
}
