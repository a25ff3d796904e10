//! Products with a [`CubeMatrix`] on its free nodes, without assembling it.
//!
//! Two passes: every chunk of cubes adds up the forces on its corners, then every node adds those of its chunks, in a fixed order.

use super::free::FreePattern;
use super::pcg::kernel::{Inverse, StoreAndDot, inverse_of_block};
use super::sliced::RowWork;
use crate::cubes::{CORNER, corner_factors, corners, mode_factor, modes, stiffness};
use crate::par::Each;
use crate::{CELLS, CubeMatrix, CubePattern, Kernel, Lane, Mat3, Scalar, Scatter, Vec3, Wide, add_four, par, run_wide};
use rayon::prelude::*;
use std::sync::Arc;

/// Cubes side by side in memory: a multiple of every register's lanes.
const BLOCK: usize = 16;
/// Blocks per chunk.
const TASK: usize = CELLS / BLOCK;
/// Rows per task, and per partial sum of [`super::pcg`].
pub(in crate::solver) const ROWS: usize = 256;

/// [`BLOCK`] cubes, number by number. The last block is filled up with cubes of no stiffness.
#[derive(Clone, Debug)]
struct CubeBlock<A> {
    /// R_ij as `rotation[i][j]`.
    rotation: [[[A; BLOCK]; 3]; 3],
    lambda: [A; BLOCK],
    mu: [A; BLOCK],
    /// Free row of each corner; the row after the last one, which holds zero, for constrained corners.
    row: [[u32; BLOCK]; 8],
}

/// The free part of a [`CubeMatrix`] in numbers of type `A`.
#[derive(Debug)]
pub(in crate::solver) struct FreeCubes<A> {
    blocks: Vec<CubeBlock<A>>,
    /// Forces of the last product, which the nodes add up.
    scatter: Scatter<8>,
    force: Vec<[A; 4]>,
    diagonal: Vec<A>,
    pattern: Arc<CubePattern>,
    /// cube * 8 + corner of the corners at each row.
    slot_start: Vec<u32>,
    slot: Vec<u32>,
}

impl<A: Scalar> FreeCubes<A> {
    pub fn new(pattern: &Arc<CubePattern>, free: &FreePattern) -> Self {
        let rows = free.row_count();
        let mut row_of = vec![rows as u32; pattern.node_count];
        for (row, node) in free.node.iter().enumerate().filter(|(row, _)| !free.is_held(*row)) {
            row_of[*node as usize] = row as u32;
        }
        let mut slot_start = vec![0u32; rows + 2];
        let row_of_corner: Vec<u32> = pattern.nodes.iter().flatten().map(|n| row_of[*n as usize]).collect();
        for row in &row_of_corner {
            slot_start[*row as usize + 1] += 1;
        }
        for i in 0..=rows {
            slot_start[i + 1] += slot_start[i];
        }
        let mut next = slot_start.clone();
        let mut slot = vec![0; row_of_corner.len()];
        for (k, row) in row_of_corner.iter().enumerate() {
            let at = &mut next[*row as usize];
            slot[*at as usize] = k as u32;
            *at += 1;
        }
        slot.truncate(slot_start[rows] as usize);
        slot_start.truncate(rows + 1);
        let cubes = pattern.nodes.len();
        let zero = [A::zero(); BLOCK];
        let blocks = (0..cubes.div_ceil(BLOCK))
            .map(|k| CubeBlock {
                rotation: [[zero; 3]; 3],
                lambda: zero,
                mu: zero,
                row: std::array::from_fn(|a| {
                    std::array::from_fn(|l| *row_of_corner.get(8 * (k * BLOCK + l) + a).unwrap_or(&(rows as u32)))
                }),
            })
            .collect::<Vec<_>>();
        let corners: Vec<[u32; 8]> =
            (0..blocks.len() * BLOCK).map(|cell| blocks[cell / BLOCK].row.map(|row| row[cell % BLOCK])).collect();
        let scatter = Scatter::new(rows, &corners);
        let force = vec![[A::zero(); 4]; scatter.part_count()];
        Self { blocks, scatter, force, diagonal: vec![A::zero(); rows], pattern: pattern.clone(), slot_start, slot }
    }

    /// What a product reads and writes [bytes].
    pub fn bytes(&self) -> usize {
        let forces = 2 * size_of_val(&self.force[..]);
        size_of_val(&self.blocks[..]) + forces + self.scatter.bytes() + size_of_val(&self.diagonal[..])
    }

    pub fn belongs_to(&self, pattern: &Arc<CubePattern>) -> bool {
        Arc::ptr_eq(&self.pattern, pattern)
    }

    /// Takes the numbers of a matrix on the pattern it was made for.
    pub fn load<R: Scalar>(&mut self, matrix: &CubeMatrix<R>, free: &FreePattern) {
        let factor = mode_factor(matrix.pattern.edge);
        let cast = |v: R| A::from_f64(v.to_f64());
        self.blocks.par_iter_mut().enumerate().each(|(k, block)| {
            for l in 0..BLOCK.min(matrix.lame.len() - k * BLOCK) {
                let columns = &matrix.rotation[k * BLOCK + l];
                for i in 0..3 {
                    for j in 0..3 {
                        block.rotation[i][j][l] = cast(columns[j][i]);
                    }
                }
                let [lambda, mu] = matrix.lame[k * BLOCK + l];
                block.lambda[l] = A::from_f64(lambda.to_f64() * factor);
                block.mu[l] = A::from_f64(mu.to_f64() * factor);
            }
        });
        self.diagonal.par_iter_mut().zip(&free.node).with_min_len(par::CHUNK).each(|(to, node)| {
            *to = cast(matrix.diagonal[*node as usize]);
        });
    }

    /// Inverts the diagonal blocks; one that has no inverse becomes zero.
    pub fn invert_diagonal(&self, inverse: &mut [Inverse<A>]) {
        inverse.par_chunks_mut(ROWS).enumerate().each(|(c, inverse)| {
            for (k, inverse) in inverse.iter_mut().enumerate() {
                let row = c * ROWS + k;
                // α I + β t tᵀ of each corner, above the diagonal
                let mut sum = [A::zero(); 6];
                let mut alpha = self.diagonal[row];
                for slot in self.slots(row) {
                    let (cube, corner) = (*slot as usize / 8, *slot as usize % 8);
                    let (block, l) = (&self.blocks[cube / BLOCK], cube % BLOCK);
                    let (a, b) = corner_factors(block.lambda[l], block.mu[l]);
                    alpha += a;
                    let t = block.rotation.map(|row| {
                        let part = |j: usize| if CORNER[corner][j] > 0.0 { row[j][l] } else { -row[j][l] };
                        part(0) + part(1) + part(2)
                    });
                    let bt = t.map(|t| b * t);
                    for (sum, (i, j)) in sum.iter_mut().zip([(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)]) {
                        *sum += bt[i] * t[j];
                    }
                }
                let [xx, yy, zz, xy, xz, yz] = sum;
                let m = [xx + alpha, xy, xz, xy, yy + alpha, yz, xz, yz, zz + alpha];
                *inverse = inverse_of_block(m.map(Scalar::to_f64)).unwrap_or_default();
            }
        });
    }

    #[inline(always)]
    fn slots(&self, row: usize) -> &[u32] {
        &self.slot[self.slot_start[row] as usize..self.slot_start[row + 1] as usize]
    }

    /// `y = A x`. `x` has one entry more than there are rows, a zero.
    pub fn product(&mut self, x: &[[A; 4]], y: &mut [[A; 4]]) {
        self.corner_forces(x);
        let cubes = &*self;
        y.par_chunks_mut(ROWS).enumerate().each(|(c, y)| {
            run_wide::<A, _>(Collect { cubes, x, chunk: c, y });
        });
    }

    /// As `product`; also writes the first of each `partial`: `xᵀ y` over a chunk of 256 rows.
    pub fn product_dot(&mut self, x: &[[A; 4]], y: &mut [[A; 4]], partial: &mut [[f64; 2]]) {
        self.corner_forces(x);
        let cubes = &*self;
        y.par_chunks_mut(ROWS).zip(partial).enumerate().each(|(c, (y, partial))| {
            partial[0] = run_wide::<A, _>(Collect { cubes, x, chunk: c, y });
        });
    }

    /// Hands the `rows` rows of chunk `c` of the product with `x`, whose corner forces must be there, to `work`.
    #[inline(always)]
    pub fn for_rows(&self, c: usize, x: &[[A; 4]], rows: usize, work: &mut impl RowWork<A>) {
        for k in 0..rows {
            let row = c * ROWS + k;
            let mut sum = Wide(x[row]) * Wide::splat(self.diagonal[row]);
            for part in self.scatter.parts(row) {
                sum += Wide(self.force[*part as usize]);
            }
            work.row(k, sum);
        }
    }

    /// Forces of all cubes on their corners, for [`Self::for_rows`].
    pub fn corner_forces(&mut self, x: &[[A; 4]]) {
        assert!(x.len() == self.diagonal.len() + 1);
        let Self { blocks, scatter, force, .. } = self;
        scatter.for_chunks(force, |c, local, force| {
            let blocks = par::chunk(blocks, c, TASK);
            run_wide::<A, _>(Forces { blocks, x, local, force });
        });
    }
}

/// Forces of a chunk's cubes on their corners.
struct Forces<'a, A> {
    blocks: &'a [CubeBlock<A>],
    x: &'a [[A; 4]],
    local: &'a [[u16; 8]],
    force: &'a mut [[A; 4]],
}

/// Three components of the corner vectors of a block.
type Corners<A> = [[[A; BLOCK]; 8]; 3];

impl<A: Scalar> Kernel for Forces<'_, A> {
    type Output = ();
    #[inline(always)]
    fn run<const W: usize>(self) {
        let zero: Corners<A> = [[[A::zero(); BLOCK]; 8]; 3];
        // the next block is fetched before this one is computed: a register cannot be read back from the four smaller writes
        // it was put together by until these have reached the cache
        let mut fetched = [zero, zero];
        let mut out = zero;
        if let Some(block) = self.blocks.first() {
            fetch(block, self.x, &mut fetched[0]);
        }
        self.force.fill([A::zero(); 4]);
        for (k, local) in self.local.as_chunks::<BLOCK>().0.iter().enumerate() {
            if let Some(block) = self.blocks.get(k + 1) {
                fetch(block, self.x, &mut fetched[(k + 1) % 2]);
            }
            // registers end here: the compiler would otherwise carry single numbers through the sums below
            let u = &std::hint::black_box(&fetched)[k % 2];
            let block = &self.blocks[k];
            cubes(block, u, &mut out);
            hand_out(std::hint::black_box(&out), local, self.force);
        }
    }
}

#[inline(always)]
fn fetch<A: Scalar>(block: &CubeBlock<A>, x: &[[A; 4]], u: &mut Corners<A>) {
    for a in 0..8 {
        for first in (0..BLOCK).step_by(4) {
            // SAFETY: rows are at most the row count, and `x` has one entry more (asserted in `corner_forces`).
            let at = |l: usize| unsafe { x.get_unchecked(block.row[a][first + l] as usize) };
            let columns = A::transposed([at(0), at(1), at(2), at(3)]);
            for c in 0..3 {
                u[c][a][first..first + 4].copy_from_slice(&columns[c]);
            }
        }
    }
}

#[inline(always)]
fn hand_out<A: Scalar>(f: &Corners<A>, local: &[[u16; 8]; BLOCK], force: &mut [[A; 4]]) {
    for a in 0..8 {
        for first in (0..BLOCK).step_by(4) {
            let part = |c: usize| &f[c][a].as_chunks::<4>().0[first / 4];
            add_four([part(0), part(1), part(2), &[A::zero(); 4]], &local[first..], a, force);
        }
    }
}

/// Forces of a block's cubes. Written for one of them: the compiler takes as many at a time as a register has lanes, where it would take
/// half as many if the code named their number, as numbers are used more than once.
#[inline(always)]
fn cubes<A: Scalar>(block: &CubeBlock<A>, u: &Corners<A>, out: &mut Corners<A>) {
    for l in 0..BLOCK {
        let (mut c, mut rotation) = ([Vec3::zero(); 7], Mat3::zero());
        for i in 0..3 {
            let mut corner = [Wide([A::zero()]); 8];
            for a in 0..8 {
                corner[a] = Wide([u[i][a][l]]);
            }
            let amplitude = modes(corner);
            for n in 0..7 {
                c[n].0[i] = amplitude[n];
            }
            for j in 0..3 {
                rotation.0[i][j] = Wide([block.rotation[i][j][l]]);
            }
        }
        for c in &mut c {
            *c = rotation.transpose_mul(*c);
        }
        let mut f = stiffness(Wide([block.lambda[l]]), Wide([block.mu[l]]), c);
        for f in &mut f {
            *f = rotation * *f;
        }
        for i in 0..3 {
            let mut part = [Wide([A::zero()]); 7];
            for n in 0..7 {
                part[n] = f[n].0[i];
            }
            let corner = corners(part);
            for a in 0..8 {
                out[i][a][l] = corner[a].0[0];
            }
        }
    }
}

/// Adds up the corner forces at rows `first..first + y.len()`; returns `xᵀ y` over them.
struct Collect<'a, A> {
    cubes: &'a FreeCubes<A>,
    x: &'a [[A; 4]],
    chunk: usize,
    y: &'a mut [[A; 4]],
}

impl<A: Scalar> Kernel for Collect<'_, A> {
    type Output = f64;
    #[inline(always)]
    fn run<const W: usize>(self) -> f64 {
        let Self { cubes, x, chunk, y } = self;
        let rows = y.len();
        let mut work = StoreAndDot { y, own: &x[chunk * ROWS..], dot: Wide::zero() };
        cubes.for_rows(chunk, x, rows, &mut work);
        work.total()
    }
}

#[cfg(test)]
mod tests;
