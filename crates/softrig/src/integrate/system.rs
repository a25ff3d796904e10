//! The linear system of a step, assembled only for solvers that read its entries.

use crate::body::Body;
use rayon::prelude::*;
use softrig_linalg::par::Each;
use softrig_linalg::{BlockCsr, BlockPattern, CubeMatrix, LinearSystem, Rows, Scalar, par};
use std::sync::Arc;

/// Rows per task.
const ROWS: usize = 1024;

/// K + vd C + ad M at the last linearisation.
pub(crate) struct StepSystem<'a, R> {
    body: &'a mut Body<R>,
    /// vd [1/s] and ad [1/s2].
    factors: (R, R),
    matrix: &'a mut BlockCsr<R>,
    cubes: Option<&'a mut CubeMatrix<R>>,
    assembled: bool,
    guess: Option<&'a [[R; 3]]>,
}

impl<'a, R: Scalar> StepSystem<'a, R> {
    /// The system of a step with the given vd and ad; `matrix` is written when it is wanted.
    pub fn new(
        body: &'a mut Body<R>,
        factors: (f64, f64),
        matrix: &'a mut BlockCsr<R>,
        mut cubes: Option<&'a mut CubeMatrix<R>>,
    ) -> Self {
        let factors = (R::from_f64(factors.0), R::from_f64(factors.1));
        if let Some(cubes) = &mut cubes {
            body.model.cubes(factors.0, body.stiffness_damping, cubes);
            let diagonal = diagonal(body, factors);
            cubes.diagonal.par_iter_mut().enumerate().with_min_len(par::CHUNK).each(|(i, d)| *d = diagonal(i));
        }
        Self { body, factors, matrix, cubes, assembled: false, guess: None }
    }

    /// The same, whose solution may lie along `guess`.
    pub fn with_guess(self, guess: Option<&'a [[R; 3]]>) -> Self {
        Self { guess, ..self }
    }
}

/// Damping by the mass of each node, and the mass where it is lumped.
fn diagonal<R: Scalar>(body: &Body<R>, (vd, ad): (R, R)) -> impl Fn(usize) -> R + Sync {
    let ad = if body.consistent_mass.is_none() { ad } else { R::zero() };
    lumped(&body.mass, &body.drag, body.mass_damping, (vd, ad))
}

/// The same of lumped masses.
fn lumped<'a, R: Scalar>(
    mass: &'a [R],
    drag: &'a [R],
    mass_damping: R,
    (vd, ad): (R, R),
) -> impl Fn(usize) -> R + Sync + 'a {
    move |i| vd * (drag[i] + mass_damping * mass[i]) + ad * mass[i]
}

impl<R: Scalar> LinearSystem<R> for StepSystem<'_, R> {
    fn assembled(&mut self) -> &BlockCsr<R> {
        if self.assembled {
            return self.matrix;
        }
        self.assembled = true;
        let (vd, ad) = self.factors;
        self.matrix.values.resize(self.matrix.pattern.block_count(), [R::zero(); 9]);
        self.body.model.stiffness(vd, self.body.stiffness_damping, self.matrix);
        if let Some(m) = &self.body.consistent_mass {
            for (to, from) in self.matrix.values.iter_mut().zip(&m.values) {
                (0..9).for_each(|k| to[k] += from[k] * ad);
            }
        }
        let (pattern, diagonal) = (&self.body.pattern, diagonal(self.body, self.factors));
        let start = |row: usize| pattern.row_start()[row] as usize;
        par::divide(0..pattern.row_count(), ROWS, &start, &mut self.matrix.values, &|rows, values| {
            let first = start(rows.start);
            for i in rows {
                let at = pattern.diagonal()[i] as usize - first;
                (0..3).for_each(|k| values[at][4 * k] += diagonal(i));
            }
        });
        self.matrix
    }

    fn rows(&mut self) -> &dyn Rows<R> {
        let possible = self.body.model.row_parts() > 0 && self.body.consistent_mass.is_none();
        if possible && !self.assembled { self } else { self.assembled() }
    }

    fn product(&mut self, x: &mut [[R; 3]]) -> bool {
        let Body { model, mass, drag, mass_damping, stiffness_damping, consistent_mass, .. } = &mut *self.body;
        let diagonal = lumped(mass, drag, *mass_damping, self.factors);
        consistent_mass.is_none() && model.product(self.factors.0, *stiffness_damping, &diagonal, x)
    }

    fn cubes(&mut self) -> Option<&CubeMatrix<R>> {
        self.cubes.as_deref()
    }

    fn guess(&self) -> Option<&[[R; 3]]> {
        self.guess
    }

    fn rotations(&mut self, node: &[u32], out: &mut [[f32; 4]]) -> bool {
        self.body.model.rotations(node, out)
    }
}

impl<R: Scalar> Rows<R> for StepSystem<'_, R> {
    fn pattern(&self) -> &Arc<BlockPattern> {
        &self.body.pattern
    }

    fn part_count(&self) -> usize {
        self.body.model.row_parts()
    }

    fn for_rows(&self, part: usize, take: &mut dyn FnMut(usize, &[[R; 9]])) {
        let (rate, damping) = (self.factors.0, self.body.stiffness_damping);
        let diagonal = diagonal(self.body, self.factors);
        self.body.model.stiffness_rows(rate, damping, part, &mut |node, blocks| {
            add_to_diagonal(&self.body.pattern, node, blocks, diagonal(node));
            take(node, blocks);
        });
    }

    fn for_rows_in_single(&self, part: usize, take: &mut dyn FnMut(usize, &[[f32; 9]])) {
        let (rate, damping) = (self.factors.0, self.body.stiffness_damping);
        let diagonal = diagonal(self.body, self.factors);
        self.body.model.stiffness_rows_in_single(rate, damping, part, &mut |node, blocks| {
            add_to_diagonal(&self.body.pattern, node, blocks, diagonal(node).to_f64() as f32);
            take(node, blocks);
        });
    }
}

/// Adds a multiple of the identity to the diagonal block of a node's row.
fn add_to_diagonal<A: Scalar>(pattern: &BlockPattern, node: usize, row: &mut [[A; 9]], added: A) {
    let own = pattern.diagonal()[node] as usize - pattern.row_start()[node] as usize;
    (0..3).for_each(|k| row[own][4 * k] += added);
}
