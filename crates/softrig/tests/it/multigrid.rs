//! The multigrid cycle on bodies with bones: same solution, far fewer iterations.

use softrig::body::Body;
use softrig::force::ElasticModel;
use softrig::integrate::{Dynamics, State, StepInput, StepOutput};
use softrig::material::{Material, MaterialMap};
use softrig::mesh::{
    CellKind, HierarchyOptions, LatticeOptions, Resolution, SurfaceMesh, VolumeMesh, bar as cut_bar, hierarchy,
    voxelize,
};
use softrig::simulation::{SolverKind, interpolations};
use softrig_linalg::solver::{Direct, Multigrid, Pcg};
use softrig_linalg::{BlockCsr, BlockPattern, DofConstraints, LinearSolver};
use std::sync::Arc;

fn box_surface(size: [f64; 3]) -> SurfaceMesh {
    let positions = (0..8).map(|i| [0, 1, 2].map(|k| if i >> k & 1 == 1 { size[k] } else { 0.0 })).collect();
    let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let triangles = quads.iter().flat_map(|q| [[q[0], q[1], q[2]], [q[0], q[2], q[3]]]).collect();
    SurfaceMesh { positions, triangles }
}

fn bar(cells: usize) -> VolumeMesh {
    let options = LatticeOptions { resolution: Resolution::Cells(cells), ..LatticeOptions::default() };
    voxelize(&box_surface([0.8, 0.2, 0.25]), &options).unwrap()
}

fn multigrid(mesh: &VolumeMesh) -> Multigrid<f64> {
    let options = HierarchyOptions { coarsest: 100, ..HierarchyOptions::default() };
    Multigrid::new(interpolations(hierarchy(mesh, &options)))
}

/// K + M/h² of a bar held along an off-axis line and at one end, and a load.
fn system(mesh: &VolumeMesh, poisson_ratio: f64, h: f64) -> (Body<f64>, BlockCsr<f64>, Vec<[f64; 3]>) {
    let held = |p: &[f64; 3]| p[0] < 0.02 || ((p[1] - 0.07).abs() < 0.02 && (p[2] - 0.13).abs() < 0.02 && p[0] < 0.4);
    let mask = mesh.nodes.iter().map(held).collect();
    let material = Material { poisson_ratio, ..Material::default() };
    let mut body: Body<f64> = Body::new(
        mesh.clone(),
        &MaterialMap::uniform(material),
        ElasticModel::Corotated,
        DofConstraints::from_mask(mask),
    )
    .unwrap();
    let rest = mesh.nodes.clone();
    body.model.linearise(&rest);
    let matrix = body.system_matrix(1.0 / (h * h));
    let load = body.weight([3.0, -9.81, 1.0]);
    (body, matrix, load)
}

fn solve(
    solver: &mut dyn LinearSolver<f64>,
    body: &Body<f64>,
    a: &BlockCsr<f64>,
    b: &[[f64; 3]],
) -> (Vec<[f64; 3]>, usize) {
    solve_with(solver, &body.pattern, &body.constraints, a, b)
}

fn solve_with(
    solver: &mut dyn LinearSolver<f64>,
    pattern: &Arc<BlockPattern>,
    constraints: &DofConstraints,
    a: &BlockCsr<f64>,
    b: &[[f64; 3]],
) -> (Vec<[f64; 3]>, usize) {
    solver.prepare(pattern, constraints).unwrap();
    let mut x = vec![[0.0; 3]; b.len()];
    let report = solver.solve(a, b, &mut x, 1e-8).unwrap();
    assert!(report.residual <= 1e-8);
    (x, report.iterations)
}

/// Against sparse Cholesky, at a time step and almost static, up to nu = 0.49.
#[test]
fn multigrid_solves_what_cholesky_solves_in_few_iterations() {
    let mesh = bar(6000);
    for (nu, h, most) in [(0.3, 1.0 / 60.0, 14), (0.4, 1.0 / 30.0, 18), (0.45, 10.0, 45), (0.49, 1.0 / 30.0, 45)] {
        let (body, a, b) = system(&mesh, nu, h);
        let (x, iterations) = solve(&mut multigrid(&mesh), &body, &a, &b);
        let (reference, _) = solve(&mut Direct::default(), &body, &a, &b);
        let (_, plain) = solve(&mut Pcg::default(), &body, &a, &b);
        println!("nu {nu}, h {h:.3}: multigrid {iterations}, block Jacobi {plain}");
        let size = reference.iter().flatten().fold(0.0f64, |m, v| m.max(v.abs()));
        let error = x.iter().flatten().zip(reference.iter().flatten()).fold(0.0f64, |m, (a, b)| m.max((a - b).abs()));
        assert!(error < 1e-5 * size, "nu {nu}: {error} of {size}");
        assert!(iterations <= most, "nu {nu}, h {h}: {iterations} iterations");
        assert!(3 * iterations < plain, "nu {nu}, h {h}: {iterations} against {plain}");
    }
}

/// Threads share the work, not the result.
#[test]
fn multigrid_gives_the_same_bits_on_one_thread_and_on_three() {
    let mesh = bar(3000);
    let (body, a, b) = system(&mesh, 0.4, 1.0 / 60.0);
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let Body { pattern, constraints, .. } = &body;
        pool.install(|| solve_with(&mut multigrid(&mesh), pattern, constraints, &a, &b))
    };
    assert_eq!(run(1), run(3));
}

/// Nothing free, nothing to coarsen, a body without a lattice: plain answers, no failure.
#[test]
fn multigrid_copes_with_nothing_to_do() {
    let mesh = bar(1000);
    let (mut body, a, b) = system(&mesh, 0.4, 1.0 / 60.0);
    let (x, _) = solve(&mut Multigrid::new(Vec::new()), &body, &a, &b);
    assert!(x.iter().flatten().any(|v| *v != 0.0));
    body.constraints = DofConstraints::from_mask(vec![true; mesh.node_count()]);
    let (x, iterations) = solve(&mut multigrid(&mesh), &body, &a, &b);
    assert!(iterations == 0 && x.iter().flatten().all(|v| *v == 0.0));
    let one = |n: usize| n != 5;
    body.constraints = DofConstraints::from_mask((0..mesh.node_count()).map(one).collect());
    let (x, _) = solve(&mut multigrid(&mesh), &body, &a, &b);
    assert!(x[5].iter().any(|v| *v != 0.0));
}

/// Tetrahedra have no coarser meshes of their own: a lattice under them serves as well.
#[test]
fn tetrahedra_are_solved_on_a_lattice_laid_under_them() {
    let mesh = cut_bar([32, 8, 10], [0.8, 0.2, 0.25], CellKind::Tet4);
    for (nu, h, most) in [(0.3, 1.0 / 60.0, 12), (0.45, 1.0 / 30.0, 20)] {
        let (body, a, load) = system(&mesh, nu, h);
        let (exact, _) = solve(&mut Direct::default(), &body, &a, &load);
        let (x, iterations) = solve(&mut *SolverKind::Multigrid.build(&mesh), &body, &a, &load);
        let (_, jacobi) = solve(&mut Pcg::default(), &body, &a, &load);
        println!("nu {nu}, h {h:.4}: {iterations} iterations, {jacobi} with block Jacobi");
        assert!(iterations <= most && 5 * iterations < jacobi, "{iterations} {jacobi}");
        let largest = exact.as_flattened().iter().fold(0.0f64, |m, v| m.max(v.abs()));
        for (x, e) in x.as_flattened().iter().zip(exact.as_flattened()) {
            assert!((x - e).abs() < 1e-6 * largest);
        }
    }
}

/// A voxel body steps by cubes, without a matrix; a sparse factorisation steps by the assembled one. Both go the same way.
#[test]
fn steps_by_cubes_are_those_of_the_assembled_matrix() {
    let mesh = bar(1500);
    let run = |kind: SolverKind| {
        let (mut body, _, weight) = system(&mesh, 0.4, 1.0);
        let mut solver = kind.build(&mesh);
        let mut integrator = Dynamics::Lively.integrator();
        let mut state = State::at_rest(mesh.nodes.clone());
        let still = vec![[0.0; 3]; mesh.node_count()];
        let mut output = StepOutput::default();
        for _ in 0..12 {
            let input = StepInput {
                target_position: &mesh.nodes,
                target_velocity: &still,
                external_force: &weight,
                dt: 1.0 / 60.0,
                tolerance: 1e-10,
                reactions: true,
            };
            integrator.step(&mut body, &mut *solver, &input, &mut state, &mut output).unwrap();
            assert!(output.residual <= 1e-10 && output.converged);
        }
        state.position
    };
    let (a, b) = (run(SolverKind::Multigrid), run(SolverKind::Direct));
    let moved = a.iter().zip(&mesh.nodes).map(|(a, n)| (a[1] - n[1]).abs()).fold(0.0, f64::max);
    assert!(moved > 0.005, "{moved}");
    for (a, b) in a.as_flattened().iter().zip(b.as_flattened()) {
        // the first of two linearisations is solved to a third of the digits, and the rotations of the second know it
        assert!((a - b).abs() < 1e-5 * moved, "{a} {b}");
    }
}
