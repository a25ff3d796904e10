//! Frames of coarse nodes, which turn with the body around them.
//!
//! Where the cells around a coarse node have turned alike since its operators were made, these need not be made anew but turned:
//! `A ≈ T A₀ Tᵀ`. A correction is `P T A₀⁻¹ Tᵀ Pᵀ r`: residuals are turned back on their way down, corrections forth on their way up. As T
//! has a rotation for each coarse node, this interpolates from the same functions as `P` does. What is left of the age of operators is how
//! far frames have turned against each other.

use super::interpolation::Weights;
use crate::par::{self, Each};
use rayon::prelude::*;

/// Nodes per task, at least.
const NODES: usize = 512;

/// A rotation as a quaternion (x, y, z, w), up to its sign.
type Quaternion = [f32; 4];

/// A rotation as the columns of a matrix.
pub(super) type Turn = [[f32; 4]; 3];

/// Frames of the nodes of a level.
#[derive(Debug, Default)]
pub(super) struct Frames {
    /// When the operators were made; empty before, and where nothing turns.
    made: Vec<Quaternion>,
    now: Vec<Quaternion>,
    /// From then to now; empty where nothing has turned.
    turns: Vec<Turn>,
}

impl Frames {
    /// Takes the rotations at the nodes of the next finer level, of any length, to which `restriction` gives the weights.
    pub fn follow(&mut self, restriction: &Weights, fine: &[Quaternion]) {
        self.now.resize(restriction.row_count(), [0.0; 4]);
        self.now.par_iter_mut().enumerate().with_min_len(NODES).each(|(c, now)| {
            let sum = sum(restriction, c, |i| fine[i]);
            let length = dot(sum, sum).sqrt();
            *now = if length > 0.0 { sum.map(|v| v / length) } else { [0.0, 0.0, 0.0, 1.0] };
        });
        let mut turns = std::mem::take(&mut self.turns);
        turns.clear();
        if self.made.len() == self.now.len() && self.made != self.now {
            turns.resize(self.now.len(), [[0.0; 4]; 3]);
            turns.par_iter_mut().enumerate().with_min_len(NODES).each(|(c, turn)| *turn = columns(self.turn(c)));
        }
        self.turns = turns;
    }

    /// Nothing turns.
    pub fn clear(&mut self) {
        self.made.clear();
        self.now.clear();
        self.turns.clear();
    }

    /// Operators are made now.
    pub fn settle(&mut self) {
        self.made.clone_from(&self.now);
        self.turns.clear();
    }

    /// From when the operators were made to now; empty where nothing has turned.
    pub fn turns(&self) -> &[Turn] {
        &self.turns
    }

    /// How far frames have turned against each other since the operators were made: the largest angle, over the nodes of the finer level,
    /// from the mean of those it interpolates from [rad]. NaN where it is not known.
    pub fn shear(&self, interpolation: &Weights) -> f64 {
        if self.now.is_empty() || self.made.len() != self.now.len() {
            return f64::NAN;
        }
        par::max(interpolation.row_count(), |i| {
            let weight: f32 = interpolation.weight[interpolation.row(i)].iter().sum();
            let sum = sum(interpolation, i, |c| self.turn(c));
            let cosine = f64::from(dot(sum, sum).sqrt() / weight);
            if weight > 0.0 { 2.0 * cosine.min(1.0).acos() } else { 0.0 }
        })
    }

    /// Rotation of a node since the operators were made.
    fn turn(&self, node: usize) -> Quaternion {
        let ([x, y, z, w], [a, b, c, d]) = (self.now[node], self.made[node]);
        [
            (d * x - w * a) + (b * z - c * y),
            (d * y - w * b) + (c * x - a * z),
            (d * z - w * c) + (a * y - b * x),
            (d * w + a * x) + (b * y + c * z),
        ]
    }
}

/// Weighted sum of what a node's entries stand for, each with the sign that is nearer to the sum of those before it.
fn sum(weights: &Weights, node: usize, of: impl Fn(usize) -> Quaternion) -> Quaternion {
    let mut sum = [0.0; 4];
    for k in weights.row(node) {
        let q = of(weights.column[k] as usize);
        let w = weights.weight[k].copysign(dot(sum, q));
        (0..4).for_each(|i| sum[i] += w * q[i]);
    }
    sum
}

fn dot(a: Quaternion, b: Quaternion) -> f32 {
    (a[0] * b[0] + a[1] * b[1]) + (a[2] * b[2] + a[3] * b[3])
}

/// Columns of the rotation of a unit quaternion.
fn columns([x, y, z, w]: Quaternion) -> Turn {
    [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y), 0.0],
        [2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x), 0.0],
        [2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y), 0.0],
    ]
}

/// The vector, turned from where operators were made to where they are used.
#[inline(always)]
pub(super) fn leave(turn: &Turn, v: [f32; 4]) -> [f32; 4] {
    std::array::from_fn(|k| (turn[0][k] * v[0] + turn[1][k] * v[1]) + turn[2][k] * v[2])
}

/// Turned the other way.
#[inline(always)]
pub(super) fn enter(turn: &Turn, v: [f32; 4]) -> [f32; 4] {
    let dot = |c: [f32; 4]| (c[0] * v[0] + c[1] * v[1]) + c[2] * v[2];
    [dot(turn[0]), dot(turn[1]), dot(turn[2]), 0.0]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::solver::Interpolation;

    /// A coarse node on each of three fine ones, and between them two fine nodes with two parents each.
    fn line() -> Interpolation {
        let (start, column) = (vec![0, 1, 3, 4, 6, 7], vec![0, 0, 1, 1, 1, 2, 2]);
        Interpolation { coarse_count: 3, start, column, weight: vec![1.0, 0.5, 0.5, 1.0, 0.25, 0.75, 1.0] }
    }

    fn about_z(degrees: f32) -> Quaternion {
        let (s, c) = (0.5 * degrees).to_radians().sin_cos();
        [0.0, 0.0, s, c]
    }

    /// Frames that have turned alike have no shear and turn vectors about, there and back; lengths and signs of the rotations do not count.
    #[test]
    fn frames_turn_with_what_is_around_them() {
        let p = line();
        let restriction = Weights::from(&p.transposed());
        let mut frames = Frames::default();
        assert!(frames.shear(&Weights::from(&p)).is_nan());
        frames.follow(&restriction, &[about_z(20.0); 5]);
        frames.settle();
        assert!(frames.shear(&Weights::from(&p)) < 1e-3 && frames.turns().is_empty());
        let turned = [1.0f32, -2.0, 0.5, -1.0, 3.0].map(|scale| about_z(110.0).map(|v| scale * v));
        frames.follow(&restriction, &turned);
        assert!(frames.shear(&Weights::from(&p)) < 1e-3 && frames.turns().len() == 3);
        for turn in frames.turns() {
            let v = leave(turn, [1.0, 2.0, 3.0, 0.0]);
            assert!((0..4).all(|k| (v[k] - [-2.0, 1.0, 3.0, 0.0][k]).abs() < 1e-6), "{v:?}");
            let v = enter(turn, v);
            assert!((0..4).all(|k| (v[k] - [1.0, 2.0, 3.0, 0.0][k]).abs() < 1e-6), "{v:?}");
        }
        frames.settle();
        assert!(frames.turns().is_empty());
        frames.clear();
        assert!(frames.shear(&Weights::from(&p)).is_nan());
    }

    /// Shear is the angle from the mean, however it was when the operators were made.
    #[test]
    fn shear_is_what_turning_together_leaves() {
        let p = line();
        let mut frames = Frames::default();
        // what the coarse nodes take is mixed from their neighbours: all turns alike keep it simple
        let only_own = Interpolation { weight: vec![1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0], ..p.clone() };
        let restriction = Weights::from(&only_own.transposed());
        let pose = |turns: [f32; 3]| [turns[0], 0.0, turns[1], 0.0, turns[2]].map(about_z);
        frames.follow(&restriction, &pose([0.0, 40.0, -60.0]));
        frames.settle();
        frames.follow(&restriction, &pose([200.0, 240.0, 140.0]));
        assert!(frames.shear(&Weights::from(&p)) < 1e-3);
        frames.follow(&restriction, &pose([10.0, 64.0, -36.0]));
        // the nodes between have parents 14 degrees apart in half, and none
        assert!((frames.shear(&Weights::from(&p)).to_degrees() - 7.0).abs() < 0.05);
    }
}
