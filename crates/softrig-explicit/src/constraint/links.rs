//! Constraints as linear conditions, for implicit steps that eliminate them.

use super::{Constraint, ConstraintError, ConstraintId, Constraints};
use softrig::constraint::{Link, LinkError};
use softrig_linalg::Scalar;

impl Constraint {
    /// Adds its conditions; `false` when it has none that are linear with fixed weights.
    pub(super) fn links(&self, label: u32, out: &mut Vec<Link>) -> bool {
        let on = |node: u32, carriers: &[u32], weights: &[f64]| {
            let carried = carriers.iter().copied().zip(weights.iter().copied());
            Link { terms: carried.chain([(node, -1.0)]).collect(), label }
        };
        match self {
            Self::Nail { node, .. } => out.push(Link { terms: vec![(*node, 1.0)], label }),
            // as gaps of pairs are counted
            Self::PointsToPoint { nodes } if nodes.len() == 2 => {
                out.push(Link { terms: vec![(nodes[1], 1.0), (nodes[0], -1.0)], label });
            }
            Self::PointsToPoint { nodes } => {
                out.extend(nodes[1..].iter().map(|n| Link { terms: vec![(*n, 1.0), (nodes[0], -1.0)], label }));
            }
            Self::PointToLine { node, carriers, weights } => out.push(on(*node, carriers, weights)),
            Self::PointToTriangle { node, carriers, weights } => out.push(on(*node, carriers, weights)),
            Self::PointToTetrahedron { node, carriers, weights } => out.push(on(*node, carriers, weights)),
            Self::Velocity { .. } | Self::PointToSurface { .. } => return false,
        }
        true
    }
}

impl Constraints {
    /// The linear conditions of the active constraints, for [`softrig::integrate::Linked::set_links`].
    pub fn links(&mut self) -> &[Link] {
        if self.is_stale() {
            self.replan();
        }
        &self.plan.links
    }

    /// Says how fast the goal of a nail moves [m/s], until it is moved again.
    ///
    /// # Errors
    /// [`ConstraintError::Unknown`].
    pub fn set_rate(&mut self, id: ConstraintId, rate: [f64; 3]) -> Result<(), ConstraintError> {
        self.slot_mut(id)?.rate = rate;
        Ok(())
    }

    /// Goals and rates of [`Self::links`] at the end of a step of `dt` [s] from `position`, in which approaches begin that have not.
    ///
    /// # Errors
    /// [`ConstraintError::ForceRamp`].
    pub fn link_goals<R: Scalar>(
        &mut self,
        dt: f64,
        inverse_mass: &[R],
        position: &[[R; 3]],
    ) -> Result<(Vec<[f64; 3]>, Vec<[f64; 3]>), ConstraintError> {
        if self.is_stale() {
            self.replan();
        }
        if self.plan.ramps {
            self.begin_approaches(position, inverse_mass);
        }
        let (mut goal, mut rate) = (Vec::new(), Vec::new());
        let mut member = 0;
        for (i, link) in self.plan.links.iter().enumerate() {
            member = if i > 0 && self.plan.links[i - 1].label == link.label { member + 1 } else { 0 };
            let Some(slot) = &self.slots[link.label as usize] else { continue };
            if slot.share() < 1.0 {
                return Err(ConstraintError::ForceRamp { kind: slot.constraint.kind(), id: link.label });
            }
            let minus = |a: Option<[f64; 3]>, b: Option<[f64; 3]>| -> [f64; 3] {
                let (a, b) = (a.unwrap_or_default(), b.unwrap_or_default());
                std::array::from_fn(|k| a[k] - b[k])
            };
            let (at, speed) = match &slot.constraint {
                Constraint::Nail { goal, .. } => (Some(*goal), Some(slot.rate)),
                _ => (None, None),
            };
            let (left, closing) = match &slot.constraint {
                Constraint::PointsToPoint { nodes } if nodes.len() > 2 => {
                    let k = member + 1;
                    (minus(slot.left(k), slot.left(0)), minus(slot.closing(k, dt), slot.closing(0, dt)))
                }
                _ => (minus(slot.left(0), None), minus(slot.closing(0, dt), None)),
            };
            let plus = |a: Option<[f64; 3]>, b: [f64; 3]| -> [f64; 3] {
                std::array::from_fn(|k| a.unwrap_or_default()[k] + b[k])
            };
            goal.push(plus(at, left));
            rate.push(plus(speed, closing));
        }
        Ok((goal, rate))
    }

    /// Forgets the forces of the last step.
    pub(crate) fn clear_forces(&mut self) {
        self.force.fill([0.0; 3]);
    }

    /// Takes down the forces of links, and what moved nodes after them on top of it.
    pub(crate) fn take_forces(&mut self, force: &[[f64; 3]]) {
        if self.has_local() {
            for (to, from) in self.force.iter_mut().zip(force) {
                (0..3).for_each(|k| to[k] += from[k]);
            }
        } else {
            self.force.copy_from_slice(force);
        }
    }

    /// What links are called here.
    pub(crate) fn named(&self, error: LinkError) -> ConstraintError {
        let LinkError::Conflict { labels, by } = error else { return error.into() };
        let name = |id: &u32| {
            let kind = self.slot(ConstraintId(*id)).map_or("", |s| s.constraint.kind());
            format!("{kind} {id}")
        };
        let (last, first) = labels.split_last().expect("a contradiction has links");
        let first: Vec<String> = first.iter().map(name).collect();
        let names = if first.is_empty() { name(last) } else { format!("{} and {}", first.join(", "), name(last)) };
        ConstraintError::Contradiction { names, by }
    }
}
