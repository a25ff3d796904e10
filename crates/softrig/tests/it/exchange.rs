//! Bones that change while a body is simulated: nodes let go and bound again keep the patterns of the solver, and nothing else.

use softrig::body::Body;
use softrig::force::ElasticModel;
use softrig::material::{Material, MaterialMap};
use softrig::mesh::{CellKind, HierarchyOptions, bar, hierarchy};
use softrig::simulation::interpolations;
use softrig_linalg::solver::{Direct, Multigrid, MultigridSettings, Smoother};
use softrig_linalg::{BlockCsr, CubeMatrix, DofConstraints, LinearSolver, LinearSystem, SolveReport};

/// A bar with K + M / dt², its weight, and some sets of bones.
struct Bar {
    body: Body<f64>,
    matrix: BlockCsr<f64>,
    cubes: Option<CubeMatrix<f64>>,
    load: Vec<[f64; 3]>,
    bones: [DofConstraints; 4],
}

/// The matrix, and the cubes where it is one of cubes.
struct Both<'a>(&'a BlockCsr<f64>, Option<&'a CubeMatrix<f64>>);

impl LinearSystem<f64> for Both<'_> {
    fn assembled(&mut self) -> &BlockCsr<f64> {
        self.0
    }
    fn cubes(&mut self) -> Option<&CubeMatrix<f64>> {
        self.1
    }
}

impl Bar {
    fn new(kind: CellKind) -> Self {
        let mesh = bar([24, 8, 8], [1.2, 0.4, 0.4], kind);
        let mask = |held: fn(&[f64; 3]) -> bool| DofConstraints::from_mask(mesh.nodes.iter().map(held).collect());
        let bones = [
            mask(|x| x[0] < 0.01),
            mask(|x| x[0] < 0.01 || ((x[1] - 0.2).hypot(x[2] - 0.2) < 0.06 && x[0] < 0.8)),
            mask(|x| (x[1] - 0.2).hypot(x[2] - 0.2) < 0.06),
            // all but the far half
            mask(|x| x[0] < 0.6),
        ];
        let material = Material { young_modulus: 5e4, poisson_ratio: 0.4, ..Material::default() };
        let rest = mesh.nodes.clone();
        let materials = MaterialMap::uniform(material);
        let mut body = Body::new(mesh, &materials, ElasticModel::Corotated, DofConstraints::none(rest.len())).unwrap();
        body.model.linearise(&rest);
        let matrix = body.system_matrix(3600.0);
        let inertia: Vec<f64> = body.mass.iter().map(|m| m * 3600.0).collect();
        let cubes = body.model.cube_pattern().map(|pattern| {
            let mut cubes = CubeMatrix::zero(pattern);
            body.model.cubes(0.0, 0.0, &mut cubes);
            cubes.diagonal.copy_from_slice(&inertia);
            cubes
        });
        let load = body.weight([1.0, -9.81, 2.0]);
        Self { body, matrix, cubes, load, bones }
    }

    fn solver(&self, smoother: Smoother, paper: bool) -> Multigrid<f64> {
        let settings = if paper { MultigridSettings::paper() } else { MultigridSettings::default() };
        let settings = MultigridSettings { outer: MultigridSettings::default().outer, smoother, ..settings };
        let options = HierarchyOptions { coarsest: 60, ..HierarchyOptions::default() };
        Multigrid::with_settings(interpolations(hierarchy(&self.body.mesh, &options)), settings)
    }

    fn solve(&self, solver: &mut dyn LinearSolver<f64>, tolerance: f64) -> (Vec<[f64; 3]>, SolveReport) {
        let mut x = vec![[9.0; 3]; self.load.len()];
        let mut system = Both(&self.matrix, self.cubes.as_ref());
        let report = solver.solve_system(&mut system, &self.load, &mut x, tolerance).unwrap();
        (x, report)
    }
}

fn sweeps() -> Smoother {
    Smoother::GaussSeidel { before: 2, after: 2 }
}

/// One solver through many exchanges against Cholesky with the same bones, and against a new solver's iterations.
#[test]
fn exchanged_bones_are_solved_as_if_they_had_always_been_there() {
    for kind in [CellKind::Tet4, CellKind::Hex8] {
        let bar = Bar::new(kind);
        assert_eq!(bar.cubes.is_some(), kind == CellKind::Hex8);
        for (smoother, paper) in [(Smoother::default(), false), (sweeps(), true)] {
            let mut old = bar.solver(smoother, paper);
            for (step, which) in [0, 1, 2, 1, 3, 0, 2, 2, 1].into_iter().enumerate() {
                let bones = &bar.bones[which];
                old.prepare(&bar.body.pattern, bones).unwrap();
                let (x, report) = bar.solve(&mut old, if step % 2 == 0 { 1e-8 } else { 1e-4 });
                let mut exact = Direct::default();
                exact.prepare(&bar.body.pattern, bones).unwrap();
                let (reference, _) = bar.solve(&mut exact, 1e-9);
                let mut new = bar.solver(smoother, paper);
                new.prepare(&bar.body.pattern, bones).unwrap();
                let (_, fresh) = bar.solve(&mut new, if step % 2 == 0 { 1e-8 } else { 1e-4 });
                let size = reference.as_flattened().iter().fold(0.0f64, |m, v| m.max(v.abs()));
                for (n, (x, r)) in x.iter().zip(&reference).enumerate() {
                    assert!(!bones.is_constrained(n) || *x == [0.0; 3], "node {n} is held and moves by {x:?}");
                    let bound = if step % 2 == 0 { 1e-6 } else { 1e-2 } * size;
                    assert!((0..3).all(|k| (x[k] - r[k]).abs() < bound), "step {step}, node {n}: {x:?} {r:?}");
                }
                assert!(report.iterations.abs_diff(fresh.iterations) <= 1, "{step}: {report:?} {fresh:?}");
            }
        }
    }
}

/// A checkpoint forgets, and a run that goes on from it is another one's beginning: not a bit may tell them apart.
#[test]
fn a_solver_that_forgets_has_no_memory_of_earlier_bones() {
    for kind in [CellKind::Tet4, CellKind::Hex8] {
        let bar = Bar::new(kind);
        for smoother in [Smoother::default(), sweeps()] {
            let (mut old, mut new) = (bar.solver(smoother, false), bar.solver(smoother, false));
            for which in [0, 2, 1] {
                old.prepare(&bar.body.pattern, &bar.bones[which]).unwrap();
                bar.solve(&mut old, 1e-6);
            }
            old.forget();
            new.prepare(&bar.body.pattern, &bar.bones[1]).unwrap();
            assert_eq!(bar.solve(&mut old, 1e-7), bar.solve(&mut new, 1e-7));
        }
    }
}
