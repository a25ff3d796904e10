//! Element-by-element evaluation of elastic forces: the standard method, with or without stiffness warping.
//!
//! Linear: f_a = V (2 mu E + lam tr(E) I) g_a with the strain E of u + ζ v. Warped [Mueller2004], [Tang2009 §4.2]:
//! f_a = V R (2 mu (S - I) + lam tr(S - I) I) g_a with R the rotation of the cell; eq. 10 of [Tang2009] turns single matrix
//! entries at a vertex, here whole cells are turned. Four or eight cells at once, their corners transposed into lanes; forces are added to
//! the nodes in the order of the cells.
//! Terms: g_a shape gradients [1/m]; V volume; lam, mu Lamé constants; q quaternion of R; sign of f_int.
mod follow;
mod kernel;
mod model;

use crate::part::{self, Part};
use follow::{Exactly, OneStep, Rotations};
use kernel::{Input, Linear, LinearTwice, Warped, WarpedDamped};
use softrig::force::tet_gradients;
use softrig::material::MaterialMap;
use softrig::mesh::VolumeMesh;
use softrig_linalg::{Scalar, run_wide};

/// How cells account for their rotation.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Warping {
    /// Not at all: linear strain.
    #[default]
    None,
    /// Each cell's stiffness turns with it.
    Stiffness,
}

/// Why a mesh has no element-by-element evaluation.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum ElementError {
    /// Some cells are not tetrahedra.
    #[error("the mesh has {0} hexahedra; cut them into tetrahedra first (`tetrahedralize`)")]
    Hexahedra(usize),
}

/// Linear or warped elasticity of tetrahedra, cell by cell.
pub struct ElementWise<R, const N: usize = 4> {
    /// Rotations are found to rounding in every `refresh`th force only [-]; in the forces between they follow by one step of the
    /// same iteration, which leaves an error of the order θ³ where a cell has turned by θ since the force before. Default 1: always.
    pub refresh: u32,
    /// Forces since rotations were found to rounding.
    calls: u32,
    warping: Warping,
    parts: Vec<Cells<R, N>>,
    rest: Vec<[R; 3]>,
    /// b where all cells have the same.
    damping: R,
    uniform: bool,
    /// Positions of the last linearisation, for the stiffness.
    linearised: Vec<[R; 3]>,
    constants: Vec<Constants>,
    nodes: Vec<[u32; 4]>,
}

struct Constants {
    gradient: [[f64; 3]; 3],
    lambda: f64,
    mu: f64,
    damping: f64,
}

/// `N` cells of a part; the last group repeats its last cell without stiffness.
#[derive(Clone)]
struct Group<R, const N: usize> {
    node: [[u32; N]; 4],
    gradient: [[[R; N]; 3]; 3],
    /// V lam, 2 V mu, b.
    lambda: [R; N],
    mu: [R; N],
    damping: [R; N],
}

struct Cells<R, const N: usize> {
    part: Part,
    rest: Vec<[R; 3]>,
    groups: Vec<Group<R, N>>,
    q: Vec<[[R; N]; 4]>,
    saved: Vec<[[R; N]; 4]>,
    /// Cell of the mesh behind each lane; `u32::MAX` for fillers.
    cell: Vec<[u32; N]>,
    u: Vec<[R; 4]>,
    v: Vec<[R; 4]>,
    f: Vec<[R; 4]>,
}

impl<R: Scalar> ElementWise<R> {
    /// The evaluation of a mesh that [`softrig::body::Body::new`] accepts, four cells at a time.
    ///
    /// # Errors
    /// [`ElementError`] when there are hexahedra.
    pub fn new(mesh: &VolumeMesh, materials: &MaterialMap, warping: Warping) -> Result<Self, ElementError> {
        Self::side_by_side(mesh, materials, warping)
    }
}

impl<R: Scalar, const N: usize> ElementWise<R, N> {
    /// As [`Self::new`], `N` cells at a time, 4 or 8: eight of f32 are as wide as four of f64.
    ///
    /// # Errors
    /// [`ElementError`] when there are hexahedra.
    pub fn side_by_side(mesh: &VolumeMesh, materials: &MaterialMap, warping: Warping) -> Result<Self, ElementError> {
        if !mesh.hexes.is_empty() {
            return Err(ElementError::Hexahedra(mesh.hexes.len()));
        }
        let rest: Vec<[R; 3]> = mesh.nodes.iter().map(|p| p.map(R::from_f64)).collect();
        let constants: Vec<Constants> = mesh
            .tets
            .iter()
            .enumerate()
            .map(|(i, cell)| {
                let m = materials.get(i);
                let (gradient, volume) = tet_gradients(cell.map(|n| mesh.nodes[n as usize]));
                let (lambda, mu) = (m.lambda() * volume, m.shear_modulus() * volume);
                Constants { gradient, lambda, mu, damping: m.stiffness_damping }
            })
            .collect();
        // neighbours in memory where they are neighbours in space, however the mesh was written
        let mut order: Vec<u32> = (0..mesh.tets.len() as u32).collect();
        order.sort_by_key(|i| mesh.tets[*i as usize].iter().min());
        let sorted: Vec<[u32; 4]> = order.iter().map(|i| mesh.tets[*i as usize]).collect();
        let parts = part::parts(mesh.node_count(), &sorted)
            .into_iter()
            .map(|(part, own)| {
                let cells: Vec<u32> = own.iter().map(|k| order[*k as usize]).collect();
                let mut out = Cells {
                    rest: (0..part.len()).map(|l| rest[part.global(l)]).collect(),
                    groups: Vec::new(),
                    q: Vec::new(),
                    saved: Vec::new(),
                    cell: Vec::new(),
                    u: vec![[R::zero(); 4]; part.len()],
                    v: vec![[R::zero(); 4]; part.len()],
                    f: vec![[R::zero(); 4]; part.len()],
                    part,
                };
                for four in cells.chunks(N) {
                    out.push(four, &mesh.tets, &constants);
                }
                out.saved = out.q.clone();
                out
            })
            .collect();
        let b = constants.first().map_or(0.0, |c| c.damping);
        Ok(Self {
            refresh: 1,
            calls: 0,
            warping,
            parts,
            uniform: constants.iter().all(|c| c.damping == b),
            damping: R::from_f64(b),
            linearised: rest.clone(),
            rest,
            constants,
            nodes: mesh.tets.clone(),
        })
    }

    /// Writes f_int(x, v) [N], with the stiffness-proportional damping of the materials and `damping` [s] more. Rotations follow the
    /// positions.
    ///
    /// # Panics
    /// When a list has another length than the body.
    pub fn internal_force(&mut self, position: &[[R; 3]], velocity: &[[R; 3]], damping: R, force: &mut [[R; 3]]) {
        let n = self.rest.len();
        assert!(position.len() == n && velocity.len() == n && force.len() == n, "one entry per node");
        let input = Input { position, velocity, damping, uniform: self.uniform.then_some(self.damping + damping) };
        let warped = self.warping == Warping::Stiffness;
        let exactly = self.calls == 0;
        self.calls = if self.calls + 1 < self.refresh { self.calls + 1 } else { 0 };
        let damped = input.uniform != Some(R::zero());
        part::run(
            &mut self.parts,
            |c| c.part.own.clone(),
            force,
            |cells, out| match (warped, input.uniform) {
                (true, _) if exactly => warp(cells, input, Exactly, damped, out),
                (true, _) => warp(cells, input, OneStep, damped, out),
                (false, Some(factor)) => run_wide::<R, _>(Linear { cells, input, factor, out }),
                (false, None) => run_wide::<R, _>(LinearTwice { cells, input, out }),
            },
        );
    }

    /// What the cells store now: the rotation of each.
    fn quaternions(&self) -> Vec<[R; 4]> {
        let mut out = vec![[R::zero(); 4]; self.nodes.len()];
        for cells in &self.parts {
            for (cell, q) in cells.cell.iter().zip(&cells.q) {
                for l in (0..N).filter(|l| cell[*l] != u32::MAX) {
                    out[cell[l] as usize] = q.map(|c| c[l]);
                }
            }
        }
        out
    }
}

fn warp<R: Scalar, const N: usize>(
    cells: &mut Cells<R, N>,
    input: Input<'_, R>,
    rotations: impl Rotations,
    damped: bool,
    out: &mut [[R; 3]],
) {
    let work = Warped { cells, input, rotations, out };
    if damped { run_wide::<R, _>(WarpedDamped(work)) } else { run_wide::<R, _>(work) }
}

impl<R: Scalar, const N: usize> Cells<R, N> {
    fn push(&mut self, four: &[u32], tets: &[[u32; 4]], constants: &[Constants]) {
        let at = |l: usize| four[l.min(four.len() - 1)] as usize;
        let full = |l: usize| l < four.len();
        let fill = |f: &dyn Fn(&Constants) -> f64| std::array::from_fn(|l| R::from_f64(f(&constants[at(l)])));
        let stiff = |f: &dyn Fn(&Constants) -> f64| {
            std::array::from_fn(|l| if full(l) { R::from_f64(f(&constants[at(l)])) } else { R::zero() })
        };
        self.groups.push(Group {
            node: std::array::from_fn(|a| {
                std::array::from_fn(|l| self.part.local(tets[at(l)][a]).expect("a part has the nodes of its cells"))
            }),
            gradient: std::array::from_fn(|a| std::array::from_fn(|k| fill(&|c| c.gradient[a][k]))),
            lambda: stiff(&|c| c.lambda),
            mu: stiff(&|c| 2.0 * c.mu),
            damping: fill(&|c| c.damping),
        });
        self.q.push([[R::zero(); N], [R::zero(); N], [R::zero(); N], [R::one(); N]]);
        self.cell.push(std::array::from_fn(|l| if full(l) { four[l] } else { u32::MAX }));
    }
}
