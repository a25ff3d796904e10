//! Modal warping: displacements of linear modes, turned with the material.
//!
//! Implements [Choi2005]. The rotation vector of a node is half the curl of the displacement, w = Ψ q, linear in the modes; were it
//! reached at constant rate, the displacement u = Φ q in the turning frame ends at R~(w) u. Forces are turned back by R(w)ᵀ.

use glam::{DMat3, DVec3};
use softrig::force::tet_gradients;
use softrig::mesh::VolumeMesh;

/// Rotation vectors of the nodes for each mode: half the curl, the mean of the tetrahedra around a node by volume. `None` for meshes
/// with other cells.
pub(super) fn curls(mesh: &VolumeMesh, shapes: &[Vec<[f64; 3]>]) -> Option<Vec<Vec<[f64; 3]>>> {
    if !mesh.hexes.is_empty() {
        return None;
    }
    let mut weight = vec![0.0; mesh.node_count()];
    let cells: Vec<_> = mesh
        .tets
        .iter()
        .map(|t| {
            let (g, volume) = tet_gradients(t.map(|n| mesh.nodes[n as usize]));
            t.iter().for_each(|n| weight[*n as usize] += volume);
            (t, g.map(DVec3::from), volume)
        })
        .collect();
    let of_mode = |shape: &Vec<[f64; 3]>| {
        let mut sum = vec![DVec3::ZERO; mesh.node_count()];
        for (t, g, volume) in &cells {
            let u = t.map(|n| DVec3::from(shape[n as usize]));
            // ∇ × u = Σ g_a × u_a
            let curl = g[0].cross(u[1] - u[0]) + g[1].cross(u[2] - u[0]) + g[2].cross(u[3] - u[0]);
            t.iter().for_each(|n| sum[*n as usize] += curl * (0.5 * volume));
        }
        sum.iter().zip(&weight).map(|(s, w)| if *w > 0.0 { (*s / *w).to_array() } else { [0.0; 3] }).collect()
    };
    Some(shapes.iter().map(of_mode).collect())
}

/// R(w) = exp [w] and its mean on the way there, R~(w) = ∫ exp [s w] ds over s from 0 to 1.
pub(super) fn turn(w: DVec3) -> (DMat3, DMat3) {
    let angle = w.length();
    let cross = DMat3::from_cols(DVec3::new(0.0, w.z, -w.y), DVec3::new(-w.z, 0.0, w.x), DVec3::new(w.y, -w.x, 0.0));
    let square = cross * cross;
    // sin a / a, (1 - cos a) / a², (a - sin a) / a³
    let (a, b, c) = if angle > 1e-3 {
        let a2 = angle * angle;
        (angle.sin() / angle, (1.0 - angle.cos()) / a2, (angle - angle.sin()) / (a2 * angle))
    } else {
        let a2 = angle * angle;
        (1.0 - a2 / 6.0, 0.5 - a2 / 24.0, 1.0 / 6.0 - a2 / 120.0)
    };
    (DMat3::IDENTITY + cross * a + square * b, DMat3::IDENTITY + cross * b + square * c)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The closed forms against the sum of many small turns.
    #[test]
    fn turns_are_exponentials_and_their_means() {
        for w in [DVec3::new(0.3, -1.2, 0.7), DVec3::new(1e-4, 2e-4, -1e-4)] {
            let n = 20_000;
            let mut mean = DMat3::ZERO;
            for k in 0..n {
                let s = (f64::from(k) + 0.5) / f64::from(n);
                mean += DMat3::from_quat(glam::DQuat::from_scaled_axis(w * s)) * (1.0 / f64::from(n));
            }
            let (r, m) = turn(w);
            let whole = DMat3::from_quat(glam::DQuat::from_scaled_axis(w));
            let far = |a: DMat3, b: DMat3| (a - b).to_cols_array().iter().fold(0.0f64, |m, x| m.max(x.abs()));
            assert!(far(r, whole) < 1e-12 && far(m, mean) < 1e-8, "{} {}", far(r, whole), far(m, mean));
        }
    }
}
