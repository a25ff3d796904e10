//! Galerkin products `A_c = Pᵀ A P` on fixed patterns.
//!
//! Two owner-computes passes: rows of `A P`, then rows of `Pᵀ (A P)`. Where each contribution lands is found once; a refresh
//! only streams values through it.

use super::interpolation::Interpolation;
use crate::solver::free::FreePattern;
use rayon::prelude::*;

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
        let (p, pt, ap, coarse) = (&self.p, &self.pt, &self.ap, &self.coarse);
        rows_mut(&ap.row_start, 0, &mut self.ap_values, &|i, out| {
            let mut at = ap.place_start[i] as usize;
            for k in fine.row(i) {
                let a = &fine_block(k);
                for e in p.row(fine.column[k] as usize) {
                    add(&mut out[ap.place[at] as usize], p.weight[e] as f32, a);
                    at += 1;
                }
            }
        });
        let ap_values = &self.ap_values;
        rows_mut(&coarse.row_start, 0, &mut self.coarse_values, &|c, out| {
            let mut at = coarse.place_start[c] as usize;
            for k in pt.row(c) {
                let i = pt.column[k] as usize;
                for a in &ap_values[ap.row_start[i] as usize..ap.row_start[i + 1] as usize] {
                    add(&mut out[coarse.place[at] as usize], pt.weight[k] as f32, a);
                    at += 1;
                }
            }
        });
    }
}

#[inline(always)]
fn add(sum: &mut [f32; 9], w: f32, a: &[f32; 9]) {
    for (s, a) in sum.iter_mut().zip(a) {
        *s += w * *a;
    }
}

/// Calls `fill(row, blocks of the row)` on zeroed blocks for all rows of `row_start`, on all threads.
fn rows_mut(row_start: &[u32], first: usize, values: &mut [[f32; 9]], fill: &(impl Fn(usize, &mut [[f32; 9]]) + Sync)) {
    let rows = row_start.len() - 1;
    if rows > ROWS {
        let half = rows / 2;
        let (a, b) = values.split_at_mut((row_start[half] - row_start[0]) as usize);
        rayon::join(
            || rows_mut(&row_start[..=half], first, a, fill),
            || rows_mut(&row_start[half..], first + half, b, fill),
        );
        return;
    }
    values.fill([0.0; 9]);
    let mut rest = values;
    for i in 0..rows {
        let (row, tail) = rest.split_at_mut((row_start[i + 1] - row_start[i]) as usize);
        fill(first + i, row);
        rest = tail;
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
