//! Conjugate gradients in numbers of one type, preconditioned by the inverted diagonal blocks or by a multigrid cycle.
//!
//! Per iteration one product `q = A p` (with `pᵀ q`), one pass `x += α p, r -= α q, z = D r` (with `rᵀ z`, `rᵀ r`) and one pass
//! `p = z + β p`. The free blocks are copied once per solve, nine numbers side by side, so that the loops never meet a
//! constrained node.
//!
//! Where the system has a guess, the first pass starts from the multiple of it that leaves the smallest residual: one product more.
//!
//! The recursive residual `r` only decides when to look: what counts is `|b - A x| / |b|` of the rounded solution, computed in
//! f64 from the caller's matrix. When it is larger than asked for, the iteration starts again from that residual and adds to
//! the solution, so that an iteration in f32 reaches the digits of f64.

use super::kernel::{Direction, Inverse, Product, Update, dots};
use super::load::{Asked, CubeProducts};
use crate::par::Each;
use crate::solver::cubes;
use crate::solver::free::FreePattern;
use crate::solver::multigrid::Cycle;
use crate::solver::quads::Quads;
use crate::solver::residual::{Squares, Target};
use crate::solver::sliced::Sliced;
use crate::solver::{SolveError, SolveReport, Traffic};
use crate::{BlockPattern, Scalar, par, run_wide};
use rayon::prelude::*;
use std::any::Any;
use std::sync::Arc;

/// Rows per chunk: the unit of work of a thread and of the order of summation.
const ROWS: usize = cubes::ROWS;

/// The recursive residual of a pass is believed down to this many roundings of its start.
const BELIEVED: f64 = 50.0;

/// The iteration and its vectors. Bitwise equal results for any thread count and machine.
#[derive(Debug)]
pub(in crate::solver) struct Iteration<R> {
    /// Gives up with [`SolveError::NotConverged`] after so many iterations.
    pub iteration_limit: usize,
    prepared: Option<Arc<BlockPattern>>,
    pub(super) pattern: Arc<FreePattern>,
    /// Made when the first stored matrix comes.
    pub(super) values: Option<Sliced<R>>,
    /// Present where products take the cubes instead of the values.
    pub(super) cubes: Option<Box<CubeProducts<R>>>,
    /// Made when someone wants it.
    pub(super) inverse: Vec<Inverse<R>>,
    /// Free rows without a single entry: treated as rows of the identity.
    pub(super) identity: Vec<bool>,
    pub(super) x: Quads<R>,
    pub(super) r: Quads<R>,
    z: Quads<R>,
    p: Quads<R>,
    q: Quads<R>,
    partial: Vec<[f64; 2]>,
    /// The solution so far, rounded to the caller's numbers.
    pub(super) candidate: Quads<f64>,
    squares: Squares,
}

impl<R: Scalar> Iteration<R> {
    /// Prepared for nothing.
    pub fn new(iteration_limit: usize) -> Self {
        Self {
            iteration_limit,
            prepared: None,
            pattern: Arc::default(),
            values: None,
            cubes: None,
            inverse: Vec::new(),
            identity: Vec::new(),
            x: Quads::zero(0),
            r: Quads::zero(0),
            z: Quads::zero(0),
            p: Quads::zero(0),
            q: Quads::zero(0),
            partial: Vec::new(),
            candidate: Quads::zero(0),
            squares: Squares::default(),
        }
    }

    /// `q = A p`; returns `pᵀ q`.
    fn product(&mut self) -> f64 {
        if let Some(own) = self.cubes.as_mut().and_then(|c| c.own.as_mut()) {
            own.product_dot(self.p.padded(), self.q.get_mut(), &mut self.partial);
        } else if let Some(matrix) = &self.values {
            let x = self.p.get();
            let rows = (self.q.get_mut().par_chunks_mut(ROWS), x.par_chunks(ROWS), &mut self.partial);
            rows.into_par_iter().enumerate().each(|(chunk, (y, own, partial))| {
                partial[0] = run_wide::<R, _>(Product { matrix, chunk, x, own, y });
            });
        }
        self.partial.iter().map(|p| p[0]).sum()
    }

    /// As `product`, by the finest level of the cycle, for an iteration in f32.
    fn product_by(&mut self, cycle: &mut Cycle) -> f64 {
        let own: (&dyn Any, &mut dyn Any) = (&self.p, &mut self.q);
        match (own.0.downcast_ref(), own.1.downcast_mut()) {
            (Some(p), Some(q)) => cycle.product_dot(p, q),
            _ => unreachable!("only the f32 iteration asks the cycle for products"),
        }
    }

    /// `x += alpha p; r -= alpha q; z = D r`; returns `(rᵀ z, rᵀ r)`. Not `jacobi`: no `z`.
    fn update(&mut self, alpha: R, jacobi: bool) -> (f64, f64) {
        let inverse = if jacobi { &self.inverse[..] } else { &[] };
        let (x, r, z) = (self.x.get_mut(), self.r.get_mut(), self.z.get_mut());
        (x.par_chunks_mut(ROWS), r.par_chunks_mut(ROWS), z.par_chunks_mut(ROWS), &mut self.partial)
            .into_par_iter()
            .zip((self.p.get().par_chunks(ROWS), self.q.get().par_chunks(ROWS)))
            .enumerate()
            .each(|(c, ((x, r, z, partial), (p, q)))| {
                let inverse = par::chunk(inverse, c, ROWS);
                *partial = run_wide::<R, _>(Update { alpha, p, q, inverse, x, r, z });
            });
        self.partial.iter().fold((0.0, 0.0), |sum, p| (sum.0 + p[0], sum.1 + p[1]))
    }

    /// `z = V r` instead of `D r`; returns `(rᵀ z, zᵀ q)`.
    fn precondition(&mut self, cycle: &mut Cycle) -> (f64, f64) {
        cycle.apply(self.r.get(), self.z.get_mut());
        dots(self.z.get(), [self.r.get(), self.q.get()], &mut self.partial)
    }

    /// The guess as the first direction: `p` and `q = A p`. Returns its best multiple, which makes `r - alpha q` smallest; zero, with
    /// nothing in `p` and `q`, where there is no good one.
    fn lead<B: Scalar>(&mut self, guess: Option<&[[B; 3]]>, cycle: Option<&mut Cycle>, products: bool) -> R {
        let free = &self.pattern;
        let nodes = self.prepared.as_ref().map_or(0, |whole| whole.row_count());
        let moves = |g: &&[[B; 3]]| g.len() == nodes && free.node.iter().any(|n| g[*n as usize] != [B::zero(); 3]);
        let Some(guess) = guess.filter(moves) else { return R::zero() };
        self.p.get_mut().par_iter_mut().enumerate().with_min_len(par::CHUNK).each(|(row, p)| {
            let g = free.of_row(guess, row);
            *p = [R::from_f64(g[0]), R::from_f64(g[1]), R::from_f64(g[2]), R::zero()];
        });
        match cycle {
            Some(cycle) if !products => self.product_by(cycle),
            _ => self.product(),
        };
        let (rq, qq) = dots(self.q.get(), [self.r.get(), self.q.get()], &mut self.partial);
        let alpha = R::from_f64(rq / qq);
        if qq.is_finite() && alpha.is_finite() {
            return alpha;
        }
        self.p.get_mut().fill([R::zero(); 4]);
        self.q.get_mut().fill([R::zero(); 4]);
        R::zero()
    }

    /// Symbolic work for the free rows in an order of their own.
    pub fn prepare(&mut self, pattern: &Arc<BlockPattern>, free: Arc<FreePattern>) {
        let n = free.row_count();
        self.values = None;
        self.cubes = None;
        self.inverse = Vec::new();
        self.identity = vec![false; n];
        for v in [&mut self.x, &mut self.r, &mut self.z, &mut self.p, &mut self.q] {
            *v = Quads::zero(n);
        }
        self.partial = vec![[0.0; 2]; n.div_ceil(ROWS)];
        self.candidate = Quads::zero(n);
        self.pattern = free;
        self.prepared = Some(Arc::clone(pattern));
    }

    /// The pattern of the whole systems it is prepared for.
    pub fn prepared(&self) -> Option<&Arc<BlockPattern>> {
        self.prepared.as_ref()
    }

    /// `other`, made on first use: an iteration in other numbers for the same systems.
    ///
    /// # Errors
    /// [`SolveError::NotPrepared`] when this one is not.
    pub fn beside<'a, B: Scalar>(
        &self,
        other: &'a mut Option<Iteration<B>>,
    ) -> Result<&'a mut Iteration<B>, SolveError> {
        let whole = self.prepared.as_ref().ok_or(SolveError::NotPrepared)?;
        Ok(other.get_or_insert_with(|| {
            let mut made = Iteration::new(self.iteration_limit);
            made.prepare(whole, self.pattern.clone());
            made
        }))
    }

    /// Takes the same rows with others of them held.
    pub fn hold(&mut self, free: Arc<FreePattern>) {
        self.cubes = None;
        self.pattern = free;
    }

    /// Rows without a single entry, where the cycle has been given the system.
    pub fn set_identity(&mut self, identity: &[bool]) {
        self.identity.copy_from_slice(identity);
    }

    /// The free part of the systems it is prepared for.
    pub fn free(&self) -> &Arc<FreePattern> {
        &self.pattern
    }

    /// `p = z + beta p`.
    fn direction(&mut self, beta: R) {
        self.p.get_mut().par_chunks_mut(ROWS).zip(self.z.get().par_chunks(ROWS)).each(|(p, z)| {
            run_wide::<R, _>(Direction { beta, z, p });
        });
    }

    /// Runs from the residual in `r`, less `lead` times `q`, until it has at most the square norm `target`; returns the iterations done
    /// and the square norm it began with. `x` is added to, `lead` times `p` too.
    fn iterate(
        &mut self,
        lead: R,
        target: f64,
        limit: usize,
        mut cycle: Option<&mut Cycle>,
        products: bool,
    ) -> Result<(usize, f64), SolveError> {
        let jacobi = cycle.is_none();
        let (mut rz, mut rr) = self.update(lead, jacobi);
        let begun = rr;
        if rr <= target {
            return Ok((0, begun));
        }
        if let Some(cycle) = &mut cycle {
            rz = self.precondition(cycle).0;
        }
        self.direction(R::zero());
        for iteration in 1..=limit {
            let pq = match &mut cycle {
                Some(cycle) if !products => self.product_by(cycle),
                _ => self.product(),
            };
            if pq.is_nan() || pq <= 0.0 || !rz.is_finite() {
                return Err(SolveError::NotPositiveDefinite { node: self.steepest_node() });
            }
            let (rz_before, alpha) = (rz, rz / pq);
            (rz, rr) = self.update(R::from_f64(alpha), jacobi);
            if rr <= target {
                return Ok((iteration, begun));
            }
            let mut beta = rz / rz_before;
            if let Some(cycle) = &mut cycle {
                let zq;
                (rz, zq) = self.precondition(cycle);
                // zᵀ (r - r_before) / rz_before: a cycle in f32 is symmetric only up to rounding
                beta = -alpha * zq / rz_before;
            }
            self.direction(R::from_f64(beta));
        }
        Ok((limit, begun))
    }

    /// The node that contributes least to `pᵀ A p`, to name one where the matrix is indefinite.
    fn steepest_node(&self) -> usize {
        let worst = |i: &usize| {
            let (p, q) = (self.p.get()[*i], self.q.get()[*i]);
            (0..3).map(|c| p[c].to_f64() * q[c].to_f64()).sum::<f64>()
        };
        let row = (0..self.pattern.row_count()).min_by(|a, b| worst(a).total_cmp(&worst(b)));
        row.map_or(0, |row| self.pattern.node[row] as usize)
    }

    /// Adds what the iteration has found, rounds, and returns the square norm of the true residual, which is left in `r`. All is
    /// multiplied by `scale`, the iteration's part by `part` on top of it. `finest` is the matrix of the cycle that makes the products.
    pub(super) fn examine<B: Scalar>(
        &mut self,
        asked: &mut Asked<'_, B>,
        rhs: &[[B; 3]],
        scale: f64,
        part: f64,
        finest: Option<&Sliced<f32>>,
    ) -> f64 {
        let factor = 1.0 / (scale * part);
        let (found, x) = (self.x.get(), self.candidate.get_mut());
        x.par_iter_mut().zip(found).with_min_len(par::CHUNK).each(|(x, found)| {
            (0..3).for_each(|c| x[c] = B::from_f64(x[c] + found[c].to_f64() * factor).to_f64());
        });
        let (free, x, identity) = (&*self.pattern, self.candidate.get(), &self.identity[..]);
        let target = Target { free, rhs, scale, out: self.r.get_mut(), squares: &mut self.squares };
        if let Some(cubes) = &mut self.cubes {
            cubes.exact.product(self.candidate.padded(), cubes.y.get_mut());
            let y = cubes.y.get();
            return target.of_rows(|row| [y[row][0], y[row][1], y[row][2]]);
        }
        // what was copied without rounding is the caller's matrix
        match (finest, &self.values) {
            (Some(matrix), _) if B::NAME == f32::NAME => return target.of_own(matrix, x),
            (None, Some(matrix)) if B::NAME == R::NAME => return target.of_own(matrix, x),
            _ => {}
        }
        let y = &mut *asked.memory;
        y.resize(rhs.len(), [B::zero(); 3]);
        free.scatter(x, y);
        if asked.system.product(y) {
            return target
                .of_rows(|row| if identity[row] { [x[row][0], x[row][1], x[row][2]] } else { free.of_row(y, row) });
        }
        target.of_entries(asked.system.assembled(), identity, x)
    }
}

impl<R: Scalar> Iteration<R> {
    /// What an iteration reads and writes.
    pub fn traffic(&self) -> Traffic {
        let matrix = self.values.as_ref().map_or(0, Sliced::bytes);
        // the product and two updates read or write twelve vectors; there are five
        let numbers = |count: usize| count * size_of::<R>() * self.pattern.row_count();
        Traffic { moved: matrix + numbers(12 * 4 + 12), held: matrix + numbers(5 * 4 + 12) }
    }

    /// Solves a system in the numbers of the caller, from zero, preconditioned by the cycle when there is one. Without `products`
    /// the cycle, which has been given the system, makes the products too.
    pub fn solve_with<B: Scalar>(
        &mut self,
        asked: &mut Asked<'_, B>,
        rhs: &[[B; 3]],
        solution: &mut [[B; 3]],
        tolerance: f64,
        cycle: Option<&mut Cycle>,
        products: bool,
    ) -> Result<SolveReport, SolveError> {
        self.check(asked.system, rhs, solution)?;
        self.load(asked.system, cycle.is_none(), products)?;
        let Some(scale) = self.pattern.scale_of(rhs)? else {
            solution.fill([B::zero(); 3]);
            return Ok(SolveReport {
                solver: "pcg",
                iterations: 0,
                residual: 0.0,
                converged: true,
                rebuilt: false,
                start: 1.0,
            });
        };
        self.improve(asked, rhs, solution, (tolerance, scale), cycle, products)
    }

    /// Starts from zero: everything is still to be solved for. Returns the square norm of the right-hand side times `scale`.
    pub(super) fn begin<B: Scalar>(&mut self, rhs: &[[B; 3]], scale: f64) -> f64 {
        self.candidate.get_mut().fill([0.0; 4]);
        Target { free: &self.pattern, rhs, scale, out: self.r.get_mut(), squares: &mut self.squares }
            .of_rows(|_| [0.0; 3])
    }

    fn improve<B: Scalar>(
        &mut self,
        asked: &mut Asked<'_, B>,
        rhs: &[[B; 3]],
        solution: &mut [[B; 3]],
        (tolerance, scale): (f64, f64),
        mut cycle: Option<&mut Cycle>,
        products: bool,
    ) -> Result<SolveReport, SolveError> {
        let square = self.begin(rhs, scale);
        let (norm, mut left) = (square.sqrt(), square);
        let (mut iterations, mut start) = (0, None);
        loop {
            // each pass solves for what is left, of size 1 again: f32 has the digits but not the range
            let part = (-left.sqrt().log2().floor()).exp2();
            let factor = R::from_f64(part);
            self.r.get_mut().par_iter_mut().with_min_len(par::CHUNK).each(|r| *r = r.map(|v| v * factor));
            for v in [&mut self.x, &mut self.p, &mut self.q] {
                v.get_mut().fill([R::zero(); 4]);
            }
            let guess = if start.is_none() { asked.system.guess() } else { None };
            let lead = self.lead(guess, cycle.as_deref_mut(), products);
            // no further than the recursion can be believed
            let goal = (tolerance * norm).powi(2).max(left * (BELIEVED * R::EPSILON.to_f64()).powi(2)) * part * part;
            let limit = self.iteration_limit.saturating_sub(iterations);
            // on the pool's own threads, so that each loop does not enter it anew
            let (done, begun) = rayon::scope(|_| self.iterate(lead, goal, limit, cycle.as_deref_mut(), products))?;
            let begun = if lead == R::zero() { 1.0 } else { begun.sqrt() / (part * norm) };
            let start = *start.get_or_insert(begun);
            iterations += done;
            let before = left;
            let finest = cycle.as_deref().filter(|_| !products).map(Cycle::finest);
            left = self.examine(asked, rhs, scale, part, finest);
            let residual = left.sqrt() / norm;
            if residual <= tolerance {
                self.pattern.scatter(self.candidate.get(), solution);
                return Ok(SolveReport { solver: "pcg", iterations, residual, converged: true, rebuilt: false, start });
            }
            // each pass must gain something, or rounding has the last word
            if iterations >= self.iteration_limit || left.is_nan() || left >= 0.25 * before {
                return Err(SolveError::NotConverged { solver: "pcg", residual, iterations, tolerance });
            }
        }
    }
}
