//! Shared by the modules: meshes, a dense solver, stepping.
#![allow(dead_code, reason = "each helper is used by some of the modules only")]

use softrig::body::Body;
use softrig::force::ElasticModel;
use softrig::integrate::{Integrator, State, StepInput, StepOutput};
use softrig::material::{Material, MaterialMap};
use softrig::mesh::VolumeMesh;
use softrig_linalg::{BlockCsr, BlockPattern, DofConstraints, LinearSolver, Scalar, SolveError, SolveReport};
use std::sync::Arc;

/// Gaussian elimination in f64: small, obviously right, and not the solver of the library.
#[derive(Default)]
pub struct Dense {
    constraints: DofConstraints,
    /// Set to make the next solve fail.
    pub fail: bool,
}

impl<R: Scalar> LinearSolver<R> for Dense {
    fn name(&self) -> &'static str {
        "dense"
    }
    fn prepare(&mut self, _: &Arc<BlockPattern>, constraints: &DofConstraints) -> Result<(), SolveError> {
        self.constraints = constraints.clone();
        Ok(())
    }
    fn solve(&mut self, a: &BlockCsr<R>, b: &[[R; 3]], x: &mut [[R; 3]], _: f64) -> Result<SolveReport, SolveError> {
        if self.fail {
            return Err(SolveError::NotPositiveDefinite { node: 0 });
        }
        let free: Vec<usize> = (0..b.len()).filter(|i| !self.constraints.is_constrained(*i)).collect();
        let n = 3 * free.len();
        let index = |i: usize| free.binary_search(&i).ok();
        let mut m = vec![vec![0.0; n + 1]; n];
        for (r, &i) in free.iter().enumerate() {
            for k in a.pattern.row(i) {
                if let Some(c) = index(a.pattern.column()[k] as usize) {
                    (0..9).for_each(|e| m[3 * r + e / 3][3 * c + e % 3] = a.values[k][e].to_f64());
                }
            }
            (0..3).for_each(|e| m[3 * r + e][n] = b[i][e].to_f64());
        }
        for p in 0..n {
            let best = (p..n).max_by(|i, j| m[*i][p].abs().total_cmp(&m[*j][p].abs())).unwrap();
            m.swap(p, best);
            if m[p][p] == 0.0 || m[p][p].is_nan() {
                return Err(SolveError::NotPositiveDefinite { node: free[p / 3] });
            }
            let (top, rest) = m.split_at_mut(p + 1);
            for row in rest {
                let f = row[p] / top[p][p];
                if f != 0.0 {
                    (p..=n).for_each(|c| row[c] -= f * top[p][c]);
                }
            }
        }
        for p in (0..n).rev() {
            let s: f64 = (p + 1..n).map(|c| m[p][c] * m[c][n]).sum();
            m[p][n] = (m[p][n] - s) / m[p][p];
        }
        for (r, &i) in free.iter().enumerate() {
            x[i] = std::array::from_fn(|e| R::from_f64(m[3 * r + e][n]));
        }
        Ok(SolveReport { solver: "dense", iterations: 1, residual: 0.0, converged: true, rebuilt: false, start: 1.0 })
    }
}

/// A material with the numbers most tests care about, and no damping.
pub fn material(young_modulus: f64, poisson_ratio: f64) -> Material {
    Material { young_modulus, poisson_ratio, density: 1000.0, mass_damping: 0.0, stiffness_damping: 0.0 }
}

/// A box of cubes of edge `h`; node (i, j, k) is number (i (ny + 1) + j) (nz + 1) + k.
pub fn hex_box(n: [usize; 3], h: f64) -> VolumeMesh {
    let id = |i: usize, j: usize, k: usize| ((i * (n[1] + 1) + j) * (n[2] + 1) + k) as u32;
    let mut mesh = VolumeMesh::default();
    for i in 0..=n[0] {
        for j in 0..=n[1] {
            for k in 0..=n[2] {
                mesh.nodes.push([i as f64 * h, j as f64 * h, k as f64 * h]);
            }
        }
    }
    for i in 0..n[0] {
        for j in 0..n[1] {
            for k in 0..n[2] {
                let bottom = |k: usize| [id(i, j, k), id(i + 1, j, k), id(i + 1, j + 1, k), id(i, j + 1, k)];
                let (b, t) = (bottom(k), bottom(k + 1));
                mesh.hexes.push([b[0], b[1], b[2], b[3], t[0], t[1], t[2], t[3]]);
            }
        }
    }
    mesh
}

/// The same box with every cube cut into six tetrahedra along its diagonal.
pub fn tet_box(n: [usize; 3], h: f64) -> VolumeMesh {
    let cubes = hex_box(n, h);
    let tets = cubes.hexes.iter().flat_map(|c| {
        // paths from corner 0 to corner 6, one per order of the axes, turned to positive volume
        [[0, 1, 2, 6], [0, 2, 3, 6], [0, 3, 7, 6], [0, 7, 4, 6], [0, 4, 5, 6], [0, 5, 1, 6]]
            .map(|t| t.map(|k: usize| c[k]))
    });
    VolumeMesh { tets: tets.collect(), nodes: cubes.nodes.clone(), ..VolumeMesh::default() }
}

/// A body of one material with the nodes prescribed that `held` picks by rest position.
pub fn body<R: Scalar>(
    mesh: VolumeMesh,
    material: Material,
    model: ElasticModel,
    held: impl Fn([f64; 3]) -> bool,
) -> Body<R> {
    let mask = mesh.nodes.iter().map(|p| held(*p)).collect();
    Body::new(mesh, &MaterialMap::uniform(material), model, DofConstraints::from_mask(mask)).unwrap()
}

/// The body's rest state.
pub fn rest<R: Scalar>(body: &Body<R>) -> State<R> {
    State::at_rest(body.mesh.nodes.iter().map(|p| p.map(R::from_f64)).collect())
}

/// One step with prescribed nodes standing where they are.
pub fn still_step<R: Scalar>(
    integrator: &mut dyn Integrator<R>,
    body: &mut Body<R>,
    solver: &mut dyn LinearSolver<R>,
    force: &[[R; 3]],
    dt: f64,
    state: &mut State<R>,
) -> Result<StepOutput<R>, softrig::integrate::StepError> {
    let target = state.position.clone();
    let zero = vec![[R::zero(); 3]; target.len()];
    let mut output = StepOutput::default();
    let input = StepInput {
        target_position: &target,
        target_velocity: &zero,
        external_force: force,
        dt,
        tolerance: 1e-9_f64.max(8.0 * R::EPSILON.to_f64()),
        reactions: true,
    };
    integrator.step(body, solver, &input, state, &mut output)?;
    Ok(output)
}

/// Numbers that look random and never change.
pub fn noise(seed: u64) -> impl FnMut() -> f64 {
    let mut s = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1;
    move || {
        s ^= s << 13;
        s ^= s >> 7;
        s ^= s << 17;
        (s >> 11) as f64 / (1u64 << 53) as f64 * 2.0 - 1.0
    }
}

/// Internal force, energy with fresh rotations at `x`.
pub fn force_at<R: Scalar>(body: &mut Body<R>, x: &[[R; 3]]) -> (Vec<[R; 3]>, f64) {
    let mut f = vec![[R::zero(); 3]; x.len()];
    body.model.linearise(x);
    let energy = body.model.force(x, softrig::force::Increment::none(), &mut f);
    (f, energy)
}
