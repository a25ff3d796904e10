//! A body that nothing holds keeps its momentum, linear and angular, to rounding.
//!
//! The step conserves both to the accuracy of its own equations only: bones turn by finite rotations where the system was linear in
//! them, stiffness damping acts on rotations that lag, and the schemes themselves lose a part h ω of a spin in every radian. For a
//! skeleton whose roots are free, what is missing is a rigid motion of the whole body, x → c + R (x − c) + t, which changes no
//! internal force. Its six numbers are found by Newton's method from
//!
//! ```text
//! Σ m v' = Σ m v + h Σ f,    Σ x' × m v' = Σ x × m v + h Σ x' × f,
//! ```
//!
//! with f the external forces and the drag. Held, led or pulled bodies are left alone: their surroundings take part.

use super::{Course, Monolithic};
use crate::body::Body;
use crate::couple::jacobian::Role;
use crate::rig::rotation::exp;
use crate::rig::{Configuration, EntryKind};
use glam::DVec3;
use softrig_linalg::Scalar;

/// Newton's method: each round doubles the digits, and it starts with three or more.
const ROUNDS: usize = 5;
/// A body needs no more than this to keep its momentum [rad]; what would is no rounding, and is left alone.
const LONGEST: f64 = 0.2;

impl<R: Scalar> Monolithic<R> {
    /// Does nothing but known forces act on the skeleton as a whole?
    fn floats(&self, course: &Course<'_, R>) -> bool {
        let input = course.input;
        let (entries, free) = (input.articulation.entries(), |k: usize| {
            input.leads[k].stiffness == 0.0 && input.leads[k].damping == 0.0 && self.limit_torque[k] == 0.0
        });
        let roots = || entries.iter().filter(|e| e.kind == EntryKind::Place);
        let turns = |e: &&crate::rig::Entry| e.kind == EntryKind::Turn;
        let loose = |e: &crate::rig::Entry| {
            let turn = entries.iter().filter(turns).find(|t| t.joint == e.joint);
            let all = |e: &crate::rig::Entry| (e.first..e.first + e.count()).all(free);
            all(e) && turn.is_some_and(all)
        };
        let rooted = |j: crate::rig::JointId| {
            input.articulation.moved_by(j).iter().any(|e| entries[*e as usize].kind == EntryKind::Place)
        };
        input.drags.is_empty()
            && self.pulls.is_empty()
            && roots().next().is_some()
            && roots().all(loose)
            && input.binding.bones.iter().all(|b| rooted(b.joint))
    }

    /// Moves the whole body so that it keeps its momentum.
    pub(super) fn keep_momentum(&mut self, body: &Body<R>, course: &Course<'_, R>, configuration: &mut Configuration) {
        if !self.floats(course) {
            return;
        }
        let (input, state, h) = (course.input, course.state, course.input.dt);
        let c = course.c;
        let vector = |v: [R; 3]| DVec3::from(v.map(Scalar::to_f64));
        let n = self.now.len();
        let mass = |i: usize| body.mass[i].to_f64();
        let total: f64 = (0..n).map(mass).sum();
        let centre = (0..n).map(|i| DVec3::from(self.now[i]) * mass(i)).sum::<DVec3>() / total;
        let rate = |i: usize| if self.role[i] == Role::Free { c.velocity[0] } else { 1.0 / h };
        // external forces at the end of the step, drag included
        let extra = body.mass_damping.to_f64();
        let (mut push, mut turn) = (DVec3::ZERO, DVec3::ZERO);
        let (mut before, mut spin_before) = (DVec3::ZERO, DVec3::ZERO);
        for i in (0..n).filter(|i| self.role[*i] != Role::Held) {
            let (x, old) = (DVec3::from(self.now[i]), DVec3::from(self.old[i]));
            let drag = body.drag[i].to_f64() + extra * mass(i);
            let f = vector(input.external_force[i]) - (x - old) * (drag / h);
            push += f;
            turn += (x - centre).cross(f);
            let p = vector(state.velocity[i]) * mass(i);
            before += p;
            spin_before += (old - centre).cross(p);
        }
        let (target, spin_target) = (before + push * h, spin_before + turn * h);
        let (mut shift, mut rotation) = (DVec3::ZERO, glam::DQuat::IDENTITY);
        let mut turned = 0.0;
        for _ in 0..ROUNDS {
            let mut lack = [target.x, target.y, target.z, spin_target.x, spin_target.y, spin_target.z];
            let mut matrix = [[0.0; 6]; 6];
            for i in (0..n).filter(|i| self.role[*i] != Role::Held) {
                let from = DVec3::from(self.now[i]);
                let arm = rotation * (from - centre);
                let (x, r) = (arm + shift, rate(i));
                // as v' follows from x': of the present place, and with the move
                let v = vector(self.v[i]) + (x + centre - from) * r;
                let (p, l) = (v * mass(i), x.cross(v * mass(i)));
                for k in 0..3 {
                    lack[k] -= p[k];
                    lack[3 + k] -= l[k];
                }
                for (k, axis) in DVec3::AXES.into_iter().enumerate() {
                    for (column, move_) in [(k, axis), (3 + k, axis.cross(arm))] {
                        let (dp, dl) =
                            (move_ * (r * mass(i)), move_.cross(v * mass(i)) + x.cross(move_ * (r * mass(i))));
                        for row in 0..3 {
                            matrix[row][column] += dp[row];
                            matrix[3 + row][column] += dl[row];
                        }
                    }
                }
            }
            let Some(by) = solve6(matrix, lack) else { return };
            let by_turn = DVec3::new(by[3], by[4], by[5]);
            shift += DVec3::new(by[0], by[1], by[2]);
            rotation = (exp(by_turn) * rotation).normalize();
            turned += by_turn.length();
            if !(turned.is_finite() && shift.is_finite() && turned < LONGEST) {
                return;
            }
        }
        self.move_rigidly(body, course, configuration, centre, (shift, rotation));
    }

    /// x → c + R (x − c) + t for bones and flesh, velocities and accelerations with it.
    fn move_rigidly(
        &mut self,
        body: &Body<R>,
        course: &Course<'_, R>,
        configuration: &mut Configuration,
        centre: DVec3,
        (shift, rotation): (DVec3, glam::DQuat),
    ) {
        let (input, c, h) = (course.input, course.c, course.input.dt);
        let axis = rotation.to_scaled_axis();
        self.increment.clear();
        self.increment.resize(input.articulation.unknown_count(), 0.0);
        let entries = input.articulation.entries();
        for root in entries.iter().filter(|e| e.kind == EntryKind::Place) {
            let from = DVec3::from(self.pose.joint(root.joint).translation);
            let by = centre + rotation * (from - centre) + shift - from;
            (0..3).for_each(|k| self.increment[root.first + k] = by[k]);
            for turn in entries.iter().filter(|e| e.joint == root.joint && e.kind == EntryKind::Turn) {
                (0..3).for_each(|k| self.increment[turn.first + k] = axis[k]);
            }
        }
        input.articulation.advance(input.skeleton, &self.pose, &self.increment, configuration);
        self.take_pose(body, input, configuration);
        for i in 0..self.now.len() {
            let from = DVec3::from(self.now[i]);
            let (to, rates) = match self.role[i] {
                Role::Held => continue,
                Role::Free => (centre + rotation * (from - centre) + shift, (c.velocity[0], c.acceleration[0])),
                Role::Bound => (DVec3::from(self.nodes.placed[i]), (1.0 / h, 0.0)),
            };
            for k in 0..3 {
                let by = to[k] - from[k];
                self.v[i][k] = R::from_f64(self.v[i][k].to_f64() + rates.0 * by);
                self.a[i][k] = R::from_f64(self.a[i][k].to_f64() + rates.1 * by);
            }
            self.now[i] = to.into();
        }
    }
}

/// Gaussian elimination with the largest pivots; `None` for a singular system.
fn solve6(mut a: [[f64; 6]; 6], mut b: [f64; 6]) -> Option<[f64; 6]> {
    let size = a.iter().flatten().fold(0.0f64, |m, v| m.max(v.abs()));
    for k in 0..6 {
        let pivot = (k..6).max_by(|i, j| a[*i][k].abs().total_cmp(&a[*j][k].abs()))?;
        if a[pivot][k].is_nan() || a[pivot][k].abs() <= 1e-14 * size {
            return None;
        }
        a.swap(k, pivot);
        b.swap(k, pivot);
        for i in k + 1..6 {
            let factor = a[i][k] / a[k][k];
            for j in k..6 {
                a[i][j] -= factor * a[k][j];
            }
            b[i] -= factor * b[k];
        }
    }
    for k in (0..6).rev() {
        let sum: f64 = (k + 1..6).map(|j| a[k][j] * b[j]).sum();
        b[k] = (b[k] - sum) / a[k][k];
    }
    Some(b)
}
