//! Generalised winding number of any triangles, with a fast far field.
//!
//! w(q) = 1/4π Σ Ω_t(q), the signed solid angles of all triangles: 1 inside a closed surface, 0 outside, in between near holes. Far groups of
//! triangles act through the first two terms of their Taylor expansion [Barill2018]; near ones are summed exactly [VanOosterom1983].
//! Terms: n area-weighted normal [m^2]; r = centre of the group − q.

use super::SurfaceMesh;
use glam::{DMat3, DVec3};
use std::f64::consts::PI;

/// Triangles of a leaf: few enough that exact sums are cheaper than descending further.
const LEAF: usize = 8;

/// Accuracy for decisions with a margin: wrong by less than 0.1, see `far_field_agrees_with_the_plain_sum`.
const ROUGH: f64 = 1.2;
/// Accuracy for decisions: wrong by less than 0.01.
const FINE: f64 = 3.0;

/// A group of triangles of the tree.
struct Group {
    centre: DVec3,
    /// Distance of the farthest corner from `centre` [m].
    radius: f64,
    /// Σ n
    dipole: DVec3,
    /// Σ n ⊗ (c − centre): column j is Σ n (c − centre)_j
    moment: DMat3,
    first: u32,
    last: u32,
    /// Index of the second child; the first one follows its parent. 0 for leaves.
    right: u32,
}

/// Answers winding-number queries for one set of triangles.
pub struct Winding {
    corners: Vec<[DVec3; 3]>,
    groups: Vec<Group>,
    /// Groups farther away than `accuracy` times their radius are expanded [-]. The default of 6 keeps errors below 4e-3
    /// beside closed surfaces, see `far_field_agrees_with_the_plain_sum`.
    pub accuracy: f64,
}

impl Winding {
    /// Prepares for queries. Triangles count as they are wound; those with a missing or non-finite vertex are left out.
    #[must_use]
    pub fn new(surface: &SurfaceMesh) -> Self {
        let corner =
            |v: u32| surface.positions.get(v as usize).map(|p| DVec3::from_array(*p)).filter(|p| p.is_finite());
        let corners =
            surface.triangles.iter().filter_map(|t| Some([corner(t[0])?, corner(t[1])?, corner(t[2])?])).collect();
        Self::from_corners(corners)
    }

    pub(crate) fn from_corners(mut corners: Vec<[DVec3; 3]>) -> Self {
        let mut groups = Vec::with_capacity(2 * corners.len() / LEAF + 1);
        let count = corners.len();
        if count > 0 {
            build(&mut corners, 0, count, &mut groups);
        }
        Self { corners, groups, accuracy: 6.0 }
    }

    /// Winding number at `point` [-].
    #[must_use]
    pub fn at(&self, point: [f64; 3]) -> f64 {
        self.sum(DVec3::from_array(point), self.accuracy)
    }

    /// Whether the winding number is above a level; far from the level a rough answer will do.
    pub(crate) fn exceeds(&self, q: DVec3, level: f64) -> bool {
        let rough = self.sum(q, ROUGH.min(self.accuracy));
        if (rough - level).abs() > 0.2 { rough > level } else { self.sum(q, FINE.min(self.accuracy)) > level }
    }

    /// Whether the winding number is above a level by a margin, or below it; `None` in between.
    pub(crate) fn clearly(&self, q: DVec3, level: f64, margin: f64) -> Option<bool> {
        let off = self.sum(q, ROUGH.min(self.accuracy)) - level;
        (off.abs() > margin).then_some(off > 0.0)
    }

    fn sum(&self, q: DVec3, accuracy: f64) -> f64 {
        let mut sum = 0.0;
        if self.groups.is_empty() {
            return 0.0;
        }
        let mut stack = [0u32; 64];
        let mut top = 1;
        while top > 0 {
            top -= 1;
            let index = stack[top];
            let g = &self.groups[index as usize];
            let r = g.centre - q;
            let distance = r.length();
            if distance > accuracy * g.radius {
                let inv = 1.0 / distance;
                let inv3 = inv * inv * inv;
                // ∂_j (r_i / |r|³) = δ_ij / |r|³ − 3 r_i r_j / |r|⁵, contracted with the moment
                let trace = g.moment.x_axis.x + g.moment.y_axis.y + g.moment.z_axis.z;
                sum += g.dipole.dot(r) * inv3 + trace * inv3 - 3.0 * r.dot(g.moment * r) * inv3 * inv * inv;
            } else if g.right == 0 {
                for t in &self.corners[g.first as usize..g.last as usize] {
                    sum += solid_angle(t, q);
                }
            } else {
                stack[top] = g.right;
                stack[top + 1] = index + 1;
                top += 2;
            }
        }
        sum / (4.0 * PI)
    }
}

/// Signed solid angle of a triangle seen from `q` [sr], positive from behind its front side. Zero for a flat one.
fn solid_angle(t: &[DVec3; 3], q: DVec3) -> f64 {
    let [a, b, c] = [t[0] - q, t[1] - q, t[2] - q];
    let (la, lb, lc) = (a.length(), b.length(), c.length());
    let above = a.dot(b.cross(c));
    let below = la * lb * lc + a.dot(b) * lc + b.dot(c) * la + c.dot(a) * lb;
    // in the plane of the triangle the sign is a matter of rounding: count nothing
    if above == 0.0 { 0.0 } else { 2.0 * above.atan2(below) }
}

/// Appends the group of `corners[first..last]` and all below it. Splits at the median of the longest axis, so depth is log2(n).
fn build(corners: &mut [[DVec3; 3]], first: usize, last: usize, groups: &mut Vec<Group>) {
    let middle = |t: &[DVec3; 3]| (t[0] + t[1] + t[2]) / 3.0;
    let own = &mut corners[first..last];
    let (mut lo, mut hi) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    let (mut weighted, mut area, mut dipole) = (DVec3::ZERO, 0.0, DVec3::ZERO);
    for t in own.iter() {
        let c = middle(t);
        lo = lo.min(c);
        hi = hi.max(c);
        let n = (t[1] - t[0]).cross(t[2] - t[0]) * 0.5;
        dipole += n;
        area += n.length();
        weighted += c * n.length();
    }
    let centre = if area > 0.0 { weighted / area } else { (lo + hi) * 0.5 };
    let mut moment = DMat3::ZERO;
    let mut radius2: f64 = 0.0;
    for t in own.iter() {
        let n = (t[1] - t[0]).cross(t[2] - t[0]) * 0.5;
        let d = middle(t) - centre;
        moment += DMat3::from_cols(n * d.x, n * d.y, n * d.z);
        t.iter().for_each(|p| radius2 = radius2.max(p.distance_squared(centre)));
    }
    let index = groups.len();
    groups.push(Group {
        centre,
        radius: radius2.sqrt(),
        dipole,
        moment,
        first: first as u32,
        last: last as u32,
        right: 0,
    });
    if last - first > LEAF {
        let size = hi - lo;
        let axis = if size.x >= size.y && size.x >= size.z {
            0
        } else if size.y >= size.z {
            1
        } else {
            2
        };
        let half = own.len() / 2;
        own.select_nth_unstable_by(half, |a, b| middle(a)[axis].total_cmp(&middle(b)[axis]));
        build(corners, first, first + half, groups);
        groups[index].right = groups.len() as u32;
        build(corners, first + half, last, groups);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sphere(n: usize) -> Vec<[DVec3; 3]> {
        let point = |i: usize, j: usize| {
            let (u, v) = (PI * i as f64 / n as f64, PI * (j % (2 * n)) as f64 / n as f64);
            DVec3::new(u.sin() * v.cos(), u.cos(), -u.sin() * v.sin())
        };
        let mut out = Vec::new();
        for i in 0..n {
            for j in 0..2 * n {
                let [a, b, c, d] = [point(i, j), point(i, j + 1), point(i + 1, j + 1), point(i + 1, j)];
                out.push([a, d, c]);
                out.push([a, c, b]);
            }
        }
        out
    }

    /// The far field against the plain sum, outside, inside and close to a sphere with a hole.
    #[test]
    fn far_field_agrees_with_the_plain_sum() {
        let mut triangles = sphere(40);
        triangles.truncate(triangles.len() * 4 / 5);
        let fast = Winding::from_corners(triangles.clone());
        let (mut worst, mut fine, mut rough): (f64, f64, f64) = (0.0, 0.0, 0.0);
        for i in 0..2000 {
            let r = |k: i32| ((i * 7919 + k * 104_729) % 2003) as f64 / 2003.0 * 2.6 - 1.3;
            let q = DVec3::new(r(1), r(2), r(3));
            let plain: f64 = triangles.iter().map(|t| solid_angle(t, q)).sum::<f64>() / (4.0 * PI);
            rough = rough.max((plain - fast.sum(q, 1.2)).abs());
            fine = fine.max((plain - fast.sum(q, 3.0)).abs());
            worst = worst.max((plain - fast.at(q.to_array())).abs());
        }
        assert!(worst < 1e-3, "{worst}");
        assert!(rough < 0.1, "{rough}");
        assert!(fine < 0.01, "{fine}");
        // a dipole alone would be worse than this
        assert!(worst > 1e-12);
    }

    #[test]
    fn closed_sphere_has_one_inside_and_zero_outside() {
        let w = Winding::from_corners(sphere(30));
        assert!((w.at([0.1, 0.2, -0.3]) - 1.0).abs() < 4e-3, "{}", w.at([0.1, 0.2, -0.3]));
        assert!((w.at([0.99, 0.0, 0.0]) - 1.0).abs() < 4e-3);
        assert!(w.at([1.1, 0.2, -0.3]).abs() < 4e-3);
    }
}
