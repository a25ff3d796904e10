//! Elastic bodies as force laws.

use crate::clustered::Clustered;
use crate::element::ElementWise;
use crate::mass_point::MassPoints;
use crate::stepper::ForceLaw;
use softrig_linalg::Scalar;

/// Elastic forces without an energy or a matrix: what an explicit step needs, as fast as it goes.
pub trait InternalForce<R>: Send {
    /// Writes f_int(x, v) [N] with the stiffness damping of the materials; sign as on the left of `M a + f_int = f_ext`.
    fn internal_force(&mut self, position: &[[R; 3]], velocity: &[[R; 3]], force: &mut [[R; 3]]);
}

impl<R: Scalar> InternalForce<R> for Box<dyn InternalForce<R>> {
    fn internal_force(&mut self, position: &[[R; 3]], velocity: &[[R; 3]], force: &mut [[R; 3]]) {
        (**self).internal_force(position, velocity, force);
    }
}

impl<R: Scalar> InternalForce<R> for Clustered<R> {
    fn internal_force(&mut self, position: &[[R; 3]], velocity: &[[R; 3]], force: &mut [[R; 3]]) {
        Self::internal_force(self, position, velocity, R::zero(), force);
    }
}

impl<R: Scalar, const N: usize> InternalForce<R> for ElementWise<R, N> {
    fn internal_force(&mut self, position: &[[R; 3]], velocity: &[[R; 3]], force: &mut [[R; 3]]) {
        Self::internal_force(self, position, velocity, R::zero(), force);
    }
}

/// Of mass points without their gravity and drag.
impl<R: Scalar> InternalForce<R> for MassPoints<R> {
    fn internal_force(&mut self, position: &[[R; 3]], velocity: &[[R; 3]], force: &mut [[R; 3]]) {
        let (gravity, drag) = (std::mem::take(&mut self.gravity), std::mem::take(&mut self.drag));
        self.force(position, velocity, force);
        (self.gravity, self.drag) = (gravity, drag);
        force.iter_mut().for_each(|f| *f = f.map(|f| -f));
    }
}

/// F = f_ext - f_int(x, v) - a M v.
pub struct ElasticLaw<R, F> {
    /// The elastic forces.
    pub internal: F,
    /// f_ext on every node [N].
    pub external: Vec<[R; 3]>,
    /// a M of every node [kg/s].
    pub drag: Vec<R>,
}

impl<R: Scalar, F: InternalForce<R>> ForceLaw<R> for ElasticLaw<R, F> {
    fn force(&mut self, position: &[[R; 3]], velocity: &[[R; 3]], force: &mut [[R; 3]]) {
        self.internal.internal_force(position, velocity, force);
        for (((f, e), v), d) in force.iter_mut().zip(&self.external).zip(velocity).zip(&self.drag) {
            for k in 0..3 {
                f[k] = e[k] - f[k] - *d * v[k];
            }
        }
    }
}
