//! Systems that are hard or have no answer: a solution, or an error that says why, and never a number that is none.

use softrig::body::Body;
use softrig::force::ElasticModel;
use softrig::material::{Material, MaterialMap};
use softrig::mesh::{CellKind, VolumeMesh, bar};
use softrig::simulation::SolverKind;
use softrig_linalg::{BlockCsr, DofConstraints, SolveError};

const KINDS: [SolverKind; 4] = [SolverKind::Multigrid, SolverKind::Pcg, SolverKind::Direct, SolverKind::Auto];

struct Hard {
    body: Body<f64>,
    matrix: BlockCsr<f64>,
    load: Vec<[f64; 3]>,
}

/// K + inertia M of a mesh whose every seventh cell is `contrast` times stiffer.
fn hard(mesh: &VolumeMesh, poisson_ratio: f64, contrast: f32, inertia: f64, held: impl Fn(usize) -> bool) -> Hard {
    let constraints = DofConstraints::from_mask((0..mesh.node_count()).map(held).collect());
    let mut materials = MaterialMap::uniform(Material { poisson_ratio, ..Material::default() });
    let factors: Vec<f32> = (0..mesh.cell_count()).map(|c| if c % 7 == 0 { contrast } else { 1.0 }).collect();
    materials.stiffen(&factors);
    let mut body = Body::new(mesh.clone(), &materials, ElasticModel::Corotated, constraints).unwrap();
    body.model.linearise(&mesh.nodes);
    let mut matrix = BlockCsr::zero(body.pattern.clone());
    body.model.stiffness(0.0, 0.0, &mut matrix);
    for (n, m) in body.mass.iter().enumerate() {
        let at = body.pattern.diagonal()[n] as usize;
        (0..3).for_each(|k| matrix.values[at][4 * k] += inertia * m);
    }
    let load = body.weight([1.0, -9.81, 2.0]);
    Hard { body, matrix, load }
}

impl Hard {
    /// Whether each solver solves it; checks what holds in either case.
    fn solve(&self, name: &str, tolerance: f64) -> Vec<bool> {
        KINDS
            .iter()
            .map(|kind| {
                let mut solver = kind.build::<f64>(&self.body.mesh);
                solver.prepare(&self.body.pattern, &self.body.constraints).unwrap();
                let mut x = vec![[7.0; 3]; self.load.len()];
                // twice: the second solve starts from what the first has left behind
                let first = solver.solve(&self.matrix, &self.load, &mut x, tolerance);
                let second = solver.solve(&self.matrix, &self.load, &mut x, tolerance);
                assert_eq!(first.is_ok(), second.is_ok());
                match second {
                    Ok(report) => {
                        assert!(report.residual <= tolerance && report.converged, "{name} {kind:?}: {report:?}");
                        assert!(x.iter().flatten().all(|v| v.is_finite()));
                        true
                    }
                    Err(e) => {
                        assert!(x.iter().all(|x| *x == [7.0; 3]), "{name} {kind:?}: an error changed the solution");
                        if let SolveError::NotConverged { residual, .. } = e {
                            assert!(residual.is_finite() && residual > tolerance);
                        }
                        false
                    }
                }
            })
            .collect()
    }
}

/// Inertia of a step of 1/60 s.
const STEP: f64 = 3600.0;

#[test]
fn contrasts_and_incompressible_flesh_are_solved() {
    let mesh = bar([16, 4, 5], [0.8, 0.2, 0.25], CellKind::Tet4);
    let end = |n: usize| mesh.nodes[n][0] == 0.0;
    for (nu, contrast, inertia) in [(0.4, 1000.0, STEP), (0.49, 1.0, STEP), (0.49, 1000.0, STEP), (0.45, 1000.0, 0.0)] {
        let name = format!("nu {nu}, contrast {contrast}, inertia {inertia}");
        assert_eq!(hard(&mesh, nu, contrast, inertia, end).solve(&name, 1e-6), [true; 4], "{name}");
    }
}

#[test]
fn pieces_and_what_holds_them() {
    let one = bar([10, 3, 3], [1.0, 0.3, 0.3], CellKind::Tet4);
    let n = one.node_count();
    let mut two = one.clone();
    two.nodes.extend(one.nodes.iter().map(|x| [x[0], x[1] + 0.301, x[2]]));
    two.tets.extend(one.tets.iter().map(|t| t.map(|v| v + n as u32)));
    // nodes that no cell uses
    two.nodes.extend([[5.0, 5.0, 5.0], [0.5, 0.1, 0.1]]);
    let end = |i: usize| two.nodes[i][0] == 0.0;
    assert_eq!(hard(&two, 0.4, 1.0, STEP, end).solve("two pieces", 1e-6), [true; 4]);
    assert_eq!(hard(&two, 0.4, 1.0, STEP, |i| i < n && end(i)).solve("one of two pieces held", 1e-6), [true; 4]);
    assert_eq!(hard(&two, 0.4, 1.0, STEP, |_| false).solve("nothing held", 1e-6), [true; 4]);
    assert_eq!(hard(&two, 0.4, 1.0, STEP, |_| true).solve("everything held", 1e-6), [true; 4]);
    // without inertia a free piece has no answer: whatever a solver says of it must be true
    hard(&two, 0.4, 1.0, 0.0, |i| i < n && end(i)).solve("a free piece without inertia", 1e-6);
}

#[test]
fn a_single_cell_is_a_body() {
    let nodes = vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    let mesh = VolumeMesh { nodes, tets: vec![[0, 1, 2, 3]], ..VolumeMesh::default() };
    assert_eq!(hard(&mesh, 0.4, 1.0, STEP, |i| i == 0).solve("one tetrahedron", 1e-9), [true; 4]);
    let cube = bar([1; 3], [1.0; 3], CellKind::Hex8);
    assert_eq!(hard(&cube, 0.49, 1.0, STEP, |_| false).solve("one cube", 1e-9), [true; 4]);
}

#[test]
fn numbers_that_are_none_are_refused() {
    let mesh = bar([12, 4, 4], [1.2, 0.4, 0.4], CellKind::Tet4);
    for bad in [f64::NAN, f64::INFINITY] {
        let mut system = hard(&mesh, 0.4, 1.0, STEP, |i| i < 25);
        system.load[300][1] = bad;
        assert_eq!(system.solve("a force", 1e-6), [false; 4]);
        system.load[300][1] = 0.0;
        let at = system.body.pattern.diagonal()[200] as usize;
        system.matrix.values[at][4] = bad;
        assert_eq!(system.solve("a stiffness", 1e-6), [false; 4]);
    }
}
