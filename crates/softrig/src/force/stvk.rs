//! St. Venant-Kirchhoff elasticity: W = ∫ mu |E|² + lam/2 tr(E)², E = (Fᵀ F − I)/2. A check on the corotated model.
//!
//! One point per tetrahedron, eight per hexahedron. The stiffness a solver sees is positive semidefinite: of the second
//! Piola-Kirchhoff stress only the tensile part enters its geometric term. [`stvk_hessian`] is the exact one.
//!
//! Terms: F = Σ x_a g_aᵀ [-]; T = 2 mu E + lam tr(E) I [Pa]; P = F T; f_a = V P g_a.
#![allow(non_snake_case, reason = "symbols of the continuum mechanics literature")]

use super::ForceModel;
use super::assembly::Increment;
use super::hex::hex_points;
use super::polar::eigen_symmetric;
use super::tet::tet_gradients;
use crate::material::MaterialMap;
use crate::mesh::{CellKind, VolumeMesh};
use softrig_linalg::{BlockCsr, Mat3, Scalar, Vec3};

/// Volume and shape gradients at one point of a cell; a tetrahedron uses the first four.
#[derive(Clone, Debug)]
struct Point<R> {
    volume: R,
    gradient: [Vec3<R>; 8],
}

#[derive(Clone, Debug)]
struct Cell<R> {
    nodes: Vec<u32>,
    points: Vec<Point<R>>,
    lambda: R,
    mu: R,
    damping: R,
}

/// St. Venant-Kirchhoff elasticity on tetrahedra and hexahedra, on one thread: for checks, not for speed.
pub struct StVenantKirchhoff<R> {
    cells: Vec<Cell<R>>,
    /// Linearisation point.
    position: Vec<[R; 3]>,
}

impl<R: Scalar> StVenantKirchhoff<R> {
    /// A model of cells that [`crate::body::Body::new`] has checked.
    pub(crate) fn new(mesh: &VolumeMesh, materials: &MaterialMap) -> Self {
        let cells = (0..mesh.cell_count()).map(|i| {
            let m = materials.get(i);
            let nodes = mesh.cell(i).to_vec();
            Cell {
                points: cell_points(mesh, i),
                nodes,
                lambda: R::from_f64(m.lambda()),
                mu: R::from_f64(m.shear_modulus()),
                damping: R::from_f64(m.stiffness_damping),
            }
        });
        Self { cells: cells.collect(), position: mesh.nodes.iter().map(|p| p.map(R::from_f64)).collect() }
    }
}

fn cell_points<R: Scalar>(mesh: &VolumeMesh, i: usize) -> Vec<Point<R>> {
    let X = |k: usize| mesh.nodes[mesh.cell(i)[k] as usize];
    let cast = |g: [f64; 3]| Vec3(g.map(R::from_f64));
    match mesh.kind(i) {
        CellKind::Tet4 => {
            let (g, volume) = tet_gradients(std::array::from_fn(X));
            let g0 = std::array::from_fn(|i| -(g[0][i] + g[1][i] + g[2][i]));
            let mut gradient = [Vec3::zero(); 8];
            [g0, g[0], g[1], g[2]].iter().zip(&mut gradient).for_each(|(g, out)| *out = cast(*g));
            vec![Point { volume: R::from_f64(volume), gradient }]
        }
        CellKind::Hex8 => hex_points(std::array::from_fn(X))
            .iter()
            .map(|p| Point { volume: R::from_f64(p.volume), gradient: p.gradient.map(cast) })
            .collect(),
    }
}

impl<R: Scalar> Cell<R> {
    /// Σ y_a g_aᵀ from differences inside the cell.
    fn gradient(&self, p: &Point<R>, y: &[[R; 3]]) -> Mat3<R> {
        let y0 = Vec3(y[self.nodes[0] as usize]);
        let mut F = Mat3::zero();
        for (k, &n) in self.nodes.iter().enumerate() {
            F += (Vec3(y[n as usize]) - y0).outer(p.gradient[k]);
        }
        F
    }

    /// Green strain E and second Piola-Kirchhoff stress T.
    fn stress(&self, F: Mat3<R>) -> (Mat3<R>, Mat3<R>) {
        let half = R::from_f64(0.5);
        let E = (F.transpose() * F - Mat3::identity()).scale(half);
        (E, E.scale(self.mu + self.mu) + Mat3::diagonal(self.lambda * E.trace()))
    }
}

/// dP for a change dF, from the material term and the geometric one with stress `T`.
fn stress_change<R: Scalar>(F: Mat3<R>, T: Mat3<R>, dF: Mat3<R>, lambda: R, mu: R) -> Mat3<R> {
    let A = F.transpose() * dF;
    let dE = (A + A.transpose()).scale(R::from_f64(0.5));
    dF * T + F * (dE.scale(mu + mu) + Mat3::diagonal(lambda * dE.trace()))
}

/// The part of a stress with positive principal values.
fn tensile<R: Scalar>(T: Mat3<R>) -> Mat3<R> {
    let (values, vectors) = eigen_symmetric(Mat3(T.0.map(|r| r.map(Scalar::to_f64))));
    let mut out = Mat3::<f64>::zero();
    for k in 0..3 {
        if values[k] > 0.0 {
            out += vectors.column(k).outer(vectors.column(k)).scale(values[k]);
        }
    }
    Mat3(out.0.map(|r| r.map(R::from_f64)))
}

/// Block (a, b) of the stiffness of one point: column j is the force on a when b moves along j.
fn block<R: Scalar>(p: &Point<R>, a: usize, b: usize, F: Mat3<R>, T: Mat3<R>, lambda: R, mu: R) -> Mat3<R> {
    let column = |j: usize| {
        let e = Vec3(std::array::from_fn(|k| if k == j { R::one() } else { R::zero() }));
        (stress_change(F, T, e.outer(p.gradient[b]), lambda, mu) * p.gradient[a]).scale(p.volume)
    };
    Mat3::from_columns(column(0), column(1), column(2))
}

/// Exact second derivative of the energy of one tetrahedron with rest corners `X` [m] at corners `x` [m]: 4x4 blocks [N/m].
/// Indefinite under compression.
#[must_use]
pub fn stvk_hessian(X: [[f64; 3]; 4], x: [[f64; 3]; 4], lambda: f64, mu: f64) -> [[[[f64; 3]; 3]; 4]; 4] {
    let mesh = VolumeMesh { nodes: X.to_vec(), tets: vec![[0, 1, 2, 3]], ..VolumeMesh::default() };
    let cell = Cell { nodes: vec![0, 1, 2, 3], points: cell_points::<f64>(&mesh, 0), lambda, mu, damping: 0.0 };
    let p = &cell.points[0];
    let F = cell.gradient(p, &x);
    let (_, T) = cell.stress(F);
    std::array::from_fn(|a| std::array::from_fn(|b| block(p, a, b, F, T, lambda, mu).0))
}

impl<R: Scalar> ForceModel<R> for StVenantKirchhoff<R> {
    fn linearise(&mut self, position: &[[R; 3]]) {
        self.position.copy_from_slice(position);
    }

    fn force(&mut self, position: &[[R; 3]], increment: Increment<'_, R>, force: &mut [[R; 3]]) -> f64 {
        force.fill([R::zero(); 3]);
        let mut energy = 0.0;
        for cell in &self.cells {
            for p in &cell.points {
                let F = cell.gradient(p, position);
                let (E, T) = cell.stress(F);
                let square = E.row(0).dot(E.row(0)) + E.row(1).dot(E.row(1)) + E.row(2).dot(E.row(2));
                let w = cell.mu * square + cell.lambda * E.trace() * E.trace() * R::from_f64(0.5);
                energy += (w * p.volume).to_f64();
                let mut P = F * T;
                let mut dF = Mat3::zero();
                if let Some(d) = increment.displacement {
                    dF += cell.gradient(p, d);
                }
                if let Some(v) = increment.velocity {
                    dF += cell.gradient(p, v).scale(cell.damping + increment.damping);
                }
                if increment.displacement.is_some() || increment.velocity.is_some() {
                    P += stress_change(F, tensile(T), dF, cell.lambda, cell.mu);
                }
                for (k, &n) in cell.nodes.iter().enumerate() {
                    let f = (P * p.gradient[k]).scale(p.volume);
                    (0..3).for_each(|c| force[n as usize][c] += f.0[c]);
                }
            }
        }
        energy
    }

    fn stiffness(&mut self, rate: R, damping: R, matrix: &mut BlockCsr<R>) {
        matrix.values.fill([R::zero(); 9]);
        for cell in &self.cells {
            let factor = R::one() + rate * (cell.damping + damping);
            for p in &cell.points {
                let F = cell.gradient(p, &self.position);
                let T = tensile(cell.stress(F).1);
                for (a, &i) in cell.nodes.iter().enumerate() {
                    for (b, &j) in cell.nodes.iter().enumerate() {
                        let at = matrix.pattern.find(i as usize, j as usize);
                        let at = at.expect("the pattern was made from these cells");
                        let k = block(p, a, b, F, T, cell.lambda, cell.mu);
                        for e in 0..9 {
                            matrix.values[at][e] += k.0[e / 3][e % 3] * factor;
                        }
                    }
                }
            }
        }
    }

    fn save(&mut self) {}
    fn roll_back(&mut self) {}
    fn history(&self) -> Vec<[R; 4]> {
        Vec::new()
    }
    fn restore(&mut self, _: &[[R; 4]]) {}
}
