//! Element-by-element evaluation of elastic forces: the standard method, with or without stiffness warping.
//!
//! Linear: f_a = V (2 mu E + lam tr(E) I) g_a with the strain E of u + ζ v. Warped [Mueller2004], [Tang2009 §4.2]:
//! f_a = V R (2 mu (S - I) + lam tr(S - I) I) g_a with R the rotation of the cell; eq. 10 of [Tang2009] turns single matrix
//! entries at a vertex, here whole cells are turned. Four cells at once, their corners transposed into lanes; forces are added to
//! the nodes in the order of the cells.
//! Terms: g_a shape gradients [1/m]; V volume; lam, mu Lamé constants; q quaternion of R; sign of f_int.
#![allow(non_snake_case, reason = "symbols of the continuum mechanics literature")]

use crate::part::{self, Part};
use softrig::force::polar::{polar, rotation, symmetric};
use softrig::force::{ForceModel, Increment, tet_gradients};
use softrig::material::MaterialMap;
use softrig::mesh::VolumeMesh;
use softrig_linalg::{BlockCsr, Kernel, Lane, Mat3, Scalar, Vec3, Wide, run_wide};

/// Cells side by side.
const LANES: usize = 4;
type Quad<R> = Wide<R, LANES>;

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
pub struct ElementWise<R> {
    /// Rotations follow the positions in every `refresh`th force only [-]; forces between use those of the last. Default 1: always. The
    /// error of a rotation that is θ behind is of order θ².
    pub refresh: u32,
    /// Forces since rotations followed.
    calls: u32,
    warping: Warping,
    parts: Vec<Cells<R>>,
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

/// Four cells of a part; the last group repeats its last cell without stiffness.
#[derive(Clone)]
struct Group<R> {
    node: [[u32; LANES]; 4],
    gradient: [[[R; LANES]; 3]; 3],
    /// V lam, 2 V mu, b.
    lambda: [R; LANES],
    mu: [R; LANES],
    damping: [R; LANES],
}

struct Cells<R> {
    part: Part,
    rest: Vec<[R; 3]>,
    groups: Vec<Group<R>>,
    q: Vec<[[R; LANES]; 4]>,
    saved: Vec<[[R; LANES]; 4]>,
    /// Cell of the mesh behind each lane; `u32::MAX` for fillers.
    cell: Vec<[u32; LANES]>,
    u: Vec<[R; 4]>,
    v: Vec<[R; 4]>,
    f: Vec<[R; 4]>,
}

impl<R: Scalar> ElementWise<R> {
    /// The evaluation of a mesh that [`softrig::body::Body::new`] accepts.
    ///
    /// # Errors
    /// [`ElementError`] when there are hexahedra.
    pub fn new(mesh: &VolumeMesh, materials: &MaterialMap, warping: Warping) -> Result<Self, ElementError> {
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
                for four in cells.chunks(LANES) {
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
        let follow = self.calls == 0;
        self.calls = if self.calls + 1 < self.refresh { self.calls + 1 } else { 0 };
        let damped = input.uniform != Some(R::zero());
        part::run(
            &mut self.parts,
            |c| c.part.own.clone(),
            force,
            |cells, out| match (warped, input.uniform) {
                (true, _) => run_wide::<R, _>(Warped { cells, input, follow, damped, out }),
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
                for l in (0..LANES).filter(|l| cell[*l] != u32::MAX) {
                    out[cell[l] as usize] = q.map(|c| c[l]);
                }
            }
        }
        out
    }
}

impl<R: Scalar> Cells<R> {
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
        self.q.push([[R::zero(); LANES], [R::zero(); LANES], [R::zero(); LANES], [R::one(); LANES]]);
        self.cell.push(std::array::from_fn(|l| if full(l) { four[l] } else { u32::MAX }));
    }
}

/// What forces are computed from.
#[derive(Clone, Copy)]
struct Input<'a, R> {
    position: &'a [[R; 3]],
    velocity: &'a [[R; 3]],
    damping: R,
    /// b of all cells.
    uniform: Option<R>,
}

// No closures in the kernels: one that is not inlined is compiled without their wide instructions.

/// Copies `from` of a part's nodes into quads.
#[inline(always)]
fn gather<R: Scalar>(part: &Part, from: &[[R; 3]], to: &mut [[R; 4]]) {
    let (own, copies) = to.split_at_mut(part.own.len());
    for (t, f) in own.iter_mut().zip(&from[part.own.clone()]) {
        *t = [f[0], f[1], f[2], R::zero()];
    }
    for (t, n) in copies.iter_mut().zip(&part.copies) {
        let f = from[*n as usize];
        *t = [f[0], f[1], f[2], R::zero()];
    }
}

/// Corner `a` of four cells.
#[inline(always)]
fn corner<R: Scalar>(from: &[[R; 4]], node: &[u32; LANES]) -> Vec3<Quad<R>> {
    let [a, b, c, d] = *node;
    let t = R::transposed([&from[a as usize], &from[b as usize], &from[c as usize], &from[d as usize]]);
    Vec3([Wide(t[0]), Wide(t[1]), Wide(t[2])])
}

/// Adds the forces on corner `a` of four cells.
#[inline(always)]
fn scatter<R: Scalar>(f: Vec3<Quad<R>>, node: &[u32; LANES], to: &mut [[R; 4]]) {
    let zero = [R::zero(); 4];
    let t = R::transposed([&f.0[0].0, &f.0[1].0, &f.0[2].0, &zero]);
    for l in 0..LANES {
        let at = &mut to[node[l] as usize];
        *at = (Wide(*at) + Wide(t[l])).0;
    }
}

/// Σ d_a g_aᵀ over corners 1, 2, 3.
#[inline(always)]
fn gradient_of<R: Scalar>(d: [Vec3<Quad<R>>; 3], g: &[[[R; LANES]; 3]; 3]) -> Mat3<Quad<R>> {
    let g = shape(g);
    d[0].outer(g[0]) + d[1].outer(g[1]) + d[2].outer(g[2])
}

#[inline(always)]
fn shape<R: Scalar>(g: &[[[R; LANES]; 3]; 3]) -> [Vec3<Quad<R>>; 3] {
    [
        Vec3([Wide(g[0][0]), Wide(g[0][1]), Wide(g[0][2])]),
        Vec3([Wide(g[1][0]), Wide(g[1][1]), Wide(g[1][2])]),
        Vec3([Wide(g[2][0]), Wide(g[2][1]), Wide(g[2][2])]),
    ]
}

/// Differences of the corners to the first.
#[inline(always)]
fn edges<R: Scalar>(from: &[[R; 4]], node: &[[u32; LANES]; 4]) -> [Vec3<Quad<R>>; 3] {
    let origin = corner(from, &node[0]);
    [corner(from, &node[1]) - origin, corner(from, &node[2]) - origin, corner(from, &node[3]) - origin]
}

/// 2 mu E + lam tr(E) I with E the symmetric part of G.
#[inline(always)]
fn stress<R: Scalar>(G: Mat3<Quad<R>>, lambda: Quad<R>, two_mu: Quad<R>) -> Mat3<Quad<R>> {
    let mu = two_mu * Wide::constant(0.5);
    let g = G.0;
    let t = lambda * (g[0][0] + g[1][1] + g[2][2]);
    let (xy, yz, zx) = (mu * (g[0][1] + g[1][0]), mu * (g[1][2] + g[2][1]), mu * (g[2][0] + g[0][2]));
    Mat3([[two_mu * g[0][0] + t, xy, zx], [xy, two_mu * g[1][1] + t, yz], [zx, yz, two_mu * g[2][2] + t]])
}

#[inline(always)]
fn scatter_all<R: Scalar>(P: Mat3<Quad<R>>, group: &Group<R>, to: &mut [[R; 4]]) {
    let g = shape(&group.gradient);
    let f = [P * g[0], P * g[1], P * g[2]];
    scatter(-(f[0] + f[1] + f[2]), &group.node[0], to);
    scatter(f[0], &group.node[1], to);
    scatter(f[1], &group.node[2], to);
    scatter(f[2], &group.node[3], to);
}

#[inline(always)]
fn write<R: Scalar>(f: &[[R; 4]], out: &mut [[R; 3]]) {
    for (o, f) in out.iter_mut().zip(f) {
        *o = [f[0], f[1], f[2]];
    }
}

/// Linear strain, all cells damped alike: one strain of u + b v.
struct Linear<'a, R> {
    cells: &'a mut Cells<R>,
    input: Input<'a, R>,
    factor: R,
    out: &'a mut [[R; 3]],
}

impl<R: Scalar> Kernel for Linear<'_, R> {
    type Output = ();
    #[inline(always)]
    fn run<const W: usize>(self) {
        let Self { cells, input, factor, out } = self;
        let own = cells.part.own.clone();
        let (u_own, u_copies) = cells.u.split_at_mut(own.len());
        let (x, v) = (&input.position[own.clone()], &input.velocity[own.clone()]);
        for (((u, x), v), rest) in u_own.iter_mut().zip(x).zip(v).zip(&cells.rest) {
            for k in 0..3 {
                u[k] = (x[k] - rest[k]) + factor * v[k];
            }
        }
        for ((u, n), rest) in u_copies.iter_mut().zip(&cells.part.copies).zip(&cells.rest[own.len()..]) {
            let (x, v) = (input.position[*n as usize], input.velocity[*n as usize]);
            for k in 0..3 {
                u[k] = (x[k] - rest[k]) + factor * v[k];
            }
        }
        cells.f.fill([R::zero(); 4]);
        for group in &cells.groups {
            let G = gradient_of(edges(&cells.u, &group.node), &group.gradient);
            let P = stress(G, Wide(group.lambda), Wide(group.mu));
            scatter_all(P, group, &mut cells.f);
        }
        write(&cells.f, out);
    }
}

/// Linear strain, each cell with its own damping.
struct LinearTwice<'a, R> {
    cells: &'a mut Cells<R>,
    input: Input<'a, R>,
    out: &'a mut [[R; 3]],
}

impl<R: Scalar> Kernel for LinearTwice<'_, R> {
    type Output = ();
    #[inline(always)]
    fn run<const W: usize>(self) {
        let Self { cells, input, out } = self;
        gather(&cells.part, input.position, &mut cells.u);
        gather(&cells.part, input.velocity, &mut cells.v);
        for (u, rest) in cells.u.iter_mut().zip(&cells.rest) {
            for k in 0..3 {
                u[k] -= rest[k];
            }
        }
        cells.f.fill([R::zero(); 4]);
        for group in &cells.groups {
            let b = Wide(group.damping) + Wide::splat(input.damping);
            let G = gradient_of(edges(&cells.u, &group.node), &group.gradient)
                + gradient_of(edges(&cells.v, &group.node), &group.gradient).scale(b);
            let P = stress(G, Wide(group.lambda), Wide(group.mu));
            scatter_all(P, group, &mut cells.f);
        }
        write(&cells.f, out);
    }
}

/// Stiffness warping: rotations and forces in one pass over the cells.
struct Warped<'a, R> {
    cells: &'a mut Cells<R>,
    input: Input<'a, R>,
    /// Rotations follow the positions.
    follow: bool,
    /// There is damping.
    damped: bool,
    out: &'a mut [[R; 3]],
}

impl<R: Scalar> Kernel for Warped<'_, R> {
    type Output = ();
    #[inline(always)]
    fn run<const W: usize>(self) {
        let Self { cells, input, follow, damped, out } = self;
        gather(&cells.part, input.position, &mut cells.u);
        if damped {
            gather(&cells.part, input.velocity, &mut cells.v);
        }
        cells.f.fill([R::zero(); 4]);
        for (group, stored) in cells.groups.iter().zip(&mut cells.q) {
            let mut F = gradient_of(edges(&cells.u, &group.node), &group.gradient);
            let mut q = [Wide(stored[0]), Wide(stored[1]), Wide(stored[2]), Wide(stored[3])];
            if follow {
                q = polar(F, q);
                for c in 0..4 {
                    stored[c] = q[c].0;
                }
            }
            let rot = rotation(q);
            if damped {
                let b = Wide(group.damping) + Wide::splat(input.damping);
                F += gradient_of(edges(&cells.v, &group.node), &group.gradient).scale(b);
            }
            // strain S - I, and its rate times b, in the cell's own axes
            let E = rot.transpose() * F - Mat3::identity();
            let P = rot * stress(E, Wide(group.lambda), Wide(group.mu));
            scatter_all(P, group, &mut cells.f);
        }
        write(&cells.f, out);
    }
}

impl<R: Scalar> ForceModel<R> for ElementWise<R> {
    /// Rotations follow with the next force.
    fn linearise(&mut self, position: &[[R; 3]]) {
        self.linearised.copy_from_slice(position);
    }

    fn force(&mut self, position: &[[R; 3]], increment: Increment<'_, R>, force: &mut [[R; 3]]) -> f64 {
        self.calls = 0;
        let zero = vec![[R::zero(); 3]; position.len()];
        let velocity = increment.velocity.unwrap_or(&zero);
        self.internal_force(position, velocity, increment.damping, force);
        if let Some(d) = increment.displacement {
            // K d is what damping with b = 1 and v = d would be, less the rest
            let (mut with, mut without) = (zero.clone(), zero.clone());
            let uniform = self.uniform.then_some(R::one());
            for (out, velocity) in [(&mut with, d), (&mut without, &zero[..])] {
                let input = Input { position, velocity, damping: R::zero(), uniform };
                let warped = self.warping == Warping::Stiffness;
                part::run(
                    &mut self.parts,
                    |c| c.part.own.clone(),
                    out,
                    |cells, out| {
                        let own: Vec<[R; LANES]> = cells.groups.iter().map(|g| g.damping).collect();
                        cells.groups.iter_mut().for_each(|g| g.damping = [R::one(); LANES]);
                        if warped {
                            run_wide::<R, _>(Warped { cells, input, follow: false, damped: true, out });
                        } else {
                            run_wide::<R, _>(LinearTwice { cells, input, out });
                        }
                        cells.groups.iter_mut().zip(own).for_each(|(g, b)| g.damping = b);
                    },
                );
            }
            for ((f, a), b) in force.iter_mut().zip(with).zip(without) {
                (0..3).for_each(|k| f[k] += a[k] - b[k]);
            }
        }
        self.energy(position)
    }

    fn stiffness(&mut self, rate: R, damping: R, matrix: &mut BlockCsr<R>) {
        if self.warping == Warping::Stiffness {
            self.calls = 0;
            let position = std::mem::take(&mut self.linearised);
            let mut force = vec![[R::zero(); 3]; position.len()];
            let zero = force.clone();
            self.internal_force(&position, &zero, R::zero(), &mut force);
            self.linearised = position;
        }
        let q = self.quaternions();
        matrix.values.fill([R::zero(); 9]);
        for ((cell, c), q) in self.nodes.iter().zip(&self.constants).zip(q) {
            let rot = rotation(q.map(Scalar::to_f64));
            let g = c.gradient.map(|g| rot * Vec3(g));
            let g = [-(g[0] + g[1] + g[2]), g[0], g[1], g[2]];
            let factor = 1.0 + rate.to_f64() * (c.damping + damping.to_f64());
            for a in 0..4 {
                for b in 0..4 {
                    let at = matrix.pattern.find(cell[a] as usize, cell[b] as usize);
                    let at = at.expect("the pattern is that of the body's cells");
                    let k = g[a].outer(g[b]).scale(c.lambda)
                        + g[b].outer(g[a]).scale(c.mu)
                        + Mat3::diagonal(c.mu * g[a].dot(g[b]));
                    let block = &mut matrix.values[at];
                    (0..9).for_each(|i| block[i] += R::from_f64(factor * k.0[i / 3][i % 3]));
                }
            }
        }
    }

    fn save(&mut self) {
        self.parts.iter_mut().for_each(|c| c.saved.copy_from_slice(&c.q));
    }

    fn roll_back(&mut self) {
        self.parts.iter_mut().for_each(|c| c.q.copy_from_slice(&c.saved));
    }

    fn history(&self) -> Vec<[R; 4]> {
        self.quaternions()
    }

    fn restore(&mut self, history: &[[R; 4]]) {
        let cold = [R::zero(), R::zero(), R::zero(), R::one()];
        for cells in &mut self.parts {
            for (cell, q) in cells.cell.iter().zip(&mut cells.q) {
                let known = cell.iter().rev().find(|c| **c != u32::MAX).copied().unwrap_or(0);
                for l in 0..LANES {
                    let c = if cell[l] == u32::MAX { known } else { cell[l] };
                    let value = if history.len() == self.nodes.len() { history[c as usize] } else { cold };
                    (0..4).for_each(|k| q[k][l] = value[k]);
                }
            }
        }
    }
}

impl<R: Scalar> ElementWise<R> {
    /// Elastic energy with the rotations of the last force [J].
    fn energy(&self, position: &[[R; 3]]) -> f64 {
        let warped = self.warping == Warping::Stiffness;
        let q = self.quaternions();
        let mut sum = 0.0;
        for ((cell, c), q) in self.nodes.iter().zip(&self.constants).zip(q) {
            let x = cell.map(|n| Vec3(position[n as usize].map(Scalar::to_f64)));
            let F = (x[1] - x[0]).outer(Vec3(c.gradient[0]))
                + (x[2] - x[0]).outer(Vec3(c.gradient[1]))
                + (x[3] - x[0]).outer(Vec3(c.gradient[2]));
            let F = if warped { rotation(q.map(Scalar::to_f64)).transpose() * F } else { F };
            let E = symmetric(F) - Mat3::identity();
            let square: f64 = (0..3).map(|i| E.row(i).dot(E.row(i))).sum();
            sum += c.mu * square + 0.5 * c.lambda * E.trace() * E.trace();
        }
        sum
    }
}
