//! Triangle surfaces.

use glam::DVec3;

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

    /// Sum of the areas of all triangles [m^2]. Indices must be valid, here and below.
    #[must_use]
    pub fn area(&self) -> f64 {
        self.triangles.iter().map(|t| self.normal(t).length() * 0.5).sum()
    }

    /// Volume enclosed, by the divergence theorem [m^3]: negative when wound inward, meaningless when open.
    #[must_use]
    pub fn signed_volume(&self) -> f64 {
        let origin = self.bounds().map_or(DVec3::ZERO, |(lo, hi)| (DVec3::from(lo) + DVec3::from(hi)) * 0.5);
        let corner = |v: u32| DVec3::from_array(self.positions[v as usize]) - origin;
        self.triangles.iter().map(|t| corner(t[0]).cross(corner(t[1])).dot(corner(t[2])) / 6.0).sum()
    }

    /// Unit normal of each vertex, the mean of its triangles' by area; zero where there is none. Seams are not welded.
    #[must_use]
    pub fn vertex_normals(&self) -> Vec<[f64; 3]> {
        let mut sum = vec![DVec3::ZERO; self.positions.len()];
        for t in &self.triangles {
            let n = self.normal(t);
            t.iter().for_each(|v| sum[*v as usize] += n);
        }
        sum.into_iter().map(|n| n.normalize_or_zero().to_array()).collect()
    }

    /// What is irregular about the surface, after merging vertices closer than 1e-6 of its diagonal.
    #[must_use]
    pub fn defects(&self) -> SurfaceDefects {
        let diagonal = self.bounds().map_or(0.0, |(lo, hi)| (DVec3::from(hi) - DVec3::from(lo)).length());
        let welded = super::weld(&self.positions, 1e-6 * diagonal);
        let mut out = SurfaceDefects { welded_vertices: welded.positions.len(), ..SurfaceDefects::default() };
        let clean = Self {
            triangles: self.triangles.iter().map(|t| t.map(|v| welded.vertex_to_welded[v as usize])).collect(),
            positions: welded.positions,
        };
        let mut edges = Vec::with_capacity(3 * clean.triangles.len());
        let mut keys = Vec::with_capacity(clean.triangles.len());
        let mut kept = Vec::with_capacity(clean.triangles.len());
        for t in &clean.triangles {
            if t[0] == t[1] || t[1] == t[2] || t[2] == t[0] || clean.normal(t) == DVec3::ZERO {
                out.degenerate_triangles += 1;
            }
            if t[0] != t[1] && t[1] != t[2] && t[2] != t[0] {
                kept.push(*t);
                let mut key = *t;
                key.sort_unstable();
                keys.push(key);
                for k in 0..3 {
                    let (a, b) = (t[k], t[(k + 1) % 3]);
                    edges.push((a.min(b), a.max(b), a < b));
                }
            }
        }
        keys.sort_unstable();
        out.duplicate_triangles = keys.chunk_by(|a, b| a == b).map(|g| g.len() - 1).sum();
        edges.sort_unstable();
        for g in edges.chunk_by(|a, b| (a.0, a.1) == (b.0, b.1)) {
            match g {
                [_] => out.boundary_edges += 1,
                [a, b] => out.misoriented_edges += usize::from(a.2 == b.2),
                _ => out.non_manifold_edges += 1,
            }
        }
        out.components = super::surface_components(&Self { triangles: kept, ..clean }).count;
        out
    }

    /// Twice the area times the unit normal.
    fn normal(&self, t: &[u32; 3]) -> DVec3 {
        let [a, b, c] = t.map(|v| DVec3::from_array(self.positions[v as usize]));
        (b - a).cross(c - a)
    }
}

/// Irregularities of a surface.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SurfaceDefects {
    /// Vertices left after welding.
    pub welded_vertices: usize,
    /// Connected components after welding.
    pub components: usize,
    /// Edges of one triangle only: the rims of holes.
    pub boundary_edges: usize,
    /// Edges of more than two triangles.
    pub non_manifold_edges: usize,
    /// Edges whose two triangles are wound against each other.
    pub misoriented_edges: usize,
    /// Triangles with the same corners as an earlier one.
    pub duplicate_triangles: usize,
    /// Triangles without area.
    pub degenerate_triangles: usize,
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
