//! One damped oscillator per mode, advanced exactly.
//!
//! q'' + (a + b ω²) q' + ω² q = φᵀ f, with f constant over a step: x' and v' follow from the closed solution for any step length, so
//! nothing can become unstable. a and b are the Rayleigh coefficients of the body's material.

use super::warp::{curls, turn};
use super::{ModalError, Modes};
use crate::frames::check;
use glam::DVec3;
use softrig::body::Body;
use softrig::integrate::{Integrator, State, StepError, StepInput, StepOutput};
use softrig_linalg::{LinearSolver, Scalar};

/// Advances a body in its lowest modes.
#[derive(Clone, Debug)]
pub struct ModalIntegrator {
    modes: Modes,
    /// φ of all modes at each node, mode after mode: `shape[node * modes + mode]`.
    shape: Vec<[f64; 3]>,
    /// Half the curl of φ in the same order; empty without warping.
    curl: Vec<[f64; 3]>,
    rest: Vec<[f64; 3]>,
    /// a and b.
    damping: (f64, f64),
    q: Vec<f64>,
    rate: Vec<f64>,
    load: Vec<f64>,
    turned: Vec<DVec3>,
}

impl ModalIntegrator {
    /// The lowest `count` modes of a body whose prescribed nodes stay at rest. `damping` are the Rayleigh coefficients a [1/s] and b [s].
    ///
    /// # Errors
    /// [`ModalError`].
    pub fn new<R: Scalar>(body: &mut Body<R>, count: usize, damping: (f64, f64)) -> Result<Self, ModalError> {
        let modes = Modes::new(body, count)?;
        let rest = body.mesh.nodes.clone();
        let shape = by_node(&modes.shape, rest.len());
        let zero = vec![0.0; count];
        let turned = vec![DVec3::ZERO; rest.len()];
        Ok(Self {
            modes,
            shape,
            curl: Vec::new(),
            rest,
            damping,
            q: zero.clone(),
            rate: zero.clone(),
            load: zero,
            turned,
        })
    }

    /// With modal warping: large turns no longer swell the body.
    #[must_use]
    pub fn warped<R: Scalar>(mut self, body: &Body<R>) -> Self {
        self.curl = curls(&body.mesh, &self.modes.shape).map_or_else(Vec::new, |c| by_node(&c, self.rest.len()));
        self
    }

    /// The modes.
    #[must_use]
    pub fn modes(&self) -> &Modes {
        &self.modes
    }

    /// Amplitudes q of the modes [m sqrt(kg)].
    #[must_use]
    pub fn amplitudes(&self) -> &[f64] {
        &self.q
    }

    /// Sets amplitudes and their rates to those of displacements and velocities, as far as the modes can follow.
    ///
    /// # Panics
    /// When the state has another length than the body.
    pub fn set_state<R: Scalar, S: Scalar>(&mut self, body: &Body<R>, state: &State<S>) {
        assert_eq!(state.position.len(), self.rest.len(), "one position per node");
        self.q.fill(0.0);
        self.rate.fill(0.0);
        let count = self.q.len();
        for (i, shape) in self.shape.chunks_exact(count).enumerate() {
            let m = body.mass[i].to_f64();
            for (k, s) in shape.iter().enumerate() {
                for c in 0..3 {
                    self.q[k] += s[c] * m * (state.position[i][c].to_f64() - self.rest[i][c]);
                    self.rate[k] += s[c] * m * state.velocity[i][c].to_f64();
                }
            }
        }
    }

    /// Elastic and kinetic energy of all modes [J].
    #[must_use]
    pub fn energies(&self) -> (f64, f64) {
        let elastic = self.q.iter().zip(&self.modes.frequency).map(|(q, w)| 0.5 * (w * q).powi(2)).sum();
        (elastic, self.rate.iter().map(|r| 0.5 * r * r).sum())
    }

    /// One step under the forces `external` [N]; writes positions [m] and velocities [m/s].
    ///
    /// # Panics
    /// When a list has another length than the body.
    pub fn advance<R: Scalar>(
        &mut self,
        dt: f64,
        external: &[[R; 3]],
        position: &mut [[R; 3]],
        velocity: &mut [[R; 3]],
    ) {
        let count = self.q.len();
        let n = self.rest.len();
        assert!(external.len() == n && position.len() == n && velocity.len() == n, "one entry per node");
        self.load.fill(0.0);
        for (i, shape) in self.shape.chunks_exact(count).enumerate() {
            let mut f = DVec3::from(external[i].map(Scalar::to_f64));
            if !self.curl.is_empty() {
                // into the frame of the node at the start of the step
                f = turn(self.turned[i]).0.transpose() * f;
            }
            for (l, s) in self.load.iter_mut().zip(shape) {
                *l += s[0] * f.x + s[1] * f.y + s[2] * f.z;
            }
        }
        let (a, b) = self.damping;
        for k in 0..count {
            let w2 = self.modes.frequency[k].powi(2);
            (self.q[k], self.rate[k]) = oscillate(self.q[k], self.rate[k], w2, a + b * w2, self.load[k], dt);
        }
        for (i, shape) in self.shape.chunks_exact(count).enumerate() {
            let (mut u, mut v) = ([0.0; 3], [0.0; 3]);
            for ((s, q), r) in shape.iter().zip(&self.q).zip(&self.rate) {
                for c in 0..3 {
                    u[c] += s[c] * q;
                    v[c] += s[c] * r;
                }
            }
            let (mut u, mut v) = (DVec3::from(u), DVec3::from(v));
            if !self.curl.is_empty() {
                let curl = &self.curl[i * count..(i + 1) * count];
                let w: DVec3 = curl.iter().zip(&self.q).map(|(c, q)| DVec3::from(*c) * *q).sum();
                self.turned[i] = w;
                let (rotation, mean) = turn(w);
                (u, v) = (mean * u, rotation * v);
            }
            position[i] = std::array::from_fn(|c| R::from_f64(self.rest[i][c] + u[c]));
            velocity[i] = v.to_array().map(R::from_f64);
        }
    }
}

fn by_node(modes: &[Vec<[f64; 3]>], nodes: usize) -> Vec<[f64; 3]> {
    (0..nodes).flat_map(|i| modes.iter().map(move |m| m[i])).collect()
}

/// q and q' after `h` of q'' + d q' + w2 q = f.
fn oscillate(q: f64, rate: f64, w2: f64, d: f64, f: f64, h: f64) -> (f64, f64) {
    let half = 0.5 * d;
    if w2 * h * h < 1e-18 {
        // nothing pulls it back: drag only
        if d * h < 1e-9 {
            return (q + h * rate + 0.5 * h * h * f, rate + h * f);
        }
        let e = (-d * h).exp();
        let last = f / d;
        return (q + last * h + (rate - last) * (1.0 - e) / d, last + (rate - last) * e);
    }
    let target = f / w2;
    let x = q - target;
    let inner = w2 - half * half;
    // x(h) = e^{-half h} (x cos + (rate + half x) sin / w): sine and cosine, or hyperbolic ones
    let s = inner.abs().sqrt();
    let (c, sn) = if s * h < 1e-6 {
        (1.0, h)
    } else if inner > 0.0 {
        ((s * h).cos(), (s * h).sin() / s)
    } else {
        // e^{-half h} cosh(s h) without overflow: both exponents are negative
        let (p, m) = (((s - half) * h).exp(), ((-s - half) * h).exp());
        let (c, sn) = (0.5 * (p + m), 0.5 * (p - m) / s);
        let next = x * c + (rate + half * x) * sn;
        return (target + next, rate * c - (half * rate + w2 * x) * sn);
    };
    let e = (-half * h).exp();
    let next = e * (x * c + (rate + half * x) * sn);
    (target + next, e * (rate * c - (half * rate + w2 * x) * sn))
}

impl<R: Scalar> Integrator<R> for ModalIntegrator {
    fn name(&self) -> &'static str {
        "modal"
    }

    fn step(
        &mut self,
        body: &mut Body<R>,
        _solver: &mut dyn LinearSolver<R>,
        input: &StepInput<'_, R>,
        state: &mut State<R>,
        output: &mut StepOutput<R>,
    ) -> Result<(), StepError> {
        let n = self.rest.len();
        check(n, input, state)?;
        if body.mass.len() != n {
            return Err(StepError::Unsupported(format!("modes of {n} nodes on a body of {}", body.mass.len())));
        }
        for (i, rest) in self.rest.iter().enumerate() {
            let moved = (0..3).any(|k| (input.target_position[i][k].to_f64() - rest[k]).abs() > 1e-9);
            if body.constraints.is_constrained(i) && moved {
                return Err(StepError::Unsupported(format!("modes of a body whose prescribed node {i} moves")));
            }
        }
        self.advance(input.dt, input.external_force, &mut state.position, &mut state.velocity);
        state.time += input.dt;
        output.iterations = 0;
        output.residual = 0.0;
        output.converged = true;
        output.guarded = false;
        output.reaction.clear();
        output.reaction.resize(n, [R::zero(); 3]);
        (output.elastic_energy, output.kinetic_energy) = self.energies();
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::oscillate;

    /// Every branch against many small steps of the definition.
    #[test]
    fn oscillators_are_exact() {
        for (w2, d) in [(40.0, 0.5), (40.0, 30.0), (1.0, 2.0), (0.0, 0.7), (0.0, 0.0), (1e-30, 0.0)] {
            let (mut q, mut r) = (0.3f64, -0.8f64);
            let (h, n) = (0.7, 200_000);
            let step = h / f64::from(n);
            for _ in 0..n {
                let a = 1.3 - d * r - w2 * q;
                let (qm, rm) = (q + 0.5 * step * r, r + 0.5 * step * a);
                (q, r) = (q + step * rm, r + step * (1.3 - d * rm - w2 * qm));
            }
            let (x, v) = oscillate(0.3, -0.8, w2, d, 1.3, h);
            assert!((x - q).abs() < 1e-8 && (v - r).abs() < 1e-8, "{w2} {d}: {x} {q}, {v} {r}");
        }
    }
}
