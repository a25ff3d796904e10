//! Cuts the skin along the edges of its clothes, so that colours meet in clean lines without any texture.

use super::paint;
use super::shape::{Body, body};
use crate::mesh::SurfaceMesh;
use glam::DVec3;
use std::collections::BTreeMap;

/// A vertex nearer to the line than this part of its shortest edge is moved onto it: what is left to split makes no slivers.
const SNAP: f64 = 0.35;

/// Inserts vertices along every border of [`paint::REGIONS`] and returns the look of each triangle. The surface stays closed.
pub(super) fn cut(skin: &mut SurfaceMesh) -> Vec<u32> {
    let body = body();
    for region in &paint::REGIONS {
        cut_along(skin, &body, region.border);
    }
    let look_of = |t: &[u32; 3]| {
        let centre = t.iter().map(|v| DVec3::from_array(skin.positions[*v as usize])).sum::<DVec3>() / 3.0;
        paint::REGIONS.iter().find(|r| (r.border)(centre) < 0.0).map_or(paint::SKIN, |r| r.look)
    };
    skin.triangles.iter().map(look_of).collect()
}

fn cut_along(skin: &mut SurfaceMesh, body: &Body, border: fn(DVec3) -> f64) {
    let mut p: Vec<DVec3> = skin.positions.iter().map(|p| DVec3::from_array(*p)).collect();
    let mut shortest = vec![f64::INFINITY; p.len()];
    for t in &skin.triangles {
        for c in 0..3 {
            let (a, b) = (t[c] as usize, t[(c + 1) % 3] as usize);
            let length = p[a].distance(p[b]);
            shortest[a] = shortest[a].min(length);
            shortest[b] = shortest[b].min(length);
        }
    }
    let mut side: Vec<f64> = p.iter().map(|p| border(*p)).collect();
    for v in 0..p.len() {
        if side[v].abs() < SNAP * shortest[v] {
            let target = onto(body, border, p[v]);
            if target.distance(p[v]) < 1.5 * SNAP * shortest[v] {
                p[v] = target;
                side[v] = 0.0;
            }
        }
    }
    // one new vertex per crossed edge, in the order in which triangles meet them
    let mut made: BTreeMap<(u32, u32), u32> = BTreeMap::new();
    let mut triangles = Vec::with_capacity(skin.triangles.len());
    for t in &skin.triangles {
        let crossed = |c: usize| side[t[c] as usize] * side[t[(c + 1) % 3] as usize] < 0.0;
        let mut middle = [None; 3];
        for c in 0..3 {
            if crossed(c) {
                let (a, b) = (t[c].min(t[(c + 1) % 3]), t[c].max(t[(c + 1) % 3]));
                middle[c] = Some(*made.entry((a, b)).or_insert_with(|| {
                    let (sa, sb) = (side[a as usize], side[b as usize]);
                    p.push(onto(body, border, p[a as usize].lerp(p[b as usize], sa / (sa - sb))));
                    p.len() as u32 - 1
                }));
            }
        }
        match middle {
            [None, None, None] => triangles.push(*t),
            _ => split(t, middle, &mut triangles),
        }
    }
    skin.positions = p.into_iter().map(|p| p.to_array()).collect();
    skin.triangles = triangles;
}

/// Splits a triangle with one crossed edge into two, with two crossed edges into three.
fn split(t: &[u32; 3], middle: [Option<u32>; 3], out: &mut Vec<[u32; 3]>) {
    for c in 0..3 {
        let (n, l) = ((c + 1) % 3, (c + 2) % 3);
        match (middle[c], middle[n], middle[l]) {
            (Some(m), None, None) => out.extend([[t[c], m, t[l]], [m, t[n], t[l]]]),
            // the corner between the crossed edges c and l is cut off
            (Some(m), None, Some(k)) => out.extend([[t[c], m, k], [m, t[n], t[l]], [m, t[l], k]]),
            _ => {}
        }
    }
}

/// Nearest point on the border within the skin: Newton steps on the border along the tangent plane, back onto the skin after each.
fn onto(body: &Body, border: fn(DVec3) -> f64, mut p: DVec3) -> DVec3 {
    let e = 1e-5;
    for _ in 0..3 {
        let slope = DVec3::from_array(DVec3::AXES.map(|a| (border(p + a * e) - border(p - a * e)) / (2.0 * e)));
        let normal = body.field(p).gradient.normalize_or_zero();
        let tangent = slope - normal * slope.dot(normal);
        if tangent.length_squared() < 1e-3 {
            break;
        }
        p = body.project(p - tangent * (border(p) / tangent.length_squared()));
    }
    p
}
