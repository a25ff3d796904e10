//! Points spread over a surface.

use super::SurfaceMesh;
use glam::DVec3;

/// A point on a triangle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfaceSample {
    /// Which triangle.
    pub triangle: u32,
    /// Weights of its three vertices, summing to 1 [-].
    pub weights: [f64; 3],
    /// Where it is [m].
    pub position: [f64; 3],
}

/// Points on all triangles, no farther than about `spacing` [m] apart, in the order of the triangles; every corner of a triangle is one of its points.
/// Triangles with missing or non-finite vertices are left out; no triangle gets more than about a million points.
#[must_use]
pub fn surface_samples(surface: &SurfaceMesh, spacing: f64) -> Vec<SurfaceSample> {
    let mut out = Vec::new();
    for (triangle, t) in surface.triangles.iter().enumerate() {
        let corner =
            |v: u32| surface.positions.get(v as usize).map(|p| DVec3::from_array(*p)).filter(|p| p.is_finite());
        let (Some(a), Some(b), Some(c)) = (corner(t[0]), corner(t[1]), corner(t[2])) else { continue };
        on_triangle([a, b, c], spacing, |weights| {
            let position = (a * weights[0] + b * weights[1] + c * weights[2]).to_array();
            out.push(SurfaceSample { triangle: triangle as u32, weights, position });
        });
    }
    out
}

/// Calls `visit` with the weights of points over one triangle, no farther than `spacing` apart along its edges.
pub(crate) fn on_triangle(p: [DVec3; 3], spacing: f64, mut visit: impl FnMut([f64; 3])) {
    // rows along the shortest edge, so that needles get few points
    let length = [p[1].distance(p[2]), p[2].distance(p[0]), p[0].distance(p[1])];
    let tip = (0..3).min_by(|a, b| length[*a].total_cmp(&length[*b])).unwrap_or(0);
    let (b, c) = ((tip + 1) % 3, (tip + 2) % 3);
    let steps = |l: f64| {
        let n = (l / spacing).ceil();
        if n.is_finite() { n.clamp(1.0, 1500.0) } else { 1.0 }
    };
    let rows = steps(length[b].max(length[c])) as usize;
    for r in 0..=rows {
        let down = r as f64 / rows as f64;
        let across = if r == 0 { 0 } else { steps(length[tip] * down) as usize };
        for s in 0..=across {
            let side = if across == 0 { 0.0 } else { s as f64 / across as f64 };
            let mut w = [0.0; 3];
            w[tip] = 1.0 - down;
            w[b] = down * (1.0 - side);
            w[c] = down * side;
            visit(w);
        }
    }
}
