//! Flesh stiff enough for a motion.
//!
//! A layer of flesh of thickness L that its bone accelerates by a presses on itself with ρ a L, and is squashed by ρ a L / E.
//! Where stylised motion asks for a strain that no flesh survives (a head of a metre that stops within a frame), the layer is
//! made as stiff as it needs to be, and everything else is left as soft as it is.

use super::drive::Drive;
use super::motion::Motion;
use crate::couple::Binding;
use crate::material::MaterialMap;
use crate::mesh::VolumeMesh;
use crate::rig::Skeleton;
use glam::DVec3;
use rayon::prelude::*;
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// Strain that flesh may take [-].
const STRAIN: f64 = 0.3;
/// Time over which an acceleration must act to squash [s]: flesh is slower than a key of a clip.
const WINDOW: f64 = 1.0 / 30.0;
/// Gravity acts in any motion [m/s2].
const GRAVITY: f64 = 9.81;
/// However wild the motion, flesh gets at most this much stiffer [-].
const STIFFEST: f64 = 100.0;

/// Factors on Young's modulus, one per cell, at least 1 [-]: what each cell needs so that the motion of the first `duration`
/// seconds does not crush it. `materials` says how stiff it is already.
#[must_use]
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a count of samples, bounded above")]
pub fn stiffening(
    skeleton: &Skeleton,
    mesh: &VolumeMesh,
    binding: &Binding,
    materials: &MaterialMap,
    motion: &dyn Motion,
    duration: f64,
) -> Vec<f32> {
    let samples = (duration / WINDOW).ceil().clamp(0.0, 1e5) as usize + 1;
    let drives: Vec<Drive> =
        (0..samples).map(|k| Drive::new(skeleton, binding, &motion.pose(k as f64 * WINDOW))).collect();
    let acceleration: Vec<f64> = (0..mesh.node_count())
        .into_par_iter()
        .map(|n| if binding.bound[n] { 0.0 } else { largest_acceleration(&drives, binding, n, mesh.nodes[n]) })
        .collect();
    let layer = Layer::new(mesh, &binding.bound, acceleration);
    (0..mesh.cell_count())
        .map(|c| {
            let m = materials.get(c);
            let load = mesh.cell(c).iter().map(|n| layer.load[*n as usize]).fold(0.0, f64::max);
            (m.density * load / (STRAIN * m.young_modulus)).clamp(1.0, STIFFEST) as f32
        })
        .collect()
}

/// Largest acceleration of a node under blended skinning, gravity on top [m/s2].
fn largest_acceleration(drives: &[Drive], binding: &Binding, n: usize, rest: [f64; 3]) -> f64 {
    let at = |d: &Drive| DVec3::from(d.node(binding, n, rest));
    let mut largest = 0.0f64;
    if let [first, second, others @ ..] = drives {
        let (mut before, mut now) = (at(first), at(second));
        for next in others {
            let next = at(next);
            largest = largest.max((next - 2.0 * now + before).length());
            (before, now) = (now, next);
        }
    }
    largest / (WINDOW * WINDOW) + GRAVITY
}

/// How flesh lies over the bound nodes.
struct Layer {
    /// Acceleration times thickness of the flesh that hangs on each node [m2/s2].
    load: Vec<f64>,
}

impl Layer {
    /// Shortest paths from the bound nodes outwards; the load of a node is that of the longest path through it.
    fn new(mesh: &VolumeMesh, bound: &[bool], mut acceleration: Vec<f64>) -> Self {
        let n = mesh.node_count();
        let at = |i: u32| DVec3::from(mesh.nodes[i as usize]);
        let mut cells_of = vec![Vec::new(); n];
        for (c, nodes) in mesh.cells().enumerate() {
            nodes.iter().for_each(|i| cells_of[*i as usize].push(c as u32));
        }
        let mut distance = vec![f64::INFINITY; n];
        let mut parent = vec![u32::MAX; n];
        // non-negative floats order as their bits do
        let mut queue = BinaryHeap::new();
        for i in (0..n).filter(|i| bound[*i]) {
            distance[i] = 0.0;
            queue.push(Reverse((0u64, i as u32)));
        }
        let mut order = Vec::with_capacity(n);
        while let Some(Reverse((bits, i))) = queue.pop() {
            if bits != distance[i as usize].to_bits() {
                continue;
            }
            order.push(i);
            for &c in &cells_of[i as usize] {
                for &j in mesh.cell(c as usize) {
                    let through = distance[i as usize] + at(i).distance(at(j));
                    if through < distance[j as usize] {
                        distance[j as usize] = through;
                        parent[j as usize] = i;
                        queue.push(Reverse((through.to_bits(), j)));
                    }
                }
            }
        }
        // from the skin back to the bones
        let mut thickness: Vec<f64> = distance.iter().map(|d| if d.is_finite() { *d } else { 0.0 }).collect();
        for &i in order.iter().rev() {
            if let Some(p) = (parent[i as usize] != u32::MAX).then_some(parent[i as usize] as usize) {
                thickness[p] = thickness[p].max(thickness[i as usize]);
                acceleration[p] = acceleration[p].max(acceleration[i as usize]);
            }
        }
        Self { load: thickness.iter().zip(&acceleration).map(|(l, a)| l * a).collect() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::{CellKind, bar};

    /// A bar clamped at one end and pulled along: the load is the acceleration times the whole length, at every node of a line,
    /// and nothing where all is bound.
    #[test]
    fn the_load_is_that_of_the_whole_layer() {
        let mesh = bar([6, 1, 1], [0.6, 0.1, 0.1], CellKind::Hex8);
        let bound: Vec<bool> = mesh.nodes.iter().map(|p| p[0] == 0.0).collect();
        let layer = Layer::new(&mesh, &bound, vec![20.0; mesh.node_count()]);
        for load in &layer.load {
            assert!((load - 20.0 * 0.6).abs() < 1e-9, "{load}");
        }
        let held = Layer::new(&mesh, &vec![true; mesh.node_count()], vec![20.0; mesh.node_count()]);
        assert!(held.load.iter().all(|l| *l == 0.0));
    }
}
