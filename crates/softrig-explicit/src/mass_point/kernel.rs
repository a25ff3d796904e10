//! Forces of distances, areas and volumes, four tetrahedra at a time.

use super::{Cells, EDGES, FACES};
use crate::lanes::{LANES, Quad, corner, gather, scatter};
use softrig_linalg::{Kernel, Lane, Scalar, Vec3, Wide};

/// All that acts on the own nodes of a part.
pub(super) struct Force<'a, R> {
    pub cells: &'a mut Cells<R>,
    pub position: &'a [[R; 3]],
    pub velocity: &'a [[R; 3]],
    pub gravity: [R; 3],
    pub drag: R,
    pub scale: Scale<R>,
    pub mass: &'a [R],
    pub out: &'a mut [[R; 3]],
}

/// What all cells have in common.
#[derive(Clone, Copy)]
pub(super) struct Scale<R> {
    /// 1 / k of edges, triangles and volumes [1/J]; zero where k is.
    pub inverse: [R; 3],
    /// k_d / k [s].
    pub damping: R,
}

/// 1 / |v|, finite for a zero vector, which then has no direction.
#[inline(always)]
fn inverse_length<R: Scalar>(v: Vec3<Quad<R>>) -> Quad<R> {
    Quad::<R>::one() / v.dot(v).max(Quad::<R>::constant(1e-30)).sqrt()
}

/// A vector at each corner of four cells. In memory, and found by a number that is not known beforehand: so it is stored whole, four lanes at
/// a time, and the optimiser does not take lanes apart.
type Corners<R> = [Vec3<Quad<R>>; 4];

/// Adds the forces of edge `e`.
#[inline(always)]
fn spring<R: Scalar>(x: &Corners<R>, v: &Corners<R>, f: &mut Corners<R>, k: &[R; LANES], s: Scale<R>, e: u8) {
    let [i, j] = EDGES[usize::from(e) % 6];
    let (i, j) = (i % 4, j % 4);
    let (d, w) = (x[j] - x[i], v[j] - v[i]);
    // k / l0 |d|
    let k = Wide(*k) * inverse_length(d);
    // C + k_d / k dC/dt, with the length d·d / |d|
    let c = (d.dot(d) + Wide::splat(s.damping) * d.dot(w)) * (k * Wide::splat(s.inverse[0])) - Quad::<R>::one();
    let pull = d.scale(k * c);
    f[i] += pull;
    f[j] += -pull;
}

/// Adds the forces of triangle `t`.
#[inline(always)]
fn triangle<R: Scalar>(x: &Corners<R>, v: &Corners<R>, f: &mut Corners<R>, k: &[R; LANES], s: Scale<R>, t: u8) {
    let [i, j, l] = FACES[usize::from(t) % 4];
    let (i, j, l) = (i % 4, j % 4, l % 4);
    let (a, c) = (x[j] - x[i], x[l] - x[i]);
    let n = a.cross(c);
    let half = Quad::<R>::constant(0.5);
    // n / 2|n|: the area is its product with n, and how that changes with the corners
    let unit = n.scale(half * inverse_length(n));
    let (gj, gl) = (c.cross(unit), unit.cross(a));
    let rate = gj.dot(v[j] - v[i]) + gl.dot(v[l] - v[i]);
    let k = Wide(*k);
    let grown = (n.dot(unit) + Wide::splat(s.damping) * rate) * (k * Wide::splat(s.inverse[1])) - Quad::<R>::one();
    let s = k * grown;
    let (fj, fl) = (gj.scale(s), gl.scale(s));
    f[i] += fj + fl;
    f[j] += -fj;
    f[l] += -fl;
}

impl<R: Scalar> Kernel for Force<'_, R> {
    type Output = ();
    #[inline(always)]
    fn run<const W: usize>(self) {
        let Self { cells, position, velocity, gravity, drag, scale, mass, out } = self;
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
            let b = Wide::splat(scale.damping);
            for e in &g.edges[..g.edge_count.min(6)] {
                spring(&x, &v, &mut f, &g.edge[usize::from(*e) % 6], scale, *e);
            }
            for t in &g.faces[..g.face_count.min(4)] {
                triangle(&x, &v, &mut f, &g.face[usize::from(*t) % 4], scale, *t);
            }
            let (a, c, d) = (x[1] - x[0], x[2] - x[0], x[3] - x[0]);
            let (g1, g2, g3) = (c.cross(d).scale(sixth), d.cross(a).scale(sixth), a.cross(c).scale(sixth));
            let volume = a.dot(g1);
            let rate = g1.dot(v[1] - v[0]) + g2.dot(v[2] - v[0]) + g3.dot(v[3] - v[0]);
            let k = Wide(g.volume);
            let s = ((volume + b * rate) * (k * Wide::splat(scale.inverse[2])) - one) * k;
            let (f1, f2, f3) = (g1.scale(s), g2.scale(s), g3.scale(s));
            f[0] += f1 + f2 + f3;
            f[1] += -f1;
            f[2] += -f2;
            f[3] += -f3;
            scatter(f[0], &g.node[0], &mut cells.f);
            scatter(f[1], &g.node[1], &mut cells.f);
            scatter(f[2], &g.node[2], &mut cells.f);
            scatter(f[3], &g.node[3], &mut cells.f);
        }
        for (((o, f), v), m) in out.iter_mut().zip(&cells.f).zip(&cells.v).zip(mass) {
            for k in 0..3 {
                o[k] = f[k] + *m * (gravity[k] - drag * v[k]);
            }
        }
    }
}
