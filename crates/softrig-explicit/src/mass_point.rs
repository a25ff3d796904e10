//! Bodies of mass points whose tetrahedra keep distances, areas and volumes.
//!
//! Implements [Teschner2004] as [Gissler2006 §5] uses it. Each constraint C = (size - rest size) / rest size, for the length of an edge, the
//! area of a triangle of the surface and the volume of a tetrahedron, has the energy k C²/2 and the damped force
//! F_i = -(k C + k_d dC/dt) dC/dx_i. Four tetrahedra at once: an edge or a triangle belongs to the first tetrahedron that has it.
//! Terms: x positions [m]; v velocities [m/s]; d edge; l its length; n normal of a triangle, twice its area long.

use crate::part::{self, Part};
use crate::stepper::ForceLaw;
use softrig::force::tet_gradients;
use softrig::mesh::VolumeMesh;
use softrig_linalg::{Kernel, Lane, Scalar, Vec3, Wide, run_wide};
use std::collections::BTreeMap;

/// Cells side by side.
const LANES: usize = 4;
type Quad<R> = Wide<R, LANES>;

/// Corners of the edges of a tetrahedron.
const EDGES: [[usize; 2]; 6] = [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]];
/// Corners of its triangles.
const FACES: [[usize; 3]; 4] = [[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]];

/// Energies of one tetrahedral mesh, all the same in every cell.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Energies {
    /// k of every edge [J]: a spring of k / l0² [N/m].
    pub distance: f64,
    /// k of every triangle of the surface [J].
    pub area: f64,
    /// k of every tetrahedron [J].
    pub volume: f64,
    /// k_d / k [s]. Default 0.002: jelly that swings a few times.
    pub damping: f64,
    /// Mass of a cubic metre [kg/m3].
    pub density: f64,
}

impl Default for Energies {
    /// About as stiff as soft rubber at cells of 10 cm.
    fn default() -> Self {
        Self { distance: 5.0, area: 1.0, volume: 5.0, damping: 0.002, density: 1000.0 }
    }
}

/// Why a mesh with energies is no body.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum MassPointError {
    /// Some cells are not tetrahedra.
    #[error("the mesh has {0} hexahedra; cut them into tetrahedra first (`tetrahedralize`)")]
    Hexahedra(usize),
    /// There is nothing to compute with.
    #[error("the mesh has no tetrahedra")]
    Empty,
    /// A cell names a node that does not exist.
    #[error("tetrahedron {cell} names node {node}, the mesh has {node_count} nodes")]
    MissingNode {
        /// Which cell.
        cell: usize,
        /// The node it names.
        node: u32,
        /// How many there are.
        node_count: usize,
    },
    /// A cell has no volume at rest.
    #[error("tetrahedron {cell} has the volume {volume:.3e} m3 at rest; it must be positive: turn or remove it")]
    BadCell {
        /// Which cell.
        cell: usize,
        /// Its volume [m3].
        volume: f64,
    },
    /// A coefficient is out of range.
    #[error("{field} is {value}, it must be finite and {expected}")]
    OutOfRange {
        /// Which one.
        field: &'static str,
        /// Its value.
        value: f64,
        /// What it must be.
        expected: &'static str,
    },
}

/// A body, or several, of mass points.
pub struct MassPoints<R> {
    /// Acceleration of everything [m/s2]; zero at first.
    pub gravity: [f64; 3],
    /// Drag on the velocity [1/s]; zero at first.
    pub drag: f64,
    mass: Vec<R>,
    parts: Vec<Cells<R>>,
    edge_count: usize,
    triangle_count: usize,
}

struct Group<R> {
    node: [[u32; LANES]; 4],
    /// 1 / l0 and k / l0 of each edge.
    edge: [[[R; LANES]; 2]; 6],
    /// 1 / A0 and k / A0 of each triangle.
    face: [[[R; LANES]; 2]; 4],
    /// 1 / V0 and k / V0.
    volume: [[R; LANES]; 2],
    /// k_d / k [s].
    damping: [R; LANES],
    /// Triangles that have a stiffness in any lane.
    surface: [bool; 4],
}

struct Cells<R> {
    part: Part,
    groups: Vec<Group<R>>,
    x: Vec<[R; 4]>,
    v: Vec<[R; 4]>,
    f: Vec<[R; 4]>,
}

impl<R: Scalar> MassPoints<R> {
    /// A body at rest in its mesh.
    ///
    /// # Errors
    /// [`MassPointError`] when the mesh or a coefficient is not usable.
    pub fn new(mesh: &VolumeMesh, energies: &Energies) -> Result<Self, MassPointError> {
        check(mesh, energies)?;
        let node_count = mesh.node_count();
        let mut mass = vec![0.0; node_count];
        for t in &mesh.tets {
            let (_, volume) = tet_gradients(t.map(|n| mesh.nodes[n as usize]));
            t.iter().for_each(|n| mass[*n as usize] += energies.density * volume / 4.0);
        }
        // the first cell of each edge, and of each triangle that only one cell has
        let mut edges = BTreeMap::<[u32; 2], usize>::new();
        let mut faces = BTreeMap::<[u32; 3], (usize, usize)>::new();
        for (i, t) in mesh.tets.iter().enumerate() {
            for e in EDGES {
                edges.entry(sorted(e.map(|c| t[c]))).or_insert(i);
            }
            for f in FACES {
                faces.entry(sorted(f.map(|c| t[c]))).or_insert((i, 0)).1 += 1;
            }
        }
        let mut order: Vec<u32> = (0..mesh.tets.len() as u32).collect();
        order.sort_by_key(|i| mesh.tets[*i as usize].iter().min());
        let cells: Vec<[u32; 4]> = order.iter().map(|i| mesh.tets[*i as usize]).collect();
        let constants: Vec<_> =
            order.iter().map(|i| cell_constants(mesh, *i as usize, energies, &edges, &faces)).collect();
        let parts = part::parts(node_count, &cells)
            .into_iter()
            .map(|(part, own)| {
                let groups = own.chunks(LANES).map(|four| group(&part, four, &cells, &constants)).collect();
                let quads = vec![[R::zero(); 4]; part.len()];
                Cells { part, groups, x: quads.clone(), v: quads.clone(), f: quads }
            })
            .collect();
        Ok(Self {
            gravity: [0.0; 3],
            drag: 0.0,
            mass: mass.into_iter().map(R::from_f64).collect(),
            parts,
            edge_count: edges.len(),
            triangle_count: faces.values().filter(|f| f.1 == 1).count(),
        })
    }

    /// Mass of each node [kg].
    #[must_use]
    pub fn mass(&self) -> &[R] {
        &self.mass
    }

    /// How many edges and surface triangles have an energy.
    #[must_use]
    pub fn energy_counts(&self) -> (usize, usize) {
        (self.edge_count, self.triangle_count)
    }
}

impl<R: Scalar> ForceLaw<R> for MassPoints<R> {
    fn force(&mut self, position: &[[R; 3]], velocity: &[[R; 3]], force: &mut [[R; 3]]) {
        let gravity = self.gravity.map(R::from_f64);
        let (drag, mass) = (R::from_f64(self.drag), &self.mass);
        part::run(
            &mut self.parts,
            |c| c.part.own.clone(),
            force,
            |cells, out| {
                let own = cells.part.own.clone();
                run_wide::<R, _>(Force { cells, position, velocity, gravity, drag, mass: &mass[own], out });
            },
        );
    }
}

fn sorted<const N: usize>(mut a: [u32; N]) -> [u32; N] {
    a.sort_unstable();
    a
}

fn check(mesh: &VolumeMesh, energies: &Energies) -> Result<(), MassPointError> {
    if !mesh.hexes.is_empty() {
        return Err(MassPointError::Hexahedra(mesh.hexes.len()));
    }
    if mesh.tets.is_empty() {
        return Err(MassPointError::Empty);
    }
    let node_count = mesh.node_count();
    for (cell, t) in mesh.tets.iter().enumerate() {
        if let Some(node) = t.iter().copied().find(|n| *n as usize >= node_count) {
            return Err(MassPointError::MissingNode { cell, node, node_count });
        }
        let (_, volume) = tet_gradients(t.map(|n| mesh.nodes[n as usize]));
        if !(volume.is_finite() && volume > 0.0) {
            return Err(MassPointError::BadCell { cell, volume });
        }
    }
    let e = energies;
    let range = [
        ("distance", e.distance, false),
        ("area", e.area, false),
        ("volume", e.volume, false),
        ("damping", e.damping, false),
        ("density", e.density, true),
    ];
    for (field, value, positive) in range {
        if !value.is_finite() || value < 0.0 || (positive && value == 0.0) {
            let expected = if positive { "positive" } else { "not negative" };
            return Err(MassPointError::OutOfRange { field, value, expected });
        }
    }
    Ok(())
}

/// (1 / rest size, k / rest size) of the edges, triangles and the volume of a cell; k_d / k; k is zero for what another cell has.
struct CellConstants {
    edge: [[f64; 2]; 6],
    face: [[f64; 2]; 4],
    volume: [f64; 2],
    damping: f64,
}

fn cell_constants(
    mesh: &VolumeMesh,
    i: usize,
    energies: &Energies,
    edges: &BTreeMap<[u32; 2], usize>,
    faces: &BTreeMap<[u32; 3], (usize, usize)>,
) -> CellConstants {
    let t = mesh.tets[i];
    let at = |c: usize| Vec3(mesh.nodes[t[c] as usize]);
    let of = |size: f64, k: f64| [1.0 / size, k / size];
    CellConstants {
        edge: EDGES.map(|[a, b]| {
            let own = edges[&sorted([t[a], t[b]])] == i;
            of((at(b) - at(a)).norm(), if own { energies.distance } else { 0.0 })
        }),
        face: FACES.map(|[a, b, c]| {
            let (_, count) = faces[&sorted([t[a], t[b], t[c]])];
            let area = 0.5 * (at(b) - at(a)).cross(at(c) - at(a)).norm();
            of(area, if count == 1 { energies.area } else { 0.0 })
        }),
        volume: of(tet_gradients(t.map(|n| mesh.nodes[n as usize])).1, energies.volume),
        damping: energies.damping,
    }
}

fn group<R: Scalar>(part: &Part, four: &[u32], cells: &[[u32; 4]], constants: &[CellConstants]) -> Group<R> {
    let at = |l: usize| four[l.min(four.len() - 1)] as usize;
    // lanes beyond the last cell repeat it without stiffness
    let pair = |f: &dyn Fn(&CellConstants) -> [f64; 2]| -> [[R; LANES]; 2] {
        std::array::from_fn(|k| {
            std::array::from_fn(|l| {
                let value = f(&constants[at(l)])[k];
                R::from_f64(if k == 1 && l >= four.len() { 0.0 } else { value })
            })
        })
    };
    Group {
        node: std::array::from_fn(|a| {
            std::array::from_fn(|l| part.local(cells[at(l)][a]).expect("a part has the nodes of its cells"))
        }),
        edge: std::array::from_fn(|e| pair(&|c| c.edge[e])),
        face: std::array::from_fn(|f| pair(&|c| c.face[f])),
        volume: pair(&|c| c.volume),
        damping: [R::from_f64(constants[at(0)].damping); LANES],
        surface: std::array::from_fn(|f| (0..four.len()).any(|l| constants[at(l)].face[f][1] != 0.0)),
    }
}

struct Force<'a, R> {
    cells: &'a mut Cells<R>,
    position: &'a [[R; 3]],
    velocity: &'a [[R; 3]],
    gravity: [R; 3],
    drag: R,
    mass: &'a [R],
    out: &'a mut [[R; 3]],
}

// No closures in the kernel: one that is not inlined is compiled without its wide instructions.

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

#[inline(always)]
fn corner<R: Scalar>(from: &[[R; 4]], node: &[u32; LANES]) -> Vec3<Quad<R>> {
    let [a, b, c, d] = *node;
    let t = R::transposed([&from[a as usize], &from[b as usize], &from[c as usize], &from[d as usize]]);
    Vec3([Wide(t[0]), Wide(t[1]), Wide(t[2])])
}

/// 1 / |v|, finite for a zero vector, which then has no direction.
#[inline(always)]
fn inverse_length<R: Scalar>(v: Vec3<Quad<R>>) -> Quad<R> {
    Quad::<R>::one() / v.dot(v).max(Quad::<R>::constant(1e-30)).sqrt()
}

type Corners<R> = [Vec3<Quad<R>>; 4];

/// Adds the forces of edge `e`.
#[inline(always)]
fn spring<R: Scalar>(x: &Corners<R>, v: &Corners<R>, f: &mut Corners<R>, g: &Group<R>, e: usize) {
    let [i, j] = EDGES[e];
    let (d, w) = (x[j] - x[i], v[j] - v[i]);
    let inverse = inverse_length(d);
    // C + k_d / k dC/dt, with the length d·d / |d|
    let c = (d.dot(d) + Wide(g.damping) * d.dot(w)) * (inverse * Wide(g.edge[e][0])) - Quad::<R>::one();
    let pull = d.scale(Wide(g.edge[e][1]) * c * inverse);
    f[i] += pull;
    f[j] += -pull;
}

/// Adds the forces of triangle `t`.
#[inline(always)]
fn triangle<R: Scalar>(x: &Corners<R>, v: &Corners<R>, f: &mut Corners<R>, g: &Group<R>, t: usize) {
    if !g.surface[t] {
        return;
    }
    let [i, j, k] = FACES[t];
    let (a, c) = (x[j] - x[i], x[k] - x[i]);
    let n = a.cross(c);
    let half = Quad::<R>::constant(0.5);
    // n / 2|n|: the area is its product with n, and how that changes with the corners
    let unit = n.scale(half * inverse_length(n));
    let (gj, gk) = (c.cross(unit), unit.cross(a));
    let rate = gj.dot(v[j] - v[i]) + gk.dot(v[k] - v[i]);
    let s = (n.dot(unit) + Wide(g.damping) * rate) * Wide(g.face[t][0]) - Quad::<R>::one();
    let s = s * Wide(g.face[t][1]);
    let (fj, fk) = (gj.scale(s), gk.scale(s));
    f[i] += fj + fk;
    f[j] += -fj;
    f[k] += -fk;
}

impl<R: Scalar> Kernel for Force<'_, R> {
    type Output = ();
    #[inline(always)]
    fn run<const W: usize>(self) {
        let Self { cells, position, velocity, gravity, drag, mass, out } = self;
        gather(&cells.part, position, &mut cells.x);
        gather(&cells.part, velocity, &mut cells.v);
        cells.f.fill([R::zero(); 4]);
        let one = Quad::<R>::one();
        let sixth = Quad::<R>::constant(1.0 / 6.0);
        for g in &cells.groups {
            let x = [
                corner(&cells.x, &g.node[0]),
                corner(&cells.x, &g.node[1]),
                corner(&cells.x, &g.node[2]),
                corner(&cells.x, &g.node[3]),
            ];
            let v = [
                corner(&cells.v, &g.node[0]),
                corner(&cells.v, &g.node[1]),
                corner(&cells.v, &g.node[2]),
                corner(&cells.v, &g.node[3]),
            ];
            let zero = Vec3::<Quad<R>>::zero();
            let mut f = [zero; 4];
            let b = Wide(g.damping);
            // written out, so that corners stay in registers
            spring(&x, &v, &mut f, g, 0);
            spring(&x, &v, &mut f, g, 1);
            spring(&x, &v, &mut f, g, 2);
            spring(&x, &v, &mut f, g, 3);
            spring(&x, &v, &mut f, g, 4);
            spring(&x, &v, &mut f, g, 5);
            triangle(&x, &v, &mut f, g, 0);
            triangle(&x, &v, &mut f, g, 1);
            triangle(&x, &v, &mut f, g, 2);
            triangle(&x, &v, &mut f, g, 3);
            let (a, c, d) = (x[1] - x[0], x[2] - x[0], x[3] - x[0]);
            let (g1, g2, g3) = (c.cross(d).scale(sixth), d.cross(a).scale(sixth), a.cross(c).scale(sixth));
            let volume = a.dot(g1);
            let rate = g1.dot(v[1] - v[0]) + g2.dot(v[2] - v[0]) + g3.dot(v[3] - v[0]);
            let s = ((volume + b * rate) * Wide(g.volume[0]) - one) * Wide(g.volume[1]);
            let (f1, f2, f3) = (g1.scale(s), g2.scale(s), g3.scale(s));
            f[0] += f1 + f2 + f3;
            f[1] += -f1;
            f[2] += -f2;
            f[3] += -f3;
            let nothing = [R::zero(); LANES];
            for c in 0..4 {
                let t = R::transposed([&f[c].0[0].0, &f[c].0[1].0, &f[c].0[2].0, &nothing]);
                for l in 0..LANES {
                    let at = &mut cells.f[g.node[c][l] as usize];
                    *at = (Wide(*at) + Wide(t[l])).0;
                }
            }
        }
        for (((o, f), v), m) in out.iter_mut().zip(&cells.f).zip(&cells.v).zip(mass) {
            for k in 0..3 {
                o[k] = f[k] + *m * (gravity[k] - drag * v[k]);
            }
        }
    }
}
