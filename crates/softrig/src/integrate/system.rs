//! The linear system of a step, assembled only for solvers that read its entries.

use crate::body::Body;
use softrig_linalg::{BlockCsr, CubeMatrix, LinearSystem, Scalar};

/// K + vd C + ad M at the last linearisation.
pub(crate) struct StepSystem<'a, R> {
    body: &'a mut Body<R>,
    /// vd [1/s] and ad [1/s2].
    factors: (R, R),
    matrix: &'a mut BlockCsr<R>,
    cubes: Option<&'a mut CubeMatrix<R>>,
    assembled: bool,
}

impl<'a, R: Scalar> StepSystem<'a, R> {
    /// The system of a step with the given vd and ad; `matrix` is written when it is wanted.
    pub fn new(
        body: &'a mut Body<R>,
        factors: (f64, f64),
        matrix: &'a mut BlockCsr<R>,
        cubes: Option<&'a mut CubeMatrix<R>>,
    ) -> Self {
        let factors = (R::from_f64(factors.0), R::from_f64(factors.1));
        let mut system = Self { body, factors, matrix, cubes: None, assembled: false };
        if let Some(cubes) = cubes {
            system.body.model.cubes(factors.0, system.body.stiffness_damping, cubes);
            for i in 0..cubes.diagonal.len() {
                cubes.diagonal[i] = system.on_diagonal(i);
            }
            system.cubes = Some(cubes);
        }
        system
    }

    /// Damping by the mass, and the mass where it is lumped.
    fn on_diagonal(&self, i: usize) -> R {
        let ((vd, ad), body) = (self.factors, &self.body);
        let drag = vd * (body.drag[i] + body.mass_damping * body.mass[i]);
        if body.consistent_mass.is_none() { drag + ad * body.mass[i] } else { drag }
    }
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
        for i in 0..self.body.mass.len() {
            let at = self.body.pattern.diagonal()[i] as usize;
            let m = self.on_diagonal(i);
            (0..3).for_each(|k| self.matrix.values[at][4 * k] += m);
        }
        self.matrix
    }

    fn cubes(&mut self) -> Option<&CubeMatrix<R>> {
        self.cubes.as_deref()
    }

    fn rotations(&mut self, out: &mut Vec<[R; 4]>) {
        self.body.model.write_history(out);
    }
}
