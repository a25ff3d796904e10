//! Ramps: how a constraint comes to act when what it holds is far apart.
//!
//! Two kinds. A **force ramp** is [Gissler2006 §4.5], j/n of the force in step j. It closes a gap within some 2 ∛n steps, however large
//! n is, since nodes keep the speed they are given: x'' = -(j/n) x/h² is the equation of Airy. An **approach** lets the gap g0
//! that is there at the start go to zero as (1 - σ(j/n)) g0 with σ(s) = 3 s² - 2 s³, met exactly in every step: no node is faster relative
//! to another than 1.5 |g0| / (n h), and forces still sum to zero.

use super::set::Slot;
use super::work::Work;
use super::{Constraint, ConstraintError, ConstraintId, Constraints};
use softrig_linalg::Scalar;

/// How far a constraint is on its ramp, and whether it acts.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Progress {
    /// It is switched on.
    pub active: bool,
    /// Steps of the ramp.
    pub steps: u32,
    /// How many of them are done.
    pub done: u32,
    /// Gaps at the start of an approach [m]; empty before its first step. `None`: a force ramp.
    pub gap: Option<Vec<[f64; 3]>>,
}

impl Constraints {
    /// Lets a constraint's force grow over `steps` steps: j/n of it in step j, all of it from step n on [Gissler2006 §4.5]. The constraint is
    /// met exactly once the ramp is over. For parts that come from far away [`Self::approach`] is gentler.
    ///
    /// # Errors
    /// [`ConstraintError::Unknown`].
    pub fn ramp(&mut self, id: ConstraintId, steps: u32) -> Result<(), ConstraintError> {
        self.start_ramp(id, steps, None)
    }

    /// Lets the gap that a constraint finds close over `steps` steps, slowly at both ends: for parts that assemble themselves from far away. The
    /// fastest they come together is 1.5 times the gap over the time of these steps. A velocity has no gap, and the nearest place of a surface
    /// is another one in every step; their forces grow as with [`Self::ramp`].
    ///
    /// # Errors
    /// [`ConstraintError::Unknown`].
    pub fn approach(&mut self, id: ConstraintId, steps: u32) -> Result<(), ConstraintError> {
        let free = matches!(self.get(id)?, Constraint::Velocity { .. } | Constraint::PointToSurface { .. });
        let gap = if free { None } else { Some(Vec::new()) };
        self.start_ramp(id, steps, gap)
    }

    fn start_ramp(&mut self, id: ConstraintId, steps: u32, gap: Option<Vec<[f64; 3]>>) -> Result<(), ConstraintError> {
        let slot = self.slot_mut(id)?;
        slot.ramp = (steps, 0);
        slot.gap = gap;
        self.plan.ramps |= steps > 1;
        Ok(())
    }

    /// How far a constraint is.
    ///
    /// # Errors
    /// [`ConstraintError::Unknown`].
    pub fn progress(&self, id: ConstraintId) -> Result<Progress, ConstraintError> {
        let slot = self.slot(id)?;
        Ok(Progress { active: slot.active, steps: slot.ramp.0, done: slot.ramp.1, gap: slot.gap.clone() })
    }

    /// Switches a constraint and puts its ramp to where it was.
    ///
    /// # Errors
    /// As [`Self::set_active`].
    pub fn set_progress(&mut self, id: ConstraintId, progress: &Progress) -> Result<(), ConstraintError> {
        self.set_active(id, progress.active)?;
        let slot = self.slot_mut(id)?;
        slot.ramp = (progress.steps, progress.done.min(progress.steps));
        let count = gap_count(&slot.constraint);
        slot.gap = progress.gap.clone().filter(|g| g.is_empty() || g.len() == count);
        self.plan.ramps |= slot_runs(self.slot(id)?);
        Ok(())
    }

    /// Forgets the gaps of approaches whose first step was not taken.
    pub(crate) fn abandon(&mut self) {
        for slot in self.slots.iter_mut().flatten().filter(|s| s.ramp.1 == 0) {
            if let Some(gap) = &mut slot.gap {
                gap.clear();
            }
        }
    }

    /// Takes down the gaps of approaches that begin in this step.
    pub(super) fn begin_approaches<R: Scalar>(&mut self, position: &[[R; 3]], inverse_mass: &[R]) {
        let at = |n: u32| position[n as usize].map(Scalar::to_f64);
        let minus = |a: [f64; 3], b: [f64; 3]| -> [f64; 3] { std::array::from_fn(|k| a[k] - b[k]) };
        for slot in self.slots.iter_mut().flatten().filter(|s| s.active && slot_runs(s)) {
            let Some(gap) = slot.gap.as_mut().filter(|g| g.is_empty()) else { continue };
            let on = |node: u32, carriers: &[u32], weights: &[f64]| {
                let place = carriers.iter().zip(weights).fold([0.0; 3], |sum: [f64; 3], (n, a)| {
                    let x = at(*n);
                    std::array::from_fn(|k| sum[k] + a * x[k])
                });
                minus(place, at(node))
            };
            match &slot.constraint {
                Constraint::Nail { node, goal } => gap.push(minus(at(*node), *goal)),
                Constraint::PointsToPoint { nodes } if nodes.len() == 2 => gap.push(minus(at(nodes[1]), at(nodes[0]))),
                Constraint::PointsToPoint { nodes } => {
                    let goal = Work::meeting_place(nodes, inverse_mass, position).unwrap_or(at(nodes[0]));
                    gap.extend(nodes.iter().map(|n| minus(at(*n), goal)));
                }
                Constraint::PointToLine { node, carriers, weights } => gap.push(on(*node, carriers, weights)),
                Constraint::PointToTriangle { node, carriers, weights } => gap.push(on(*node, carriers, weights)),
                Constraint::PointToTetrahedron { node, carriers, weights } => gap.push(on(*node, carriers, weights)),
                Constraint::Velocity { .. } | Constraint::PointToSurface { .. } => {}
            }
        }
    }
}

/// Gaps of a constraint.
fn gap_count(constraint: &Constraint) -> usize {
    match constraint {
        Constraint::PointsToPoint { nodes } if nodes.len() > 2 => nodes.len(),
        Constraint::Velocity { .. } | Constraint::PointToSurface { .. } => 0,
        _ => 1,
    }
}

fn slot_runs(slot: &Slot) -> bool {
    slot.ramp.1 < slot.ramp.0
}

impl Slot {
    /// Part of the force that acts in this step.
    pub(super) fn share(&self) -> f64 {
        let (steps, done) = self.ramp;
        if self.gap.is_some() || done + 1 >= steps { 1.0 } else { f64::from(done + 1) / f64::from(steps) }
    }

    /// What is to be left of gap `k` at the end of this step [m].
    pub(super) fn left(&self, k: usize) -> Option<[f64; 3]> {
        let (steps, done) = self.ramp;
        if done + 1 >= steps {
            return None;
        }
        let gap = self.gap.as_ref()?.get(k)?;
        let s = f64::from(done + 1) / f64::from(steps);
        let rest = 1.0 - s * s * (3.0 - 2.0 * s);
        Some(gap.map(|g| g * rest))
    }

    /// How fast that changes then, for steps of `dt` [m/s].
    pub(super) fn closing(&self, k: usize, dt: f64) -> Option<[f64; 3]> {
        let (steps, done) = self.ramp;
        if done + 1 >= steps {
            return None;
        }
        let gap = self.gap.as_ref()?.get(k)?;
        let s = f64::from(done + 1) / f64::from(steps);
        Some(gap.map(|g| -6.0 * s * (1.0 - s) * g / (f64::from(steps) * dt)))
    }
}
