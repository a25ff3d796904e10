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
        match &self.gradients {
            Gradients::Stored(blocks) => {
                let [g, h, k] = &blocks[block];
                [
                    Vec3([load(&g[0], first), load(&g[1], first), load(&g[2], first)]),
                    Vec3([load(&h[0], first), load(&h[1], first), load(&h[2], first)]),
                    Vec3([load(&k[0], first), load(&k[1], first), load(&k[2], first)]),
                ]
            }
            Gradients::Made(rest) => {
                let [e, f, k] = self.edges_of(rest, block, first);
                let inverse = Mat3::from_columns(e, f, k).inverse();
                [inverse.row(0), inverse.row(1), inverse.row(2)]
            }
        }
    }

    /// Edges of `W` cells of the rest shape from corner 0 [m], in other numbers; `None` of bodies that keep gradients instead.
    #[inline(always)]
    pub(super) fn edges<A: Scalar, const W: usize>(&self, block: usize, first: usize) -> Option<[Vec3<Wide<A, W>>; 3]> {
        let Gradients::Made(rest) = &self.gradients else { return None };
        Some(self.edges_of(rest, block, first))
    }

    /// Differences of all digits, rounded then. Behind the last cell comes the last one again.
    #[inline(always)]
    fn edges_of<A: Scalar, const W: usize>(
        &self,
        rest: &[[R; 4]],
        block: usize,
        first: usize,
    ) -> [Vec3<Wide<A, W>>; 3] {
        let chunk = block / TASK;
        let (nodes, local, first) =
            (self.scatter.nodes(chunk), self.scatter.local(chunk), block % TASK * BLOCK + first);
        let last = local.len() - 1;
        let mut edges = [Vec3([Wide([A::zero(); W]); 3]); 3];
        for k in 0..W / 4 {
            let mut rows = [[[A::zero(); 4]; 3]; 4];
            for i in 0..4 {
                rows[i] = edges_of_cell(rest, nodes, &local[(first + 4 * k + i).min(last)]);
            }
            for a in 0..3 {
                let numbers = A::transposed([&rows[0][a], &rows[1][a], &rows[2][a], &rows[3][a]]);
                for c in 0..3 {
                    edges[a].0[c].0.as_chunks_mut::<4>().0[k] = numbers[c];
                }
            }
        }
        for i in W - W % 4..W {
            let row = edges_of_cell::<R, A>(rest, nodes, &local[(first + i).min(last)]);
            for a in 0..3 {
                for c in 0..3 {
                    edges[a].0[c].0[i] = row[a][c];
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

/// Edges of one cell from corner 0; the fourth numbers are idle.
#[inline(always)]
fn edges_of_cell<R: Scalar, A: Scalar>(rest: &[[R; 4]], nodes: &[u32], cell: &[u16; 4]) -> [[A; 4]; 3] {
    let from = Wide(rest[nodes[cell[0] as usize] as usize]);
    let mut edges = [[A::zero(); 4]; 3];
    for a in 0..3 {
        edges[a] = (Wide(rest[nodes[cell[a + 1] as usize] as usize]) - from).0.map(cast);
    }
    edges
}
