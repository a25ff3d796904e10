//! Where a step's first solve starts from: as far along the velocities as that brings the balance of forces.

use super::{Constants, Implicit};
use crate::body::Body;
use crate::integrate::{State, StepInput};
use softrig_linalg::Scalar;

impl<R: Scalar> Implicit<R> {
    /// With d = 0 and its right-hand side given, of size `norm`: lets free nodes go on as they move, d = s h v, and leaves what
    /// is then missing in the right-hand side. It is linear in s, whose best value follows from two of them; so a bad guess
    /// (flesh that vibrates faster than steps can follow) becomes none. Returns the size of what is missing.
    pub(super) fn lead(
        &mut self,
        body: &mut Body<R>,
        c: &Constants,
        input: &StepInput<'_, R>,
        state: &State<R>,
        norm: f64,
    ) -> f64 {
        let n = state.position.len();
        let free = |body: &Body<R>, i: usize| !body.constraints.is_constrained(i);
        if !(0..n).any(|i| free(body, i) && state.velocity[i] != [R::zero(); 3]) {
            return norm;
        }
        let h = R::from_f64(input.dt);
        for i in (0..n).filter(|i| free(body, *i)) {
            self.d[i] = state.velocity[i].map(|v| h * v);
        }
        // the memory of the correction, which is not there yet
        std::mem::swap(&mut self.rhs, &mut self.correction);
        self.forces(body, c, input, state, true);
        self.residual(body, c, input, state);
        let (still, moving) = (&self.correction, &mut self.rhs);
        let (mut along, mut square) = (0.0, 0.0);
        for (b, m) in still.iter().flatten().zip(moving.iter().flatten()) {
            let (b, change) = (b.to_f64(), m.to_f64() - b.to_f64());
            along -= b * change;
            square += change * change;
        }
        let share = along / square;
        let share = R::from_f64(if share.is_finite() { share } else { 0.0 });
        let mut left = 0.0;
        for (b, m) in still.iter().flatten().zip(moving.iter_mut().flatten()) {
            *m = *b + share * (*m - *b);
            left += m.to_f64() * m.to_f64();
        }
        for i in (0..n).filter(|i| free(body, *i)) {
            self.d[i] = self.d[i].map(|d| share * d);
        }
        left.sqrt()
    }
}
