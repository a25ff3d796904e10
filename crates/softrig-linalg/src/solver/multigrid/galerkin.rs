//! Galerkin products `A_c = Pᵀ A P` on fixed patterns, streamed.
//!
//! Fine rows are taken strip by strip. A row of `A P` lives in the cache for as long as it takes to add its multiples to the coarse
//! rows it belongs to, from the diagonal on; what is left of these is the mirror image, as systems are symmetric. Each strip adds to
//! coarse rows of its own, which are summed in the order of the strips: any number of threads gives the same bits. Where each
//! contribution lands is found once; a refresh only streams values through it.

use super::interpolation::{Interpolation, Weights};
use super::pattern::{MIRRORED, Pattern};
use crate::solver::free::{BlockRows, Blocks};
use crate::{Kernel, par, run_wide};
use rayon::prelude::*;
use std::ops::Range;

/// Fine rows of a strip: enough that few coarse rows belong to several, few enough that its blocks stay in the cache.
const STRIP: usize = 512;
/// Rows per task.
const ROWS: usize = 128;

/// One coarsening.
#[derive(Debug, Default)]
pub(super) struct Galerkin {
    p: Weights,
    pt: Weights,
    /// Pattern of the coarse matrix: rows and columns.
    coarse: Pattern,
    /// Its part from the diagonal on, which is what is computed.
    upper: Pattern,
    /// For every coarse block: where it is in the upper part, or its mirror image, with [`MIRRORED`].
    source: Vec<u32>,
    /// Fine rows in the order of their nodes, which lie close together strip by strip.
    order: Vec<u32>,
    strips: Vec<Strip>,
    /// Where contributions land, in the order a refresh meets them.
    places: Places,
    /// The coarse rows of each strip, after room for one row of `A P`.
    parts: Vec<[f32; 9]>,
    /// For every coarse row: where its parts are.
    part_start: Vec<u32>,
    part: Vec<u32>,
    values: Vec<[f32; 9]>,
}

/// Where a strip begins in each of the lists.
#[derive(Clone, Copy, Debug, Default)]
struct Strip {
    row: usize,
    gather: usize,
    entry: usize,
    spread: usize,
    part: usize,
}

#[derive(Debug, Default)]
struct Places {
    /// Blocks of each row of `A P`.
    width: Vec<u16>,
    /// Of what is added to a row of `A P`: place in the row.
    gather: Vec<u16>,
    /// For each weight of a fine row: first block of its row of `A P` that is not left of the coarse diagonal, and the strip's part of
    /// the coarse row.
    tail: Vec<u16>,
    base: Vec<u32>,
    /// Of what is added to a coarse row: place in the row.
    spread: Vec<u16>,
}

impl Places {
    /// Gives back what growing has taken too much.
    fn shrink(&mut self) {
        [&mut self.width, &mut self.gather, &mut self.tail, &mut self.spread].into_iter().for_each(Vec::shrink_to_fit);
        self.base.shrink_to_fit();
    }
}

impl Galerkin {
    /// `fine` has one row per row of `p`.
    pub fn new(fine: &Blocks, p: &Interpolation) -> Self {
        let pt = p.transposed();
        let ap = Pattern::of_product(fine.row_count(), p.coarse_count, |i, add| {
            for k in fine.row(i) {
                p.column[p.row(fine.column[k] as usize)].iter().for_each(|c| add(*c));
            }
        });
        let coarse = Pattern::of_product(p.coarse_count, p.coarse_count, |c, add| {
            for k in pt.row(c) {
                ap.columns(pt.column[k] as usize).iter().for_each(|c| add(*c));
            }
        });
        let upper = coarse.upper();
        let source = coarse.sources(&upper);
        let values = vec![[0.0; 9]; upper.column.len()];
        let mut order: Vec<u32> = (0..fine.row_count() as u32).collect();
        order.sort_by_key(|row| fine.node[*row as usize]);
        let mut out = Self { p: p.into(), pt: (&pt).into(), coarse, upper, source, order, values, ..Self::default() };
        out.cut(fine, p, &ap);
        out
    }

    /// Makes the strips and finds all places.
    fn cut(&mut self, fine: &Blocks, p: &Interpolation, ap: &Pattern) {
        let Self { upper, order, strips, places, .. } = self;
        let room = (0..ap.row_count()).map(|i| ap.row(i).len()).max().unwrap_or(0);
        // coarse row and place in all parts
        let mut part: Vec<(u32, u32)> = Vec::new();
        let mut base = vec![u32::MAX; p.coarse_count];
        let (mut row, mut len) = (0, 0);
        for rows in order.chunks(STRIP) {
            let Places { gather, tail, spread, .. } = &*places;
            let strip = Strip { row, gather: gather.len(), entry: tail.len(), spread: spread.len(), part: len };
            strips.push(strip);
            let first = part.len();
            let mut next = room;
            for i in rows.iter().map(|i| *i as usize) {
                let columns = ap.columns(i);
                places.width.push(columns.len() as u16);
                for k in fine.row(i) {
                    for c in &p.column[p.row(fine.column[k] as usize)] {
                        places.gather.push(place_of(*c, columns));
                    }
                }
                for c in p.column[p.row(i)].iter().map(|c| *c as usize) {
                    let coarse = upper.columns(c);
                    if base[c] == u32::MAX {
                        base[c] = next as u32;
                        part.push((c as u32, (len + next) as u32));
                        next += coarse.len();
                    }
                    let tail = columns.partition_point(|j| (*j as usize) < c);
                    places.tail.push(tail as u16);
                    places.base.push(base[c]);
                    places.spread.extend(columns[tail..].iter().map(|j| place_of(*j, coarse)));
                }
            }
            part[first..].iter().for_each(|(c, _)| base[*c as usize] = u32::MAX);
            (row, len) = (row + rows.len(), len + next);
        }
        let Places { gather, tail, spread, .. } = &*places;
        strips.push(Strip { row, gather: gather.len(), entry: tail.len(), spread: spread.len(), part: len });
        places.shrink();
        self.parts = vec![[0.0; 9]; len];
        // strips stay in their order
        part.sort_by_key(|(c, _)| *c);
        let starts = (0..=p.coarse_count as u32).map(|c| part.partition_point(|(row, _)| *row < c) as u32);
        self.part_start = starts.collect();
        self.part = part.into_iter().map(|(_, at)| at).collect();
    }

    pub fn interpolation(&self) -> &Weights {
        &self.p
    }

    pub fn restriction(&self) -> &Weights {
        &self.pt
    }

    /// Takes other weights on the same entries.
    pub fn set_weights(&mut self, p: &Interpolation) {
        debug_assert_eq!((&p.start, &p.column), (&self.p.start, &self.p.column));
        self.pt = (&p.transposed()).into();
        self.p = p.into();
    }

    /// The coarse pattern, as a system of its own: a row for each of `node`.
    pub fn coarse_pattern(&self, node: Vec<u32>) -> Blocks {
        let Pattern { start, column } = &self.coarse;
        let diagonal = (0..self.coarse.row_count())
            .map(|i| {
                let at = self.coarse.columns(i).binary_search(&(i as u32));
                start[i] + at.expect("a coarse node sees itself through any fine node it interpolates") as u32
            })
            .collect();
        let rows = BlockRows { node, row_start: start.clone(), diagonal };
        Blocks { rows: rows.into(), column: column.clone() }
    }

    /// A block of the coarse pattern, as the last [`Self::refresh`] made it.
    pub fn coarse_block(&self, k: usize) -> [f32; 9] {
        let m = self.values[(self.source[k] & !MIRRORED) as usize];
        if self.source[k] < MIRRORED { m } else { [m[0], m[3], m[6], m[1], m[4], m[7], m[2], m[5], m[8]] }
    }

    /// Makes the coarse blocks for the fine ones, which are those of a symmetric matrix: column and numbers by row and
    /// place in it.
    pub fn refresh(&mut self, fine: &BlockRows, fine_block: &(impl Fn(usize, usize) -> (u32, [f32; 9]) + Sync)) {
        let mut parts = std::mem::take(&mut self.parts);
        let at = |s: usize| self.strips[s].part;
        par::divide(0..self.strips.len() - 1, 1, &at, &mut parts, &|strips, parts| {
            for s in strips {
                run_wide::<f32, _>(FillStrip { all: self, fine, fine_block, s, parts: &mut *parts });
            }
        });
        let mut values = std::mem::take(&mut self.values);
        let at = |c: usize| self.upper.start[c] as usize;
        par::divide(0..self.upper.row_count(), ROWS, &at, &mut values, &|rows, values| {
            run_wide::<f32, _>(AddParts { all: self, parts: &parts, rows, values });
        });
        (self.parts, self.values) = (parts, values);
    }
}

fn place_of(column: u32, columns: &[u32]) -> u16 {
    columns.binary_search(&column).expect("the pattern holds every contribution") as u16
}

/// What the rows of a strip add to coarse rows.
struct FillStrip<'a, F> {
    all: &'a Galerkin,
    fine: &'a BlockRows,
    fine_block: &'a F,
    s: usize,
    parts: &'a mut [[f32; 9]],
}

impl<F: Fn(usize, usize) -> (u32, [f32; 9]) + Sync> Kernel for FillStrip<'_, F> {
    type Output = ();
    #[inline(always)]
    fn run<const W: usize>(self) {
        let Galerkin { p, order, places, strips, .. } = self.all;
        let (strip, end) = (strips[self.s], strips[self.s + 1]);
        let mut gather = places.gather[strip.gather..end.gather].iter();
        let mut spread = places.spread[strip.spread..end.spread].iter();
        let mut entries = places.tail[strip.entry..].iter().zip(&places.base[strip.entry..]);
        let parts = self.parts;
        parts.fill([0.0; 9]);
        for (i, width) in order[strip.row..end.row].iter().zip(&places.width[strip.row..]) {
            let (i, width) = (*i as usize, *width as usize);
            parts[..width].fill([0.0; 9]);
            for k in 0..self.fine.row(i).len() {
                let (column, a) = (self.fine_block)(i, k);
                for (w, at) in p.weight[p.row(column as usize)].iter().zip(&mut gather) {
                    add(&mut parts[*at as usize], *w, &a);
                }
            }
            for (w, (tail, base)) in p.weight[p.row(i)].iter().zip(&mut entries) {
                let (row, parts) = parts.split_at_mut(*base as usize);
                for (a, at) in row[*tail as usize..width].iter().zip(&mut spread) {
                    add(&mut parts[*at as usize], *w, a);
                }
            }
        }
    }
}

/// Sums the parts of some coarse rows.
struct AddParts<'a> {
    all: &'a Galerkin,
    parts: &'a [[f32; 9]],
    rows: Range<usize>,
    values: &'a mut [[f32; 9]],
}

impl Kernel for AddParts<'_> {
    type Output = ();
    #[inline(always)]
    fn run<const W: usize>(self) {
        let Galerkin { upper, part, part_start, .. } = self.all;
        let mut rest = self.values;
        for c in self.rows {
            let (row, after) = rest.split_at_mut(upper.row(c).len());
            rest = after;
            row.fill([0.0; 9]);
            for at in &part[part_start[c] as usize..part_start[c + 1] as usize] {
                for (sum, a) in row.iter_mut().zip(&self.parts[*at as usize..]) {
                    add(sum, 1.0, a);
                }
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

/// `out = Σ weight x` for every row of the interpolation, added to what is there.
pub(super) fn interpolate_add(p: &Weights, x: &[[f32; 4]], out: &mut [[f32; 4]]) {
    out.par_chunks_mut(ROWS).enumerate().for_each(|(c, out)| {
        for (i, out) in out.iter_mut().enumerate() {
            for k in p.row(c * ROWS + i) {
                let (w, x) = (p.weight[k], x[p.column[k] as usize]);
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
            // up to three strips
            let (n, coarse) = (30 + 301 * case, 4 + 3 * case);
            let cells: Vec<[u32; 3]> =
                (0..2 * n as u32).map(|i| [i % n as u32, (i * i + 3) % n as u32, (i * 7 + 1) % n as u32]).collect();
            let pattern = BlockPattern::from_cells(n, cells.iter().map(|c| &c[..]));
            let fine = crate::solver::free::FreePattern::new(
                &pattern,
                &DofConstraints::from_mask((0..n).map(|i| i % 4 == case % 4).collect()),
            )
            .blocks(&pattern);
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
            let mut galerkin = Galerkin::new(&fine, &p);
            galerkin.refresh(&fine, &|i, at| (fine.column[fine.row(i).start + at], block(fine.row(i).start + at)));
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
                        assert!((a - b).abs() < 1e-5 * b.abs().max(100.0), "block {i} {j}: {a} {b}");
                    }
                }
            }
            let missing = |(i, j): (usize, usize)| !there[i][j] && dense[i][j] != [0.0; 9];
            assert!(!(0..p.coarse_count).flat_map(|i| (0..p.coarse_count).map(move |j| (i, j))).any(missing));
        }
    }
}
