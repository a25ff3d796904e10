//! Loose ends of a lattice: crumbs dropped, pieces that came off a connected skin put back.
//!
//! Skin that narrows below a sub-voxel can leave a tip without a way to the rest. Two components of the lattice that carry the same connected part of
//! the surface are joined where their material comes nearest, at that place only; components of different parts stay apart.

use super::cells::{CORNERS, sub_at};
use crate::mesh::orient::Oriented;
use crate::mesh::samples::on_triangle;
use crate::mesh::sets::Sets;
use crate::mesh::{Components, Embedding, Lattice, VolumeMesh, components};
use std::collections::{BTreeMap, BTreeSet, HashMap};

/// Components of at most this many cells may be dropped when they carry no skin.
const CRUMB: usize = 8;

/// What was done.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Tidied {
    pub dropped: usize,
    pub joined: usize,
}

/// Drops crumbs and joins loose pieces.
pub(super) fn tidy(mut mesh: VolumeMesh, surface: &Oriented) -> (VolumeMesh, Tidied) {
    /// Each round at least halves the number of pieces in a chain of equal ones.
    const ROUNDS: usize = 16;
    let mut all = Tidied::default();
    for _ in 0..ROUNDS {
        let (next, done) = round(mesh, surface);
        mesh = next;
        all.dropped += done.dropped;
        all.joined += done.joined;
        if done.joined == 0 {
            break;
        }
    }
    (mesh, all)
}

fn round(mesh: VolumeMesh, surface: &Oriented) -> (VolumeMesh, Tidied) {
    let mut done = Tidied::default();
    let parts = components(&mesh);
    if parts.count <= 1 {
        return (mesh, done);
    }
    // skin of each component, by connected parts of the surface
    let skin = skin_parts(&mesh, surface, &parts);
    let mut size = vec![0usize; parts.count];
    parts.of_cell.iter().for_each(|c| size[*c as usize] += 1);
    let keep: Vec<bool> = (0..parts.count).map(|c| size[c] > CRUMB || !skin[c].is_empty()).collect();
    if !keep.iter().any(|k| *k) {
        return (mesh, done);
    }
    done.dropped = keep.iter().filter(|k| !**k).count();

    // join each component to one larger one of the same skin, small ones first
    let Some(lattice) = mesh.lattice.as_ref() else { return (mesh, done) };
    let mut nodes = Sets::new(mesh.node_count());
    let mut order: Vec<usize> = (0..parts.count).filter(|c| keep[*c]).collect();
    order.sort_by_key(|c| (size[*c], *c));
    let mut cells_at: HashMap<[i32; 3], Vec<u32>> = HashMap::new();
    lattice.voxel.iter().enumerate().for_each(|(c, v)| cells_at.entry(*v).or_default().push(c as u32));
    let mut own: Vec<Vec<u32>> = vec![Vec::new(); parts.count];
    parts.of_cell.iter().enumerate().for_each(|(i, c)| own[*c as usize].push(i as u32));
    for (rank, &a) in order.iter().enumerate() {
        let larger: BTreeSet<u32> =
            order[rank + 1..].iter().filter(|b| !skin[a].is_disjoint(&skin[**b])).map(|b| *b as u32).collect();
        if larger.is_empty() {
            continue;
        }
        let pairs = nearest_pairs(lattice, &own[a], &cells_at, |cell| larger.contains(&parts.of_cell[cell as usize]));
        done.joined += usize::from(!pairs.is_empty());
        for (x, y) in pairs {
            weld_corners(&mesh, lattice, x as usize, y as usize, &mut nodes);
        }
    }
    if done.dropped == 0 && done.joined == 0 {
        return (mesh, done);
    }
    (rebuild(&mesh, nodes, |cell| keep[parts.of_cell[cell] as usize]), done)
}

/// Connected parts of the surface that each component of the lattice carries. Points between the vertices count too: cells far from any vertex hold
/// the middle of a large triangle.
fn skin_parts(mesh: &VolumeMesh, surface: &Oriented, parts: &Components) -> Vec<BTreeSet<u32>> {
    let mut sets = Sets::new(surface.positions.len());
    for t in &surface.triangles {
        sets.join(t[0], t[1]);
        sets.join(t[0], t[2]);
    }
    let (label, _) = sets.labels();
    let step = mesh.lattice.as_ref().map_or(f64::INFINITY, |l| l.spacing);
    let mut points = Vec::new();
    let mut part = Vec::new();
    for t in &surface.triangles {
        let p = t.map(|v| surface.positions[v as usize]);
        on_triangle(p, step, |w| {
            points.push((p[0] * w[0] + p[1] * w[1] + p[2] * w[2]).to_array());
            part.push(label[t[0] as usize]);
        });
    }
    let mut out = vec![BTreeSet::new(); parts.count];
    // generated cells and checked vertices always embed; without an answer nothing is joined
    if let Ok(e) = Embedding::embed(mesh, &points, None) {
        for (part, cell) in part.iter().zip(&e.cell) {
            out[parts.of_cell[*cell as usize] as usize].insert(*part);
        }
    }
    out
}

/// The pairs of neighbouring cells whose material comes nearest; those that share most corners among equals.
fn nearest_pairs(
    lattice: &Lattice,
    own: &[u32],
    cells_at: &HashMap<[i32; 3], Vec<u32>>,
    wanted: impl Fn(u32) -> bool,
) -> Vec<(u32, u32)> {
    let mut best: BTreeMap<(u32, i32), Vec<(u32, u32)>> = BTreeMap::new();
    for &a in own {
        let v = lattice.voxel[a as usize];
        for n in 0..27 {
            let d = [n % 3 - 1, n / 3 % 3 - 1, n / 9 - 1];
            let there = std::array::from_fn(|k| v[k] + d[k]);
            for &b in cells_at.get(&there).into_iter().flatten().filter(|b| wanted(**b)) {
                let gap = gap2(lattice.piece[a as usize], lattice.piece[b as usize], d);
                let diagonal = d.iter().map(|x| x.abs()).sum();
                best.entry((gap, diagonal)).or_default().push((a, b));
            }
        }
        // only the best one is of interest
        while best.len() > 1 {
            best.pop_last();
        }
    }
    best.pop_first().map(|(_, pairs)| pairs).unwrap_or_default()
}

/// Smallest squared distance between sub-voxels of two pieces, the second in a voxel `offset` away [sub-voxels^2].
fn gap2(a: u64, b: u64, offset: [i32; 3]) -> u32 {
    let bits = |m: u64| (0..64u32).filter(move |k| m >> k & 1 == 1).map(sub_at);
    let mut best = u32::MAX;
    for p in bits(a) {
        for q in bits(b) {
            let d: i32 = (0..3).map(|k| (q[k] + 4 * offset[k] - p[k]).pow(2)).sum();
            best = best.min(d as u32);
        }
    }
    best
}

/// Makes corners of two cells at the same place of the lattice one.
fn weld_corners(mesh: &VolumeMesh, lattice: &Lattice, a: usize, b: usize, nodes: &mut Sets) {
    let corner =
        |c: usize, i: usize| -> [i32; 3] { std::array::from_fn(|k| lattice.voxel[c][k] + CORNERS[i][k] as i32) };
    for i in 0..8 {
        for j in 0..8 {
            if corner(a, i) == corner(b, j) {
                nodes.join(mesh.hexes[a][i], mesh.hexes[b][j]);
            }
        }
    }
}

/// The lattice with merged nodes and the wanted cells only; cells that became the same are one.
fn rebuild(mesh: &VolumeMesh, nodes: Sets, keep: impl Fn(usize) -> bool) -> VolumeMesh {
    let (label, count) = nodes.labels();
    let mut number = vec![u32::MAX; count];
    let mut out = VolumeMesh::default();
    let Some(old) = mesh.lattice.as_ref() else { return mesh.clone() };
    let mut lattice = Lattice { origin: old.origin, spacing: old.spacing, voxel: Vec::new(), piece: Vec::new() };
    for (cell, hex) in mesh.hexes.iter().enumerate().filter(|(c, _)| keep(*c)) {
        let hex = hex.map(|n| {
            let id = &mut number[label[n as usize] as usize];
            if *id == u32::MAX {
                *id = out.nodes.len() as u32;
                out.nodes.push(mesh.nodes[n as usize]);
            }
            *id
        });
        let voxel = old.voxel[cell];
        let same = (0..out.hexes.len()).rev().take_while(|c| lattice.voxel[*c] == voxel).find(|c| out.hexes[*c] == hex);
        if let Some(c) = same {
            lattice.piece[c] |= old.piece[cell];
            out.fill[c] = (out.fill[c] + mesh.fill[cell]).min(1.0);
            continue;
        }
        out.hexes.push(hex);
        out.fill.push(mesh.fill[cell]);
        lattice.voxel.push(voxel);
        lattice.piece.push(old.piece[cell]);
    }
    out.lattice = Some(lattice);
    out
}
