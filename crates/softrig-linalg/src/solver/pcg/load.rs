//! From the caller's system to the numbers of the iteration: free blocks or cubes, in the iteration's own type.

use super::kernel::{Blocks, Inverse, inverse_of_block};
use super::{Pcg, ROWS};
use crate::solver::cubes::FreeCubes;
use crate::solver::free::FreePattern;
use crate::solver::multigrid::Cycle;
use crate::solver::quads::Quads;
use crate::solver::{LinearSystem, SolveError};
use crate::{BlockCsr, CubeMatrix, Scalar};

/// Products with cubes, for the iteration and for the true residual.
#[derive(Debug)]
pub(super) struct CubeProducts<R> {
    /// Absent where a cycle makes the products.
    pub own: Option<FreeCubes<R>>,
    pub exact: FreeCubes<f64>,
    pub x: Quads<f64>,
    pub y: Quads<f64>,
}

/// Where a matrix comes from.
pub(in crate::solver) enum Source<'a, R> {
    Stored(&'a BlockCsr<R>),
    Cubes(&'a CubeMatrix<R>),
}

impl<R> Clone for Source<'_, R> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<R> Copy for Source<'_, R> {}

impl<'a, R> Source<'a, R> {
    /// The cubes if there are any.
    pub fn of(system: &'a mut dyn LinearSystem<R>) -> Self {
        if system.cubes().is_some() {
            Self::Cubes(system.cubes().expect("it just had them"))
        } else {
            Self::Stored(system.assembled())
        }
    }
}

impl<R: Scalar> Pcg<R> {
    /// Copies the free blocks, or the cubes, and inverts the diagonal blocks. With a cycle that makes the products, only what
    /// the true residual needs.
    pub(super) fn load<B: Scalar>(
        &mut self,
        source: Source<'_, B>,
        jacobi: bool,
        products: bool,
    ) -> Result<(), SolveError> {
        let matrix = match source {
            Source::Stored(matrix) => {
                self.cubes = None;
                if !products {
                    return Ok(());
                }
                if self.values.0.is_empty() {
                    self.values = Blocks::zero(self.pattern.block_count());
                }
                let used = 9 * self.pattern.block_count();
                let values = &mut self.values.0[..used];
                return load_rows(&self.pattern, matrix, 0, values, &mut self.inverse, &mut self.identity);
            }
            Source::Cubes(matrix) => matrix,
        };
        let n = self.pattern.row_count();
        if !self.cubes.as_ref().is_some_and(|c| c.exact.belongs_to(&matrix.pattern)) {
            let exact = FreeCubes::new(&matrix.pattern, &self.pattern);
            self.cubes = Some(Box::new(CubeProducts { own: None, exact, x: Quads::zero(n), y: Quads::zero(n) }));
        }
        self.identity.fill(false);
        let cubes = self.cubes.as_mut().expect("made above");
        cubes.exact.load(matrix, &self.pattern);
        if products {
            let own = cubes.own.get_or_insert_with(|| FreeCubes::new(&matrix.pattern, &self.pattern));
            own.load(matrix, &self.pattern);
            if jacobi {
                own.invert_diagonal(&mut self.inverse);
            }
        }
        Ok(())
    }

    /// Fills the finest level of a cycle, which then makes the products as well.
    pub(in crate::solver) fn load_cycle<B: Scalar>(
        &mut self,
        matrix: &BlockCsr<B>,
        cycle: &mut Cycle,
    ) -> Result<(), SolveError> {
        let (values, inverse) = cycle.finest_mut();
        load_rows(&self.pattern, matrix, 0, values, inverse, &mut self.identity)
    }
}

/// Fills the values, inverses and identity marks of the rows from `first` on; halves the work between threads.
fn load_rows<R: Scalar, B: Scalar>(
    pattern: &FreePattern,
    matrix: &BlockCsr<B>,
    first: usize,
    values: &mut [R],
    inverse: &mut [Inverse<R>],
    identity: &mut [bool],
) -> Result<(), SolveError> {
    let rows = inverse.len();
    if rows > ROWS {
        let half = (rows / 2).next_multiple_of(ROWS).min(rows - 1);
        let blocks = (pattern.row_start[first + half] - pattern.row_start[first]) as usize;
        let (values, values_after) = values.split_at_mut(9 * blocks);
        let (inverse, inverse_after) = inverse.split_at_mut(half);
        let (identity, identity_after) = identity.split_at_mut(half);
        let (a, b) = rayon::join(
            || load_rows(pattern, matrix, first, values, inverse, identity),
            || load_rows(pattern, matrix, first + half, values_after, inverse_after, identity_after),
        );
        return a.and(b);
    }
    let start = pattern.row_start[first..].first().map_or(0, |s| *s as usize);
    let values = values.as_chunks_mut::<9>().0;
    for i in 0..rows {
        let row = pattern.row(first + i);
        let node = pattern.node[first + i] as usize;
        // zero times anything finite is zero: one comparison per row instead of nine per block
        let (mut finite, mut any) = (R::zero(), false);
        for k in row {
            let block = matrix.values[pattern.source[k] as usize].map(|v| R::from_f64(v.to_f64()));
            for v in block {
                finite += v * R::zero();
                any |= v != R::zero();
            }
            values[k - start] = block;
        }
        if finite != R::zero() {
            return Err(SolveError::NotFinite { node });
        }
        let diagonal = &mut values[pattern.diagonal[first + i] as usize - start];
        identity[i] = !any;
        if !any {
            for c in 0..3 {
                diagonal[4 * c] = R::one();
            }
        }
        inverse[i] = inverse_of_block(diagonal.map(Scalar::to_f64)).ok_or(SolveError::NotPositiveDefinite { node })?;
    }
    Ok(())
}
