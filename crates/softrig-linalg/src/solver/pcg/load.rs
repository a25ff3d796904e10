//! From the caller's system to the numbers of the iteration: free blocks or cubes, in the iteration's own type.

use super::Iteration;
use crate::Scalar;
use crate::solver::cubes::FreeCubes;
use crate::solver::quads::Quads;
use crate::solver::sliced::Sliced;
use crate::solver::{LinearSystem, SolveError};

/// Products with cubes, for the iteration and for the true residual.
#[derive(Debug)]
pub(super) struct CubeProducts<R> {
    /// Absent where a cycle makes the products.
    pub own: Option<FreeCubes<R>>,
    pub exact: FreeCubes<f64>,
    pub y: Quads<f64>,
}

/// A system that is being solved, and memory for products with all of it, made when someone wants one.
pub(in crate::solver) struct Asked<'a, B: Scalar> {
    pub system: &'a mut dyn LinearSystem<B>,
    pub memory: &'a mut Vec<[B; 3]>,
}

impl<R: Scalar> Iteration<R> {
    /// Does the system belong to the prepared pattern?
    ///
    /// # Errors
    /// [`SolveError::NotPrepared`] when not.
    pub fn check<B: Scalar>(
        &self,
        system: &mut dyn LinearSystem<B>,
        rhs: &[[B; 3]],
        solution: &[[B; 3]],
    ) -> Result<(), SolveError> {
        let prepared = self.prepared().ok_or(SolveError::NotPrepared)?;
        let nodes = prepared.row_count();
        let known = match system.cubes() {
            Some(cubes) => cubes.pattern.node_count == nodes,
            None => prepared == system.rows().pattern(),
        };
        if known && rhs.len() == nodes && solution.len() == nodes { Ok(()) } else { Err(SolveError::NotPrepared) }
    }

    /// Copies the free blocks, or the cubes, and inverts the diagonal blocks. With a cycle that makes the products, only what
    /// the true residual needs.
    pub(super) fn load<B: Scalar>(
        &mut self,
        system: &mut dyn LinearSystem<B>,
        jacobi: bool,
        products: bool,
    ) -> Result<(), SolveError> {
        let n = self.pattern.row_count();
        let Some(matrix) = system.cubes() else {
            self.cubes = None;
            if !products {
                return Ok(());
            }
            self.inverse.resize(n, [[R::zero(); 4]; 3]);
            let rows = system.rows();
            let values =
                self.values.get_or_insert_with(|| Sliced::new(&self.pattern.blocks(rows.pattern()), &[0, n as u32]));
            let loaded = values.load(&self.pattern, rows, &mut self.inverse, &mut self.identity);
            return loaded.map_err(|fault| self.pattern.blame(&fault));
        };
        if products && jacobi {
            self.inverse.resize(n, [[R::zero(); 4]; 3]);
        }
        if !self.cubes.as_ref().is_some_and(|c| c.exact.belongs_to(&matrix.pattern)) {
            let exact = FreeCubes::new(&matrix.pattern, &self.pattern);
            self.cubes = Some(Box::new(CubeProducts { own: None, exact, y: Quads::zero(n) }));
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
