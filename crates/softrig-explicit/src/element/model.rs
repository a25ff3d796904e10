//! Cells as the force model of a body: forces, stiffness, energy, and the rotations as history.
#![allow(non_snake_case, reason = "symbols of the continuum mechanics literature")]

use super::follow::Still;
use super::kernel::{Input, LinearTwice};
use super::{ElementWise, Warping, warp};
use crate::part;
use softrig::force::polar::{rotation, symmetric};
use softrig::force::{ForceModel, Increment};
use softrig_linalg::{BlockCsr, Mat3, Scalar, Vec3, run_wide};

impl<R: Scalar, const N: usize> ForceModel<R> for ElementWise<R, N> {
    /// Rotations follow with the next force.
    fn linearise(&mut self, position: &[[R; 3]]) {
        self.linearised.copy_from_slice(position);
    }

    fn force(&mut self, position: &[[R; 3]], increment: Increment<'_, R>, force: &mut [[R; 3]]) -> f64 {
        self.calls = 0;
        let zero = vec![[R::zero(); 3]; position.len()];
        let velocity = increment.velocity.unwrap_or(&zero);
        self.internal_force(position, velocity, increment.damping, force);
        if let Some(d) = increment.displacement {
            // K d is what damping with b = 1 and v = d would be, less the rest
            let (mut with, mut without) = (zero.clone(), zero.clone());
            let uniform = self.uniform.then_some(R::one());
            for (out, velocity) in [(&mut with, d), (&mut without, &zero[..])] {
                let input = Input { position, velocity, damping: R::zero(), uniform };
                let warped = self.warping == Warping::Stiffness;
                part::run(
                    &mut self.parts,
                    |c| c.part.own.clone(),
                    out,
                    |cells, out| {
                        let own: Vec<[R; N]> = cells.groups.iter().map(|g| g.damping).collect();
                        cells.groups.iter_mut().for_each(|g| g.damping = [R::one(); N]);
                        if warped {
                            warp(cells, input, Still, true, out);
                        } else {
                            run_wide::<R, _>(LinearTwice { cells, input, out });
                        }
                        cells.groups.iter_mut().zip(own).for_each(|(g, b)| g.damping = b);
                    },
                );
            }
            for ((f, a), b) in force.iter_mut().zip(with).zip(without) {
                (0..3).for_each(|k| f[k] += a[k] - b[k]);
            }
        }
        self.energy(position)
    }

    fn stiffness(&mut self, rate: R, damping: R, matrix: &mut BlockCsr<R>) {
        if self.warping == Warping::Stiffness {
            self.calls = 0;
            let position = std::mem::take(&mut self.linearised);
            let mut force = vec![[R::zero(); 3]; position.len()];
            let zero = force.clone();
            self.internal_force(&position, &zero, R::zero(), &mut force);
            self.linearised = position;
        }
        let q = self.quaternions();
        matrix.values.fill([R::zero(); 9]);
        for ((cell, c), q) in self.nodes.iter().zip(&self.constants).zip(q) {
            let rot = rotation(q.map(Scalar::to_f64));
            let g = c.gradient.map(|g| rot * Vec3(g));
            let g = [-(g[0] + g[1] + g[2]), g[0], g[1], g[2]];
            let factor = 1.0 + rate.to_f64() * (c.damping + damping.to_f64());
            for a in 0..4 {
                for b in 0..4 {
                    let at = matrix.pattern.find(cell[a] as usize, cell[b] as usize);
                    let at = at.expect("the pattern is that of the body's cells");
                    let k = g[a].outer(g[b]).scale(c.lambda)
                        + g[b].outer(g[a]).scale(c.mu)
                        + Mat3::diagonal(c.mu * g[a].dot(g[b]));
                    let block = &mut matrix.values[at];
                    (0..9).for_each(|i| block[i] += R::from_f64(factor * k.0[i / 3][i % 3]));
                }
            }
        }
    }

    fn save(&mut self) {
        self.parts.iter_mut().for_each(|c| c.saved.copy_from_slice(&c.q));
    }

    fn roll_back(&mut self) {
        self.parts.iter_mut().for_each(|c| c.q.copy_from_slice(&c.saved));
    }

    fn history(&self) -> Vec<[R; 4]> {
        self.quaternions()
    }

    fn restore(&mut self, history: &[[R; 4]]) {
        // what was turned by another history is far from these positions: one step would not find it
        self.calls = 0;
        let cold = [R::zero(), R::zero(), R::zero(), R::one()];
        for cells in &mut self.parts {
            for (cell, q) in cells.cell.iter().zip(&mut cells.q) {
                let known = cell.iter().rev().find(|c| **c != u32::MAX).copied().unwrap_or(0);
                for l in 0..N {
                    let c = if cell[l] == u32::MAX { known } else { cell[l] };
                    let value = if history.len() == self.nodes.len() { history[c as usize] } else { cold };
                    (0..4).for_each(|k| q[k][l] = value[k]);
                }
            }
        }
    }
}

impl<R: Scalar, const N: usize> ElementWise<R, N> {
    /// Elastic energy with the rotations of the last force [J].
    fn energy(&self, position: &[[R; 3]]) -> f64 {
        let warped = self.warping == Warping::Stiffness;
        let q = self.quaternions();
        let mut sum = 0.0;
        for ((cell, c), q) in self.nodes.iter().zip(&self.constants).zip(q) {
            let x = cell.map(|n| Vec3(position[n as usize].map(Scalar::to_f64)));
            let F = (x[1] - x[0]).outer(Vec3(c.gradient[0]))
                + (x[2] - x[0]).outer(Vec3(c.gradient[1]))
                + (x[3] - x[0]).outer(Vec3(c.gradient[2]));
            let F = if warped { rotation(q.map(Scalar::to_f64)).transpose() * F } else { F };
            let E = symmetric(F) - Mat3::identity();
            let square: f64 = (0..3).map(|i| E.row(i).dot(E.row(i))).sum();
            sum += c.mu * square + 0.5 * c.lambda * E.trace() * E.trace();
        }
        sum
    }
}
