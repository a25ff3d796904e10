//! The features of the face: small closed surfaces that sit in the head and follow it.

use super::paint::{EYE, GLINT, HAIR, MOUTH};
use super::shape::body;
use crate::character::SkinWeights;
use crate::mesh::SurfaceMesh;
use crate::rig::Skeleton;
use glam::{DMat3, DVec3};

/// Appends eyes, brows and mouth to the skin, all weighted to the head alone.
pub(super) fn append(
    skin: &mut SurfaceMesh,
    look: &mut Vec<u32>,
    colors: &mut Vec<[f32; 4]>,
    rows: &mut SkinWeights,
    skeleton: &Skeleton,
) {
    let body = body();
    // a point of the face in front of (x, y), and the way out of the skin there
    let face = |x: f64, y: f64| {
        let p = body.project(DVec3::new(x, y, 0.17));
        (p, body.field(p).gradient.normalize())
    };
    let mut add = |piece: SurfaceMesh, color: u32| {
        let base = skin.positions.len() as u32;
        look.resize(look.len() + piece.triangles.len(), color);
        colors.resize(colors.len() + piece.positions.len(), [1.0; 4]);
        skin.triangles.extend(piece.triangles.iter().map(|t| t.map(|v| v + base)));
        skin.positions.extend(piece.positions);
    };
    for side in [1.0, -1.0] {
        let (at, out) = face(side * 0.069, 1.345);
        let right = DVec3::Y.cross(out).normalize();
        let axes = DMat3::from_cols(right, out.cross(right), out);
        add(ellipsoid(2, at, axes * DMat3::from_diagonal(DVec3::new(0.0235, 0.034, 0.013))), EYE);
        // both lights on the same side: one lamp
        let glint = at + axes * DVec3::new(0.0045 - 0.002 * side, 0.013, 0.0110);
        add(ellipsoid(1, glint, axes * DMat3::from_diagonal(DVec3::new(0.0075, 0.009, 0.004))), GLINT);
        let brow: Vec<DVec3> = (0..9)
            .map(|i| {
                let s = f64::from(i) / 4.0 - 1.0;
                face(side * (0.073 + 0.029 * s), 1.408 + 0.004 * s - 0.011 * s * s).0
            })
            .collect();
        add(tube(&brow, |s| swell(s, 0.0085, 0.0045)), HAIR);
    }
    let smile: Vec<DVec3> = (0..17)
        .map(|i| {
            let s = f64::from(i) / 8.0 - 1.0;
            face(0.062 * s, 1.233 + 0.022 * s * s).0
        })
        .collect();
    add(tube(&smile, |s| swell(s, 0.0075, 0.0045)), MOUTH);
    // a quiff: three strands that sprout from the crown and curl forward
    for (foot, lift, lean, curl, radius) in [
        (DVec3::new(0.0, 1.505, 0.045), 0.085, 0.0, 0.075, 0.034),
        (DVec3::new(0.022, 1.508, 0.015), 0.075, 0.028, 0.040, 0.028),
        (DVec3::new(-0.024, 1.508, 0.012), 0.066, -0.030, 0.035, 0.027),
    ] {
        let strand: Vec<DVec3> = (0..12)
            .map(|i| {
                let s = f64::from(i) / 11.0;
                foot + DVec3::new(lean * s, lift * s * (1.55 - 0.55 * s * s), curl * s * s)
            })
            .collect();
        add(tube(&strand, |s| radius * (1.0 - s * s * s) + 0.006), HAIR);
    }
    let head = skeleton.find("head").expect("the skeleton has a head");
    while rows.start.len() <= skin.positions.len() {
        rows.push([(head, 1.0)]);
    }
}

/// A sphere of subdivided icosahedron triangles, under a linear map.
fn ellipsoid(rounds: u32, centre: DVec3, axes: DMat3) -> SurfaceMesh {
    let g = (1.0 + 5f64.sqrt()) / 2.0;
    let mut points = Vec::new();
    for (a, b) in [(1.0, g), (-1.0, g), (1.0, -g), (-1.0, -g)] {
        points.extend([DVec3::new(0.0, a, b), DVec3::new(a, b, 0.0), DVec3::new(b, 0.0, a)]);
    }
    points.iter_mut().for_each(|p| *p = p.normalize());
    // faces are the triples of mutually nearest corners
    let near = |a: usize, b: usize| points[a].distance(points[b]) < 1.1;
    let mut triangles = Vec::new();
    for a in 0..12 {
        for b in a + 1..12 {
            for c in b + 1..12 {
                if near(a, b) && near(b, c) && near(a, c) {
                    let out = (points[b] - points[a]).cross(points[c] - points[a]).dot(points[a]) > 0.0;
                    triangles.push(if out { [a, b, c] } else { [a, c, b] });
                }
            }
        }
    }
    for _ in 0..rounds {
        let mut made = std::collections::BTreeMap::new();
        let mut finer = Vec::new();
        for [a, b, c] in triangles {
            let [ab, bc, ca] = [(a, b), (b, c), (c, a)].map(|(u, v)| {
                *made.entry((u.min(v), u.max(v))).or_insert_with(|| {
                    points.push((points[u] + points[v]).normalize());
                    points.len() - 1
                })
            });
            finer.extend([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]);
        }
        triangles = finer;
    }
    SurfaceMesh {
        positions: points.iter().map(|p| (centre + axes * *p).to_array()).collect(),
        triangles: triangles.iter().map(|t| t.map(|v| v as u32)).collect(),
    }
}

/// Thick in the middle, thin at both ends, for `s` from 0 to 1.
fn swell(s: f64, middle: f64, end: f64) -> f64 {
    end + (middle - end) * 4.0 * s * (1.0 - s)
}

/// A round tube along points, closed by a tip at each end; its radius is a function of the way along it, 0 to 1.
fn tube(line: &[DVec3], radius: impl Fn(f64) -> f64) -> SurfaceMesh {
    const SIDES: usize = 10;
    let (mut positions, mut triangles) = (Vec::new(), Vec::new());
    let last = line.len() - 1;
    for (i, p) in line.iter().enumerate() {
        let along = (line[(i + 1).min(last)] - line[i.saturating_sub(1)]).normalize();
        // any direction across will do, as long as no tube runs along this one
        let u = along.cross(DVec3::new(0.15, 0.1, 1.0)).normalize();
        let w = along.cross(u);
        let r = radius(i as f64 / last as f64);
        for c in 0..SIDES {
            let angle = std::f64::consts::TAU * c as f64 / SIDES as f64;
            positions.push((*p + r * (u * angle.cos() + w * angle.sin())).to_array());
        }
    }
    let ring = |i: usize, c: usize| (i * SIDES + c % SIDES) as u32;
    for i in 0..last {
        for c in 0..SIDES {
            let [a, b, d, e] = [ring(i, c), ring(i, c + 1), ring(i + 1, c), ring(i + 1, c + 1)];
            triangles.extend([[a, b, e], [a, e, d]]);
        }
    }
    for (at, inner, i) in [(line[0], line[1], 0), (line[last], line[last - 1], last)] {
        let tip = positions.len() as u32;
        positions.push((at + (at - inner).normalize() * radius(i as f64 / last as f64)).to_array());
        for c in 0..SIDES {
            let (a, b) = (ring(i, c), ring(i, c + 1));
            triangles.push(if i == 0 { [tip, b, a] } else { [tip, a, b] });
        }
    }
    SurfaceMesh { positions, triangles }
}
