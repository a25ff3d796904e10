//! From cells to nodes: each node gathers its own force, each row its own blocks.
//!
//! No two threads write the same number and every sum has a fixed order, so results are bitwise equal for any thread count.
#![allow(non_snake_case, reason = "symbols of the continuum mechanics literature")]

use super::hex::{HexBlock, HexShape, columns};
use super::incidence::{Cells, Corner, GROUP, GROUPS, Incidence, Strips};
use super::tet::{BLOCK, Tets, warp};
use rayon::prelude::*;
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
    force.par_chunks_mut(1024).enumerate().for_each(|(chunk, out)| {
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
                self.hand_out(strip, &mut |_, blocks| {
                    let (values, after) = std::mem::take(&mut rest).split_at_mut(blocks.len());
                    values.copy_from_slice(blocks);
                    rest = after;
                });
            }
        });
    }

    /// Hands the row of each node of a strip to `take`, in order.
    pub(super) fn hand_out(&self, strip: usize, take: &mut dyn FnMut(usize, &mut [[R; 9]])) {
        run_wide::<R, _>(RowKernel { rows: self, strip, take });
    }
}

struct RowKernel<'a, R> {
    rows: &'a Rows<'a, R>,
    strip: usize,
    take: &'a mut dyn FnMut(usize, &mut [[R; 9]]),
}

type Quad<R> = Wide<R, 4>;
/// Rotated gradients and constants of the cells of a strip.
type Warped<R> = Stacked<[[R; 4]; 3], { GROUPS * GROUP }>;

impl<R: Scalar> Kernel for RowKernel<'_, R> {
    type Output = ();
    /// Rows of 3x3 blocks as four lanes, the fourth idle; cells are turned as many at a time as the machine likes.
    #[inline(always)]
    fn run<const W: usize>(self) {
        let Self { rows, strip, take } = self;
        let zero = Quad::<R>::splat(R::zero());
        let mut warped = Warped::<R>::new();
        let mut near = [[[R::zero(); 4]; 3]; GROUP];
        let mut sums = [[zero; 3]; WINDOW];
        let mut short = [[R::zero(); 9]; WINDOW];
        let mut long = Vec::new();
        if let Cells::Groups(groups) = rows.strips.cells(strip) {
            for group in groups {
                warp::<R, W>(rows.tets, rows.tet_q, *group as usize, &mut near);
                for cell in near {
                    warped.push(cell);
                }
            }
        }
        for node in rows.strips.nodes(strip) {
            let row = rows.pattern.row(node);
            let values = match short.get_mut(..row.len()) {
                Some(short) => short,
                None => {
                    long.resize(row.len(), [R::zero(); 9]);
                    &mut long[..]
                }
            };
            let own = rows.pattern.diagonal()[node] as usize - row.start;
            // K maps rigid translations to zero: the diagonal is minus the sum of the others
            let mut diagonal = [zero; 3];
            for window in (0..row.len()).step_by(WINDOW) {
                let len = (row.len() - window).min(WINDOW);
                sums[..len].fill([zero; 3]);
                match rows.strips.cells(strip) {
                    Cells::Groups(_) => tet_row(rows, node, window, &warped, &mut sums[..len]),
                    Cells::Crowded(corners) => crowded_row(rows, corners, window, &mut sums),
                }
                hex_row(rows, node, window, &mut sums);
                for k in 0..len {
                    if window + k != own {
                        let s = sums[k];
                        for i in 0..3 {
                            diagonal[i] -= s[i];
                        }
                        values[window + k] = flat(s);
                    }
                }
            }
            values[own] = flat(diagonal);
            take(node, values);
        }
    }
}

#[inline(always)]
fn flat<R: Scalar>(s: [Quad<R>; 3]) -> [R; 9] {
    let [a, b, c] = [s[0].0, s[1].0, s[2].0];
    [a[0], a[1], a[2], b[0], b[1], b[2], c[0], c[1], c[2]]
}

/// Blocks of a row from the cells of its strip.
#[inline(always)]
fn tet_row<R: Scalar>(
    rows: &Rows<'_, R>,
    node: usize,
    window: usize,
    warped: &[[[R; 4]; 3]],
    sums: &mut [[Quad<R>; 3]],
) {
    let (slots, blocks) = rows.strips.at(node);
    let Some(ratio) = rows.ratio else {
        for (slot, block) in slots.iter().zip(blocks) {
            let (cell, a) = (*slot as usize / 4, *slot as usize % 4);
            let block = [block[0] as usize, block[1] as usize, block[2] as usize];
            add_tet(rows, &warped[cell], a, block, window, sums);
        }
        return;
    };
    // with lam = ratio mu everywhere, G = Σ V mu g_a g_bᵀ has it all: K_ab = ratio G + Gᵀ + tr(G) I. A third of the work.
    for (slot, block) in slots.iter().zip(blocks) {
        let (g, a) = (&warped[*slot as usize / 4], *slot as usize % 4);
        let mu = g[1][3] * (R::one() + rows.rate * (g[2][3] + rows.damping));
        let g = all_gradients(g);
        let mga = [g[a][0] * mu, g[a][1] * mu, g[a][2] * mu];
        for k in 1..4 {
            let b = (a + k) % 4;
            if let Some(sum) = sums.get_mut((block[k - 1] as usize).wrapping_sub(window)) {
                let gb = Wide(g[b]);
                for i in 0..3 {
                    sum[i] += gb * Wide::splat(mga[i]);
                }
            }
        }
    }
    let (ratio, zero) = (Wide::splat(ratio), R::zero());
    for sum in sums.iter_mut() {
        let [x, y, z] = *sum;
        let transposed = R::transposed([&x.0, &y.0, &z.0, &[zero; 4]]);
        let trace = x.0[0] + y.0[1] + z.0[2];
        let added = [[trace, zero, zero, zero], [zero, trace, zero, zero], [zero, zero, trace, zero]];
        for i in 0..3 {
            sum[i] = ratio * sum[i] + Wide(transposed[i]) + Wide(added[i]);
        }
    }
}

/// The gradients of all corners: they add up to nothing.
#[inline(always)]
fn all_gradients<R: Scalar>(g: &[[R; 4]; 3]) -> [[R; 4]; 4] {
    [(-(Wide(g[0]) + Wide(g[1]) + Wide(g[2]))).0, g[0], g[1], g[2]]
}

/// Blocks of the row of a crowded node. Out of line: meshes have none, or few.
#[inline(never)]
fn crowded_row<R: Scalar>(rows: &Rows<'_, R>, corners: &[Corner], window: usize, sums: &mut [[Quad<R>; 3]; WINDOW]) {
    let mut near = [[[R::zero(); 4]; 3]; GROUP];
    for Corner { slot, block } in corners {
        let (cell, a) = (*slot as usize / 4, *slot as usize % 4);
        warp::<R, 1>(rows.tets, rows.tet_q, cell / GROUP, &mut near);
        add_tet(rows, &near[cell % GROUP], a, block.map(usize::from), window, sums);
    }
}

/// K_ab = V (lam g_a g_bᵀ + mu g_b g_aᵀ + mu (g_a . g_b) I) with the rotated gradients `g`.
#[inline(always)]
fn add_tet<R: Scalar>(
    rows: &Rows<'_, R>,
    g: &[[R; 4]; 3],
    a: usize,
    block: [usize; 3],
    window: usize,
    sums: &mut [[Quad<R>; 3]],
) {
    let (o, l) = (R::zero(), R::one());
    let units = [Wide([l, o, o, o]), Wide([o, l, o, o]), Wide([o, o, l, o])];
    let factor = R::one() + rows.rate * (g[2][3] + rows.damping);
    let (lambda, mu) = (g[0][3] * factor, g[1][3] * factor);
    let g = all_gradients(g);
    let ga = g[a];
    let mga = Wide([ga[0] * mu, ga[1] * mu, ga[2] * mu, R::zero()]);
    let lga = [ga[0] * lambda, ga[1] * lambda, ga[2] * lambda];
    for k in 1..4 {
        let b = (a + k) % 4;
        let Some(sum) = sums.get_mut(block[k - 1].wrapping_sub(window)) else { continue };
        let gb = g[b];
        let dot = gb[0] * mga.0[0] + gb[1] * mga.0[1] + gb[2] * mga.0[2];
        for i in 0..3 {
            sum[i] += Wide(gb) * Wide::splat(lga[i]) + mga * Wide::splat(gb[i]) + units[i] * Wide::splat(dot);
        }
    }
}

/// K_ab = R Ke_ab Rᵀ.
#[inline(always)]
fn hex_row<R: Scalar>(rows: &Rows<'_, R>, node: usize, window: usize, sums: &mut [[Quad<R>; 3]; WINDOW]) {
    let (slots, blocks) = rows.hexes.at(node);
    for (slot, block) in slots.iter().zip(blocks) {
        let slot = *slot as usize;
        let (cell, a) = (slot / 8, slot % 8);
        let (columns, shape) = columns(rows.hex_blocks, rows.hex_q, cell);
        let scale = columns[0][3] * (R::one() + rows.rate * (columns[1][3] + rows.damping));
        let transposed = [Wide(columns[0]), Wide(columns[1]), Wide(columns[2])];
        let shape = &rows.shapes[shape as usize];
        // rows of scale * R
        let mut rot = [[R::zero(); 3]; 3];
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
                let [x, y, z] = K[i];
                C[i] = transposed[0] * Wide::splat(x) + transposed[1] * Wide::splat(y) + transposed[2] * Wide::splat(z);
            }
            let sum = &mut sums[at];
            for i in 0..3 {
                sum[i] += C[0] * Wide::splat(rot[i][0]) + C[1] * Wide::splat(rot[i][1]) + C[2] * Wide::splat(rot[i][2]);
            }
        }
    }
}
