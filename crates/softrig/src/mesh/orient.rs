//! A surface made usable for winding numbers: seams welded, doubled triangles dropped, every part wound outward.
//!
//! Orientation is passed on from triangle to triangle across edges that exactly two share, and a part whose volume comes out
//! negative is turned over. Where triangles of a file are already consistent together, their own winding wins.

use super::{MeshError, SurfaceMesh, weld};
use glam::DVec3;

/// A cleaned, oriented surface.
pub(crate) struct Oriented {
    /// Welded vertices [m].
    pub positions: Vec<DVec3>,
    /// Triangles, wound outward.
    pub triangles: Vec<[u32; 3]>,
    /// What each triangle can enclose.
    pub role: Vec<Role>,
    /// Sum of the volumes of all parts [m^3]; overlaps count twice.
    pub volume: f64,
    /// Sum of areas [m^2].
    pub area: f64,
    /// Boundary edges, as pairs of vertices.
    pub boundary: Vec<[u32; 2]>,
    /// False when orientation came out contradictory, or doubled triangles were dropped, on a good part of the surface.
    pub trusted: bool,
}

/// What a triangle's part of the surface can enclose.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Role {
    /// It belongs to a set without boundary.
    Closed,
    /// It has a boundary, and bulges.
    Open,
    /// It has a boundary and is flat: nothing is inside, the winding number beside it is at most one half.
    Flat,
}

/// One edge of one triangle: ends sorted, which triangle, and whether the triangle runs from the lower to the higher end.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Half {
    lo: u32,
    hi: u32,
    triangle: u32,
    forward: bool,
}

/// All triangle edges sorted by their ends.
fn halves(triangles: &[[u32; 3]]) -> Vec<Half> {
    let mut out = Vec::with_capacity(triangles.len() * 3);
    for (t, v) in triangles.iter().enumerate() {
        for k in 0..3 {
            let (a, b) = (v[k], v[(k + 1) % 3]);
            out.push(Half { lo: a.min(b), hi: a.max(b), triangle: t as u32, forward: a < b });
        }
    }
    out.sort_unstable();
    out
}

/// Checks indices and coordinates of a surface.
pub(crate) fn validate(surface: &SurfaceMesh) -> Result<(), MeshError> {
    if surface.triangles.is_empty() {
        return Err(MeshError::NoTriangles);
    }
    let count = surface.positions.len();
    for (triangle, t) in surface.triangles.iter().enumerate() {
        for &vertex in t {
            match surface.positions.get(vertex as usize) {
                None => return Err(MeshError::TriangleIndex { triangle, vertex, count }),
                Some(p) if !p.iter().all(|x| x.is_finite()) => {
                    return Err(MeshError::NonFinite { what: "vertex", index: vertex as usize });
                }
                Some(_) => {}
            }
        }
    }
    Ok(())
}

/// Cleans and orients a valid surface.
pub(crate) fn orient(surface: &SurfaceMesh) -> Oriented {
    let diagonal = surface.bounds().map_or(0.0, |(lo, hi)| (DVec3::from(hi) - DVec3::from(lo)).length());
    let welded = weld(&surface.positions, 1e-6 * diagonal);
    let positions: Vec<DVec3> = welded.positions.iter().map(|p| DVec3::from_array(*p)).collect();
    let area2 = |t: &[u32; 3]| {
        let [a, b, c] = t.map(|v| positions[v as usize]);
        (b - a).cross(c - a).length()
    };
    // triangles that keep three corners, each set of corners once
    let mut triangles: Vec<[u32; 3]> = surface
        .triangles
        .iter()
        .map(|t| t.map(|v| welded.vertex_to_welded[v as usize]))
        .filter(|t| t[0] != t[1] && t[1] != t[2] && t[2] != t[0])
        .collect();
    let mut order: Vec<([u32; 3], u32)> = triangles
        .iter()
        .enumerate()
        .map(|(i, t)| {
            let mut key = *t;
            key.sort_unstable();
            (key, i as u32)
        })
        .collect();
    order.sort_unstable();
    let mut doubled = vec![false; triangles.len()];
    for pair in order.windows(2) {
        doubled[pair[1].1 as usize] = pair[0].0 == pair[1].0;
    }
    let mut suspect: f64 = triangles.iter().zip(&doubled).filter(|(_, d)| **d).map(|(t, _)| area2(t)).sum();
    let mut flags = doubled.iter();
    triangles.retain(|_| !flags.next().copied().unwrap_or(false));

    let edges = halves(&triangles);
    let groups: Vec<&[Half]> = edges.chunk_by(|a, b| (a.lo, a.hi) == (b.lo, b.hi)).collect();
    let (mut part, flip, conflict) = propagate(triangles.len(), &groups);
    let pieces = merge_all_edges(triangles.len(), &groups);
    let piece_count = pieces.iter().max().map_or(0, |m| *m as usize + 1);

    // pieces that close with the winding the file gave them are taken as they are, as one part each
    let mut file_closed = vec![true; piece_count];
    for g in &groups {
        let net: i32 = g.iter().map(|h| if h.forward { 1 } else { -1 }).sum();
        if net != 0 {
            file_closed[pieces[g[0].triangle as usize] as usize] = false;
        }
    }
    let part_count = part.iter().max().map_or(0, |m| *m as usize + 1);
    for t in 0..triangles.len() {
        if file_closed[pieces[t] as usize] {
            part[t] = (part_count + pieces[t] as usize) as u32;
        } else if flip[t] {
            triangles[t].swap(1, 2);
        }
    }
    // volume of each part; an open one is closed by a cone from the middle of its boundary
    let all = part_count + piece_count;
    let net_edges = boundary_by(&triangles, &part);
    let mut middle = vec![(DVec3::ZERO, 0.0_f64); all];
    let mut open = vec![false; all];
    for (p, [a, b]) in &net_edges {
        let m = &mut middle[*p as usize];
        m.0 += positions[*a as usize] + positions[*b as usize];
        m.1 += 2.0;
        open[*p as usize] = true;
    }
    for (t, v) in triangles.iter().enumerate() {
        let m = &mut middle[part[t] as usize];
        if !open[part[t] as usize] {
            v.iter().for_each(|i| m.0 += positions[*i as usize]);
            m.1 += 3.0;
        }
    }
    let mut volume = vec![0.0_f64; all];
    let mut area = vec![0.0_f64; all];
    for (t, v) in triangles.iter().enumerate() {
        let p = part[t] as usize;
        let o = middle[p].0 / middle[p].1.max(1.0);
        let [a, b, c] = v.map(|i| positions[i as usize] - o);
        volume[p] += a.cross(b).dot(c) / 6.0;
        area[p] += area2(v) / 2.0;
    }
    for (t, v) in triangles.iter_mut().enumerate() {
        // a sheet has no outside: keep what the file says
        let p = part[t] as usize;
        if volume[p] < -1e-9 * area[p].powf(1.5) {
            v.swap(1, 2);
        }
    }
    volume.iter_mut().for_each(|v| *v = v.abs());
    let total_area: f64 = area.iter().sum();
    for (t, v) in triangles.iter().enumerate() {
        if conflict[t] && !file_closed[pieces[t] as usize] {
            suspect += area2(v);
        }
    }
    // parts that close only together, through edges that more than two triangles share
    let mut piece_open = vec![false; piece_count];
    let together = boundary_by(&triangles, &pieces);
    together.iter().for_each(|(p, _)| piece_open[*p as usize] = true);
    let role = (0..triangles.len())
        .map(|t| {
            let p = part[t] as usize;
            match (!open[p] || !piece_open[pieces[t] as usize], volume[p] < 1e-6 * area[p].powf(1.5)) {
                (true, _) => Role::Closed,
                (false, false) => Role::Open,
                (false, true) => Role::Flat,
            }
        })
        .collect();
    Oriented {
        volume: volume.iter().sum(),
        area: total_area,
        boundary: together.into_iter().map(|(_, e)| e).collect(),
        trusted: suspect / 2.0 <= 0.1 * total_area,
        positions,
        triangles,
        role,
    }
}

/// Walks across edges that two triangles share: part of each triangle, whether it has to be turned to agree with the first of
/// its part, and whether its part contradicts itself.
fn propagate(count: usize, groups: &[&[Half]]) -> (Vec<u32>, Vec<bool>, Vec<bool>) {
    let mut next: Vec<[(u32, bool); 3]> = vec![[(u32::MAX, false); 3]; count];
    for g in groups {
        if let [a, b] = g {
            // two neighbours agree when they run along their edge in opposite ways
            let turn = a.forward == b.forward;
            for (from, to) in [(a, b), (b, a)] {
                if let Some(free) = next[from.triangle as usize].iter_mut().find(|n| n.0 == u32::MAX) {
                    *free = (to.triangle, turn);
                }
            }
        }
    }
    let mut part = vec![u32::MAX; count];
    let mut flip = vec![false; count];
    let mut bad = Vec::new();
    let mut stack = Vec::new();
    for seed in 0..count {
        if part[seed] != u32::MAX {
            continue;
        }
        let id = bad.len() as u32;
        bad.push(false);
        part[seed] = id;
        stack.push(seed);
        while let Some(t) = stack.pop() {
            for &(n, turn) in next[t].iter().filter(|n| n.0 != u32::MAX) {
                let n = n as usize;
                if part[n] == u32::MAX {
                    part[n] = id;
                    flip[n] = flip[t] ^ turn;
                    stack.push(n);
                } else if flip[n] != flip[t] ^ turn {
                    bad[id as usize] = true;
                }
            }
        }
    }
    let conflict = part.iter().map(|p| bad[*p as usize]).collect();
    (part, flip, conflict)
}

/// Connects triangles across every shared edge: piece of each triangle.
fn merge_all_edges(count: usize, groups: &[&[Half]]) -> Vec<u32> {
    let mut sets = super::sets::Sets::new(count);
    for g in groups {
        for h in &g[1..] {
            sets.join(g[0].triangle, h.triangle);
        }
    }
    sets.labels().0
}

/// Edges whose triangles of one label do not cancel, with the label.
fn boundary_by(triangles: &[[u32; 3]], label: &[u32]) -> Vec<(u32, [u32; 2])> {
    let edges = halves(triangles);
    let mut out = Vec::new();
    let mut net: Vec<(u32, i32)> = Vec::new();
    for g in edges.chunk_by(|a, b| (a.lo, a.hi) == (b.lo, b.hi)) {
        net.clear();
        for h in g {
            let sign = if h.forward { 1 } else { -1 };
            let l = label[h.triangle as usize];
            match net.iter_mut().find(|n| n.0 == l) {
                Some(n) => n.1 += sign,
                None => net.push((l, sign)),
            }
        }
        out.extend(net.iter().filter(|n| n.1 != 0).map(|n| (n.0, [g[0].lo, g[0].hi])));
    }
    out
}
