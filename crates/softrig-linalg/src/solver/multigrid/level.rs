//! One level of the hierarchy: its matrix in f32, stored or as cubes, and a Chebyshev smoother.

use crate::solver::cubes::{self, FreeCubes};
use crate::solver::free::FreePattern;
use crate::solver::pcg::kernel::{Blocks, Inverse, Product, inverse_of_block};
use crate::solver::quads::Quads;
use crate::{CubeMatrix, Kernel, Lane, Scalar, Wide, run_wide};
use rayon::prelude::*;
use std::any::Any;

/// Rows per task: coarse levels are not worth a second thread.
const ROWS: usize = 512;
/// Products per smoothing. Degree 3 needs the fewest products per digit on lattices with bones (numerics 5.6).
const DEGREE: usize = 3;
/// Smoothed part of the spectrum: from the largest eigenvalue down by this ratio.
const RATIO: f32 = 10.0;
/// The power iteration finds the largest eigenvalue from below.
const SAFETY: f32 = 1.1;
/// Power iterations.
const POWER_STEPS: usize = 15;

#[derive(Debug)]
pub(super) struct Level {
    pub pattern: FreePattern,
    pub values: Blocks<f32>,
    /// Present where products take the cubes instead of the values.
    cubes: Option<FreeCubes<f32>>,
    /// Products take the values even so.
    stored: bool,
    inverse: Vec<Inverse<f32>>,
    /// Largest eigenvalue of `D⁻¹ A`, with safety.
    largest: f32,
    /// Right-hand side, solution, residual, direction, product.
    pub b: Quads<f32>,
    pub x: Quads<f32>,
    pub r: Quads<f32>,
    d: Quads<f32>,
    q: Quads<f32>,
}

impl Level {
    pub fn new(pattern: FreePattern) -> Self {
        let n = pattern.row_count();
        Self {
            values: Blocks::zero(pattern.block_count()),
            cubes: None,
            stored: true,
            inverse: vec![[[0.0; 4]; 3]; n],
            largest: 1.0,
            b: Quads::zero(n),
            x: Quads::zero(n),
            r: Quads::zero(n),
            d: Quads::zero(n),
            q: Quads::zero(n),
            pattern,
        }
    }

    /// The blocks, nine numbers each.
    pub fn blocks(&self) -> &[[f32; 9]] {
        self.values.0[..9 * self.pattern.block_count()].as_chunks().0
    }

    /// The same, to be written.
    pub fn blocks_mut(&mut self) -> &mut [[f32; 9]] {
        let used = 9 * self.pattern.block_count();
        self.values.0[..used].as_chunks_mut().0
    }

    /// Blocks, nine numbers each, and inverted diagonal blocks, to be filled.
    pub fn parts_mut(&mut self) -> (&mut [f32], &mut [Inverse<f32>]) {
        let used = 9 * self.pattern.block_count();
        (&mut self.values.0[..used], &mut self.inverse)
    }

    /// `q = A p`; writes the first of each `partial`: `pᵀ q` over a chunk of [`cubes::ROWS`] rows.
    pub fn product_dot<A: Scalar>(&mut self, p: &Quads<A>, q: &mut Quads<A>, partial: &mut [[f64; 2]]) {
        let own: (&dyn Any, &mut dyn Any) = (p, q);
        if let (Some(p), Some(q)) = (own.0.downcast_ref::<Quads<f32>>(), own.1.downcast_mut::<Quads<f32>>()) {
            if let Some(cubes) = self.cubes.as_mut().filter(|_| !self.stored) {
                cubes.product_dot(p.padded(), q.get_mut(), partial);
                return;
            }
            let (pattern, values, x) = (&self.pattern, &self.values, p.get());
            let rows = q.get_mut().par_chunks_mut(cubes::ROWS).zip(partial).enumerate();
            rows.for_each(|(c, (y, partial))| {
                partial[0] = run_wide::<f32, _>(Product { pattern, values, x, first: c * cubes::ROWS, y });
            });
            return;
        }
        // other numbers are converted: nobody who cares for speed comes here
        for (d, p) in self.d.get_mut().iter_mut().zip(p.get()) {
            *d = p.map(|v| v.to_f64() as f32);
        }
        self.product(false);
        for (q, own) in q.get_mut().iter_mut().zip(self.q.get()) {
            *q = own.map(|v| A::from_f64(f64::from(v)));
        }
        for (c, partial) in partial.iter_mut().enumerate() {
            let rows = c * cubes::ROWS..((c + 1) * cubes::ROWS).min(p.get().len());
            let dot = |i: usize| (0..3).map(|k| p.get()[i][k].to_f64() * q.get()[i][k].to_f64()).sum::<f64>();
            partial[0] = rows.map(dot).sum();
        }
    }

    /// Makes products take these cubes; `None` goes back to the values.
    pub fn set_cubes<R: Scalar>(&mut self, matrix: Option<&CubeMatrix<R>>) {
        self.stored = matrix.is_none();
        let Some(matrix) = matrix else { return };
        if !self.cubes.as_ref().is_some_and(|c| c.belongs_to(&matrix.pattern)) {
            self.cubes = Some(FreeCubes::new(&matrix.pattern, &self.pattern));
        }
        if let Some(cubes) = &mut self.cubes {
            cubes.load(matrix, &self.pattern);
            cubes.invert_diagonal(&mut self.inverse);
        }
    }

    /// Inverts the diagonal blocks; a block that has no inverse is left out of the smoothing.
    pub fn invert_diagonal(&mut self) {
        let (pattern, blocks) = (&self.pattern, self.values.0[..9 * self.pattern.block_count()].as_chunks::<9>().0);
        self.inverse.par_iter_mut().enumerate().for_each(|(i, inverse)| {
            let block = blocks[pattern.diagonal[i] as usize].map(f64::from);
            *inverse = inverse_of_block(block).unwrap_or_default();
        });
    }

    /// Estimates the largest eigenvalue of `D⁻¹ A`.
    pub fn estimate_spectrum(&mut self) {
        // a start that is no eigenvector of anything regular, and the same everywhere
        for (i, d) in self.d.get_mut().iter_mut().enumerate() {
            let h = (i as u32).wrapping_mul(2_654_435_761) >> 8;
            let v = |k: u32| ((h.wrapping_mul(k) >> 4) & 1023) as f32 / 512.0 - 1.0;
            *d = [v(3), v(5), v(7), 0.0];
        }
        let mut largest = 1.0f64;
        for _ in 0..POWER_STEPS {
            let norm = square(self.d.get()).sqrt();
            if !(norm > 0.0 && norm.is_finite()) {
                break;
            }
            let scale = (1.0 / norm) as f32;
            self.d.get_mut().iter_mut().for_each(|d| *d = d.map(|v| v * scale));
            self.product(false);
            for ((d, q), inverse) in self.d.get_mut().iter_mut().zip(self.q.get()).zip(&self.inverse) {
                *d = apply(inverse, q);
            }
            largest = square(self.d.get()).sqrt();
        }
        self.largest = if largest.is_finite() && largest > 0.0 { SAFETY * largest as f32 } else { 2.0 };
    }

    /// Chebyshev smoothing of `A x = b` from `x = 0`; leaves the residual in `r`.
    pub fn smooth_from_zero(&mut self) {
        self.r.get_mut().copy_from_slice(self.b.get());
        self.x.get_mut().fill([0.0; 4]);
        self.chebyshev(true);
    }

    /// Chebyshev smoothing of `A x = b` from the present `x`; the residual is not kept.
    pub fn smooth(&mut self) {
        self.product(true);
        let (q, b) = (self.q.get(), self.b.get());
        self.r.get_mut().par_chunks_mut(ROWS).zip(q.par_chunks(ROWS).zip(b.par_chunks(ROWS))).for_each(
            |(r, (q, b))| {
                for ((r, q), b) in r.iter_mut().zip(q).zip(b) {
                    *r = std::array::from_fn(|k| b[k] - q[k]);
                }
            },
        );
        self.chebyshev(false);
    }

    /// The three-term recurrence on `r` [Saad2003 alg. 12.1], preconditioned by the diagonal blocks.
    fn chebyshev(&mut self, keep_residual: bool) {
        let (upper, lower) = (self.largest, self.largest / RATIO);
        let (theta, delta) = (0.5 * (upper + lower), 0.5 * (upper - lower));
        let sigma = theta / delta;
        let mut rho = 1.0 / sigma;
        self.advance(0.0, 1.0 / theta);
        for _ in 1..DEGREE {
            self.reduce_residual();
            let next = 1.0 / (2.0 * sigma - rho);
            self.advance(next * rho, 2.0 * next / delta);
            rho = next;
        }
        if keep_residual {
            self.reduce_residual();
        }
    }

    /// `d = keep d + gain D⁻¹ r; x += d`.
    fn advance(&mut self, keep: f32, gain: f32) {
        let (d, x) = (self.d.get_mut(), self.x.get_mut());
        (d.par_chunks_mut(ROWS), x.par_chunks_mut(ROWS))
            .into_par_iter()
            .zip((self.r.get().par_chunks(ROWS), self.inverse.par_chunks(ROWS)))
            .for_each(|((d, x), (r, inverse))| run_wide::<f32, _>(Advance { keep, gain, d, x, r, inverse }));
    }

    /// `q = A x` or `q = A d`.
    fn product(&mut self, of_solution: bool) {
        let x = if of_solution { &self.x } else { &self.d };
        if let Some(cubes) = self.cubes.as_mut().filter(|_| !self.stored) {
            cubes.product(x.padded(), self.q.get_mut());
            return;
        }
        let (pattern, values, x) = (&self.pattern, &self.values, x.get());
        self.q.get_mut().par_chunks_mut(ROWS).enumerate().for_each(|(c, y)| {
            run_wide::<f32, _>(Product { pattern, values, x, first: c * ROWS, y });
        });
    }

    /// `r -= A d`.
    fn reduce_residual(&mut self) {
        if let Some(cubes) = self.cubes.as_mut().filter(|_| !self.stored) {
            cubes.subtract_product(self.d.padded(), self.r.get_mut());
            return;
        }
        self.product(false);
        let q = self.q.get();
        self.r.get_mut().par_chunks_mut(ROWS).zip(q.par_chunks(ROWS)).for_each(|(r, q)| {
            for (r, q) in r.iter_mut().zip(q) {
                *r = std::array::from_fn(|k| r[k] - q[k]);
            }
        });
    }
}

/// The loop of [`Level::advance`], a node's four numbers side by side.
struct Advance<'a> {
    keep: f32,
    gain: f32,
    d: &'a mut [[f32; 4]],
    x: &'a mut [[f32; 4]],
    r: &'a [[f32; 4]],
    inverse: &'a [Inverse<f32>],
}

impl Kernel for Advance<'_> {
    type Output = ();
    #[inline(always)]
    fn run<const W: usize>(self) {
        let n = self.d.len();
        let (d, x, r, inverse) = (self.d, &mut self.x[..n], &self.r[..n], &self.inverse[..n]);
        // the first direction keeps nothing: the old one may hold anything, even NaN
        let fresh = self.keep == 0.0;
        let (keep, gain) = (Wide::<f32, 4>::splat(self.keep), Wide::<f32, 4>::splat(self.gain));
        for i in 0..n {
            let (v, m) = (r[i], &inverse[i]);
            let z = (Wide(m[0]) * Wide::splat(v[0]) + Wide(m[1]) * Wide::splat(v[1])) + Wide(m[2]) * Wide::splat(v[2]);
            let old = if fresh { Wide::splat(0.0) } else { keep * Wide(d[i]) };
            let next = old + gain * z;
            d[i] = next.0;
            x[i] = (Wide(x[i]) + next).0;
        }
    }
}

#[inline(always)]
fn apply(inverse: &Inverse<f32>, v: &[f32; 4]) -> [f32; 4] {
    std::array::from_fn(|k| (inverse[0][k] * v[0] + inverse[1][k] * v[1]) + inverse[2][k] * v[2])
}

fn square(v: &[[f32; 4]]) -> f64 {
    crate::par::sum(v.len(), |range| v[range].iter().flatten().map(|v| f64::from(*v) * f64::from(*v)).sum())
}
