//! Polygonises the implicit skin: surface nets on a grid, then relaxation on the surface.
//!
//! Surface nets put one vertex into each grid cell that the surface crosses and one quadrilateral around each grid edge it
//! crosses [Gibson1998]. Vertices then slide towards the middle of their neighbours and back onto the surface, which removes
//! the stair-steps of the grid and evens out the triangles.

use super::shape::{Body, body};
use crate::mesh::SurfaceMesh;
use glam::DVec3;
use rayon::prelude::*;

/// Edge of the grid [m]: gives about 8 thousand vertices.
pub(super) const SPACING: f64 = 0.0215;

/// Box that holds the body [m].
const LOW: DVec3 = DVec3::new(-0.75, -0.06, -0.36);
const HIGH: DVec3 = DVec3::new(0.75, 1.68, 0.42);

/// Rounds of relaxation; the triangles do not change visibly after these.
const ROUNDS: usize = 10;

/// The closed skin as triangles, oriented outwards.
pub(super) fn polygonise(spacing: f64) -> SurfaceMesh {
    let body = body();
    let (mut positions, quads) = surface_nets(&body, spacing);
    relax(&body, &mut positions, &quads);
    let mut triangles = Vec::with_capacity(2 * quads.len());
    for q in quads {
        let p = q.map(|v| positions[v as usize]);
        // the shorter diagonal
        if p[0].distance_squared(p[2]) <= p[1].distance_squared(p[3]) {
            triangles.extend([[q[0], q[1], q[2]], [q[0], q[2], q[3]]]);
        } else {
            triangles.extend([[q[0], q[1], q[3]], [q[1], q[2], q[3]]]);
        }
    }
    SurfaceMesh { positions: positions.into_iter().map(|p| p.to_array()).collect(), triangles }
}

/// Vertices and quadrilaterals, counter-clockwise seen from outside.
fn surface_nets(body: &Body, spacing: f64) -> (Vec<DVec3>, Vec<[u32; 4]>) {
    let size = ((HIGH - LOW) / spacing).ceil();
    let n = [size.x as usize + 1, size.y as usize + 1, size.z as usize + 1];
    let node = |i: usize, j: usize, k: usize| i + n[0] * (j + n[1] * k);
    let at = |i: usize, j: usize, k: usize| LOW + spacing * DVec3::new(i as f64, j as f64, k as f64);
    let mut value = vec![0.0; n[0] * n[1] * n[2]];
    value.par_chunks_mut(n[0] * n[1]).enumerate().for_each(|(k, slab)| {
        for j in 0..n[1] {
            let mut i = 0;
            while i < n[0] {
                let d = body.field(at(i, j, k)).d;
                slab[i + n[0] * j] = d;
                // The distance changes by at most about the distance walked: what lies surely on the same side is not looked at.
                // Half of it, because ellipsoids overestimate far away.
                let skip = ((0.5 * d.abs() / spacing) as usize).min(n[0] - 1 - i);
                slab[i + n[0] * j..=i + skip + n[0] * j].fill(d);
                i += skip + 1;
            }
        }
    });

    let mut positions = Vec::new();
    let mut vertex = vec![u32::MAX; value.len()];
    for k in 0..n[2] - 1 {
        for j in 0..n[1] - 1 {
            for i in 0..n[0] - 1 {
                let d: [f64; 8] = std::array::from_fn(|c| value[node(i + (c & 1), j + (c >> 1 & 1), k + (c >> 2))]);
                let (mut sum, mut count) = (DVec3::ZERO, 0.0);
                for a in 0..8usize {
                    for axis in 0..3 {
                        let b = a | 1 << axis;
                        if b != a && (d[a] < 0.0) != (d[b] < 0.0) {
                            let corner = DVec3::new((a & 1) as f64, (a >> 1 & 1) as f64, (a >> 2) as f64);
                            sum += corner + DVec3::AXES[axis] * (d[a] / (d[a] - d[b]));
                            count += 1.0;
                        }
                    }
                }
                if count > 0.0 {
                    vertex[node(i, j, k)] = positions.len() as u32;
                    positions.push(at(i, j, k) + spacing * sum / count);
                }
            }
        }
    }

    let mut quads = Vec::new();
    let stride = [1, n[0], n[0] * n[1]];
    for k in 1..n[2] - 1 {
        for j in 1..n[1] - 1 {
            for i in 1..n[0] - 1 {
                let from = node(i, j, k);
                for axis in 0..3 {
                    let (u, w) = (stride[(axis + 1) % 3], stride[(axis + 2) % 3]);
                    let (inside, beyond) = (value[from] < 0.0, value[from + stride[axis]] < 0.0);
                    if inside != beyond {
                        let around = [from - u - w, from - w, from, from - u].map(|c| vertex[c]);
                        quads.push(if inside { around } else { [around[0], around[3], around[2], around[1]] });
                    }
                }
            }
        }
    }
    (positions, quads)
}

/// Slides every vertex to the mean of its neighbours within the tangent plane, and back onto the surface.
fn relax(body: &Body, positions: &mut Vec<DVec3>, quads: &[[u32; 4]]) {
    let mut neighbours = vec![Vec::new(); positions.len()];
    for q in quads {
        for c in 0..4 {
            // every edge is shared by two quadrilaterals that run along it in opposite directions: each end is listed once
            neighbours[q[c] as usize].push(q[(c + 1) % 4]);
        }
    }
    for _ in 0..ROUNDS {
        let old = &*positions;
        *positions = old
            .par_iter()
            .zip(&neighbours)
            .map(|(&p, around)| {
                let mean = around.iter().map(|v| old[*v as usize]).sum::<DVec3>() / around.len() as f64;
                let normal = body.field(p).gradient.normalize_or_zero();
                let step = mean - p;
                body.project(p + 0.6 * (step - normal * step.dot(normal)))
            })
            .collect();
    }
}
