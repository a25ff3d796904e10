//! Triangle surfaces.

/// A triangle surface: any triangles, with no promise of being closed, oriented or free of crossings.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SurfaceMesh {
    /// Vertex positions [m].
    pub positions: Vec<[f64; 3]>,
    /// Vertex indices of each triangle; counter-clockwise seen from outside where the surface has an outside.
    pub triangles: Vec<[u32; 3]>,
}

impl SurfaceMesh {
    /// Smallest box around all vertices, as (lowest corner, highest corner) [m]; `None` without vertices.
    #[must_use]
    pub fn bounds(&self) -> Option<([f64; 3], [f64; 3])> {
        bounds(&self.positions)
    }
}

/// Smallest box around points, as (lowest corner, highest corner); `None` without points.
#[must_use]
pub(crate) fn bounds(points: &[[f64; 3]]) -> Option<([f64; 3], [f64; 3])> {
    let first = *points.first()?;
    Some(points.iter().fold((first, first), |(mut lo, mut hi), p| {
        for k in 0..3 {
            lo[k] = lo[k].min(p[k]);
            hi[k] = hi[k].max(p[k]);
        }
        (lo, hi)
    }))
}
