//! Vectors over nodes and unknowns of the skeleton: in f64 for what is true, in f32 for the iteration.

use super::CHUNK;
use rayon::prelude::*;
use softrig_linalg::par;
use softrig_linalg::par::Each;

/// A vector over nodes (zero at all but free ones) and unknowns of the skeleton.
#[derive(Clone, Debug, Default)]
pub(crate) struct Pair {
    pub node: Vec<[f64; 3]>,
    pub joint: Vec<f64>,
}

impl Pair {
    pub fn resize(&mut self, nodes: usize, unknowns: usize) {
        self.node.clear();
        self.node.resize(nodes, [0.0; 3]);
        self.joint.clear();
        self.joint.resize(unknowns, 0.0);
    }

    /// Size of a residual [N]: torques count as forces at `length` [m].
    pub fn size(&self, length: f64) -> f64 {
        let nodes =
            par::sum(self.node.len(), |r| self.node[r].iter().map(|a| a[0] * a[0] + a[1] * a[1] + a[2] * a[2]).sum());
        (nodes + self.joint.iter().map(|t| t * t).sum::<f64>() / (length * length)).sqrt()
    }
}

/// A vector of the iteration.
#[derive(Clone, Debug, Default)]
pub(super) struct Light {
    pub node: Vec<[f32; 4]>,
    pub joint: Vec<f64>,
}

impl Light {
    pub fn resize(&mut self, nodes: usize, unknowns: usize) {
        self.node.clear();
        self.node.resize(nodes, [0.0; 4]);
        self.joint.clear();
        self.joint.resize(unknowns, 0.0);
    }

    pub fn dot(&self, other: &Self) -> f64 {
        let nodes = par::sum(self.node.len(), |r| {
            let pairs = self.node[r.clone()].iter().zip(&other.node[r]);
            pairs.map(|(a, b)| (0..3).map(|k| f64::from(a[k]) * f64::from(b[k])).sum::<f64>()).sum()
        });
        nodes + self.joint.iter().zip(&other.joint).map(|(a, b)| a * b).sum::<f64>()
    }

    /// self += a other.
    pub fn add(&mut self, a: f64, other: &Self) {
        let factor = a as f32;
        self.node.par_chunks_mut(CHUNK).zip(other.node.par_chunks(CHUNK)).each(|(x, y)| {
            for (x, y) in x.iter_mut().zip(y) {
                (0..4).for_each(|k| x[k] += factor * y[k]);
            }
        });
        self.joint.iter_mut().zip(&other.joint).for_each(|(x, y)| *x += a * y);
    }

    /// self = other + b self.
    pub fn direction(&mut self, b: f64, other: &Self) {
        let factor = b as f32;
        self.node.par_chunks_mut(CHUNK).zip(other.node.par_chunks(CHUNK)).each(|(x, y)| {
            for (x, y) in x.iter_mut().zip(y) {
                (0..4).for_each(|k| x[k] = y[k] + factor * x[k]);
            }
        });
        self.joint.iter_mut().zip(&other.joint).for_each(|(x, y)| *x = y + b * *x);
    }

    /// Square of the size of a residual [N2]: torques count as forces at `length` [m].
    pub fn square(&self, length: f64) -> f64 {
        let nodes = par::sum(self.node.len(), |range| {
            self.node[range].iter().map(|v| (0..3).map(|k| f64::from(v[k]) * f64::from(v[k])).sum::<f64>()).sum()
        });
        nodes + self.joint.iter().map(|t| t * t).sum::<f64>() / (length * length)
    }
}
