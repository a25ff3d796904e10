//! Springs that pull on flesh at a point, and on joints.

use crate::rig::JointId;

/// A spring between a place in the world and a point of the flesh, which is a weighted sum of nodes.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PointSpring {
    /// Nodes and weights of the point; weights sum to 1.
    pub nodes: Vec<(u32, f64)>,
    /// Where it pulls to [m].
    pub target: [f64; 3],
    /// How the target moves [m/s].
    pub velocity: [f64; 3],
    /// [N/m].
    pub stiffness: f64,
    /// [N s/m].
    pub damping: f64,
    /// Stiffness of the spring as a step sees it, damping included [N/m]: set by the step.
    pub(crate) effective: f64,
}

/// A spring between a place in the world and a joint.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointSpring {
    /// The joint.
    pub joint: JointId,
    /// Where it pulls to [m].
    pub target: [f64; 3],
    /// How the target moves [m/s].
    pub velocity: [f64; 3],
    /// [N/m].
    pub stiffness: f64,
    /// [N s/m].
    pub damping: f64,
    /// The spring is never taken to be longer than this [m]: what is out of reach pulls no harder.
    pub longest: f64,
}

impl PointSpring {
    /// The point, from the positions of all nodes.
    #[must_use]
    pub fn point(&self, x: &[[f64; 3]]) -> [f64; 3] {
        let mut p = [0.0; 3];
        for (n, w) in &self.nodes {
            (0..3).for_each(|k| p[k] += w * x[*n as usize][k]);
        }
        p
    }

    /// The point, where `of` has the nodes.
    pub(crate) fn point_of(&self, of: impl Fn(usize) -> [f64; 4]) -> [f64; 3] {
        let mut p = [0.0; 3];
        for (n, w) in &self.nodes {
            let x = of(*n as usize);
            (0..3).for_each(|k| p[k] += w * x[k]);
        }
        p
    }
}

/// A vector no longer than `longest`.
pub(crate) fn shortened(v: [f64; 3], longest: f64) -> [f64; 3] {
    let length = (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]).sqrt();
    if !length.is_finite() {
        return [0.0; 3];
    }
    if length > longest { v.map(|c| c * longest / length) } else { v }
}
