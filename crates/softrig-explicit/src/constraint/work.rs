//! How constraints of each kind move the unconstrained result of a step.

use super::ConstraintError;
use super::set::Slot;
use crate::scheme::Gain;
use softrig::integrate::State;
use softrig_linalg::Scalar;

/// A point on a line, triangle or tetrahedron: so many carriers of four.
#[derive(Clone, Copy, Debug)]
pub(super) struct Carried {
    pub id: u32,
    pub node: u32,
    pub count: u32,
    pub carriers: [u32; 4],
    pub weights: [f64; 4],
}

/// A step's result while it is moved.
pub(super) struct Work<'a, R> {
    /// Gain of a unit mass: that of a node is its inverse mass times this, for every scheme.
    pub unit: Gain,
    pub inverse_mass: &'a [R],
    pub next: &'a mut State<R>,
    pub force: &'a mut [[f64; 3]],
    /// Present while some ramp runs.
    pub slots: Option<&'a [Option<Slot>]>,
}

impl<R: Scalar> Work<'_, R> {
    #[inline]
    fn at(&self, node: usize) -> [f64; 3] {
        self.next.position[node].map(Scalar::to_f64)
    }

    #[inline]
    fn weight(&self, node: usize) -> f64 {
        self.inverse_mass[node].to_f64()
    }

    /// Part of the force that acts in this step.
    #[inline]
    fn share(&self, id: u32) -> f64 {
        let Some(slots) = self.slots else { return 1.0 };
        let Some(slot) = &slots[id as usize] else { return 1.0 };
        let (steps, done) = slot.ramp;
        if done + 1 >= steps { 1.0 } else { f64::from(done + 1) / f64::from(steps) }
    }

    /// Puts a node to `goal`, with the force that takes.
    #[inline]
    pub fn move_to(&mut self, id: u32, node: usize, goal: [f64; 3]) {
        let share = self.share(id);
        let x = self.at(node);
        let mut delta = [0.0; 3];
        for k in 0..3 {
            delta[k] = share * (goal[k] - x[k]);
        }
        self.add(node, delta);
        if share == 1.0 {
            // not merely to rounding
            self.next.position[node] = goal.map(R::from_f64);
        }
    }

    /// Moves a node by c F = `delta`.
    #[inline]
    fn add(&mut self, node: usize, delta: [f64; 3]) {
        let w = self.weight(node);
        let per_unit = 1.0 / self.unit.position;
        let mass = if w > 0.0 { 1.0 / w } else { 0.0 };
        for k in 0..3 {
            let a = delta[k] * per_unit;
            self.force[node][k] = a * mass;
            let x = self.next.position[node][k].to_f64() + delta[k];
            self.next.position[node][k] = R::from_f64(x);
            if w > 0.0 {
                let v = self.next.velocity[node][k].to_f64() + a * self.unit.velocity;
                self.next.velocity[node][k] = R::from_f64(v);
                self.next.acceleration[node][k] += R::from_f64(a);
            }
        }
    }

    #[inline]
    pub fn pair(&mut self, id: u32, i: usize, j: usize) -> Result<(), ConstraintError> {
        let (wi, wj) = (self.weight(i), self.weight(j));
        if wi + wj <= 0.0 {
            return Err(ConstraintError::Immovable { kind: "points-to-point", id });
        }
        let share = self.share(id);
        let (a, b) = (self.at(i), self.at(j));
        let per_unit = 1.0 / self.unit.position;
        let ratio = self.unit.velocity * per_unit;
        // F_i = (x^_j - x^_i) / (c_i + c_j), F_j = -F_i; the heavier node keeps more of its place
        let s = share / (wi + wj);
        let next = &mut *self.next;
        for k in 0..3 {
            let gap = (b[k] - a[k]) * s;
            let f = gap * per_unit;
            self.force[i][k] = f;
            self.force[j][k] = -f;
            let goal = a[k] + wi * gap;
            let other = if share == 1.0 { goal } else { b[k] - wj * gap };
            next.position[i][k] = R::from_f64(goal);
            next.position[j][k] = R::from_f64(other);
            next.velocity[i][k] += R::from_f64(wi * gap * ratio);
            next.velocity[j][k] += R::from_f64(-(wj * gap) * ratio);
            next.acceleration[i][k] += R::from_f64(wi * f);
            next.acceleration[j][k] += R::from_f64(-(wj * f));
        }
        Ok(())
    }

    pub fn group(&mut self, id: u32, nodes: &[u32]) -> Result<(), ConstraintError> {
        // a node that nothing moves is where all others go
        let fixed = |n: &&u32| self.weight(**n as usize) <= 0.0;
        let goal = if let Some(n) = nodes.iter().find(fixed) {
            if nodes.iter().filter(fixed).count() > 1 {
                return Err(ConstraintError::Immovable { kind: "points-to-point", id });
            }
            self.at(*n as usize)
        } else {
            let origin = self.at(nodes[0] as usize);
            let (mut sum, mut mass) = ([0.0; 3], 0.0);
            for &n in nodes {
                let (m, x) = (1.0 / self.weight(n as usize), self.at(n as usize));
                mass += m;
                (0..3).for_each(|k| sum[k] += m * (x[k] - origin[k]));
            }
            std::array::from_fn(|k| origin[k] + sum[k] / mass)
        };
        nodes.iter().for_each(|n| self.move_to(id, *n as usize, goal));
        Ok(())
    }

    pub fn carried(&mut self, c: &Carried) -> Result<(), ConstraintError> {
        let count = c.count as usize;
        let point = self.at(c.node as usize);
        let (mut gap, mut gain) = ([0.0; 3], self.weight(c.node as usize));
        for i in 0..count {
            let (n, a) = (c.carriers[i] as usize, c.weights[i]);
            let x = self.at(n);
            gain += self.weight(n) * a * a;
            (0..3).for_each(|k| gap[k] += a * (x[k] - point[k]));
        }
        if gain <= 0.0 {
            let kind = ["", "", "point-to-line", "point-to-triangle", "point-to-tetrahedron"][count];
            return Err(ConstraintError::Immovable { kind, id: c.id });
        }
        let share = self.share(c.id);
        // F_0 times the step's unit gain
        let f = gap.map(|g| share * g / gain);
        let w = self.weight(c.node as usize);
        self.add(c.node as usize, f.map(|f| f * w));
        for i in 0..count {
            if c.weights[i] != 0.0 {
                let n = c.carriers[i] as usize;
                let s = -c.weights[i] * self.weight(n);
                self.add(n, f.map(|f| f * s));
            }
        }
        Ok(())
    }

    pub fn velocity(&mut self, id: u32, node: usize, goal: [f64; 3]) {
        let w = self.weight(node);
        if w <= 0.0 {
            return;
        }
        let share = self.share(id);
        for k in 0..3 {
            let a = share * (goal[k] - self.next.velocity[node][k].to_f64()) / self.unit.velocity;
            self.force[node][k] = a / w;
            let x = self.next.position[node][k].to_f64() + a * self.unit.position;
            self.next.position[node][k] = R::from_f64(x);
            self.next.acceleration[node][k] += R::from_f64(a);
            let v = self.next.velocity[node][k].to_f64() + a * self.unit.velocity;
            self.next.velocity[node][k] = if share == 1.0 { R::from_f64(goal[k]) } else { R::from_f64(v) };
        }
    }
}
