//! What is wrong with a surface. Nothing of it keeps softrig from filling it; some of it may surprise.

use serde::Serialize;
use softrig::character::Character;
use softrig::mesh::{surface_components, weld};
use std::collections::BTreeMap;

/// Counts of defects, of all meshes together, once vertices at the same place are merged.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Defects {
    /// Vertices after merging.
    pub welded_vertices: usize,
    /// Parts that are not connected.
    pub parts: usize,
    /// Edges with a triangle on one side only: holes, open ends.
    pub boundary_edges: usize,
    /// Edges of more than two triangles.
    pub non_manifold_edges: usize,
    /// Triangles without area.
    pub degenerate_triangles: usize,
    /// Triangles that are there more than once.
    pub duplicate_triangles: usize,
}

/// Relative to the size of the character: what files store as one place differs by rounding only.
const SAME_PLACE: f64 = 1e-6;

impl Defects {
    /// Counts the defects of a character.
    #[must_use]
    pub fn of(character: &Character) -> Self {
        let mut surface = character.surface(false);
        let Some((lo, hi)) = surface.bounds() else { return Self::default() };
        let size = (0..3).map(|k| hi[k] - lo[k]).fold(0.0, f64::max);
        let welded = weld(&surface.positions, SAME_PLACE * size);
        for t in &mut surface.triangles {
            *t = t.map(|v| welded.vertex_to_welded[v as usize]);
        }
        let all = surface.triangles.len();
        surface.triangles.retain(|t| t[0] != t[1] && t[1] != t[2] && t[2] != t[0]);
        let degenerate = all - surface.triangles.len();
        surface.positions = welded.positions;
        let parts = surface_components(&surface).count;

        let mut seen = BTreeMap::<[u32; 3], usize>::new();
        let mut edges = BTreeMap::<[u32; 2], usize>::new();
        for t in &surface.triangles {
            let mut key = *t;
            key.sort_unstable();
            *seen.entry(key).or_default() += 1;
            for (a, b) in [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])] {
                *edges.entry([a.min(b), a.max(b)]).or_default() += 1;
            }
        }
        Self {
            welded_vertices: surface.positions.len(),
            parts,
            boundary_edges: edges.values().filter(|n| **n == 1).count(),
            non_manifold_edges: edges.values().filter(|n| **n > 2).count(),
            degenerate_triangles: degenerate,
            duplicate_triangles: seen.values().map(|n| n - 1).sum(),
        }
    }

    /// In words.
    #[must_use]
    pub fn text(&self) -> String {
        let counts = [
            (self.boundary_edges, "edges of holes"),
            (self.non_manifold_edges, "edges of more than two triangles"),
            (self.degenerate_triangles, "triangles without area"),
            (self.duplicate_triangles, "doubled triangles"),
        ];
        let found: Vec<_> = counts.iter().filter(|(n, _)| *n > 0).map(|(n, what)| format!("{n} {what}")).collect();
        let parts = if self.parts == 1 { "one part".into() } else { format!("{} parts", self.parts) };
        let found = if found.is_empty() { "closed, no defects".into() } else { found.join(", ") };
        format!("{parts}, {} different vertices: {found}", self.welded_vertices)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use softrig::character::CharacterMesh;

    /// A tetrahedron whose corners are split, one face doubled, one triangle a line.
    #[test]
    fn defects_are_counted_after_merging() {
        let p = [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        let faces = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]];
        let mut mesh = CharacterMesh::default();
        for f in faces.iter().chain(&[faces[0], [0, 0, 1]]) {
            let base = mesh.positions.len() as u32;
            mesh.positions.extend(f.map(|v| p[v]));
            mesh.triangles.push([base, base + 1, base + 2]);
        }
        let mut character = softrig::sample::character();
        character.meshes = vec![mesh];
        let expected = Defects {
            welded_vertices: 4,
            parts: 1,
            boundary_edges: 0,
            non_manifold_edges: 3,
            degenerate_triangles: 1,
            duplicate_triangles: 1,
        };
        assert_eq!(Defects::of(&character), expected);
    }

    #[test]
    fn the_built_in_character_is_closed() {
        let defects = Defects::of(&softrig::sample::character());
        assert_eq!((defects.boundary_edges, defects.non_manifold_edges, defects.degenerate_triangles), (0, 0, 0));
    }
}
