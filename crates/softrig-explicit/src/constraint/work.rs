//! How constraints of each kind move the unconstrained result of a step.

use super::ConstraintError;
use super::set::Slot;
use crate::scheme::Gain;
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

/// A stretch of a step's result while it is moved.
pub(super) struct Work<'a, R> {
    /// Gain of a unit mass: that of a node is its inverse mass times this, for every scheme.
    pub unit: Gain,
    pub inverse_mass: &'a [R],
    /// The node that the lists below begin with.
    pub first: usize,
    pub position: &'a mut [[R; 3]],
    pub velocity: &'a mut [[R; 3]],
    pub acceleration: &'a mut [[R; 3]],
    pub force: &'a mut [[f64; 3]],
    /// Present while some ramp runs.
    pub slots: Option<&'a [Option<Slot>]>,
}

impl<R: Scalar> Work<'_, R> {
    #[inline]
    fn at(&self, node: usize) -> [f64; 3] {
        self.position[node - self.first].map(Scalar::to_f64)
    }

    #[inline]
    fn weight(&self, node: usize) -> f64 {
        self.inverse_mass[node].to_f64()
    }

    /// Part of the force that acts in this step.
    #[inline]
    fn share(&self, id: u32) -> f64 {
        let Some(slots) = self.slots else { return 1.0 };
        slots[id as usize].as_ref().map_or(1.0, Slot::share)
    }

    /// What is to be left of gap `k` at the end of this step [m].
    #[inline]
    fn left(&self, id: u32, k: usize) -> Option<[f64; 3]> {
        self.slots?[id as usize].as_ref()?.left(k)
    }

    /// Puts a node to `goal`, or as near as its ramp wants it.
    #[inline]
    pub fn nail(&mut self, id: u32, node: usize, goal: [f64; 3]) {
        self.member(id, 0, node, goal);
    }

    /// Puts a node to `goal`, or as near as gap `k` of its ramp wants it.
    #[inline]
    fn member(&mut self, id: u32, k: usize, node: usize, goal: [f64; 3]) {
        let left = self.left(id, k).unwrap_or([0.0; 3]);
        self.move_to(id, node, std::array::from_fn(|k| goal[k] + left[k]));
    }

    /// Puts a node to `goal`, with the force that takes.
    #[inline]
    fn move_to(&mut self, id: u32, node: usize, goal: [f64; 3]) {
        let share = self.share(id);
        let x = self.at(node);
        let mut delta = [0.0; 3];
        for k in 0..3 {
            delta[k] = share * (goal[k] - x[k]);
        }
        self.add(node, delta);
        if share == 1.0 {
            // not merely to rounding
            self.position[node - self.first] = goal.map(R::from_f64);
        }
    }

    /// Moves a node by c F = `delta`.
    #[inline]
    fn add(&mut self, node: usize, delta: [f64; 3]) {
        let w = self.weight(node);
        let per_unit = 1.0 / self.unit.position;
        let mass = if w > 0.0 { 1.0 / w } else { 0.0 };
        let i = node - self.first;
        let (x, v) = (&mut self.position[i], &mut self.velocity[i]);
        for k in 0..3 {
            let a = delta[k] * per_unit;
            self.force[i][k] = a * mass;
            x[k] = R::from_f64(x[k].to_f64() + delta[k]);
            if w > 0.0 {
                v[k] = R::from_f64(v[k].to_f64() + a * self.unit.velocity);
                self.acceleration[i][k] += R::from_f64(a);
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
        let left = self.left(id, 0);
        let (a, b) = (self.at(i), self.at(j));
        let per_unit = 1.0 / self.unit.position;
        let ratio = self.unit.velocity * per_unit;
        // F_i = (x^_j - x^_i) / (c_i + c_j), F_j = -F_i; the heavier node keeps more of its place
        let s = share / (wi + wj);
        let (i, j) = (i - self.first, j - self.first);
        let one = share == 1.0 && left.is_none();
        let left = left.unwrap_or([0.0; 3]);
        for k in 0..3 {
            let gap = (b[k] - a[k] - left[k]) * s;
            let f = gap * per_unit;
            self.force[i][k] = f;
            self.force[j][k] = -f;
            let goal = a[k] + wi * gap;
            let other = if one { goal } else { b[k] - wj * gap };
            self.position[i][k] = R::from_f64(goal);
            self.position[j][k] = R::from_f64(other);
            self.velocity[i][k] += R::from_f64(wi * gap * ratio);
            self.velocity[j][k] += R::from_f64(-(wj * gap) * ratio);
            self.acceleration[i][k] += R::from_f64(wi * f);
            self.acceleration[j][k] += R::from_f64(-(wj * f));
        }
        Ok(())
    }

    pub fn group(&mut self, id: u32, nodes: &[u32]) -> Result<(), ConstraintError> {
        let Some(goal) = Work::meeting_place(nodes, self.inverse_mass, self.position) else {
            return Err(ConstraintError::Immovable { kind: "points-to-point", id });
        };
        for (k, n) in nodes.iter().enumerate() {
            self.member(id, k, *n as usize, goal);
        }
        Ok(())
    }

    /// Where nodes meet: their centre of mass, or the place of the one that nothing moves. `None` when there are two of those.
    pub fn meeting_place(nodes: &[u32], inverse_mass: &[R], position: &[[R; 3]]) -> Option<[f64; 3]> {
        let at = |n: &u32| position[*n as usize].map(Scalar::to_f64);
        let mut fixed = nodes.iter().filter(|n| inverse_mass[**n as usize] <= R::zero());
        if let Some(n) = fixed.next() {
            return if fixed.next().is_some() { None } else { Some(at(n)) };
        }
        let origin = at(&nodes[0]);
        let (mut sum, mut mass) = ([0.0; 3], 0.0);
        for n in nodes {
            let (m, x) = (1.0 / inverse_mass[*n as usize].to_f64(), at(n));
            mass += m;
            (0..3).for_each(|k| sum[k] += m * (x[k] - origin[k]));
        }
        Some(std::array::from_fn(|k| origin[k] + sum[k] / mass))
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
        if let Some(left) = self.left(c.id, 0) {
            (0..3).for_each(|k| gap[k] -= left[k]);
        }
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
        let i = node - self.first;
        for k in 0..3 {
            let (x, v) = (self.position[i][k].to_f64(), self.velocity[i][k].to_f64());
            let a = share * (goal[k] - v) / self.unit.velocity;
            self.force[i][k] = a / w;
            self.position[i][k] = R::from_f64(x + a * self.unit.position);
            self.acceleration[i][k] += R::from_f64(a);
            self.velocity[i][k] = R::from_f64(if share == 1.0 { goal[k] } else { v + a * self.unit.velocity });
        }
    }
}
