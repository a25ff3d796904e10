//! Shape functions of the two cells, as far as meshes need them: where a point is within a cell.

use glam::{DMat3, DVec3};

/// Corner signs of a hexahedron in VTK order, as 0 or 1.
const CORNERS: [[f64; 3]; 8] = [
    [0.0, 0.0, 0.0],
    [1.0, 0.0, 0.0],
    [1.0, 1.0, 0.0],
    [0.0, 1.0, 0.0],
    [0.0, 0.0, 1.0],
    [1.0, 0.0, 1.0],
    [1.0, 1.0, 1.0],
    [0.0, 1.0, 1.0],
];

/// Trilinear weights at local coordinates; inside the cell where all are in [0, 1].
pub(crate) fn trilinear(c: DVec3) -> [f64; 8] {
    CORNERS.map(|s| (0..3).map(|k| if s[k] == 1.0 { c[k] } else { 1.0 - c[k] }).product())
}

/// Derivatives of [`trilinear`] in the three local coordinates.
fn trilinear_gradient(c: DVec3) -> [DVec3; 8] {
    CORNERS.map(|s| {
        let f = |k: usize| if s[k] == 1.0 { c[k] } else { 1.0 - c[k] };
        let d = |k: usize| if s[k] == 1.0 { 1.0 } else { -1.0 };
        DVec3::new(d(0) * f(1) * f(2), f(0) * d(1) * f(2), f(0) * f(1) * d(2))
    })
}

/// Derivative of the position in the local coordinates of a hexahedron [m].
pub(crate) fn hex_jacobian(x: &[DVec3; 8], c: DVec3) -> DMat3 {
    let mut j = DMat3::ZERO;
    for (g, x) in trilinear_gradient(c).iter().zip(x) {
        j += DMat3::from_cols(*x * g.x, *x * g.y, *x * g.z);
    }
    j
}

/// Weights of a point in a hexahedron and how far outside it is in local coordinates: 0 inside.
/// The local coordinates are sought in the cell; what is left goes linearly from there, so that weights reproduce the point, and all linear
/// functions, even far outside.
pub(crate) fn hex_weights(x: &[DVec3; 8], p: DVec3) -> Option<([f64; 8], f64)> {
    let mut c = DVec3::splat(0.5);
    let map = |c: DVec3| trilinear(c).iter().zip(x).fold(DVec3::ZERO, |s, (w, x)| s + *x * *w);
    let mut step = DVec3::ZERO;
    let mut j = DMat3::ZERO;
    for _ in 0..20 {
        j = hex_jacobian(x, c);
        if !invertible(&j) {
            return None;
        }
        step = j.inverse() * (p - map(c));
        let next = (c + step).clamp(DVec3::ZERO, DVec3::ONE);
        let moved = next.distance(c);
        c = next;
        if moved < 1e-14 {
            break;
        }
    }
    // last linear step, from wherever Newton stopped
    let _ = step;
    let left = p - map(c);
    let last = hex_jacobian(x, c);
    j = if invertible(&last) { last } else { j };
    let d = j.inverse() * left;
    let (w, g) = (trilinear(c), trilinear_gradient(c));
    let outside = (c + d - DVec3::ONE).max(-(c + d)).max(DVec3::ZERO).length();
    Some((std::array::from_fn(|k| w[k] + g[k].dot(d)), outside))
}

/// Barycentric weights of a point in a tetrahedron; inside where all are positive. `None` for a flat one.
pub(crate) fn tet_weights(x: &[DVec3; 4], p: DVec3) -> Option<[f64; 4]> {
    let j = DMat3::from_cols(x[1] - x[0], x[2] - x[0], x[3] - x[0]);
    if !invertible(&j) {
        return None;
    }
    let c = j.inverse() * (p - x[0]);
    Some([1.0 - c.x - c.y - c.z, c.x, c.y, c.z])
}

/// Whether a cell's frame has a volume to speak of, against its edges.
pub(crate) fn invertible(j: &DMat3) -> bool {
    let size = j.x_axis.length().max(j.y_axis.length()).max(j.z_axis.length());
    j.determinant().abs() > 1e-12 * size.powi(3)
}

/// Six times the signed volume of a tetrahedron.
pub(crate) fn tet_volume6(x: &[DVec3; 4]) -> f64 {
    (x[1] - x[0]).cross(x[2] - x[0]).dot(x[3] - x[0])
}

/// Determinant of the Jacobian in the middle of a hexahedron: its volume, but for the part that is quadratic in its distortion.
pub(crate) fn hex_centre_volume(x: &[DVec3; 8]) -> f64 {
    hex_jacobian(x, DVec3::splat(0.5)).determinant()
}

/// Volume of a hexahedron, by 2x2x2 points.
pub(crate) fn hex_volume(x: &[DVec3; 8]) -> f64 {
    hex_point_volumes(x).iter().sum()
}

/// The parts of a hexahedron's volume at its 2x2x2 integration points.
pub(crate) fn hex_point_volumes(x: &[DVec3; 8]) -> [f64; 8] {
    let at = [0.5 - 0.5 / 3f64.sqrt(), 0.5 + 0.5 / 3f64.sqrt()];
    // a column of the Jacobian is the same all along its axis, and bilinear in the four edges there
    let column = |edge: [[DVec3; 2]; 2]| {
        at.map(|s| at.map(|t| edge[0][0].lerp(edge[1][0], s).lerp(edge[0][1].lerp(edge[1][1], s), t)))
    };
    let edge = |from: usize, to: usize| x[to] - x[from];
    let a = column([[edge(0, 1), edge(4, 5)], [edge(3, 2), edge(7, 6)]]);
    let b = column([[edge(0, 3), edge(4, 7)], [edge(1, 2), edge(5, 6)]]);
    let c = column([[edge(0, 4), edge(3, 7)], [edge(1, 5), edge(2, 6)]]);
    CORNERS.map(|s| {
        let [i, j, k] = s.map(|s| usize::from(s == 1.0));
        a[j][k].cross(b[i][k]).dot(c[i][j]) / 8.0
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Point by point they are determinants of the Jacobian, which is a sum over the corners.
    #[test]
    fn volumes_are_determinants_of_the_jacobian() {
        let x = CORNERS.map(|s| {
            let [x, y, z] = s.map(|s| 2.0 * s + 0.3);
            DVec3::new(x + 0.2 * y * z, 1.5 * y - 0.1 * x * y, z + 0.1 * x * y * z)
        });
        let at = 0.5 / 3f64.sqrt();
        let volumes = hex_point_volumes(&x);
        for (s, volume) in CORNERS.iter().zip(volumes) {
            let c = DVec3::from(s.map(|s| if s == 1.0 { 0.5 + at } else { 0.5 - at }));
            assert!((hex_jacobian(&x, c).determinant() / 8.0 - volume).abs() < 1e-13 * volume.abs());
        }
        let spread = volumes.iter().fold(0.0f64, |m, v| m.max((v - volumes[0]).abs()));
        assert!(spread > 0.1, "the cell is not a box");
    }
}
