//! The closest point of a closed triangle surface that moves with its nodes: a tree of boxes, refitted every step.
//!
//! Takes the place of the closest point transform of [Gissler2006 §4.4], which samples space on a grid.

use super::ConstraintError;
use glam::DVec3;
use std::collections::BTreeMap;

/// Triangles of a leaf.
const LEAF: usize = 4;

/// A closed surface of nodes.
#[derive(Clone, Debug)]
pub struct Surface {
    triangles: Vec<[u32; 3]>,
    /// Triangles in the order of the leaves.
    order: Vec<u32>,
    branches: Vec<Branch>,
}

#[derive(Clone, Copy, Debug)]
struct Branch {
    lo: DVec3,
    hi: DVec3,
    first: u32,
    last: u32,
    /// Second child, the first follows its parent; 0 for leaves.
    right: u32,
}

/// Where a surface is nearest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClosestPoint {
    /// Which triangle.
    pub triangle: u32,
    /// Nodes of the triangle.
    pub nodes: [u32; 3],
    /// Their weights [-], in [0, 1] with the sum 1; zeros on edges and corners.
    pub weights: [f64; 3],
    /// Distance [m].
    pub distance: f64,
}

impl Surface {
    /// A surface of these triangles of nodes.
    ///
    /// # Errors
    /// [`ConstraintError`] when a triangle names a node twice or one that does not exist, or when an edge has only one triangle.
    pub fn new(triangles: Vec<[u32; 3]>, node_count: usize) -> Result<Self, ConstraintError> {
        if triangles.is_empty() {
            return Err(ConstraintError::EmptySurface);
        }
        let mut edges = BTreeMap::<[u32; 2], usize>::new();
        for (i, t) in triangles.iter().enumerate() {
            let distinct = t[0] != t[1] && t[1] != t[2] && t[2] != t[0];
            if !distinct || t.iter().any(|n| *n as usize >= node_count) {
                return Err(ConstraintError::BadTriangle { triangle: i, nodes: *t, node_count });
            }
            for k in 0..3 {
                let (a, b) = (t[k], t[(k + 1) % 3]);
                *edges.entry([a.min(b), a.max(b)]).or_default() += 1;
            }
        }
        let mut rim = edges.iter().filter(|(_, count)| **count == 1);
        if let Some((first, _)) = rim.next() {
            return Err(ConstraintError::OpenSurface { edges: 1 + rim.count(), first: *first });
        }
        Ok(Self { triangles, order: Vec::new(), branches: Vec::new() })
    }

    /// The triangles.
    #[must_use]
    pub fn triangles(&self) -> &[[u32; 3]] {
        &self.triangles
    }

    /// Fits the boxes to the nodes' positions, which `at` gives [m]. The tree is built on the first call and keeps its shape.
    pub fn fit(&mut self, at: &dyn Fn(u32) -> [f64; 3]) {
        let corner = |i: u32| self.triangles[i as usize].map(|n| DVec3::from(at(n)));
        if self.branches.is_empty() {
            let centre: Vec<DVec3> = (0..self.triangles.len() as u32).map(|i| corner(i).iter().sum()).collect();
            let mut order: Vec<u32> = (0..self.triangles.len() as u32).collect();
            build(&centre, &mut order, 0, &mut self.branches);
            self.order = order;
        }
        // children come after their parents
        for k in (0..self.branches.len()).rev() {
            let b = self.branches[k];
            let (lo, hi) = if b.right == 0 {
                let own = &self.order[b.first as usize..b.last as usize];
                let start = (DVec3::INFINITY, DVec3::NEG_INFINITY);
                own.iter().flat_map(|i| corner(*i)).fold(start, |(l, h), p| (l.min(p), h.max(p)))
            } else {
                let (l, r) = (self.branches[k + 1], self.branches[b.right as usize]);
                (l.lo.min(r.lo), l.hi.max(r.hi))
            };
            (self.branches[k].lo, self.branches[k].hi) = (lo, hi);
        }
    }

    /// The closest point to `point` [m] with the boxes of the last [`Self::fit`], whose positions `at` must give again; of equal
    /// distances the triangle with the lowest number. `None` when nothing is at a finite place.
    #[must_use]
    pub fn closest(&self, point: [f64; 3], at: &dyn Fn(u32) -> [f64; 3]) -> Option<ClosestPoint> {
        let p = DVec3::from(point);
        let mut best: Option<ClosestPoint> = None;
        let mut reach = f64::INFINITY;
        let mut stack = vec![0u32];
        while let Some(k) = stack.pop() {
            let Some(b) = self.branches.get(k as usize) else { continue };
            if gap(b, p) > reach {
                continue;
            }
            if b.right == 0 {
                for &i in &self.order[b.first as usize..b.last as usize] {
                    let nodes = self.triangles[i as usize];
                    let corners = nodes.map(|n| DVec3::from(at(n)));
                    let weights = closest_on_triangle(p, corners);
                    let q = corners[0] * weights[0] + corners[1] * weights[1] + corners[2] * weights[2];
                    let square = p.distance_squared(q);
                    let nearer = square < reach || (square == reach && best.is_some_and(|b| i < b.triangle));
                    if nearer {
                        reach = square;
                        best = Some(ClosestPoint { triangle: i, nodes, weights, distance: square.sqrt() });
                    }
                }
            } else {
                let (left, right) = (k + 1, b.right);
                let near = gap(&self.branches[left as usize], p) <= gap(&self.branches[right as usize], p);
                stack.extend(if near { [right, left] } else { [left, right] });
            }
        }
        best
    }
}

/// Square of the distance to a box.
fn gap(b: &Branch, p: DVec3) -> f64 {
    (b.lo - p).max(p - b.hi).max(DVec3::ZERO).length_squared()
}

fn build(centre: &[DVec3], own: &mut [u32], first: usize, branches: &mut Vec<Branch>) {
    let index = branches.len();
    let (first32, last) = (first as u32, (first + own.len()) as u32);
    branches.push(Branch { lo: DVec3::ZERO, hi: DVec3::ZERO, first: first32, last, right: 0 });
    if own.len() <= LEAF {
        return;
    }
    let start = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    let (lo, hi) = own.iter().fold(start, |(l, h), i| (l.min(centre[*i as usize]), h.max(centre[*i as usize])));
    let size = (hi - lo).to_array();
    let axis = (0..3).fold(0, |m, k| if size[k] > size[m] { k } else { m });
    let half = own.len() / 2;
    own.select_nth_unstable_by(half, |a, b| {
        centre[*a as usize][axis].total_cmp(&centre[*b as usize][axis]).then(a.cmp(b))
    });
    let (left, right) = own.split_at_mut(half);
    build(centre, left, first, branches);
    branches[index].right = branches.len() as u32;
    build(centre, right, first + half, branches);
}

/// Weights of the point of a triangle closest to `p`: by the regions of its corners, edges and face [Ericson2005].
fn closest_on_triangle(p: DVec3, [a, b, c]: [DVec3; 3]) -> [f64; 3] {
    let (ab, ac, ap) = (b - a, c - a, p - a);
    let (d1, d2) = (ab.dot(ap), ac.dot(ap));
    if d1 <= 0.0 && d2 <= 0.0 {
        return [1.0, 0.0, 0.0];
    }
    let bp = p - b;
    let (d3, d4) = (ab.dot(bp), ac.dot(bp));
    if d3 >= 0.0 && d4 <= d3 {
        return [0.0, 1.0, 0.0];
    }
    let edge = |t: f64| if t.is_finite() { t.clamp(0.0, 1.0) } else { 0.0 };
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        let t = edge(d1 / (d1 - d3));
        return [1.0 - t, t, 0.0];
    }
    let cp = p - c;
    let (d5, d6) = (ab.dot(cp), ac.dot(cp));
    if d6 >= 0.0 && d5 <= d6 {
        return [0.0, 0.0, 1.0];
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        let t = edge(d2 / (d2 - d6));
        return [1.0 - t, 0.0, t];
    }
    let va = d3 * d6 - d5 * d4;
    if va <= 0.0 && d4 - d3 >= 0.0 && d5 - d6 >= 0.0 {
        let t = edge((d4 - d3) / ((d4 - d3) + (d5 - d6)));
        return [0.0, 1.0 - t, t];
    }
    let (v, w) = (edge(vb / (va + vb + vc)), edge(vc / (va + vb + vc)));
    // rounding must not leave [0, 1]
    let w = w.min(1.0 - v);
    [1.0 - v - w, v, w]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The tree and a scan of densely sampled triangles find the same distance; the two share no code but the positions.
    #[test]
    fn closest_points_are_those_of_a_dense_scan() {
        // an octahedron, subdivided and dented
        let mut nodes: Vec<DVec3> =
            [DVec3::X, -DVec3::X, DVec3::Y, -DVec3::Y, DVec3::Z, -DVec3::Z].into_iter().collect();
        let mut triangles: Vec<[u32; 3]> =
            vec![[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]];
        for _ in 0..3 {
            let mut middle = BTreeMap::new();
            let mut finer = Vec::new();
            for t in &triangles {
                let mut m = |a: u32, b: u32, nodes: &mut Vec<DVec3>| {
                    *middle.entry([a.min(b), a.max(b)]).or_insert_with(|| {
                        nodes.push((nodes[a as usize] + nodes[b as usize]).normalize());
                        nodes.len() as u32 - 1
                    })
                };
                let (x, y, z) = (m(t[0], t[1], &mut nodes), m(t[1], t[2], &mut nodes), m(t[2], t[0], &mut nodes));
                finer.extend([[t[0], x, z], [x, t[1], y], [z, y, t[2]], [x, y, z]]);
            }
            triangles = finer;
        }
        nodes.iter_mut().for_each(|p| *p *= 1.0 + 0.3 * (5.0 * p.x).sin() * p.y);
        let at = |n: u32| nodes[n as usize].to_array();
        let mut surface = Surface::new(triangles.clone(), nodes.len()).unwrap();
        surface.fit(&at);
        for k in 0..60 {
            let s = f64::from(k);
            let p = DVec3::new((s * 1.7).sin(), (s * 2.3).cos(), (s * 0.9).sin()) * (0.3 + 0.03 * s);
            let found = surface.closest(p.to_array(), &at).unwrap();
            let mut best = f64::INFINITY;
            for t in &triangles {
                let c = t.map(|n| nodes[n as usize]);
                for i in 0..=20 {
                    for j in 0..=20 - i {
                        let (u, v) = (f64::from(i) / 20.0, f64::from(j) / 20.0);
                        best = best.min(p.distance(c[0] * (1.0 - u - v) + c[1] * u + c[2] * v));
                    }
                }
            }
            // samples are at most 0.01 m apart and never nearer than the nearest point
            assert!(found.distance <= best + 1e-12 && found.distance > best - 0.01, "{} {best}", found.distance);
            let sum: f64 = found.weights.iter().sum();
            assert!((sum - 1.0).abs() < 1e-15 && found.weights.iter().all(|w| (0.0..=1.0).contains(w)));
        }
    }
}
