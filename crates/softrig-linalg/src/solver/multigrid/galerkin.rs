//! Galerkin products `A_c = Pᵀ A P` on fixed patterns.
//!
//! Two owner-computes passes: rows of `A P`, then rows of `Pᵀ (A P)`. Where each contribution lands is found once; a refresh
//! only streams values through it.

use super::interpolation::Interpolation;
use crate::solver::free::FreePattern;
use crate::{Kernel, run_wide};
use rayon::prelude::*;
use std::ops::Range;

/// Rows per task.
const ROWS: usize = 128;

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
    coarse: Product,
    ap_values: Vec<[f32; 9]>,
    coarse_values: Vec<[f32; 9]>,
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
}

impl Galerkin {
    /// `fine` has one row per row of `p`.
    pub fn new(fine: &FreePattern, p: Interpolation) -> Self {
        let pt = p.transposed();
        let ap = symbolic(fine.row_count(), p.coarse_count, |i, add| {
            for k in fine.row(i) {
                p.column[p.row(fine.column[k] as usize)].iter().for_each(|c| add(*c));
            }
        });
        let coarse = symbolic(p.coarse_count, p.coarse_count, |c, add| {
            for k in pt.row(c) {
                let i = pt.column[k] as usize;
                ap.column[ap.row_start[i] as usize..ap.row_start[i + 1] as usize].iter().for_each(|c| add(*c));
            }
        });
        let ap_values = vec![[0.0; 9]; ap.column.len()];
        let coarse_values = vec![[0.0; 9]; coarse.column.len()];
        Self { p, pt, ap, coarse, ap_values, coarse_values }
    }

    pub fn interpolation(&self) -> &Interpolation {
        &self.p
    }

    pub fn restriction(&self) -> &Interpolation {
        &self.pt
    }

    /// The coarse pattern, as a system of its own.
    pub fn coarse_pattern(&self) -> FreePattern {
        let n = self.p.coarse_count;
        let diagonal = (0..n)
            .map(|i| {
                let row = self.coarse.row_start[i] as usize..self.coarse.row_start[i + 1] as usize;
                let at = self.coarse.column[row.clone()].binary_search(&(i as u32));
                (row.start + at.expect("a coarse node sees itself through any fine node it interpolates")) as u32
            })
            .collect();
        FreePattern {
            node: (0..n as u32).collect(),
            row_start: self.coarse.row_start.clone(),
            column: self.coarse.column.clone(),
            source: Vec::new(),
            diagonal,
        }
    }

    /// The coarse blocks of the last [`Self::refresh`].
    pub fn coarse_blocks(&self) -> &[[f32; 9]] {
        &self.coarse_values
    }

    /// Makes the coarse blocks for the fine ones.
    pub fn refresh(&mut self, fine: &FreePattern, fine_block: &(impl Fn(usize) -> [f32; 9] + Sync)) {
        let Self { p, pt, ap, coarse, ap_values, coarse_values } = self;
        fill(0..ap.row_count(), ap_values, &FineTimesP { fine, fine_block, p, ap });
        fill(0..coarse.row_count(), coarse_values, &Restrict { pt, ap, ap_values, coarse });
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
    fine: &'a FreePattern,
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

/// `Pᵀ (A P)`.
struct Restrict<'a> {
    pt: &'a Interpolation,
    ap: &'a Product,
    ap_values: &'a [[f32; 9]],
    coarse: &'a Product,
}

impl Rows for Restrict<'_> {
    fn pattern(&self) -> &Product {
        self.coarse
    }

    #[inline(always)]
    fn add(&self, i: usize, out: &mut [[f32; 9]]) {
        let mut at = self.coarse.place_start[i] as usize;
        for k in self.pt.row(i) {
            let fine = self.pt.column[k] as usize;
            for a in &self.ap_values[self.ap.row_start[fine] as usize..self.ap.row_start[fine + 1] as usize] {
                add(&mut out[self.coarse.place[at] as usize], self.pt.weight[k] as f32, a);
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
