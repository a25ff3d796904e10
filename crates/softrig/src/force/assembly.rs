//! From cells to nodes: each node gathers its own force, each row its own blocks.
//!
//! No two threads write the same number and every sum has a fixed order, so results are bitwise equal for any thread count.
#![allow(non_snake_case, reason = "symbols of the continuum mechanics literature")]

use super::hex::HexShape;
use rayon::prelude::*;
use softrig_linalg::{BlockPattern, Kernel, Lane, Scalar, Wide, run_wide};
use std::ops::Range;

/// Most blocks of a row: their places are counted in 16 bits.
pub(crate) const LONGEST_ROW: usize = 1 << 16;
/// Rows per task handed to a thread.
const ROWS: usize = 128;
/// Blocks of a row that are summed at once; longer rows are done window by window.
const WINDOW: usize = 64;
/// Cells fetched together, so that the memory works on all of them at once: the cells of a node are scattered, and waiting for
/// one after the other took half of the assembly's time.
const TOGETHER: usize = 16;

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

/// The corners of cells that meet at each node, for cells of `N` corners.
#[derive(Clone, Debug)]
pub(super) struct Incidence<const N: usize> {
    start: Vec<u32>,
    /// cell * N + corner, ascending at each node.
    slot: Vec<u32>,
    /// Where the blocks (node, corner b of the cell) are, counted from the start of the node's row.
    block: Vec<[u16; N]>,
}

impl<const N: usize> Incidence<N> {
    pub(super) fn new(node_count: usize, cells: &[[u32; N]], pattern: &BlockPattern) -> Self {
        let mut start = vec![0u32; node_count + 1];
        for n in cells.iter().flatten() {
            start[*n as usize + 1] += 1;
        }
        for i in 0..node_count {
            start[i + 1] += start[i];
        }
        let mut next = start.clone();
        let mut slot = vec![0; cells.len() * N];
        for (k, n) in cells.iter().flatten().enumerate() {
            let at = &mut next[*n as usize];
            slot[*at as usize] = k as u32;
            *at += 1;
        }
        let mut block = Vec::with_capacity(slot.len());
        for i in 0..node_count {
            for &s in &slot[start[i] as usize..start[i + 1] as usize] {
                block.push(cells[s as usize / N].map(|n| {
                    let at = pattern.find(i, n as usize).expect("the pattern was made from these cells");
                    u16::try_from(at - pattern.row(i).start).expect("a body has no longer rows")
                }));
            }
        }
        Self { start, slot, block }
    }

    #[inline(always)]
    fn at(&self, node: usize) -> Range<usize> {
        self.start[node] as usize..self.start[node + 1] as usize
    }
}

/// Sums corner forces into node forces, overwriting `force`.
pub(super) fn gather_forces<R: Scalar>(
    tets: &Incidence<4>,
    tet_force: &[[[R; 3]; 4]],
    hexes: &Incidence<8>,
    hex_force: &[[[R; 3]; 8]],
    force: &mut [[R; 3]],
) {
    force.par_chunks_mut(1024).enumerate().for_each(|(chunk, out)| {
        for (k, f) in out.iter_mut().enumerate() {
            let node = chunk * 1024 + k;
            let mut sum = [R::zero(); 3];
            let mut add = |f: [R; 3]| (0..3).for_each(|c| sum[c] += f[c]);
            for &s in &tets.slot[tets.at(node)] {
                add(tet_force[s as usize / 4][s as usize % 4]);
            }
            for &s in &hexes.slot[hexes.at(node)] {
                add(hex_force[s as usize / 8][s as usize % 8]);
            }
            *f = sum;
        }
    });
}

/// What the stiffness rows read.
pub(super) struct Rows<'a, R> {
    pub pattern: &'a BlockPattern,
    /// R g_a of corners 1, 2, 3 of each tetrahedron; fourth places: V lam, V mu, b.
    pub tets: &'a Incidence<4>,
    pub warped: &'a [[[R; 4]; 3]],
    /// Columns of R of each hexahedron; fourth places: factor on the shape's stiffness, b.
    pub hexes: &'a Incidence<8>,
    pub rotation: &'a [[[R; 4]; 3]],
    pub shape_of: &'a [u32],
    pub shapes: &'a [HexShape<R>],
    /// The matrix is the sum of (1 + rate (b + damping)) K over the cells.
    pub rate: R,
    pub damping: R,
}

impl<R: Scalar> Rows<'_, R> {
    /// Writes all blocks.
    pub(super) fn write(&self, values: &mut [[R; 9]]) {
        let rows = self.pattern.row_count();
        // blocks of consecutive rows are consecutive: hand each task its own part of the matrix
        split_rows(self, 0..rows, values);
    }
}

/// Halves the rows until a task's worth is left. (A recursion rather than a list of parts: it needs no memory.)
fn split_rows<R: Scalar>(rows: &Rows<'_, R>, range: Range<usize>, values: &mut [[R; 9]]) {
    if range.len() <= ROWS {
        run_wide::<R, _>(RowKernel { rows, range, values });
        return;
    }
    let middle = range.start + range.len() / 2;
    let start = rows.pattern.row_start();
    let (left, right) = values.split_at_mut((start[middle] - start[range.start]) as usize);
    let end = range.end;
    rayon::join(|| split_rows(rows, range.start..middle, left), || split_rows(rows, middle..end, right));
}

struct RowKernel<'a, R> {
    rows: &'a Rows<'a, R>,
    range: Range<usize>,
    values: &'a mut [[R; 9]],
}

type Quad<R> = Wide<R, 4>;

impl<R: Scalar> Kernel for RowKernel<'_, R> {
    type Output = ();
    /// Rows of 3x3 blocks as four lanes, the fourth idle: the width of the machine does not matter here.
    #[inline(always)]
    fn run<const W: usize>(self) {
        let zero = Quad::<R>::splat(R::zero());
        let first = self.rows.pattern.row_start()[self.range.start] as usize;
        let mut sums = [[zero; 3]; WINDOW];
        for node in self.range.clone() {
            let row = self.rows.pattern.row(node);
            let own = self.rows.pattern.diagonal()[node] as usize - row.start;
            // K maps rigid translations to zero: the diagonal is minus the sum of the others
            let mut diagonal = [zero; 3];
            for window in (0..row.len()).step_by(WINDOW) {
                let len = (row.len() - window).min(WINDOW);
                sums[..len].fill([zero; 3]);
                tet_row(self.rows, node, window, &mut sums);
                hex_row(self.rows, node, window, &mut sums);
                for k in 0..len {
                    if window + k != own {
                        let s = sums[k];
                        for i in 0..3 {
                            diagonal[i] -= s[i];
                        }
                        self.values[row.start + window + k - first] = flat(s);
                    }
                }
            }
            self.values[row.start + own - first] = flat(diagonal);
        }
    }
}

#[inline(always)]
fn flat<R: Scalar>(s: [Quad<R>; 3]) -> [R; 9] {
    let [a, b, c] = [s[0].0, s[1].0, s[2].0];
    [a[0], a[1], a[2], b[0], b[1], b[2], c[0], c[1], c[2]]
}

/// K_ab = V (lam g_a g_bᵀ + mu g_b g_aᵀ + mu (g_a . g_b) I) with the rotated gradients.
#[inline(always)]
fn tet_row<R: Scalar>(rows: &Rows<'_, R>, node: usize, window: usize, sums: &mut [[Quad<R>; 3]; WINDOW]) {
    let (o, l) = (R::zero(), R::one());
    let units = [Wide([l, o, o, o]), Wide([o, l, o, o]), Wide([o, o, l, o])];
    let range = rows.tets.at(node);
    let (slots, blocks) = (&rows.tets.slot[range.clone()], &rows.tets.block[range]);
    let mut near = [[[R::zero(); 4]; 3]; TOGETHER];
    for (slots, blocks) in slots.chunks(TOGETHER).zip(blocks.chunks(TOGETHER)) {
        for (near, slot) in near.iter_mut().zip(slots) {
            *near = rows.warped[*slot as usize / 4];
        }
        for ((g, slot), block) in near.iter().zip(slots).zip(blocks) {
            let a = *slot as usize % 4;
            let factor = R::one() + rows.rate * (g[2][3] + rows.damping);
            let (lambda, mu) = (g[0][3] * factor, g[1][3] * factor);
            // the gradients of all corners add up to nothing
            let g = [(-(Wide(g[0]) + Wide(g[1]) + Wide(g[2]))).0, g[0], g[1], g[2]];
            let ga = g[a];
            let mga = Wide([ga[0] * mu, ga[1] * mu, ga[2] * mu, R::zero()]);
            let lga = [ga[0] * lambda, ga[1] * lambda, ga[2] * lambda];
            for b in 0..4 {
                let at = (block[b] as usize).wrapping_sub(window);
                if b == a || at >= WINDOW {
                    continue;
                }
                let gb = g[b];
                let dot = gb[0] * mga.0[0] + gb[1] * mga.0[1] + gb[2] * mga.0[2];
                let sum = &mut sums[at];
                for i in 0..3 {
                    sum[i] += Wide(gb) * Wide::splat(lga[i]) + mga * Wide::splat(gb[i]) + units[i] * Wide::splat(dot);
                }
            }
        }
    }
}

/// K_ab = R Ke_ab Rᵀ.
#[inline(always)]
fn hex_row<R: Scalar>(rows: &Rows<'_, R>, node: usize, window: usize, sums: &mut [[Quad<R>; 3]; WINDOW]) {
    for k in rows.hexes.at(node) {
        let slot = rows.hexes.slot[k] as usize;
        let (cell, a) = (slot / 8, slot % 8);
        let columns = &rows.rotation[cell];
        let scale = columns[0][3] * (R::one() + rows.rate * (columns[1][3] + rows.damping));
        let transposed = [Wide(columns[0]), Wide(columns[1]), Wide(columns[2])];
        let shape = &rows.shapes[rows.shape_of[cell] as usize];
        // rows of scale * R
        let mut rot = [[R::zero(); 3]; 3];
        for i in 0..3 {
            for j in 0..3 {
                rot[i][j] = columns[j][i] * scale;
            }
        }
        for b in 0..8 {
            let at = (rows.hexes.block[k][b] as usize).wrapping_sub(window);
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
