//! The coarsest level: solved exactly.

use super::galerkin::Galerkin;
use super::level::Level;
use crate::solver::factor::Factor;
use crate::solver::free::Blocks;

/// Relative shift of the coarsest diagonal: interpolation next to constraints can be rank deficient (numerics 5.3), and
/// rounding of the operators to f32 can leave the smallest pivots below zero.
const SHIFT: f64 = 1e-6;

/// The factor of the coarsest operator.
pub(super) struct Coarsest {
    /// Absent when there was no memory for it.
    factor: Option<Factor>,
    blocks: Blocks,
    state: Factorisation,
    identity: Vec<bool>,
    rhs: Vec<f64>,
}

/// How far the factorisation has come.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Factorisation {
    /// The operator has changed since the last one, or there was none.
    Due,
    Done,
    /// The operator is not positive definite, or there is no memory.
    Failed,
}

impl Coarsest {
    /// Of an operator with these blocks.
    pub fn new(blocks: Blocks) -> Self {
        let n = blocks.row_count();
        let (identity, rhs) = (vec![false; n], vec![0.0; 3 * n]);
        Self { factor: Factor::new(&blocks), blocks, state: Factorisation::Due, identity, rhs }
    }

    /// The operator has changed.
    pub fn expire(&mut self) {
        self.state = Factorisation::Due;
    }

    /// Is there anything to factorise?
    pub fn is_due(&self) -> bool {
        self.state == Factorisation::Due
    }

    /// Factorises the operator that `galerkin` has made, on one thread.
    pub fn factorise(&mut self, galerkin: &Galerkin) {
        let Self { factor, blocks, identity, .. } = self;
        let block_of = |row: usize, k: usize| galerkin.coarse_block(row, k).map(f64::from);
        let done = factor.as_mut().is_some_and(|factor| {
            let loaded = factor.load(blocks, &block_of, identity);
            factor.shift_diagonal(SHIFT, 1e-6);
            loaded.and_then(|()| factor.factorise()).is_ok()
        });
        self.state = if done { Factorisation::Done } else { Factorisation::Failed };
    }

    /// `A x = b` of the level.
    pub fn solve(&mut self, level: &mut Level) {
        let Some(factor) = self.factor.as_mut().filter(|_| self.state == Factorisation::Done) else {
            // not positive definite even with the shift: smoothing alone is still a valid preconditioner
            level.smooth_from_zero();
            return;
        };
        for (to, b) in self.rhs.as_chunks_mut::<3>().0.iter_mut().zip(level.b.get()) {
            *to = [b[0], b[1], b[2]].map(f64::from);
        }
        factor.solve_in_place(&mut self.rhs);
        for (x, from) in level.x.get_mut().iter_mut().zip(self.rhs.as_chunks::<3>().0) {
            *x = [from[0] as f32, from[1] as f32, from[2] as f32, 0.0];
        }
    }
}
