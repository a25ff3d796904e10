//! From cells to nodes: each node gathers its own force, each row the blocks of its edges and hexahedra.
//!
//! No two threads write the same number and every sum has a fixed order, so results are bitwise equal for any thread count.
#![allow(non_snake_case, reason = "symbols of the continuum mechanics literature")]

use super::hex::{HexBlock, HexShape, columns};
use super::incidence::{Corner, EDGES, GROUP, GROUPS, Incidence, NODES, Strips};
use super::tet::{BLOCK, Tets, Warped, cast, warp};
use rayon::prelude::*;
use softrig_linalg::par::Each;
use softrig_linalg::{BlockPattern, Kernel, Lane, Scalar, Scatter, Stacked, Wide, par, run_wide};

/// Most blocks of a row: their places are counted in 16 bits.
pub(crate) const LONGEST_ROW: usize = 1 << 16;
/// Strips of rows per task handed to a thread.
const STRIPS: usize = 2;
/// Blocks of a row that are summed at once; longer rows are done window by window.
const WINDOW: usize = 64;
/// What is added to the internal force: `K d + C v` with the stiffness-proportional part `C` of the damping.
#[derive(Clone, Copy, Debug)]
pub struct Increment<'a, R> {
    /// d [m], one per node.
    pub displacement: Option<&'a [[R; 3]]>,
    /// v [m/s], one per node; each cell damps it with its own b.
    pub velocity: Option<&'a [[R; 3]]>,
    /// Added to the b of every cell [s].
    pub damping: R,
}

impl<R: Scalar> Increment<'_, R> {
    /// Nothing is added.
    #[must_use]
    pub fn none() -> Self {
        Self { displacement: None, velocity: None, damping: R::zero() }
    }
}

/// What is added to the product with a stiffness: this number of each node times what is multiplied there.
pub type Diagonal<'a, R> = &'a (dyn Fn(usize) -> R + Sync);

/// Sums the parts of the nodes into their forces, overwriting `force`, with a diagonal times what is there before where one is given.
pub(super) fn gather_forces<R: Scalar>(
    tets: (&Scatter<4>, &[[R; 4]]),
    hexes: (&Scatter<8>, &[[R; 4]]),
    diagonal: Option<Diagonal<'_, R>>,
    force: &mut [[R; 3]],
) {
    force.par_chunks_mut(1024).enumerate().each(|(chunk, out)| {
        for (k, f) in out.iter_mut().enumerate() {
            let node = chunk * 1024 + k;
            let mut sum = Wide([R::zero(); 4]);
            for part in tets.0.parts(node) {
                sum += Wide(tets.1[*part as usize]);
            }
            for part in hexes.0.parts(node) {
                sum += Wide(hexes.1[*part as usize]);
            }
            let before = *f;
            *f = [sum.0[0], sum.0[1], sum.0[2]];
            if let Some(d) = diagonal.map(|d| d(node)) {
                (0..3).for_each(|c| f[c] += d * before[c]);
            }
        }
    });
}

/// What the stiffness rows read.
pub(super) struct Rows<'a, R> {
    pub pattern: &'a BlockPattern,
    pub strips: &'a Strips,
    pub tets: &'a Tets<R>,
    pub tet_q: &'a [[[R; BLOCK]; 4]],
    /// lam / mu, where it is the same for all tetrahedra.
    pub ratio: Option<R>,
    pub hexes: &'a Incidence<8>,
    pub hex_blocks: &'a [HexBlock<R>],
    pub hex_q: &'a [[[R; BLOCK]; 4]],
    pub shapes: &'a [HexShape<R>],
    /// The matrix is the sum of (1 + rate (b + damping)) K over the cells.
    pub rate: R,
    pub damping: R,
}

impl<R: Scalar> Rows<'_, R> {
    /// Writes all blocks.
    pub(super) fn write(&self, values: &mut [[R; 9]]) {
        let start = |strip: usize| self.pattern.row_start()[self.strips.nodes(strip).start] as usize;
        par::divide(0..self.strips.count(), STRIPS, &start, values, &|strips, values| {
            let mut rest = values;
            for strip in strips {
                self.hand_out(strip, &mut |_, blocks: &mut [[R; 9]]| {
                    let (values, after) = std::mem::take(&mut rest).split_at_mut(blocks.len());
                    values.copy_from_slice(blocks);
                    rest = after;
                });
            }
        });
    }

    /// Hands the row of each node of a strip to `take`, in order, summed up in the numbers that `take` wants.
    pub(super) fn hand_out<A: Scalar>(&self, strip: usize, take: &mut dyn FnMut(usize, &mut [[A; 9]])) {
        run_wide::<R, _>(RowKernel { rows: self, strip, take });
    }
}

struct RowKernel<'a, R, A> {
    rows: &'a Rows<'a, R>,
    strip: usize,
    take: &'a mut dyn FnMut(usize, &mut [[A; 9]]),
}

type Quad<A> = Wide<A, 4>;

impl<R: Scalar, A: Scalar> Kernel for RowKernel<'_, R, A> {
    type Output = ();
    /// Rows of 3x3 blocks as four lanes, the fourth idle; cells are turned as many at a time as the machine likes.
    #[inline(always)]
    fn run<const W: usize>(self) {
        let Self { rows, strip, take } = self;
        let (pattern, nodes) = (rows.pattern, rows.strips.nodes(strip));
        let mut edges = Stacked::<[A; 9], EDGES>::new();
        edge_blocks::<R, A, W>(rows, strip, &mut edges);
        // the edges of the rows that came: the next that a later row will ask for
        let (mut cursor, mut next) = ([0usize; NODES], 0);
        let mut sums = [[Quad::<A>::splat(A::zero()); 3]; WINDOW];
        let mut short = [[A::zero(); 9]; WINDOW];
        let mut long = Vec::new();
        for node in nodes.clone() {
            let row = pattern.row(node);
            let columns = &pattern.column()[row.clone()];
            let values = match short.get_mut(..row.len()) {
                Some(short) => short,
                None => {
                    long.resize(row.len(), [A::zero(); 9]);
                    &mut long[..]
                }
            };
            let own = pattern.diagonal()[node] as usize - row.start;
            if edges.is_empty() {
                values.fill([A::zero(); 9]);
                crowded_row(rows, node, values);
            } else {
                for (k, (value, column)) in values.iter_mut().zip(columns).enumerate() {
                    let earlier = (*column as usize).wrapping_sub(nodes.start);
                    if k == own {
                        // columns ascend: what follows are the edges to later nodes of the strip
                        cursor[node - nodes.start] = next;
                    } else if earlier < node - nodes.start {
                        let [a, b, c, d, e, f, g, h, i] = edges[cursor[earlier]];
                        *value = [a, d, g, b, e, h, c, f, i];
                        cursor[earlier] += 1;
                    } else {
                        *value = edges[next];
                        next += 1;
                    }
                }
            }
            hex_row(rows, node, &mut sums, values);
            // K maps rigid translations to zero: the diagonal is minus the sum of the others
            values[own] = [A::zero(); 9];
            let mut diagonal = [A::zero(); 9];
            for value in &*values {
                for i in 0..9 {
                    diagonal[i] -= value[i];
                }
            }
            values[own] = diagonal;
            take(node, values);
        }
    }
}

#[inline(always)]
fn flat<R: Scalar>(s: [Quad<R>; 3]) -> [R; 9] {
    let [a, b, c] = [s[0].0, s[1].0, s[2].0];
    [a[0], a[1], a[2], b[0], b[1], b[2], c[0], c[1], c[2]]
}

/// (lam / mu) G + Gᵀ + tr(G) I, with `scaled` the first of these.
#[inline(always)]
fn block_of<R: Scalar>([x, y, z]: [Quad<R>; 3], scaled: [Quad<R>; 3]) -> [R; 9] {
    let zero = R::zero();
    let transposed = R::transposed([&x.0, &y.0, &z.0, &[zero; 4]]);
    let trace = x.0[0] + y.0[1] + z.0[2];
    let added = [[trace, zero, zero, zero], [zero, trace, zero, zero], [zero, zero, trace, zero]];
    let mut sum = scaled;
    for i in 0..3 {
        sum[i] = sum[i] + Wide(transposed[i]) + Wide(added[i]);
    }
    flat(sum)
}

/// Blocks of all edges of a strip, from G = Σ h_a h_bᵀ over the cells around an edge, which has it all where lam / mu is the same for all
/// of them. An edge of two rows is computed once.
#[inline(always)]
fn edge_blocks<R: Scalar, A: Scalar, const W: usize>(
    rows: &Rows<'_, R>,
    strip: usize,
    edges: &mut Stacked<[A; 9], EDGES>,
) {
    let (groups, around, mut rest) = rows.strips.edges(strip);
    let mut warped = Stacked::<Warped<A>, { GROUPS * GROUP }>::new();
    let mut near = [[[A::zero(); 4]; 4]; GROUP];
    for group in groups {
        warp::<R, A, W>(rows.tets, rows.tet_q, *group as usize, [rows.rate, rows.damping], &mut near);
        for cell in near {
            warped.push(cell);
        }
    }
    let warped = &*warped;
    for count in around {
        let (corners, after) = rest.split_at(usize::from(*count));
        rest = after;
        let mut G = [Quad::<A>::splat(A::zero()); 3];
        if let Some(ratio) = rows.ratio.map(cast) {
            for corner in corners {
                let (a, b) = ends(warped, *corner);
                for i in 0..3 {
                    G[i] += Wide(*b) * Wide::splat(a[i]);
                }
            }
            edges.push(block_of(G, G.map(|g| Wide::splat(ratio) * g)));
        } else {
            let mut scaled = G;
            for corner in corners {
                let (a, b) = ends(warped, *corner);
                let ratio = Wide::splat(warped[usize::from(*corner) / 16][0][3]);
                for i in 0..3 {
                    let part = Wide(*b) * Wide::splat(a[i]);
                    G[i] += part;
                    scaled[i] += ratio * part;
                }
            }
            edges.push(block_of(G, scaled));
        }
    }
}

/// Gradients at both ends of an edge of a cell.
#[inline(always)]
fn ends<R>(warped: &[Warped<R>], corner: u16) -> (&[R; 4], &[R; 4]) {
    let cell = &warped[usize::from(corner) / 16];
    (&cell[usize::from(corner) / 4 % 4], &cell[usize::from(corner) % 4])
}

/// Blocks of the row of a crowded node. Out of line: meshes have none, or few.
#[inline(never)]
fn crowded_row<R: Scalar, A: Scalar>(rows: &Rows<'_, R>, node: usize, values: &mut [[A; 9]]) {
    let mut near = [[[A::zero(); 4]; 4]; GROUP];
    for Corner { slot, block } in rows.strips.crowded(node) {
        let (cell, a) = (*slot as usize / 4, *slot as usize % 4);
        warp::<R, A, 1>(rows.tets, rows.tet_q, cell / GROUP, [rows.rate, rows.damping], &mut near);
        let h = &near[cell % GROUP];
        for (k, at) in block.iter().enumerate() {
            let G = h[a].map(|v| Wide(h[(a + 1 + k) % 4]) * Wide::splat(v));
            let G = [G[0], G[1], G[2]];
            let part = block_of(G, G.map(|g| Wide::splat(h[0][3]) * g));
            values[usize::from(*at)].iter_mut().zip(part).for_each(|(v, p)| *v += p);
        }
    }
}

/// Adds K_ab = R Ke_ab Rᵀ of all hexahedra at a node.
#[inline(always)]
fn hex_row<R: Scalar, A: Scalar>(
    rows: &Rows<'_, R>,
    node: usize,
    sums: &mut [[Quad<A>; 3]; WINDOW],
    values: &mut [[A; 9]],
) {
    if rows.hexes.at(node).0.is_empty() {
        return;
    }
    for (k, values) in values.chunks_mut(WINDOW).enumerate() {
        sums[..values.len()].fill([Wide::splat(A::zero()); 3]);
        hex_window(rows, node, k * WINDOW, sums);
        for (value, sum) in values.iter_mut().zip(&*sums) {
            value.iter_mut().zip(flat(*sum)).for_each(|(v, s)| *v += s);
        }
    }
}

/// The same for the blocks of a window, which are summed in registers' shape.
#[inline(always)]
fn hex_window<R: Scalar, A: Scalar>(rows: &Rows<'_, R>, node: usize, window: usize, sums: &mut [[Quad<A>; 3]; WINDOW]) {
    let (slots, blocks) = rows.hexes.at(node);
    for (slot, block) in slots.iter().zip(blocks) {
        let slot = *slot as usize;
        let (cell, a) = (slot / 8, slot % 8);
        let (columns, shape) = columns(rows.hex_blocks, rows.hex_q, cell);
        let scale: A = cast(columns[0][3] * (R::one() + rows.rate * (columns[1][3] + rows.damping)));
        let columns = columns.map(|column| column.map(cast::<R, A>));
        let transposed = [Wide(columns[0]), Wide(columns[1]), Wide(columns[2])];
        let shape = &rows.shapes[shape as usize];
        // rows of scale * R
        let mut rot = [[A::zero(); 3]; 3];
        for i in 0..3 {
            for j in 0..3 {
                rot[i][j] = columns[j][i] * scale;
            }
        }
        for b in 0..8 {
            let at = (block[b] as usize).wrapping_sub(window);
            if b == a || at >= WINDOW {
                continue;
            }
            let K = &shape.stiffness[a][b];
            let mut C = transposed;
            for i in 0..3 {
                let [x, y, z] = K[i].map(cast::<R, A>);
                C[i] = transposed[0] * Wide::splat(x) + transposed[1] * Wide::splat(y) + transposed[2] * Wide::splat(z);
            }
            let sum = &mut sums[at];
            for i in 0..3 {
                sum[i] += C[0] * Wide::splat(rot[i][0]) + C[1] * Wide::splat(rot[i][1]) + C[2] * Wide::splat(rot[i][2]);
            }
        }
    }
}
