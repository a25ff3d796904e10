//! The constraints of a body, switched on and off while it moves.

use super::work::{Carried, Work};
use super::{Constraint, ConstraintError, ConstraintId, Surface, SurfaceId};
use crate::scheme::Scheme;
use rayon::prelude::*;
use softrig::constraint::Link;
use softrig::integrate::State;
use softrig_linalg::Scalar;

/// Nodes of a stretch, whose pairs are one task: at some 15 ns a pair, less is not worth waking a thread for.
const STRETCH: usize = 2048;

/// Number and nodes of two points that are to be one.
pub(super) type Pair = (u32, [u32; 2]);

/// Weights may miss the sum 1 by this much.
const WEIGHT_SLACK: f64 = 1e-9;

#[derive(Clone, Debug)]
pub(super) struct Slot {
    pub(super) constraint: Constraint,
    pub(super) active: bool,
    /// Steps until the constraint is met, and how many of them are done.
    pub(super) ramp: (u32, u32),
    /// Gaps when the ramp began, if it closes them evenly; empty before that.
    pub(super) gap: Option<Vec<[f64; 3]>>,
    /// Velocity of a goal that moves [m/s].
    pub(super) rate: [f64; 3],
}

impl Slot {
    fn new(constraint: Constraint, active: bool) -> Self {
        Self { constraint, active, ramp: (0, 0), gap: None, rate: [0.0; 3] }
    }
}

/// Constraints on the nodes of one body (or of several that are stepped together).
#[derive(Clone, Debug)]
pub struct Constraints {
    node_count: usize,
    pub(super) slots: Vec<Option<Slot>>,
    /// Number + 1 of the active constraint that holds each node.
    pub(super) holder: Vec<u32>,
    surfaces: Vec<Surface>,
    pub(super) plan: Plan,
    stale: bool,
    pub(super) force: Vec<[f64; 3]>,
    /// Nodes of the carriers that slides took in the last step: their forces are to be cleared.
    slid: Vec<u32>,
    /// How many constraints that are eliminated hold each node, which may be several; empty where forces meet all of them.
    shared: Vec<u32>,
}

/// The active constraints, one flat list per kind.
#[derive(Clone, Debug, Default)]
pub(super) struct Plan {
    pub(super) nails: Vec<(u32, u32, [f64; 3])>,
    pub(super) velocities: Vec<(u32, u32, [f64; 3])>,
    /// Pairs of nodes of one stretch, stretch after stretch.
    pub(super) near: Vec<Vec<Pair>>,
    /// All others.
    pub(super) pairs: Vec<Pair>,
    pub(super) groups: Vec<(u32, Vec<u32>)>,
    pub(super) carried: Vec<Carried>,
    slides: Vec<(u32, u32, u32)>,
    /// What is eliminated; the label is the number of the constraint.
    pub(super) links: Vec<Link>,
    /// Some constraint has not reached its whole force.
    pub(super) ramps: bool,
}

impl Constraints {
    /// No constraints, for a body of so many nodes.
    #[must_use]
    pub fn new(node_count: usize) -> Self {
        Self {
            node_count,
            slots: Vec::new(),
            holder: vec![0; node_count],
            surfaces: Vec::new(),
            plan: Plan::default(),
            stale: false,
            force: vec![[0.0; 3]; node_count],
            slid: Vec::new(),
            shared: Vec::new(),
        }
    }

    /// No constraints, for a body whose implicit steps eliminate them: nodes may be in several, if these can all be met.
    #[must_use]
    pub fn eliminated(node_count: usize) -> Self {
        Self { shared: vec![0; node_count], ..Self::new(node_count) }
    }

    /// Adds a surface for nodes to slide on.
    ///
    /// # Errors
    /// As [`Surface::new`].
    pub fn add_surface(&mut self, triangles: Vec<[u32; 3]>) -> Result<SurfaceId, ConstraintError> {
        self.surfaces.push(Surface::new(triangles, self.node_count)?);
        Ok(SurfaceId(self.surfaces.len() as u32 - 1))
    }

    /// Adds a constraint; it acts from the next step on.
    ///
    /// # Errors
    /// [`ConstraintError`] when it is no constraint of this body, or when an active one holds one of its nodes.
    pub fn add(&mut self, constraint: Constraint) -> Result<ConstraintId, ConstraintError> {
        let id = self.slots.len() as u32;
        self.check(id, &constraint)?;
        self.claim(id, &constraint)?;
        self.slots.push(Some(Slot::new(constraint, true)));
        self.stale = true;
        Ok(ConstraintId(id))
    }

    /// Adds a constraint that is switched off; its nodes may be those of others.
    ///
    /// # Errors
    /// [`ConstraintError`] when it is no constraint of this body.
    pub fn add_inactive(&mut self, constraint: Constraint) -> Result<ConstraintId, ConstraintError> {
        let id = self.slots.len() as u32;
        self.check(id, &constraint)?;
        self.slots.push(Some(Slot::new(constraint, false)));
        Ok(ConstraintId(id))
    }

    /// Takes a constraint away; its number is not given again.
    ///
    /// # Errors
    /// [`ConstraintError::Unknown`].
    pub fn remove(&mut self, id: ConstraintId) -> Result<(), ConstraintError> {
        self.set_active(id, false)?;
        self.slots[id.0 as usize] = None;
        Ok(())
    }

    /// Switches a constraint on or off. What is switched on begins its ramp anew.
    ///
    /// # Errors
    /// [`ConstraintError::Conflict`] when another active constraint holds one of its nodes, [`ConstraintError::Unknown`].
    pub fn set_active(&mut self, id: ConstraintId, active: bool) -> Result<(), ConstraintError> {
        let slot = self.slot(id)?;
        if slot.active == active {
            return Ok(());
        }
        let constraint = slot.constraint.clone();
        if active {
            self.claim(id.0, &constraint)?;
        } else {
            self.release(id.0, &constraint);
        }
        let slot = self.slots[id.0 as usize].as_mut().expect("it was found above");
        slot.active = active;
        slot.rate = [0.0; 3];
        slot.ramp.1 = 0;
        if let Some(gap) = &mut slot.gap {
            gap.clear();
        }
        self.stale = true;
        Ok(())
    }

    /// Moves a nail [m], or changes a prescribed velocity [m/s].
    ///
    /// # Errors
    /// [`ConstraintError::Unknown`], [`ConstraintError::NoGoal`], [`ConstraintError::NotFinite`].
    pub fn set_goal(&mut self, id: ConstraintId, to: [f64; 3]) -> Result<(), ConstraintError> {
        let kind = self.slot(id)?.constraint.kind();
        if !to.iter().all(|x| x.is_finite()) {
            return Err(ConstraintError::NotFinite { kind, id: id.0, goal: to });
        }
        let slot = self.slots[id.0 as usize].as_mut().expect("it was found above");
        let (Constraint::Nail { goal, .. } | Constraint::Velocity { goal, .. }) = &mut slot.constraint else {
            return Err(ConstraintError::NoGoal { kind, id: id.0 });
        };
        *goal = to;
        slot.rate = [0.0; 3];
        // lists are in the order of the numbers
        for list in [&mut self.plan.nails, &mut self.plan.velocities] {
            if let Ok(at) = list.binary_search_by_key(&id.0, |l| l.0) {
                list[at].2 = to;
            }
        }
        Ok(())
    }

    /// The constraint of this number.
    ///
    /// # Errors
    /// [`ConstraintError::Unknown`].
    pub fn get(&self, id: ConstraintId) -> Result<&Constraint, ConstraintError> {
        Ok(&self.slot(id)?.constraint)
    }

    /// Is it switched on?
    ///
    /// # Errors
    /// [`ConstraintError::Unknown`].
    pub fn is_active(&self, id: ConstraintId) -> Result<bool, ConstraintError> {
        Ok(self.slot(id)?.active)
    }

    /// How many are switched on.
    #[must_use]
    pub fn active_count(&self) -> usize {
        self.slots.iter().flatten().filter(|s| s.active).count()
    }

    /// A surface.
    ///
    /// # Errors
    /// [`ConstraintError::Unknown`].
    pub fn surface(&self, id: SurfaceId) -> Result<&Surface, ConstraintError> {
        self.surfaces.get(id.0 as usize).ok_or(ConstraintError::Unknown { what: "surface", id: id.0 })
    }

    /// Constraint force on every node in the last step [N]; zero where no constraint acts.
    #[must_use]
    pub fn force(&self) -> &[[f64; 3]] {
        &self.force
    }

    pub(super) fn slot_mut(&mut self, id: ConstraintId) -> Result<&mut Slot, ConstraintError> {
        let slot = self.slots.get_mut(id.0 as usize).and_then(Option::as_mut);
        slot.ok_or(ConstraintError::Unknown { what: "constraint", id: id.0 })
    }

    pub(super) fn slot(&self, id: ConstraintId) -> Result<&Slot, ConstraintError> {
        let slot = self.slots.get(id.0 as usize).and_then(Option::as_ref);
        slot.ok_or(ConstraintError::Unknown { what: "constraint", id: id.0 })
    }

    fn check(&self, id: u32, constraint: &Constraint) -> Result<(), ConstraintError> {
        let kind = constraint.kind();
        let mut nodes = constraint.nodes();
        let node_count = self.node_count;
        if let Some(node) = nodes.iter().copied().find(|n| *n as usize >= node_count) {
            return Err(ConstraintError::MissingNode { kind, id, node, node_count });
        }
        if let Constraint::PointToSurface { node, surface } = constraint
            && self.surface(*surface)?.triangles().iter().flatten().any(|n| n == node)
        {
            return Err(ConstraintError::RepeatedNode { kind, id, node: *node });
        }
        if matches!(constraint, Constraint::PointsToPoint { .. }) && nodes.len() < 2 {
            return Err(ConstraintError::TooFewNodes { id, found: nodes.len() });
        }
        nodes.sort_unstable();
        if let Some(pair) = nodes.windows(2).find(|p| p[0] == p[1]) {
            return Err(ConstraintError::RepeatedNode { kind, id, node: pair[0] });
        }
        let weights = constraint.weights();
        let inside = weights.iter().all(|w| (0.0..=1.0).contains(w));
        let whole = weights.is_empty() || (weights.iter().sum::<f64>() - 1.0).abs() <= WEIGHT_SLACK;
        if !inside || !whole {
            return Err(ConstraintError::Weights { kind, id, weights: weights.to_vec() });
        }
        if let Constraint::Nail { goal, .. } | Constraint::Velocity { goal, .. } = constraint
            && !goal.iter().all(|x| x.is_finite())
        {
            return Err(ConstraintError::NotFinite { kind, id, goal: *goal });
        }
        Ok(())
    }

    fn claim(&mut self, id: u32, constraint: &Constraint) -> Result<(), ConstraintError> {
        let nodes = constraint.nodes();
        let eliminated = self.eliminates(constraint);
        for &node in &nodes {
            let holder = self.holder[node as usize];
            if holder != 0 && !(eliminated && self.shared[node as usize] > 0) {
                return Err(self.conflict(node, holder - 1, constraint.kind(), id));
            }
        }
        for n in nodes {
            self.holder[n as usize] = id + 1;
            if eliminated {
                self.shared[n as usize] += 1;
            }
        }
        Ok(())
    }

    fn release(&mut self, id: u32, constraint: &Constraint) {
        let eliminated = self.eliminates(constraint);
        for n in constraint.nodes() {
            if eliminated {
                self.shared[n as usize] -= 1;
            }
            if !eliminated || self.shared[n as usize] == 0 {
                self.holder[n as usize] = 0;
            } else if self.holder[n as usize] == id + 1 {
                // another that is still there
                let holds = |(i, s): (usize, &Option<Slot>)| {
                    let s = s.as_ref()?;
                    (i as u32 != id && s.active && s.constraint.nodes().contains(&n)).then_some(i as u32 + 1)
                };
                self.holder[n as usize] = self.slots.iter().enumerate().find_map(holds).unwrap_or(0);
            }
        }
    }

    /// Whether a constraint is met by elimination.
    fn eliminates(&self, constraint: &Constraint) -> bool {
        let local = matches!(constraint, Constraint::Velocity { .. } | Constraint::PointToSurface { .. });
        !self.shared.is_empty() && !local
    }

    fn conflict(&self, node: u32, first: u32, second_kind: &'static str, second: u32) -> ConstraintError {
        let first_kind = self.slots[first as usize].as_ref().map_or("", |s| s.constraint.kind());
        ConstraintError::Conflict { node, first_kind, first, second_kind, second }
    }

    /// Whether constraints were switched since the last call of [`Self::enforce`] or [`Self::links`].
    pub(crate) fn is_stale(&self) -> bool {
        self.stale
    }

    /// Whether some are met by forces after the step.
    pub(crate) fn has_local(&self) -> bool {
        !(self.plan.slides.is_empty() && self.plan.velocities.is_empty())
    }

    pub(super) fn replan(&mut self) {
        let plan = &mut self.plan;
        *plan = Plan { near: vec![Vec::new(); self.node_count.div_ceil(STRETCH)], ..Plan::default() };
        for (id, slot) in self.slots.iter().enumerate().filter_map(|(i, s)| Some((i as u32, s.as_ref()?))) {
            if !slot.active {
                continue;
            }
            plan.ramps |= slot.ramp.1 < slot.ramp.0;
            if !self.shared.is_empty() && slot.constraint.links(id, &mut plan.links) {
                continue;
            }
            let mut carried = |node: u32, carriers: &[u32], weights: &[f64]| {
                let mut c = Carried { id, node, count: carriers.len() as u32, carriers: [node; 4], weights: [0.0; 4] };
                c.carriers[..carriers.len()].copy_from_slice(carriers);
                c.weights[..weights.len()].copy_from_slice(weights);
                plan.carried.push(c);
            };
            match &slot.constraint {
                Constraint::Nail { node, goal } => plan.nails.push((id, *node, *goal)),
                Constraint::Velocity { node, goal } => plan.velocities.push((id, *node, *goal)),
                Constraint::PointsToPoint { nodes } if nodes.len() == 2 => {
                    let stretch = [nodes[0], nodes[1]].map(|n| n as usize / STRETCH);
                    let list = if stretch[0] == stretch[1] { &mut plan.near[stretch[0]] } else { &mut plan.pairs };
                    list.push((id, [nodes[0], nodes[1]]));
                }
                Constraint::PointsToPoint { nodes } => plan.groups.push((id, nodes.clone())),
                Constraint::PointToLine { node, carriers, weights } => carried(*node, carriers, weights),
                Constraint::PointToTriangle { node, carriers, weights } => carried(*node, carriers, weights),
                Constraint::PointToTetrahedron { node, carriers, weights } => carried(*node, carriers, weights),
                Constraint::PointToSurface { node, surface } => plan.slides.push((id, *node, surface.0)),
            }
        }
        self.force.fill([0.0; 3]);
        self.slid.clear();
        self.stale = false;
    }

    /// Moves `next`, the unconstrained result of a step, to where all active constraints are met. Call [`Self::advance`] when the
    /// step is accepted.
    ///
    /// # Errors
    /// [`ConstraintError`] when the scheme cannot enforce a constraint, when slides meet other constraints, or when nothing of
    /// a constraint can be moved; `next` is of no use then.
    pub fn enforce<R: Scalar>(
        &mut self,
        scheme: Scheme,
        dt: f64,
        inverse_mass: &[R],
        next: &mut State<R>,
    ) -> Result<(), ConstraintError> {
        self.enforce_local(scheme, dt, inverse_mass, next)?;
        if self.plan.slides.is_empty() { Ok(()) } else { self.slide(scheme, dt, inverse_mass, next) }
    }

    /// All but points that slide.
    pub(super) fn enforce_local<R: Scalar>(
        &mut self,
        scheme: Scheme,
        dt: f64,
        inverse_mass: &[R],
        next: &mut State<R>,
    ) -> Result<(), ConstraintError> {
        if inverse_mass.len() != self.node_count {
            return Err(ConstraintError::NodeCount { expected: self.node_count, found: inverse_mass.len() });
        }
        if self.stale {
            self.replan();
        }
        self.supported(scheme)?;
        if self.plan.ramps {
            self.begin_approaches(&next.position, inverse_mass);
        }
        let mut work = Work {
            unit: scheme.gain(1.0, dt),
            inverse_mass,
            first: 0,
            position: &mut next.position,
            velocity: &mut next.velocity,
            acceleration: &mut next.acceleration,
            force: &mut self.force,
            slots: if self.plan.ramps { Some(&self.slots) } else { None },
        };
        near_pairs(&mut work, &self.plan.near)?;
        for &(id, node, goal) in &self.plan.nails {
            work.nail(id, node as usize, goal);
        }
        for &(id, [a, b]) in &self.plan.pairs {
            work.pair(id, a as usize, b as usize)?;
        }
        for (id, nodes) in &self.plan.groups {
            work.group(*id, nodes)?;
        }
        for c in &self.plan.carried {
            work.carried(c)?;
        }
        for &(id, node, goal) in &self.plan.velocities {
            work.velocity(id, node as usize, goal);
        }
        Ok(())
    }

    /// Counts a step of all ramps.
    pub fn advance(&mut self) {
        if !self.plan.ramps {
            return;
        }
        self.plan.ramps = false;
        for slot in self.slots.iter_mut().flatten().filter(|s| s.active && s.ramp.1 < s.ramp.0) {
            slot.ramp.1 += 1;
            self.plan.ramps |= slot.ramp.1 < slot.ramp.0;
        }
    }

    fn supported(&self, scheme: Scheme) -> Result<(), ConstraintError> {
        if scheme.gain(1.0, 1.0).position != 0.0 {
            return Ok(());
        }
        let p = &self.plan;
        let first = [
            p.nails.first().map(|n| n.0),
            p.near.iter().flatten().chain(&p.pairs).map(|n| n.0).min(),
            p.groups.first().map(|n| n.0),
            p.carried.first().map(|n| n.id),
            p.slides.first().map(|n| n.0),
        ];
        match first.into_iter().flatten().min() {
            None => Ok(()),
            Some(id) => {
                let kind = self.slots[id as usize].as_ref().map_or("", |s| s.constraint.kind());
                Err(ConstraintError::Unsupported { scheme: scheme.name(), kind, id })
            }
        }
    }

    fn slide<R: Scalar>(
        &mut self,
        scheme: Scheme,
        dt: f64,
        inverse_mass: &[R],
        next: &mut State<R>,
    ) -> Result<(), ConstraintError> {
        for n in self.slid.drain(..) {
            self.force[n as usize] = [0.0; 3];
        }
        // all triangles are found before any node moves
        let mut found = Vec::with_capacity(self.plan.slides.len());
        let at = |n: u32| next.position[n as usize].map(Scalar::to_f64);
        let mut fitted = vec![false; self.surfaces.len()];
        for &(id, node, surface) in &self.plan.slides {
            let s = &mut self.surfaces[surface as usize];
            if !std::mem::replace(&mut fitted[surface as usize], true) {
                s.fit(&at);
            }
            let Some(c) = s.closest(at(node), &at) else { continue };
            let [a, b, d] = c.nodes;
            let w = c.weights;
            found.push(Carried { id, node, count: 3, carriers: [a, b, d, node], weights: [w[0], w[1], w[2], 0.0] });
        }
        for (k, c) in found.iter().enumerate() {
            let kind = "point-to-surface";
            for (i, &n) in c.carriers[..3].iter().enumerate() {
                if c.weights[i] == 0.0 {
                    continue;
                }
                if self.holder[n as usize] != 0 {
                    return Err(self.conflict(n, self.holder[n as usize] - 1, kind, c.id));
                }
                let other = found[..k].iter().find(|o| (0..3).any(|j| o.carriers[j] == n && o.weights[j] != 0.0));
                if let Some(other) = other {
                    return Err(self.conflict(n, other.id, kind, c.id));
                }
            }
        }
        let mut work = Work {
            unit: scheme.gain(1.0, dt),
            inverse_mass,
            first: 0,
            position: &mut next.position,
            velocity: &mut next.velocity,
            acceleration: &mut next.acceleration,
            force: &mut self.force,
            slots: if self.plan.ramps { Some(&self.slots) } else { None },
        };
        for c in &found {
            work.carried(c)?;
            self.slid.extend(&c.carriers[..3]);
        }
        Ok(())
    }
}

/// Pairs of nodes that are both in one stretch, stretches side by side: no other constraint holds these nodes.
fn near_pairs<R: Scalar>(work: &mut Work<'_, R>, near: &[Vec<Pair>]) -> Result<(), ConstraintError> {
    if near.iter().all(Vec::is_empty) {
        return Ok(());
    }
    if let [only] = near {
        return only.iter().try_for_each(|&(id, [a, b])| work.pair(id, a as usize, b as usize));
    }
    let (unit, inverse_mass, slots) = (work.unit, work.inverse_mass, work.slots);
    let lists = work.position.par_chunks_mut(STRETCH).zip(work.velocity.par_chunks_mut(STRETCH));
    let lists = lists.zip(work.acceleration.par_chunks_mut(STRETCH)).zip(work.force.par_chunks_mut(STRETCH));
    let errors =
        lists.zip(near).enumerate().filter_map(|(k, ((((position, velocity), acceleration), force), pairs))| {
            let first = k * STRETCH;
            let mut work = Work { unit, inverse_mass, first, position, velocity, acceleration, force, slots };
            let mut pairs = pairs.iter().map(|&(id, [a, b])| Some((id, work.pair(id, a as usize, b as usize).err()?)));
            pairs.find_map(|e| e)
        });
    // the same one for any number of threads
    errors.min_by_key(|e| e.0).map_or(Ok(()), |e| Err(e.1))
}
