//! Galerkin products `A_c = Pᵀ A P` on fixed patterns.
//!
//! Two owner-computes passes: rows of `A P`, then rows of `Pᵀ (A P)` from the diagonal on; what is left of it is the mirror image,
//! as systems are symmetric. Where each contribution lands is found once; a refresh only streams values through it.

use super::interpolation::Interpolation;
use crate::solver::free::BlockRows;
use crate::{Kernel, run_wide};
use rayon::prelude::*;
use std::ops::Range;

/// Rows per task.
const ROWS: usize = 128;

/// Marks a block that is the transpose of the one it points to.
const MIRRORED: u32 = 1 << 31;

/// A sparse pattern of blocks, with the place of every contribution to it.
#[derive(Debug, Default)]
struct Product {
    row_start: Vec<u32>,
    column: Vec<u32>,
    /// Place within the row of each contribution, in the order a refresh meets them.
    place: Vec<u16>,
    /// First contribution of each row.
    place_start: Vec<u32>,
}

/// The symbolic part of one coarsening.
#[derive(Debug, Default)]
pub(super) struct Galerkin {
    p: Interpolation,
    pt: Interpolation,
    ap: Product,
    /// Pattern of the coarse matrix: rows and columns.
    coarse: (Vec<u32>, Vec<u32>),
    /// Its part from the diagonal on, which is what is computed.
    upper: Product,
    /// For every entry of `pt`: the first block of its row of `ap` that is not left of the diagonal.
    tail: Vec<u32>,
    /// For every coarse block: where it is in the upper part, or its mirror image, with [`MIRRORED`].
    source: Vec<u32>,
    ap_values: Vec<[f32; 9]>,
    upper_values: Vec<[f32; 9]>,
}

/// Walks a sparse product row by row; `visit(row, add)` names the columns of all contributions of a row in order.
fn symbolic(rows: usize, columns: usize, visit: impl Fn(usize, &mut dyn FnMut(u32))) -> Product {
    let mut out = Product { row_start: vec![0], place_start: vec![0], ..Product::default() };
    let mut mark = vec![u32::MAX; columns];
    for i in 0..rows {
        let first = out.column.len();
        visit(i, &mut |c| {
            if mark[c as usize] == u32::MAX {
                mark[c as usize] = 0;
                out.column.push(c);
            }
        });
        out.column[first..].sort_unstable();
        for (k, c) in out.column[first..].iter().enumerate() {
            mark[*c as usize] = k as u32;
        }
        visit(i, &mut |c| out.place.push(mark[c as usize] as u16));
        out.column[first..].iter().for_each(|c| mark[*c as usize] = u32::MAX);
        out.row_start.push(out.column.len() as u32);
        out.place_start.push(out.place.len() as u32);
    }
    out
}

impl Product {
    fn row_count(&self) -> usize {
        self.row_start.len() - 1
    }

    fn row(&self, i: usize) -> Range<usize> {
        self.row_start[i] as usize..self.row_start[i + 1] as usize
    }

    /// The part of a square product from the diagonal on.
    fn upper(&self) -> Self {
        let mut out = Self { row_start: vec![0], place_start: vec![0], ..Self::default() };
        for i in 0..self.row_count() {
            let row = &self.column[self.row(i)];
            let diagonal = row.partition_point(|c| (*c as usize) < i);
            out.column.extend_from_slice(&row[diagonal..]);
            let places = &self.place[self.place_start[i] as usize..self.place_start[i + 1] as usize];
            out.place.extend(places.iter().filter_map(|k| k.checked_sub(diagonal as u16)));
            out.row_start.push(out.column.len() as u32);
            out.place_start.push(out.place.len() as u32);
        }
        out
    }

    /// For every block of this square product with a symmetric pattern: where it is in its upper part, or its mirror image, with
    /// [`MIRRORED`].
    fn sources(&self, upper: &Self) -> Vec<u32> {
        let mut out = Vec::with_capacity(self.column.len());
        for i in 0..self.row_count() {
            for &j in &self.column[self.row(i)] {
                let (row, column) = (i.min(j as usize), i.max(j as usize) as u32);
                let row = upper.row(row);
                let at = upper.column[row.clone()].binary_search(&column).expect("the pattern is symmetric");
                let mirrored = if (j as usize) < i { MIRRORED } else { 0 };
                out.push((row.start + at) as u32 | mirrored);
            }
        }
        out
    }
}

impl Galerkin {
    /// `fine` has one row per row of `p`.
    pub fn new(fine: &BlockRows, p: Interpolation) -> Self {
        let pt = p.transposed();
        let ap = symbolic(fine.row_count(), p.coarse_count, |i, add| {
            for k in fine.row(i) {
                p.column[p.row(fine.column[k] as usize)].iter().for_each(|c| add(*c));
            }
        });
        let whole = symbolic(p.coarse_count, p.coarse_count, |c, add| {
            for k in pt.row(c) {
                ap.column[ap.row(pt.column[k] as usize)].iter().for_each(|c| add(*c));
            }
        });
        let mut tail = Vec::with_capacity(pt.column.len());
        for c in 0..p.coarse_count {
            for k in pt.row(c) {
                let row = ap.row(pt.column[k] as usize);
                tail.push((row.start + ap.column[row].partition_point(|j| (*j as usize) < c)) as u32);
            }
        }
        let upper = whole.upper();
        let source = whole.sources(&upper);
        let ap_values = vec![[0.0; 9]; ap.column.len()];
        let upper_values = vec![[0.0; 9]; upper.column.len()];
        Self { p, pt, ap, coarse: (whole.row_start, whole.column), upper, tail, source, ap_values, upper_values }
    }

    pub fn interpolation(&self) -> &Interpolation {
        &self.p
    }

    pub fn restriction(&self) -> &Interpolation {
        &self.pt
    }

    /// Takes other weights on the same entries.
    pub fn set_weights(&mut self, p: Interpolation) {
        debug_assert_eq!((&p.start, &p.column), (&self.p.start, &self.p.column));
        self.pt = p.transposed();
        self.p = p;
    }

    /// The coarse pattern, as a system of its own: a row for each of `node`.
    pub fn coarse_pattern(&self, node: Vec<u32>) -> BlockRows {
        let (row_start, column) = &self.coarse;
        let diagonal = (0..self.p.coarse_count)
            .map(|i| {
                let row = row_start[i] as usize..row_start[i + 1] as usize;
                let at = column[row.clone()].binary_search(&(i as u32));
                (row.start + at.expect("a coarse node sees itself through any fine node it interpolates")) as u32
            })
            .collect();
        BlockRows { node, row_start: row_start.clone(), column: column.clone(), diagonal }
    }

    /// A block of the coarse pattern, as the last [`Self::refresh`] made it.
    pub fn coarse_block(&self, k: usize) -> [f32; 9] {
        let m = self.upper_values[(self.source[k] & !MIRRORED) as usize];
        if self.source[k] < MIRRORED { m } else { [m[0], m[3], m[6], m[1], m[4], m[7], m[2], m[5], m[8]] }
    }

    /// Makes the coarse blocks for the fine ones, which are those of a symmetric matrix.
    pub fn refresh(&mut self, fine: &BlockRows, fine_block: &(impl Fn(usize) -> [f32; 9] + Sync)) {
        let Self { p, pt, ap, upper, tail, ap_values, upper_values, .. } = self;
        fill(0..ap.row_count(), ap_values, &FineTimesP { fine, fine_block, p, ap });
        fill(0..upper.row_count(), upper_values, &Restrict { pt, ap, tail, ap_values, upper });
    }
}

/// Rows of a sparse product, added up where they are wanted.
trait Rows: Sync {
    fn pattern(&self) -> &Product;
    /// Adds row `i` to zeroed blocks. Must be `#[inline(always)]`.
    fn add(&self, i: usize, out: &mut [[f32; 9]]);
}

/// `A P`.
struct FineTimesP<'a, F> {
    fine: &'a BlockRows,
    fine_block: &'a F,
    p: &'a Interpolation,
    ap: &'a Product,
}

impl<F: Fn(usize) -> [f32; 9] + Sync> Rows for FineTimesP<'_, F> {
    fn pattern(&self) -> &Product {
        self.ap
    }

    #[inline(always)]
    fn add(&self, i: usize, out: &mut [[f32; 9]]) {
        let mut at = self.ap.place_start[i] as usize;
        for k in self.fine.row(i) {
            let a = (self.fine_block)(k);
            for e in self.p.row(self.fine.column[k] as usize) {
                add(&mut out[self.ap.place[at] as usize], self.p.weight[e] as f32, &a);
                at += 1;
            }
        }
    }
}

/// `Pᵀ (A P)` from the diagonal on.
struct Restrict<'a> {
    pt: &'a Interpolation,
    ap: &'a Product,
    tail: &'a [u32],
    ap_values: &'a [[f32; 9]],
    upper: &'a Product,
}

impl Rows for Restrict<'_> {
    fn pattern(&self) -> &Product {
        self.upper
    }

    #[inline(always)]
    fn add(&self, i: usize, out: &mut [[f32; 9]]) {
        let mut at = self.upper.place_start[i] as usize;
        for k in self.pt.row(i) {
            let end = self.ap.row_start[self.pt.column[k] as usize + 1] as usize;
            for a in &self.ap_values[self.tail[k] as usize..end] {
                add(&mut out[self.upper.place[at] as usize], self.pt.weight[k] as f32, a);
                at += 1;
            }
        }
    }
}

#[inline(always)]
fn add(sum: &mut [f32; 9], w: f32, a: &[f32; 9]) {
    for (s, a) in sum.iter_mut().zip(a) {
        *s += w * *a;
    }
}

/// Makes the blocks of some rows on all threads; halves the work between them.
fn fill<P: Rows>(range: Range<usize>, values: &mut [[f32; 9]], rows: &P) {
    if range.len() > ROWS {
        let half = range.start + range.len() / 2;
        let start = &rows.pattern().row_start;
        let (a, b) = values.split_at_mut((start[half] - start[range.start]) as usize);
        rayon::join(|| fill(range.start..half, a, rows), || fill(half..range.end, b, rows));
        return;
    }
    run_wide::<f32, _>(Fill { rows, range, values });
}

struct Fill<'a, P> {
    rows: &'a P,
    range: Range<usize>,
    values: &'a mut [[f32; 9]],
}

impl<P: Rows> Kernel for Fill<'_, P> {
    type Output = ();
    #[inline(always)]
    fn run<const W: usize>(self) {
        let start = &self.rows.pattern().row_start;
        let first = start[self.range.start];
        self.values.fill([0.0; 9]);
        for i in self.range {
            self.rows.add(i, &mut self.values[(start[i] - first) as usize..(start[i + 1] - first) as usize]);
        }
    }
}

/// `out = Σ weight x` for every row of the interpolation, added to what is there.
pub(super) fn interpolate_add(p: &Interpolation, x: &[[f32; 4]], out: &mut [[f32; 4]]) {
    out.par_chunks_mut(ROWS).enumerate().for_each(|(c, out)| {
        for (i, out) in out.iter_mut().enumerate() {
            for k in p.row(c * ROWS + i) {
                let (w, x) = (p.weight[k] as f32, x[p.column[k] as usize]);
                for j in 0..4 {
                    out[j] += w * x[j];
                }
            }
        }
    });
}

#[cfg(test)]
mod tests {
    use super::super::settings::Marking;
    use super::*;
    use crate::{BlockPattern, DofConstraints};

    /// Coarse blocks against the triple product of dense matrices.
    #[test]
    fn coarse_operators_are_the_dense_triple_product() {
        for case in 0..6usize {
            let (n, coarse) = (30 + 9 * case, 4 + 3 * case);
            let cells: Vec<[u32; 3]> =
                (0..2 * n as u32).map(|i| [i % n as u32, (i * i + 3) % n as u32, (i * 7 + 1) % n as u32]).collect();
            let pattern = BlockPattern::from_cells(n, cells.iter().map(|c| &c[..]));
            let fine = crate::solver::free::FreePattern::new(
                &pattern,
                &DofConstraints::from_mask((0..n).map(|i| i % 4 == case % 4).collect()),
            );
            let mut p = Interpolation { coarse_count: coarse, start: vec![0], ..Interpolation::default() };
            for i in 0..n {
                for c in 0..1 + i % 3 {
                    p.column.push(((i * 5 + c * 11) % coarse) as u32);
                    p.weight.push(0.25 + 0.125 * ((i + c) % 5) as f64);
                }
                p.start.push(p.column.len() as u32);
            }
            let (p, _) = p.restricted(&fine.node, Marking::EmptyColumns);
            // symmetric, as systems are
            let number = |a: usize, b: usize| ((a.min(b) * 13 + a.max(b) * 5) as f32).sin();
            let row_of = |k: usize| fine.row_start.partition_point(|s| *s as usize <= k) - 1;
            let block = |k: usize| -> [f32; 9] {
                let (i, j) = (row_of(k), fine.column[k] as usize);
                std::array::from_fn(|e| number(3 * i + e / 3, 3 * j + e % 3))
            };
            let mut galerkin = Galerkin::new(&fine, p.clone());
            galerkin.refresh(&fine, &block);
            let mut dense = vec![vec![[0.0f64; 9]; p.coarse_count]; p.coarse_count];
            for i in 0..fine.row_count() {
                for k in fine.row(i) {
                    for a in p.row(i) {
                        for b in p.row(fine.column[k] as usize) {
                            let to = &mut dense[p.column[a] as usize][p.column[b] as usize];
                            let w = p.weight[a] * p.weight[b];
                            (0..9).for_each(|e| to[e] += w * f64::from(block(k)[e]));
                        }
                    }
                }
            }
            let coarse_pattern = galerkin.coarse_pattern((0..p.coarse_count as u32).collect());
            let mut there = vec![vec![false; p.coarse_count]; p.coarse_count];
            for i in 0..p.coarse_count {
                for k in coarse_pattern.row(i) {
                    let j = coarse_pattern.column[k] as usize;
                    there[i][j] = true;
                    for e in 0..9 {
                        let (a, b) = (f64::from(galerkin.coarse_block(k)[e]), dense[i][j][e]);
                        assert!((a - b).abs() < 1e-4, "block {i} {j}: {a} {b}");
                    }
                }
            }
            let missing = |(i, j): (usize, usize)| !there[i][j] && dense[i][j] != [0.0; 9];
            assert!(!(0..p.coarse_count).flat_map(|i| (0..p.coarse_count).map(move |j| (i, j))).any(missing));
        }
    }
}
