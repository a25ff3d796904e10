//! Where a step's first solve starts from: as far along the velocities as that brings the balance of forces.

use super::{Constants, Implicit};
use crate::body::Body;
use crate::integrate::system::product;
use crate::integrate::{State, StepInput};
use rayon::prelude::*;
use softrig_linalg::{Scalar, par};

impl<R: Scalar> Implicit<R> {
    /// With the right-hand side b of d = 0 given, of size `norm`: lets free nodes go on as they move, d = s h v, and leaves what is then
    /// missing, b - s A h v, in the right-hand side. The best s follows from b and A h v; so a bad guess (flesh that vibrates faster
    /// than steps can follow) becomes none. Returns the size of what is missing; does nothing where a model has no products.
    pub(super) fn lead(
        &mut self,
        body: &mut Body<R>,
        c: &Constants,
        input: &StepInput<'_, R>,
        state: &State<R>,
        norm: f64,
    ) -> f64 {
        let n = state.position.len();
        let h = R::from_f64(input.dt);
        let along = |body: &Body<R>, i: usize| {
            if body.constraints.is_constrained(i) { [R::zero(); 3] } else { state.velocity[i].map(|v| h * v) }
        };
        let still = &*body;
        if par::first(n, |i| along(still, i) != [R::zero(); 3]).is_none() {
            return norm;
        }
        // the memory of the correction, which is not there yet
        let change = &mut self.correction;
        change.par_iter_mut().enumerate().with_min_len(par::CHUNK).for_each(|(i, u)| *u = along(still, i));
        if !product(body, (R::from_f64(c.vd), R::from_f64(c.ad)), change) {
            return norm;
        }
        let still = &*body;
        let of = |i: usize, v: &[[R; 3]]| {
            if still.constraints.is_constrained(i) { [0.0; 3] } else { v[i].map(Scalar::to_f64) }
        };
        let (change, rhs) = (&self.correction, &self.rhs);
        let dot = |a: &[[R; 3]], b: &[[R; 3]]| {
            let one = |i: usize| (0..3).map(|k| of(i, a)[k] * of(i, b)[k]).sum::<f64>();
            par::sum(n, |range| range.map(one).sum())
        };
        let share = dot(rhs, change) / dot(change, change);
        let share = R::from_f64(if share.is_finite() { share } else { 0.0 });
        let both = self.d.par_iter_mut().zip(&mut self.rhs).enumerate().with_min_len(par::CHUNK);
        both.for_each(|(i, (d, b))| {
            if still.constraints.is_constrained(i) {
                return;
            }
            let step = along(still, i);
            *d = step.map(|step| share * step);
            *b = std::array::from_fn(|k| b[k] - share * change[i][k]);
        });
        dot(&self.rhs, &self.rhs).sqrt()
    }
}
