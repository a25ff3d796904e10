//! Solvers on real meshes with slivers.

use crate::shared::real_file;
use softrig::body::Body;
use softrig::force::ElasticModel;
use softrig::material::{Material, MaterialMap};
use softrig::simulation::SolverKind;
use softrig_linalg::{BlockCsr, DofConstraints};

#[test]
fn every_solver_copes_with_slivers() {
    for file in ["bunny_igl.mesh", "Armadillo_Tetra_4406.vtu"] {
        let Some(path) = real_file(&format!("data/volumes/stanford/{file}")) else { continue };
        let (mut mesh, _) = softrig_io::volume::read_checked(&path).unwrap();
        let (low, high) = mesh.bounds().unwrap();
        let scale = 1.0 / (high[1] - low[1]);
        mesh.nodes.iter_mut().for_each(|x| *x = std::array::from_fn(|k| (x[k] - low[k]) * scale));
        let held = DofConstraints::from_mask(mesh.nodes.iter().map(|x| x[1] < 0.05).collect());
        let rest = mesh.nodes.clone();
        let mut body =
            Body::<f64>::new(mesh, &MaterialMap::uniform(Material::default()), ElasticModel::Corotated, held).unwrap();
        body.model.linearise(&rest);
        let mut matrix = BlockCsr::zero(body.pattern.clone());
        body.model.stiffness(0.0, 0.0, &mut matrix);
        for (n, m) in body.mass.iter().enumerate() {
            let at = body.pattern.diagonal()[n] as usize;
            (0..3).for_each(|k| matrix.values[at][4 * k] += 3600.0 * m);
        }
        let load = body.weight([1.0, -9.81, 2.0]);
        for kind in [SolverKind::Multigrid, SolverKind::Pcg, SolverKind::Direct, SolverKind::Auto] {
            let mut solver = kind.build::<f64>(&body.mesh);
            solver.prepare(&body.pattern, &body.constraints).unwrap();
            let mut x = vec![[0.0; 3]; rest.len()];
            let report = solver.solve(&matrix, &load, &mut x, 1e-6).unwrap();
            println!("{file}: {} in {} iterations", report.solver, report.iterations);
            assert!(report.residual <= 1e-6 && x.iter().flatten().all(|v| v.is_finite()), "{file} {kind:?}");
        }
    }
}
