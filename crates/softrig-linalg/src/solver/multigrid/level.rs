//! One level of the hierarchy: its matrix in f32, stored or as cubes, and the smoothers.

use super::colour::by_colour;
use super::products::{Advance, Again, Matrix, Product, Reduce, Relax, Start};
use super::settings::Smoother;
use crate::par::Each;
use crate::solver::cubes::FreeCubes;
use crate::solver::free::{BlockRows, Blocks, FreePattern};
use crate::solver::pcg::kernel::Inverse;
use crate::solver::quads::Quads;
use crate::solver::sliced::{Fault, ROWS, Sliced, sort_rows};
use crate::{CubeMatrix, Rows, Scalar, run_wide};
use rayon::prelude::*;
use std::borrow::Borrow;
use std::ops::Range;
use std::sync::Arc;

/// Chunks per task: fewer are not worth a second thread.
const CHUNKS: usize = 4;
/// The power iteration finds the largest eigenvalue from below.
const SAFETY: f32 = 1.1;
/// Power iterations from nothing, and from where those of the last matrix ended: turning the cells changes little.
const POWER_STEPS: [usize; 2] = [15, 3];

#[derive(Debug)]
pub(super) struct Level {
    pub pattern: Arc<BlockRows>,
    smoother: Smoother,
    /// As [`order_for`] gives them; one range of all rows where nobody asks for colours.
    colours: Vec<u32>,
    matrix: Sliced<f32>,
    /// Present once a matrix of cubes has come.
    cubes: Option<FreeCubes<f32>>,
    /// Products take the cubes.
    by_cubes: bool,
    inverse: Vec<Inverse<f32>>,
    identity: Vec<bool>,
    /// Largest eigenvalue of `D⁻¹ A`, with safety.
    largest: f32,
    /// Where the last power iteration ended; empty when there was none.
    eigenvector: Vec<[f32; 4]>,
    partial: Vec<f64>,
    /// Right-hand side, solution, residual, and two directions.
    pub b: Quads<f32>,
    pub x: Quads<f32>,
    pub r: Quads<f32>,
    d: Quads<f32>,
    e: Quads<f32>,
}

/// An order for the rows of a level, and the first row of each colour and one past the last, where its smoother wants one: only then the
/// pattern is made. Rows of a colour are as far apart in space as colours are many: there they lie as the matrix takes them. Other rows
/// stay neighbours of their neighbours.
pub(super) fn order_for<P: Borrow<Blocks>>(
    smoother: Smoother,
    pattern: impl FnOnce() -> P,
) -> Option<(Vec<u32>, Vec<u32>)> {
    let Smoother::GaussSeidel { .. } = smoother else { return None };
    let pattern = pattern();
    let pattern = pattern.borrow();
    let (mut order, colours) = by_colour(pattern);
    sort_rows(pattern, &colours, &mut order);
    Some((order, colours))
}

impl Level {
    /// `colours` as [`order_for`] gave them for the pattern; the rows of the pattern are in that order.
    pub fn new(pattern: &Blocks, smoother: Smoother, colours: Option<Vec<u32>>) -> Self {
        let n = pattern.row_count();
        let colours = colours.unwrap_or_else(|| vec![0, n as u32]);
        Self {
            smoother,
            matrix: Sliced::new(pattern, &colours),
            colours,
            cubes: None,
            by_cubes: false,
            inverse: vec![[[0.0; 4]; 3]; n],
            identity: vec![false; n],
            largest: 1.0,
            eigenvector: Vec::with_capacity(n),
            partial: vec![0.0; n.div_ceil(ROWS)],
            b: Quads::zero(n),
            x: Quads::zero(n),
            r: Quads::zero(n),
            d: Quads::zero(n),
            e: Quads::zero(n),
            pattern: pattern.rows.clone(),
        }
    }

    /// Takes the blocks of the pattern, by row and place; from now on products take these.
    pub fn load(&mut self, block_of: &(impl Fn(usize, usize) -> [f32; 9] + Sync)) -> Result<(), Fault> {
        self.by_cubes = false;
        self.matrix.load_blocks(&self.pattern, block_of, &mut self.inverse, &mut self.identity)
    }

    /// Takes the rows of the whole system, whose free part is `free`; from now on products take these.
    pub fn load_rows<R: Scalar>(&mut self, free: &FreePattern, rows: &dyn Rows<R>) -> Result<(), Fault> {
        self.by_cubes = false;
        self.matrix.load(free, rows, &mut self.inverse, &mut self.identity)
    }

    /// The nodes of the rows, and room for four numbers at each, in which nothing lasts.
    pub fn scratch(&mut self) -> (&[u32], &mut [[f32; 4]]) {
        (&self.pattern.node, self.d.get_mut())
    }

    /// The blocks, as they were loaded last.
    pub fn matrix(&self) -> &Sliced<f32> {
        &self.matrix
    }

    /// Makes products take these cubes; `free` is the pattern.
    pub fn load_cubes<R: Scalar>(&mut self, matrix: &CubeMatrix<R>, free: &FreePattern) {
        self.by_cubes = true;
        let made = self.cubes.take().filter(|c| c.belongs_to(&matrix.pattern));
        let cubes = self.cubes.insert(made.unwrap_or_else(|| FreeCubes::new(&matrix.pattern, free)));
        cubes.load(matrix, free);
        cubes.invert_diagonal(&mut self.inverse);
    }

    /// What a product and what is done with it read and write [bytes].
    pub fn bytes(&self) -> usize {
        let matrix = match &self.cubes {
            Some(cubes) if self.by_cubes => cubes.bytes(),
            _ => self.matrix.bytes(),
        };
        // the vector, the inverse, three that are read and written
        matrix + (16 + 48 + 6 * 16) * self.pattern.row_count()
    }

    /// Rows without a single entry.
    pub fn identity(&self) -> &[bool] {
        &self.identity
    }

    /// `q = A p`; returns `pᵀ q`.
    pub fn product_dot(&mut self, p: &Quads<f32>, q: &mut Quads<f32>) -> f64 {
        let matrix = multiplier(&self.matrix, &mut self.cubes, self.by_cubes, p);
        let mut sum = 0.0;
        for (chunks, rows) in colour_chunks(&self.colours) {
            let partial = &mut self.partial[..chunks.len()];
            let vectors = (q.get_mut()[rows.clone()].par_chunks_mut(ROWS), p.get()[rows].par_chunks(ROWS));
            let all = (vectors.0, vectors.1, partial.par_iter_mut()).into_par_iter().enumerate();
            all.with_min_len(CHUNKS).each(|(c, (y, own, partial))| {
                *partial = run_wide::<f32, _>(Product { matrix, chunk: chunks.start + c, x: p.padded(), own, y });
            });
            sum += self.partial[..chunks.len()].iter().sum::<f64>();
        }
        sum
    }

    /// Estimates the largest eigenvalue of `D⁻¹ A`, where the smoother needs it.
    pub fn estimate_spectrum(&mut self) {
        if matches!(self.smoother, Smoother::GaussSeidel { .. }) {
            return;
        }
        let known = !self.eigenvector.is_empty();
        if known {
            self.d.get_mut().copy_from_slice(&self.eigenvector);
        } else {
            // a start that is no eigenvector of anything regular, and the same everywhere
            for (i, d) in self.d.get_mut().iter_mut().enumerate() {
                let h = (i as u32).wrapping_mul(2_654_435_761) >> 8;
                let v = |k: u32| ((h.wrapping_mul(k) >> 4) & 1023) as f32 / 512.0 - 1.0;
                *d = [v(3), v(5), v(7), 0.0];
            }
        }
        let mut largest = 1.0f64;
        for _ in 0..POWER_STEPS[usize::from(known)] {
            let norm = square(self.d.get()).sqrt();
            if !(norm > 0.0 && norm.is_finite()) {
                break;
            }
            let scale = (1.0 / norm) as f32;
            self.d.get_mut().iter_mut().for_each(|d| *d = d.map(|v| v * scale));
            self.r.get_mut().fill([0.0; 4]);
            self.reduce();
            for ((d, r), inverse) in self.d.get_mut().iter_mut().zip(self.r.get()).zip(&self.inverse) {
                *d = std::array::from_fn(|k| (inverse[0][k] * r[0] + inverse[1][k] * r[1]) + inverse[2][k] * r[2]);
            }
            largest = square(self.d.get()).sqrt();
        }
        let good = largest.is_finite() && largest > 0.0;
        self.largest = if good { SAFETY * largest as f32 } else { 2.0 };
        self.eigenvector.clear();
        if good {
            self.eigenvector.extend_from_slice(self.d.get());
        }
    }

    /// Other rows of the pattern are held from now on.
    pub fn hold(&mut self) {
        self.cubes = None;
    }

    /// Drops what it knows of earlier matrices.
    pub fn forget(&mut self) {
        self.eigenvector.clear();
    }

    /// Smoothing of `A x = b` from `x = 0`; leaves the residual in `r`.
    pub fn smooth_from_zero(&mut self) {
        match self.smoother {
            Smoother::Chebyshev { degree, ratio } => {
                let (theta, delta) = self.interval(ratio);
                self.start(1.0 / theta);
                self.advance(degree, theta, delta, false);
                self.reduce();
            }
            Smoother::GaussSeidel { before, .. } => {
                self.x.get_mut().fill([0.0; 4]);
                (0..before.max(1)).for_each(|_| self.sweep(false));
                self.again(0.0);
            }
        }
    }

    /// Smoothing of `A x = b` from the present `x`; the residual is not kept.
    pub fn smooth(&mut self) {
        match self.smoother {
            Smoother::Chebyshev { degree, ratio } => {
                let (theta, delta) = self.interval(ratio);
                self.again(1.0 / theta);
                self.advance(degree, theta, delta, true);
            }
            Smoother::GaussSeidel { after, .. } => (0..after).for_each(|_| self.sweep(true)),
        }
    }

    /// Middle and half width of the part of the spectrum that is smoothed.
    fn interval(&self, ratio: f32) -> (f32, f32) {
        let (upper, lower) = (self.largest, self.largest / ratio.max(1.0 + 1e-3));
        (0.5 * (upper + lower), 0.5 * (upper - lower))
    }

    fn start(&mut self, gain: f32) {
        let vectors = (self.r.get_mut(), self.d.get_mut(), self.x.get_mut());
        let (r, d, x) =
            (vectors.0.par_chunks_mut(ROWS), vectors.1.par_chunks_mut(ROWS), vectors.2.par_chunks_mut(ROWS));
        let (b, inverse) = (self.b.get().par_chunks(ROWS), self.inverse.par_chunks(ROWS));
        let all = (r, d, x, b, inverse).into_par_iter().with_min_len(CHUNKS);
        all.each(|(r, d, x, b, inverse)| run_wide::<f32, _>(Start { gain, inverse, b, r, d, x }));
    }

    /// `r = b - A x`, `d = gain D⁻¹ r`; `x` lags behind by `d`.
    fn again(&mut self, gain: f32) {
        let matrix = multiplier(&self.matrix, &mut self.cubes, self.by_cubes, &self.x);
        let x = self.x.padded();
        for (chunks, rows) in colour_chunks(&self.colours) {
            let vectors = (&mut self.r.get_mut()[rows.clone()], &mut self.d.get_mut()[rows.clone()]);
            let (r, d) = (vectors.0.par_chunks_mut(ROWS), vectors.1.par_chunks_mut(ROWS));
            let (b, inverse) = (self.b.get()[rows.clone()].par_chunks(ROWS), self.inverse[rows].par_chunks(ROWS));
            let all = (r, d, b, inverse).into_par_iter().enumerate().with_min_len(CHUNKS);
            all.each(|(c, (r, d, b, inverse))| {
                run_wide::<f32, _>(Again { matrix, chunk: chunks.start + c, gain, x, inverse, b, r, d });
            });
        }
    }

    /// The rest of the three-term recurrence [Saad2003 alg. 12.1] after its first step `d`, preconditioned by the diagonal
    /// blocks. `late`: `x` still lacks that first step.
    fn advance(&mut self, degree: usize, theta: f32, delta: f32, late: bool) {
        if degree <= 1 && late {
            for (x, d) in self.x.get_mut().iter_mut().zip(self.d.get()) {
                *x = std::array::from_fn(|k| x[k] + d[k]);
            }
        }
        let sigma = theta / delta;
        let mut rho = 1.0 / sigma;
        for step in 1..degree {
            let next = 1.0 / (2.0 * sigma - rho);
            let (keep, gain, late) = (next * rho, 2.0 * next / delta, late && step == 1);
            let matrix = multiplier(&self.matrix, &mut self.cubes, self.by_cubes, &self.d);
            let (d, own) = (self.d.padded(), self.d.get().par_chunks(ROWS));
            let (r, e) = (self.r.get_mut().par_chunks_mut(ROWS), self.e.get_mut().par_chunks_mut(ROWS));
            let (x, inverse) = (self.x.get_mut().par_chunks_mut(ROWS), self.inverse.par_chunks(ROWS));
            let all = (own, r, e, x, inverse).into_par_iter().enumerate().with_min_len(CHUNKS);
            all.each(|(chunk, (own, r, e, x, inverse))| {
                run_wide::<f32, _>(Advance { matrix, chunk, keep, gain, late, d, own, inverse, r, e, x });
            });
            std::mem::swap(&mut self.d, &mut self.e);
            rho = next;
        }
    }

    /// `r -= A d`.
    fn reduce(&mut self) {
        let matrix = multiplier(&self.matrix, &mut self.cubes, self.by_cubes, &self.d);
        let d = self.d.padded();
        let all = self.r.get_mut().par_chunks_mut(ROWS).enumerate().with_min_len(CHUNKS);
        all.each(|(chunk, r)| run_wide::<f32, _>(Reduce { matrix, chunk, d, r }));
    }

    /// One sweep of Gauss-Seidel.
    fn sweep(&mut self, backwards: bool) {
        let count = self.colours.len() - 1;
        for k in 0..count {
            let colour = if backwards { count - 1 - k } else { k };
            let Some((chunks, rows)) = colour_chunks(&self.colours).nth(colour) else { continue };
            let matrix = multiplier(&self.matrix, &mut self.cubes, self.by_cubes, &self.x);
            let (x, y) = (self.x.padded(), self.e.get_mut()[rows.clone()].par_chunks_mut(ROWS));
            let own = self.x.get()[rows.clone()].par_chunks(ROWS);
            let (b, inverse) =
                (self.b.get()[rows.clone()].par_chunks(ROWS), self.inverse[rows.clone()].par_chunks(ROWS));
            // a colour has few chunks: each may go to another thread
            let all = (own, y, b, inverse).into_par_iter().enumerate();
            all.each(|(c, (own, y, b, inverse))| {
                run_wide::<f32, _>(Relax { matrix, chunk: chunks.start + c, x, own, inverse, b, y });
            });
            self.x.get_mut()[rows.clone()].copy_from_slice(&self.e.get()[rows]);
        }
    }
}

/// Chunks and rows of every colour.
fn colour_chunks(colours: &[u32]) -> impl Iterator<Item = (Range<usize>, Range<usize>)> + '_ {
    let mut first = 0;
    colours.windows(2).map(move |c| {
        let rows = c[0] as usize..c[1] as usize;
        let chunks = first..first + rows.len().div_ceil(ROWS);
        first = chunks.end;
        (chunks, rows)
    })
}

/// What multiplies, ready for `x`.
fn multiplier<'a>(
    stored: &'a Sliced<f32>,
    cubes: &'a mut Option<FreeCubes<f32>>,
    by_cubes: bool,
    x: &Quads<f32>,
) -> Matrix<'a> {
    match cubes {
        Some(cubes) if by_cubes => {
            cubes.corner_forces(x.padded());
            Matrix::Cubes(cubes)
        }
        _ => Matrix::Stored(stored),
    }
}

fn square(v: &[[f32; 4]]) -> f64 {
    crate::par::sum(v.len(), |range| v[range].iter().flatten().map(|v| f64::from(*v) * f64::from(*v)).sum())
}
