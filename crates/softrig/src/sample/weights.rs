//! Skin weights of the sample character: smooth, at most four joints per vertex.

use super::shape::body;
use crate::character::SkinWeights;
use crate::mesh::SurfaceMesh;
use crate::rig::{JointId, Skeleton};
use glam::DVec3;
use rayon::prelude::*;

/// Width over which one bone's parts hand over to the next's [m]: about a third of a limb's radius.
const WIDTH: f64 = 0.022;

/// Rounds of averaging over neighbours: take out the kinks where the nearest part changes.
const ROUNDS: usize = 8;

/// Influences below this are dropped: nobody sees them, and every one costs.
const LEAST: f64 = 0.01;

/// Weights from the distance of each vertex to the parts that each joint carries, averaged over the surface.
pub(super) fn weights(skin: &SurfaceMesh, skeleton: &Skeleton) -> SkinWeights {
    let body = body();
    let owner: Vec<usize> = body
        .parts
        .iter()
        .map(|part| skeleton.find(&part.bone).expect("every part names a joint of the table").index())
        .collect();
    let joints = skeleton.joint_count();
    let mut table: Vec<Vec<f64>> = skin
        .positions
        .par_iter()
        .map(|p| {
            let mut nearest = vec![f64::INFINITY; joints];
            for (part, joint) in body.parts.iter().zip(&owner) {
                nearest[*joint] = nearest[*joint].min(part.field(DVec3::from_array(*p)).d);
            }
            let least = nearest.iter().copied().fold(f64::INFINITY, f64::min);
            let row: Vec<f64> = nearest.iter().map(|d| (-(d - least) / WIDTH).exp()).collect();
            let sum: f64 = row.iter().sum();
            row.iter().map(|w| w / sum).collect()
        })
        .collect();
    let mut neighbours = vec![Vec::new(); skin.positions.len()];
    for t in &skin.triangles {
        for c in 0..3 {
            neighbours[t[c] as usize].push(t[(c + 1) % 3] as usize);
        }
    }
    for _ in 0..ROUNDS {
        let old = &table;
        table = neighbours
            .par_iter()
            .enumerate()
            .map(|(v, around)| {
                let mean = |j: usize| around.iter().map(|n| old[*n][j]).sum::<f64>() / around.len() as f64;
                (0..joints).map(|j| 0.5 * (old[v][j] + mean(j))).collect()
            })
            .collect();
    }
    let mut rows = SkinWeights::default();
    for row in &table {
        let mut best: Vec<usize> = (0..joints).filter(|j| row[*j] >= LEAST).collect();
        best.sort_by(|a, b| row[*b].total_cmp(&row[*a]));
        rows.push(best.iter().take(4).map(|j| (JointId(*j as u32), row[*j] as f32)));
    }
    rows
}
