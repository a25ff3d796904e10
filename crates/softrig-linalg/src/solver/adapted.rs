//! The baseline that elimination is measured against: constrained nodes stay in the system as rows of their own.
#![allow(clippy::doc_markdown, reason = "keys of papers")]

use super::{LinearSolver, Multigrid, SolveError, SolveReport};
use crate::{BlockCsr, BlockPattern, DofConstraints, Scalar};
use std::sync::Arc;

/// Multigrid on adapted equations [Georgii2010 §3.2, Fig. 6]: rows and columns of constrained nodes are replaced by `alpha` times
/// the identity, interpolation is left as it is, and these rows find their way into all coarse operators.
///
/// How much slower that is than [`Multigrid`] alone depends on `alpha` alone (numerics 5.2): with a small one it is
/// the same, with a hundred times the mean diagonal it takes up to three times the cycles.
#[derive(Debug)]
pub struct Adapted<R> {
    /// Diagonal of constrained rows, in units of the mean diagonal of the free ones [-].
    pub alpha: f64,
    inner: Multigrid<R>,
    matrix: Option<BlockCsr<R>>,
    constraints: DofConstraints,
    rhs: Vec<[R; 3]>,
}

impl<R: Scalar> Adapted<R> {
    /// `inner` is what solves the adapted equations.
    #[must_use]
    pub fn new(alpha: f64, inner: Multigrid<R>) -> Self {
        Self { alpha, inner, matrix: None, constraints: DofConstraints::none(0), rhs: Vec::new() }
    }
}

impl<R: Scalar> LinearSolver<R> for Adapted<R> {
    fn name(&self) -> &'static str {
        "adapted"
    }

    fn prepare(&mut self, pattern: &Arc<BlockPattern>, constraints: &DofConstraints) -> Result<(), SolveError> {
        self.constraints = constraints.clone();
        self.matrix = Some(BlockCsr::zero(pattern.clone()));
        self.inner.prepare(pattern, &DofConstraints::none(pattern.row_count()))
    }

    fn forget(&mut self) {
        self.inner.forget();
    }

    fn solve(
        &mut self,
        matrix: &BlockCsr<R>,
        rhs: &[[R; 3]],
        solution: &mut [[R; 3]],
        tolerance: f64,
    ) -> Result<SolveReport, SolveError> {
        let adapted = self.matrix.as_mut().ok_or(SolveError::NotPrepared)?;
        super::check_system(&adapted.pattern, matrix, rhs, solution)?;
        let pattern = adapted.pattern.clone();
        let held = self.constraints.mask();
        let diagonal = |i: usize| {
            let m = &matrix.values[pattern.diagonal()[i] as usize];
            m[0].to_f64() + m[4].to_f64() + m[8].to_f64()
        };
        let free = (0..pattern.row_count()).filter(|i| !held[*i]);
        let count = pattern.row_count() - self.constraints.constrained_count();
        let dummy = R::from_f64(self.alpha * free.map(diagonal).sum::<f64>() / (3 * count.max(1)) as f64);
        for i in 0..pattern.row_count() {
            for k in pattern.row(i) {
                let coupled = !held[i] && !held[pattern.column()[k] as usize];
                adapted.values[k] = if coupled { matrix.values[k] } else { [R::zero(); 9] };
            }
            if held[i] {
                (0..3).for_each(|c| adapted.values[pattern.diagonal()[i] as usize][4 * c] = dummy);
            }
        }
        self.rhs.clear();
        self.rhs.extend(rhs.iter().zip(held).map(|(b, held)| if *held { [R::zero(); 3] } else { *b }));
        self.inner.solve(adapted, &self.rhs, solution, tolerance)
    }
}
