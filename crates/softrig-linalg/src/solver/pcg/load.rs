//! From the caller's system to the numbers of the iteration: free blocks or cubes, in the iteration's own type.

use super::Iteration;
use crate::solver::cubes::FreeCubes;
use crate::solver::quads::Quads;
use crate::solver::sliced::Sliced;
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

impl<R: Scalar> Iteration<R> {
    /// Copies the free blocks, or the cubes, and inverts the diagonal blocks. With a cycle that makes the products, only what
    /// the true residual needs.
    pub(super) fn load<B: Scalar>(
        &mut self,
        source: Source<'_, B>,
        jacobi: bool,
        products: bool,
    ) -> Result<(), SolveError> {
        let n = self.pattern.row_count();
        if products && (jacobi || matches!(source, Source::Stored(_))) {
            self.inverse.resize(n, [[R::zero(); 4]; 3]);
        }
        let matrix = match source {
            Source::Stored(matrix) => {
                self.cubes = None;
                if !products {
                    return Ok(());
                }
                let rows = [0, self.pattern.row_count() as u32];
                let values = self.values.get_or_insert_with(|| Sliced::new(&self.pattern, &rows));
                let block_of = self.pattern.block_of(matrix);
                let loaded = values.load(&self.pattern, &block_of, &mut self.inverse, &mut self.identity);
                return loaded.map_err(|fault| self.pattern.blame(&fault));
            }
            Source::Cubes(matrix) => matrix,
        };
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
}
