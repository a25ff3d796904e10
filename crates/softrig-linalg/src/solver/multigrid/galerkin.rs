//! Galerkin products `A_c = Pᵀ A P` on fixed patterns, streamed.
//!
//! Fine rows are taken strip by strip. A row of `A P` lives in the cache for as long as it takes to add its multiples to the coarse
//! rows it belongs to, from the diagonal on; what is left of these is the mirror image, as systems are symmetric. Each strip adds to
//! coarse rows of its own, which are summed, where a block is asked for, in the order of the strips: any number of threads gives the
//! same bits. Where each contribution lands is found once; a refresh only streams values through it.

use super::frames::{Frames, enter, leave};
use super::interpolation::{Interpolation, Weights};
use super::pattern::Pattern;
use crate::par::Each;
use crate::solver::free::{BlockRows, Blocks};
use crate::solver::sliced::Sliced;
use crate::{Kernel, par, run_wide};
use rayon::prelude::*;

/// Fine rows of a strip: enough that few coarse rows belong to several, few enough that its blocks stay in the cache.
const STRIP: usize = 1024;
/// A strip with more coarse columns ends: tables grow with rows times columns, and nodes may be in no order.
const COLUMNS: usize = 2048;
/// Not a column of the strip, or not a block of the row.
const ABSENT: u16 = u16::MAX;
/// Rows per task.
const ROWS: usize = 128;

/// One coarsening.
#[derive(Debug, Default)]
pub(super) struct Galerkin {
    p: Weights,
    pt: Weights,
    /// Of the coarse nodes: the operator is in these as they were when it was made.
    frames: Frames,
    /// Pattern of the coarse matrix.
    coarse: Pattern,
    /// For every coarse block: its place, or that of its mirror image, in what the row has from the diagonal on, which is what is
    /// computed.
    place: Vec<u16>,
    /// Fine rows strip by strip: strips take them in the order of their nodes, which lie close together, and go through them in the order
    /// of their places in memory.
    order: Vec<u32>,
    strips: Vec<Strip>,
    places: Places,
    /// Blocks of the longest row of `A P`.
    room: usize,
    /// The coarse rows of each strip, after room for one row of `A P`.
    parts: Vec<[f32; 9]>,
    /// For every coarse row: where its parts are.
    part_start: Vec<u32>,
    part: Vec<u32>,
}

/// Where a strip begins in each of the lists.
#[derive(Clone, Copy, Debug, Default)]
struct Strip {
    row: usize,
    gather: usize,
    list: usize,
    entry: usize,
    column: usize,
    table: usize,
    part: usize,
}

/// Where contributions land. Coarse columns of a strip have numbers of their own, ascending, by which tables find the place of a
/// contribution: these stay in the cache.
#[derive(Debug, Default)]
struct Places {
    /// Blocks of each row of `A P`.
    width: Vec<u16>,
    /// Of what is added to a row of `A P`: place in the row.
    gather: Vec<u16>,
    /// Of each block of a row of `A P`: number of its column.
    list: Vec<u16>,
    /// For each weight of a fine row: number of the coarse row.
    number: Vec<u16>,
    /// For each number that is also one of a coarse row: where this begins in the strip's table, and in its part.
    row: Vec<[u32; 2]>,
    /// For each coarse row of a strip and each number from its own on: place in the coarse row.
    table: Vec<u16>,
}

impl Places {
    fn end(&self, row: usize, part: usize) -> Strip {
        let Self { gather, list, number, row: column, table, .. } = self;
        let (gather, list, entry) = (gather.len(), list.len(), number.len());
        Strip { row, gather, list, entry, column: column.len(), table: table.len(), part }
    }

    /// Gives back what growing has taken too much.
    fn shrink(&mut self) {
        let Self { width, gather, list, number, row, table } = self;
        [width, gather, list, number, table].into_iter().for_each(Vec::shrink_to_fit);
        row.shrink_to_fit();
    }
}

impl Galerkin {
    /// `fine` has one row per row of `p`; `matrix` is where its numbers will be.
    pub fn new(fine: &Blocks, matrix: &Sliced<f32>, p: &Interpolation) -> Self {
        Self::in_strips(fine, matrix, p, [STRIP, COLUMNS])
    }

    /// Strips end after so many rows, or coarse columns.
    fn in_strips(fine: &Blocks, matrix: &Sliced<f32>, p: &Interpolation, most: [usize; 2]) -> Self {
        let pt = p.transposed();
        let (ap, coarse) = patterns(fine, p, &pt);
        let upper = coarse.upper();
        let place = coarse.places(&upper);
        let mut order: Vec<u32> = (0..fine.row_count() as u32).collect();
        order.sort_by_key(|row| fine.node[*row as usize]);
        let mut out = Self { p: p.into(), pt: (&pt).into(), coarse, place, order, ..Self::default() };
        out.cut(fine, matrix, &ap, &upper, most);
        out
    }

    /// Makes the strips and finds all places.
    fn cut(
        &mut self,
        fine: &Blocks,
        matrix: &Sliced<f32>,
        ap: &Pattern,
        upper: &Pattern,
        [most_rows, most_columns]: [usize; 2],
    ) {
        let Self { p, order, strips, places, room, .. } = self;
        *room = (0..ap.row_count()).map(|i| ap.row(i).len()).max().unwrap_or(0);
        // coarse row and place in all parts
        let mut part: Vec<(u32, u32)> = Vec::new();
        let mut number = vec![ABSENT; upper.row_count()];
        let mut columns: Vec<u32> = Vec::new();
        let (mut rest, mut row, mut len) = (&mut order[..], 0, 0);
        while !rest.is_empty() {
            let strip = places.end(row, len);
            strips.push(strip);
            columns.clear();
            let mut count = 0;
            while count < rest.len().min(most_rows) && columns.len() <= most_columns {
                for c in ap.columns(rest[count] as usize) {
                    if std::mem::replace(&mut number[*c as usize], 0) == ABSENT {
                        columns.push(*c);
                    }
                }
                count += 1;
            }
            columns.sort_unstable();
            columns.iter().enumerate().for_each(|(n, c)| number[*c as usize] = n as u16);
            let (rows, after) = rest.split_at_mut(count);
            (rest, row) = (after, row + count);
            rows.sort_unstable_by_key(|i| matrix.place(*i as usize));
            let mut is_row = vec![false; columns.len()];
            for i in rows.iter().map(|i| *i as usize) {
                let row = ap.columns(i);
                places.width.push(row.len() as u16);
                places.list.extend(row.iter().map(|c| number[*c as usize]));
                for k in fine.row(i) {
                    let place = |c: &u32| row.binary_search(c).expect("the pattern holds every contribution") as u16;
                    places.gather.extend(p.column[p.row(fine.column[k] as usize)].iter().map(place));
                }
                for c in &p.column[p.row(i)] {
                    places.number.push(number[*c as usize]);
                    is_row[usize::from(number[*c as usize])] = true;
                }
            }
            len += *room;
            for (n, c) in columns.iter().enumerate() {
                let at = [places.table.len() - strip.table, len - *room - strip.part].map(|at| at as u32);
                places.row.push(at);
                if is_row[n] {
                    part.push((*c, len as u32));
                    let coarse = upper.columns(*c as usize);
                    len += coarse.len();
                    let place = |c: &u32| coarse.binary_search(c).map_or(ABSENT, |at| at as u16);
                    places.table.extend(columns[n..].iter().map(place));
                }
            }
            columns.iter().for_each(|c| number[*c as usize] = ABSENT);
        }
        strips.push(places.end(row, len));
        places.shrink();
        self.parts = vec![[0.0; 9]; len];
        // strips stay in their order
        part.sort_by_key(|(c, _)| *c);
        let starts = (0..=upper.row_count() as u32).map(|c| part.partition_point(|(row, _)| *row < c) as u32);
        self.part_start = starts.collect();
        self.part = part.into_iter().map(|(_, at)| at).collect();
    }

    pub fn interpolation(&self) -> &Weights {
        &self.p
    }

    /// Takes other weights on the same entries.
    pub fn set_weights(&mut self, p: &Interpolation) {
        debug_assert_eq!((&p.start, &p.column), (&self.p.start, &self.p.column));
        self.pt = (&p.transposed()).into();
        self.p = p.into();
    }

    /// The coarse pattern, as a system of its own: a row for each of `node`.
    pub fn coarse_pattern(&self, node: Vec<u32>) -> Blocks {
        as_blocks(&self.coarse, node)
    }

    /// Block `k` of the coarse pattern, which is in that row, as the last [`Self::refresh`] made it: the sum of its parts, or its
    /// mirror image.
    #[inline(always)]
    pub fn coarse_block(&self, row: usize, k: usize) -> [f32; 9] {
        let column = self.coarse.column[k] as usize;
        let (first, at) = (row.min(column), usize::from(self.place[k]));
        let mut m = [0.0; 9];
        for part in &self.part[self.part_start[first] as usize..self.part_start[first + 1] as usize] {
            add(&mut m, 1.0, &self.parts[*part as usize + at]);
        }
        if column < row { [m[0], m[3], m[6], m[1], m[4], m[7], m[2], m[5], m[8]] } else { m }
    }

    /// Makes the coarse blocks for the fine ones, which are those of a symmetric matrix.
    pub fn refresh(&mut self, fine: &BlockRows, matrix: &Sliced<f32>) {
        let mut parts = std::mem::take(&mut self.parts);
        let at = |s: usize| self.strips[s].part;
        par::divide(0..self.strips.len() - 1, 1, &at, &mut parts, &|strips, parts| {
            for s in strips {
                run_wide::<f32, _>(FillStrip { all: self, fine, matrix, s, parts: &mut *parts });
            }
        });
        self.parts = parts;
        self.frames.settle();
    }

    /// The fine nodes are turned like this now, as quaternions of any length; or nothing turns.
    pub fn follow(&mut self, fine: Option<&mut [[f32; 4]]>) {
        match fine {
            Some(fine) => self.frames.follow(&self.pt, fine),
            None => self.frames.clear(),
        }
    }

    /// How far frames have turned against each other since the operator was made, see [`Frames::shear`] [rad].
    pub fn shear(&self) -> f64 {
        self.frames.shear(&self.p)
    }

    /// `b = Tᵀ Pᵀ r`.
    pub fn restrict(&self, r: &[[f32; 4]], b: &mut [[f32; 4]]) {
        let (pt, turns) = (&self.pt, self.frames.turns());
        b.par_chunks_mut(ROWS).enumerate().each(|(c, b)| {
            for (i, b) in b.iter_mut().enumerate() {
                let sum = interpolated(pt, c * ROWS + i, r);
                *b = turns.get(c * ROWS + i).map_or(sum, |turn| enter(turn, sum));
            }
        });
    }

    /// Adds `P T x`; leaves `T x` in `x`.
    pub fn interpolate_add(&self, x: &mut [[f32; 4]], fine: &mut [[f32; 4]]) {
        let (p, turns) = (&self.p, self.frames.turns());
        x.par_iter_mut().zip(turns).with_min_len(ROWS).each(|(x, turn)| *x = leave(turn, *x));
        let x = &*x;
        fine.par_chunks_mut(ROWS).enumerate().each(|(c, fine)| {
            for (i, out) in fine.iter_mut().enumerate() {
                let sum = interpolated(p, c * ROWS + i, x);
                (0..4).for_each(|j| out[j] += sum[j]);
            }
        });
    }
}

/// Patterns of `A P` and of `Pᵀ A P`.
fn patterns(fine: &Blocks, p: &Interpolation, pt: &Interpolation) -> (Pattern, Pattern) {
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
    (ap, coarse)
}

fn as_blocks(pattern: &Pattern, node: Vec<u32>) -> Blocks {
    let Pattern { start, column } = pattern;
    let diagonal = (0..pattern.row_count())
        .map(|i| {
            let at = pattern.columns(i).binary_search(&(i as u32));
            start[i] + at.expect("a coarse node sees itself through any fine node it interpolates") as u32
        })
        .collect();
    let rows = BlockRows { node, row_start: start.clone(), diagonal };
    Blocks { rows: rows.into(), column: column.clone() }
}

/// The coarse pattern before anyone has made the product: what an order of the coarse rows is found from.
pub(super) fn coarse_pattern(fine: &Blocks, p: &Interpolation, node: Vec<u32>) -> Blocks {
    as_blocks(&patterns(fine, p, &p.transposed()).1, node)
}

/// What the rows of a strip add to coarse rows.
struct FillStrip<'a> {
    all: &'a Galerkin,
    fine: &'a BlockRows,
    matrix: &'a Sliced<f32>,
    s: usize,
    parts: &'a mut [[f32; 9]],
}

impl Kernel for FillStrip<'_> {
    type Output = ();
    #[inline(always)]
    fn run<const W: usize>(self) {
        let Galerkin { p, order, places, strips, .. } = self.all;
        let (strip, end) = (strips[self.s], strips[self.s + 1]);
        let coarse_row = &places.row[strip.column..end.column];
        let table = &places.table[strip.table..end.table];
        let mut gather = places.gather[strip.gather..end.gather].iter();
        let mut entries = places.number[strip.entry..end.entry].iter();
        let (row, parts) = self.parts.split_at_mut(self.all.room);
        parts.fill([0.0; 9]);
        let mut lists = &places.list[strip.list..end.list];
        for (i, width) in order[strip.row..end.row].iter().zip(&places.width[strip.row..]) {
            let (list, after) = lists.split_at(*width as usize);
            lists = after;
            let i = *i as usize;
            let row = &mut row[..list.len()];
            row.fill([0.0; 9]);
            for (column, a) in self.matrix.blocks(i).take(self.fine.row(i).len()) {
                for (w, at) in p.weight[p.row(column as usize)].iter().zip(&mut gather) {
                    add(&mut row[*at as usize], *w, &a);
                }
            }
            for (w, number) in p.weight[p.row(i)].iter().zip(&mut entries) {
                let [table_start, part] = coarse_row[usize::from(*number)];
                let (places, part) = (&table[table_start as usize..], &mut parts[part as usize..]);
                let tail = list.partition_point(|c| c < number);
                for (a, c) in row[tail..].iter().zip(&list[tail..]) {
                    add(&mut part[usize::from(places[usize::from(*c - number)])], *w, a);
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

/// `Σ weight x` of a row.
#[inline(always)]
fn interpolated(p: &Weights, row: usize, x: &[[f32; 4]]) -> [f32; 4] {
    let row = p.row(row);
    // two sums: one addition need not wait for the last one
    let mut sums = [[0.0; 4]; 2];
    for (k, (w, column)) in p.weight[row.clone()].iter().zip(&p.column[row]).enumerate() {
        let x = x[*column as usize];
        (0..4).for_each(|j| sums[k % 2][j] += w * x[j]);
    }
    std::array::from_fn(|j| sums[0][j] + sums[1][j])
}

#[cfg(test)]
mod tests;
