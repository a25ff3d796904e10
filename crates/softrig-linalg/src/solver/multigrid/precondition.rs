//! The cycle for other iterations than our own.

use super::Multigrid;
use super::age::Age;
use crate::Scalar;
use crate::solver::{LinearSystem, Preconditioner, SolveError};

impl<R: Scalar> Preconditioner<R> for Multigrid<R> {
    fn load(&mut self, system: &mut dyn LinearSystem<R>) -> Result<(), SolveError> {
        if self.pcg.prepared().ok_or(SolveError::NotPrepared)? != system.rows().pattern() {
            return Err(SolveError::NotPrepared);
        }
        let rebuild = self.is_stale(system);
        self.load_cycle(system, rebuild)?;
        if rebuild {
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
