//! The cycle for other iterations than our own.

use super::age::Age;
use super::{Multigrid, Smoother};
use crate::Scalar;
use crate::solver::{LinearSystem, Preconditioner, SolveError};

impl<R: Scalar> Preconditioner<R> for Multigrid<R> {
    fn load(&mut self, system: &mut dyn LinearSystem<R>) -> Result<(), SolveError> {
        let rebuild = self.is_stale(system) || self.age.is_over();
        let cubes = matches!(self.settings.smoother, Smoother::Chebyshev { .. }) && system.cubes().is_some();
        let known = self.pcg.prepared().ok_or(SolveError::NotPrepared)?;
        let cycle = self.cycle.as_mut().ok_or(SolveError::NotPrepared)?;
        let free = self.pcg.free();
        if let Some(matrix) = system.cubes().filter(|_| cubes) {
            cycle.load_cubes(matrix, free);
        }
        if rebuild || !cubes {
            let matrix = system.assembled();
            if *matrix.pattern != **known {
                return Err(SolveError::NotPrepared);
            }
            if !cubes {
                cycle.load(&free.block_of(matrix)).map_err(|fault| free.blame(&fault))?;
            }
            if rebuild {
                cycle.rebuild(&free.block_of(matrix));
            }
        }
        if rebuild {
            std::mem::swap(&mut self.built, &mut self.turned);
            self.age = Age::unknown();
        }
        Ok(())
    }

    fn free_nodes(&self) -> &[u32] {
        &self.pcg.free().node
    }

    fn apply(&mut self, r: &[[f32; 4]], z: &mut [[f32; 4]]) {
        match &mut self.cycle {
            Some(cycle) => cycle.apply(r, z),
            None => z.copy_from_slice(r),
        }
    }
}
