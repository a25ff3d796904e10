//! Vertex normals that are smooth across seams and sharp across edges.

use std::collections::HashMap;

/// Sharper edges than this stay sharp [cosine of 50 degrees].
const CREASE: f64 = 0.642_787_609_686_539_3;

/// Which triangles each vertex takes its normal from, decided once on the rest shape: its own, and those of vertices at the
/// same place (where a file cuts its surface for texture coordinates) unless an edge lies between them.
#[derive(Clone, Debug)]
pub(super) struct SmoothNormals {
    triangles: Vec<[u32; 3]>,
    /// Vertices with one common normal: index of the group of each.
    group: Vec<u32>,
    groups: usize,
}

impl SmoothNormals {
    /// Decides on the rest shape.
    pub fn new(rest: &[[f64; 3]], triangles: &[[u32; 3]]) -> Self {
        let alone: Vec<u32> = (0..rest.len() as u32).collect();
        let mut this = Self { triangles: triangles.to_vec(), group: alone, groups: rest.len() };
        let own = this.of(|v| rest[v]);
        let mut at_place: HashMap<[u64; 3], Vec<u32>> = HashMap::new();
        // + 0.0 makes one place of the two zeros
        let place = |p: &[f64; 3]| p.map(|v| (v + 0.0).to_bits());
        let mut groups = 0;
        for v in 0..rest.len() {
            let others = at_place.entry(place(&rest[v])).or_default();
            let alike = |u: &&u32| {
                let n = own[**u as usize];
                (0..3).map(|k| f64::from(n[k]) * f64::from(own[v][k])).sum::<f64>() > CREASE
            };
            this.group[v] = match others.iter().find(alike) {
                Some(u) => this.group[*u as usize],
                None => {
                    groups += 1;
                    others.push(v as u32);
                    groups - 1
                }
            };
        }
        this.groups = groups as usize;
        this
    }

    /// Unit normals for the given positions; up where a vertex has no triangle with an area.
    pub fn of(&self, position: impl Fn(usize) -> [f64; 3]) -> Vec<[f32; 3]> {
        let mut sums = vec![[0.0f64; 3]; self.groups];
        for t in &self.triangles {
            let [a, b, c] = t.map(|v| position(v as usize));
            let (u, w) = ([b[0] - a[0], b[1] - a[1], b[2] - a[2]], [c[0] - a[0], c[1] - a[1], c[2] - a[2]]);
            // twice the area times the normal
            let n = [u[1] * w[2] - u[2] * w[1], u[2] * w[0] - u[0] * w[2], u[0] * w[1] - u[1] * w[0]];
            for v in t {
                let sum = &mut sums[self.group[*v as usize] as usize];
                (0..3).for_each(|k| sum[k] += n[k]);
            }
        }
        let unit: Vec<[f32; 3]> = sums
            .iter()
            .map(|n| {
                let length = (n[0] * n[0] + n[1] * n[1] + n[2] * n[2]).sqrt();
                if length > 0.0 && length.is_finite() { n.map(|v| (v / length) as f32) } else { [0.0, 1.0, 0.0] }
            })
            .collect();
        self.group.iter().map(|g| unit[*g as usize]).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two triangles that share an edge through doubled vertices: flat, they have one normal; folded, each keeps its own.
    #[test]
    fn seams_are_smooth_and_edges_sharp() {
        let normals = |z: f64| {
            let rest =
                [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, z], [0.0, 1.0, 0.0]];
            SmoothNormals::new(&rest, &[[0, 1, 2], [3, 4, 5]]).of(|v| rest[v])
        };
        let gentle = normals(0.1);
        assert!(gentle[1] == gentle[3] && gentle[2] == gentle[5] && gentle[1] != gentle[0]);
        let sharp = normals(5.0);
        assert!(sharp[1] == sharp[0] && sharp[3] == sharp[4] && sharp[1] != sharp[3]);
    }
}
