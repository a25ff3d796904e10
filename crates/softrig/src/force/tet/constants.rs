//! What does not change about tetrahedra.
#![allow(non_snake_case, reason = "symbols of the continuum mechanics literature")]

use super::{BLOCK, TASK, cast, load};
use softrig_linalg::{Lane, Mat3, Scalar, Scatter, Vec3, Wide};

/// Constants of tetrahedra, block by block. The last block repeats its last cell.
#[derive(Clone, Debug)]
pub(in crate::force) struct Tets<R> {
    /// Their nodes, and where forces at these add up.
    pub scatter: Scatter<4>,
    gradients: Gradients<R>,
    moduli: Moduli<R>,
}

/// Rows of the inverse edge matrices: the gradients of nodes 1, 2, 3 [1/m].
#[derive(Clone, Debug)]
enum Gradients<R> {
    /// Those of f32, made in f64: slivers need its digits for the inverse.
    Stored(Vec<[[[R; BLOCK]; 3]; 3]>),
    /// The rest shape [m], one entry per node, of which f64 makes the same numbers whenever they are read: they are a third of all
    /// that a body would hold. The fourth number is idle: four corners are read as four registers.
    Made(Vec<[R; 4]>),
}

/// Lamé constants and stiffness damping.
#[derive(Clone, Debug)]
enum Moduli<R> {
    /// V of each cell [m3], and lam [Pa], mu [Pa] and b [s] of all.
    Same(Vec<[R; BLOCK]>, [R; 3]),
    /// V lam [N m], V mu [N m] and b [s] of each cell.
    Each(Vec<[[R; BLOCK]; 3]>),
}

/// What one tetrahedron brings, in f64.
#[derive(Clone, Copy, Debug)]
pub(in crate::force) struct TetConstants {
    pub gradient: [[f64; 3]; 3],
    pub volume: f64,
    pub lambda: f64,
    pub mu: f64,
    pub damping: f64,
}

/// Shape gradients of nodes 1, 2, 3 [1/m] and volume [m3] of a tetrahedron; node 0 has minus their sum.
#[must_use]
pub fn tet_gradients(X: [[f64; 3]; 4]) -> ([[f64; 3]; 3], f64) {
    let e = |k: usize| Vec3(X[k]) - Vec3(X[0]);
    let Dm = Mat3::from_columns(e(1), e(2), e(3));
    (Dm.inverse().0, Dm.determinant() / 6.0)
}

impl<R: Scalar> Tets<R> {
    /// `cells` in the order of the scatter's; `rest` has the rest shape [m].
    pub(in crate::force) fn new(cells: &[TetConstants], scatter: Scatter<4>, rest: &[[f64; 3]]) -> Self {
        let blocks = || cells.chunks(BLOCK);
        let fill = |cells: &[TetConstants], f: &dyn Fn(&TetConstants) -> f64| {
            std::array::from_fn(|l| R::from_f64(f(&cells[l.min(cells.len() - 1)])))
        };
        let gradient = |cells: &[TetConstants]| {
            std::array::from_fn(|a| std::array::from_fn(|i| fill(cells, &|c| c.gradient[a][i])))
        };
        let of = |c: &TetConstants| [c.lambda, c.mu, c.damping];
        let each = |cells: &[TetConstants]| {
            [fill(cells, &|c| c.volume * c.lambda), fill(cells, &|c| c.volume * c.mu), fill(cells, &|c| c.damping)]
        };
        let moduli = match cells.first().map(of) {
            Some(all) if cells.iter().all(|c| of(c) == all) => {
                Moduli::Same(blocks().map(|cells| fill(cells, &|c| c.volume)).collect(), all.map(R::from_f64))
            }
            _ => Moduli::Each(blocks().map(each).collect()),
        };
        let gradients = if R::EPSILON.to_f64() > f64::EPSILON {
            Gradients::Stored(blocks().map(gradient).collect())
        } else {
            Gradients::Made(rest.iter().map(|[x, y, z]| [*x, *y, *z, 0.0].map(R::from_f64)).collect())
        };
        Self { scatter, gradients, moduli }
    }

    /// Gradients of nodes 1, 2, 3 of `W` cells.
    #[inline(always)]
    pub(super) fn gradients<const W: usize>(&self, block: usize, first: usize) -> [Vec3<Wide<R, W>>; 3] {
        let rest = match &self.gradients {
            Gradients::Stored(blocks) => {
                let [g, h, k] = &blocks[block];
                return [
                    Vec3([load(&g[0], first), load(&g[1], first), load(&g[2], first)]),
                    Vec3([load(&h[0], first), load(&h[1], first), load(&h[2], first)]),
                    Vec3([load(&k[0], first), load(&k[1], first), load(&k[2], first)]),
                ];
            }
            Gradients::Made(rest) => rest,
        };
        let chunk = block / TASK;
        let (nodes, local, first) =
            (self.scatter.nodes(chunk), self.scatter.local(chunk), block % TASK * BLOCK + first);
        let X = [
            rest_corner::<R, W>(rest, nodes, local, first, 0),
            rest_corner::<R, W>(rest, nodes, local, first, 1),
            rest_corner::<R, W>(rest, nodes, local, first, 2),
            rest_corner::<R, W>(rest, nodes, local, first, 3),
        ];
        let inverse = Mat3::from_columns(X[1] - X[0], X[2] - X[0], X[3] - X[0]).inverse();
        [inverse.row(0), inverse.row(1), inverse.row(2)]
    }

    /// Edges of `W` cells of the rest shape from corner 0 [m], as differences of all digits, rounded then. Of bodies in f32, which keep
    /// gradients instead, zero.
    #[inline(always)]
    pub(super) fn edges<A: Scalar, const W: usize>(&self, block: usize, first: usize) -> [Vec3<Wide<A, W>>; 3] {
        let mut edges = [Vec3([Wide([A::zero(); W]); 3]); 3];
        let Gradients::Made(rest) = &self.gradients else { return edges };
        let chunk = block / TASK;
        let (nodes, local, first) =
            (self.scatter.nodes(chunk), self.scatter.local(chunk), block % TASK * BLOCK + first);
        let last = local.len() - 1;
        for k in 0..W / 4 {
            let mut rows = [[[A::zero(); 4]; 4]; 3];
            for i in 0..4 {
                let cell = local[(first + 4 * k + i).min(last)];
                let from = Wide(rest[nodes[cell[0] as usize] as usize]);
                for a in 0..3 {
                    let edge = Wide(rest[nodes[cell[a + 1] as usize] as usize]) - from;
                    rows[a][i] = edge.0.map(cast);
                }
            }
            for a in 0..3 {
                let [p, q, r, s] = &rows[a];
                let numbers = A::transposed([p, q, r, s]);
                for c in 0..3 {
                    edges[a].0[c].0.as_chunks_mut::<4>().0[k] = numbers[c];
                }
            }
        }
        edges
    }

    /// V lam, V mu and b of `W` cells.
    #[inline(always)]
    pub(super) fn moduli<const W: usize>(&self, block: usize, first: usize) -> [Wide<R, W>; 3] {
        match &self.moduli {
            Moduli::Same(volume, [lambda, mu, damping]) => {
                let volume = load::<R, W>(&volume[block], first);
                [volume * Wide::splat(*lambda), volume * Wide::splat(*mu), Wide::splat(*damping)]
            }
            Moduli::Each(blocks) => {
                let [lambda, mu, damping] = &blocks[block];
                [load(lambda, first), load(mu, first), load(damping, first)]
            }
        }
    }
}

/// Corner `a` of `W` cells of a chunk in the rest shape; behind the last cell comes the last one again.
#[inline(always)]
fn rest_corner<R: Scalar, const W: usize>(
    rest: &[[R; 4]],
    nodes: &[u32],
    local: &[[u16; 4]],
    first: usize,
    a: usize,
) -> Vec3<Wide<R, W>> {
    let mut out = Vec3([Wide([R::zero(); W]); 3]);
    let last = local.len() - 1;
    for k in 0..W / 4 {
        let mut rows = [&rest[nodes[local[last][a] as usize] as usize]; 4];
        for i in 0..4 {
            rows[i] = &rest[nodes[local[(first + 4 * k + i).min(last)][a] as usize] as usize];
        }
        let numbers = R::transposed(rows);
        for c in 0..3 {
            out.0[c].0.as_chunks_mut::<4>().0[k] = numbers[c];
        }
    }
    for i in W - W % 4..W {
        let x = rest[nodes[local[(first + i).min(last)][a] as usize] as usize];
        for c in 0..3 {
            out.0[c].0[i] = x[c];
        }
    }
    out
}
