//! Implicit Euler: M (v' - v) = h F(x + h v', v'), by Newton's method with conjugate gradients.
//!
//! The derivative of the force along a direction is taken by a central difference of the force itself, so that every law has
//! one. Of an indefinite derivative only the directions of positive curvature are used.

use super::{ForceLaw, StepperError};
use softrig::integrate::State;
use softrig_linalg::Scalar;

/// Newton iterations before a step is given up.
const LIMIT: usize = 30;
/// Iterations of the linear solve within one of them.
const LINEAR_LIMIT: usize = 300;

/// Memory of the solve.
#[derive(Clone, Debug, Default)]
pub(super) struct Newton<R> {
    residual: Vec<[R; 3]>,
    delta: Vec<[R; 3]>,
    r: Vec<[R; 3]>,
    p: Vec<[R; 3]>,
    q: Vec<[R; 3]>,
    force: Vec<[R; 3]>,
    trial: Vec<[R; 3]>,
    x: Vec<[R; 3]>,
}

impl<R: Scalar> Newton<R> {
    /// Writes the state after a step into `next`.
    pub fn step(
        &mut self,
        law: &mut dyn ForceLaw<R>,
        w: &[R],
        state: &State<R>,
        dt: f64,
        next: &mut State<R>,
    ) -> Result<(), StepperError> {
        let n = w.len();
        for list in [
            &mut self.residual,
            &mut self.delta,
            &mut self.r,
            &mut self.p,
            &mut self.q,
            &mut self.force,
            &mut self.trial,
            &mut self.x,
        ] {
            list.resize(n, [R::zero(); 3]);
        }
        let h = R::from_f64(dt);
        // half the digits that the central differences have
        let tolerance = R::EPSILON.to_f64().powf(0.6);
        next.velocity.copy_from_slice(&state.velocity);
        let first = self.residual(law, w, state, h, &next.velocity);
        let mut norm = first;
        let mut iterations = 0;
        // forces may cancel to rounding: what they are made of sets the floor
        while norm > tolerance * first && norm > 0.0 {
            if iterations == LIMIT || !norm.is_finite() {
                return Err(StepperError::NotConverged { residual: norm / first, iterations });
            }
            iterations += 1;
            self.solve(law, w, state, h, &next.velocity, 1e-2 * tolerance.sqrt());
            let mut share = R::one();
            let mut reached = f64::INFINITY;
            for _ in 0..12 {
                for i in 0..n {
                    self.trial[i] = std::array::from_fn(|k| next.velocity[i][k] + share * self.delta[i][k]);
                }
                let trial = std::mem::take(&mut self.trial);
                reached = self.residual(law, w, state, h, &trial);
                self.trial = trial;
                if reached < norm {
                    break;
                }
                share *= R::from_f64(0.5);
            }
            let stalled = reached >= norm;
            if !stalled {
                next.velocity.copy_from_slice(&self.trial);
                norm = reached;
            } else if norm <= 1e3 * tolerance * first {
                // as close as rounding lets it come
                break;
            } else {
                return Err(StepperError::NotConverged { residual: norm / first, iterations });
            }
        }
        for i in 0..n {
            let moved = w[i] > R::zero();
            for k in 0..3 {
                let v = if moved { next.velocity[i][k] } else { R::zero() };
                next.acceleration[i][k] = (v - state.velocity[i][k]) / h;
                next.velocity[i][k] = v;
                next.position[i][k] = state.position[i][k] + h * v;
            }
        }
        Ok(())
    }

    /// Leaves M (v - v') + h F(x + h v', v') in `residual`; returns its norm weighted by 1/m.
    fn residual(&mut self, law: &mut dyn ForceLaw<R>, w: &[R], state: &State<R>, h: R, v: &[[R; 3]]) -> f64 {
        for i in 0..w.len() {
            self.x[i] = std::array::from_fn(|k| state.position[i][k] + h * v[i][k]);
        }
        law.force(&self.x, v, &mut self.force);
        let mut sum = 0.0;
        for i in 0..w.len() {
            for k in 0..3 {
                let r = if w[i] > R::zero() {
                    (state.velocity[i][k] - v[i][k]) / w[i] + h * self.force[i][k]
                } else {
                    R::zero()
                };
                self.residual[i][k] = r;
                sum += (r * r * w[i]).to_f64();
            }
        }
        sum.sqrt()
    }

    /// Solves (M - h dF) delta = residual; preconditioned with the mass.
    fn solve(&mut self, law: &mut dyn ForceLaw<R>, w: &[R], state: &State<R>, h: R, v: &[[R; 3]], tolerance: f64) {
        let n = w.len();
        let dot = |a: &[[R; 3]], b: &[[R; 3]], w: Option<&[R]>| -> f64 {
            (0..n)
                .map(|i| {
                    let s = a[i][0] * b[i][0] + a[i][1] * b[i][1] + a[i][2] * b[i][2];
                    w.map_or(s, |w| s * w[i]).to_f64()
                })
                .sum()
        };
        self.delta.fill([R::zero(); 3]);
        self.r.copy_from_slice(&self.residual);
        for i in 0..n {
            self.p[i] = self.r[i].map(|r| r * w[i]);
        }
        let mut rz = dot(&self.r, &self.r, Some(w));
        let goal = rz * tolerance * tolerance;
        for _ in 0..LINEAR_LIMIT {
            if rz <= goal || rz == 0.0 {
                break;
            }
            self.product(law, w, state, h, v);
            let curvature = dot(&self.p, &self.q, None);
            if curvature.is_nan() || curvature <= 0.0 {
                if self.delta.iter().all(|d| *d == [R::zero(); 3]) {
                    self.delta.copy_from_slice(&self.p);
                }
                break;
            }
            let alpha = R::from_f64(rz / curvature);
            for i in 0..n {
                for k in 0..3 {
                    self.delta[i][k] += alpha * self.p[i][k];
                    self.r[i][k] -= alpha * self.q[i][k];
                }
            }
            let next = dot(&self.r, &self.r, Some(w));
            let beta = R::from_f64(next / rz);
            rz = next;
            for i in 0..n {
                self.p[i] = std::array::from_fn(|k| self.r[i][k] * w[i] + beta * self.p[i][k]);
            }
        }
    }

    /// q = (M - h dF) p around the velocities v.
    fn product(&mut self, law: &mut dyn ForceLaw<R>, w: &[R], state: &State<R>, h: R, v: &[[R; 3]]) {
        let n = w.len();
        let largest = |l: &[[R; 3]]| l.iter().flatten().fold(0.0f64, |m, x| m.max(x.to_f64().abs()));
        let scale = largest(&self.p);
        let size = largest(&state.position).max(h.to_f64() * largest(v)).max(1e-6);
        // a displacement of the cube root of the rounding error, relative to the body
        let e = R::from_f64(R::EPSILON.to_f64().cbrt() * size / (scale * h.to_f64()));
        self.q.fill([R::zero(); 3]);
        for sign in [R::one(), -R::one()] {
            for i in 0..n {
                self.trial[i] = std::array::from_fn(|k| v[i][k] + sign * e * self.p[i][k]);
                self.x[i] = std::array::from_fn(|k| state.position[i][k] + h * self.trial[i][k]);
            }
            law.force(&self.x, &self.trial, &mut self.force);
            for i in 0..n {
                (0..3).for_each(|k| self.q[i][k] += sign * self.force[i][k]);
            }
        }
        let slope = h / (e + e);
        for i in 0..n {
            let fixed = w[i] <= R::zero();
            self.q[i] =
                std::array::from_fn(|k| if fixed { R::zero() } else { self.p[i][k] / w[i] - slope * self.q[i][k] });
        }
    }
}
