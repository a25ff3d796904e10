//! Which sub-voxels are inside.
//!
//! Sub-voxel centres that can be reached from each other without crossing the surface form regions. Closed parts have one winding number
//! all over a region, so few questions settle it. Open parts leak: their winding number is asked piece by piece, and sub-voxel by
//! sub-voxel near their boundary.

use super::grid::{Crossings, Grid, HAS_NEXT, NONE, STEP, SUB, Walls};
use crate::mesh::orient::{Oriented, Role};
use crate::mesh::sets::Sets;
use crate::mesh::winding::Winding;
use glam::DVec3;
use rayon::prelude::*;

/// Inside is a winding number above this: one half, and the error of the far field for sheets, which have exactly one half beside them.
const INSIDE: f64 = 0.501;

/// Winding numbers of one surface, kept while the spacing is searched.
pub(super) struct Judge {
    closed: Winding,
    open: Winding,
    /// Box around the triangles of open parts.
    reach: Option<(DVec3, DVec3)>,
    trusted: bool,
}

impl Judge {
    pub fn new(surface: &Oriented) -> Self {
        let pick = |role: Role| -> Vec<[DVec3; 3]> {
            let all = surface.triangles.iter().zip(&surface.role);
            all.filter(|(_, r)| **r == role).map(|(t, _)| t.map(|v| surface.positions[v as usize])).collect()
        };
        let open = pick(Role::Open);
        let reach = open
            .iter()
            .flatten()
            .fold(None, |r: Option<(DVec3, DVec3)>, p| Some(r.map_or((*p, *p), |(lo, hi)| (lo.min(*p), hi.max(*p)))));
        Self {
            closed: Winding::from_corners(pick(Role::Closed)),
            open: Winding::from_corners(open),
            reach,
            trusted: surface.trusted,
        }
    }
}

/// Inside sub-voxels of every voxel.
pub(super) struct Inside {
    /// Bit mask of each voxel.
    pub mask: Vec<u64>,
    /// Bit mask of sub-voxels inside more than one closed part, for each slot of the crossings: leaving one part there is
    /// not leaving the material.
    pub deep: Vec<u64>,
}

/// Connected pieces of `material` within one voxel, cut by walls; lowest bit first.
pub(super) fn pieces(material: u64, walls: &[u64; 3], out: &mut Vec<u64>) {
    out.clear();
    let mut rest = material;
    while rest != 0 {
        let mut piece = rest & rest.wrapping_neg();
        loop {
            let mut grown = piece;
            for k in 0..3 {
                let link = HAS_NEXT[k] & !walls[k];
                grown |= (grown & link) << STEP[k];
                grown |= (grown >> STEP[k]) & link;
            }
            grown &= rest;
            if grown == piece {
                break;
            }
            piece = grown;
        }
        rest &= !piece;
        out.push(piece);
    }
}

/// Sub-voxels of `material` at the far end of a voxel in direction `k` without a wall behind them, shifted to the near end of the next voxel.
pub(super) fn across(material: u64, wall: u64, k: usize) -> u64 {
    (material & !wall & !HAS_NEXT[k]) >> (STEP[k] * (SUB as u32 - 1))
}

/// Pieces of free space: those of crossed voxels first, then one for each voxel that is not crossed.
struct Free {
    voxel: Vec<u32>,
    mask: Vec<u64>,
    /// First piece of each voxel, and one past the last.
    start: Vec<u32>,
}

fn free_space(crossings: &Crossings) -> Free {
    let count = crossings.slot.len();
    let mut free = Free {
        voxel: Vec::with_capacity(count),
        mask: Vec::with_capacity(count),
        start: Vec::with_capacity(count + 1),
    };
    let mut list = Vec::new();
    for voxel in 0..count {
        free.start.push(free.mask.len() as u32);
        match crossings.slot[voxel] {
            NONE => {
                free.voxel.push(voxel as u32);
                free.mask.push(u64::MAX);
            }
            slot => {
                pieces(u64::MAX, &crossings.walls[slot as usize].crossed, &mut list);
                free.voxel.resize(free.voxel.len() + list.len(), voxel as u32);
                free.mask.extend_from_slice(&list);
            }
        }
    }
    free.start.push(free.mask.len() as u32);
    free
}

/// Region of each piece, and how many there are. Region 0 is the outside.
fn regions(grid: &Grid, crossings: &Crossings, free: &Free) -> (Vec<u32>, usize) {
    let mut sets = Sets::new(free.mask.len());
    let stride = grid.stride();
    for voxel in 0..grid.voxel_count() {
        let at = grid.voxel(voxel);
        let walls = crossings.walls(voxel);
        for k in 0..3 {
            if at[k] + 1 == grid.size[k] {
                continue;
            }
            let other = voxel + stride[k];
            for a in free.start[voxel]..free.start[voxel + 1] {
                let open = across(free.mask[a as usize], walls.crossed[k], k);
                for b in free.start[other]..free.start[other + 1] {
                    if open & free.mask[b as usize] != 0 {
                        sets.join(a, b);
                    }
                }
            }
        }
    }
    sets.labels()
}

/// Decides for every sub-voxel.
pub(super) fn inside(grid: &Grid, crossings: &Crossings, surface: &Oriented, judge: &Judge) -> Inside {
    let free = free_space(crossings);
    let (region, region_count) = regions(grid, crossings, &free);
    let depth = region_depth(grid, &free, &region, region_count, judge);
    let mut out = Inside { mask: vec![0; grid.voxel_count()], deep: vec![0; crossings.walls.len()] };
    for (i, mask) in free.mask.iter().enumerate() {
        let voxel = free.voxel[i] as usize;
        let d = depth[region[i] as usize];
        if d > INSIDE {
            out.mask[voxel] |= mask;
        }
        if d > 1.5 && crossings.slot[voxel] != NONE {
            out.deep[crossings.slot[voxel] as usize] |= mask;
        }
    }
    if let Some(reach) = judge.reach {
        leaks(grid, surface, judge, reach, &free, &region, &mut out);
    }
    out
}

/// Mean winding number of each enclosed region over a few of its pieces; 0 for the outside.
fn region_depth(grid: &Grid, free: &Free, region: &[u32], count: usize, judge: &Judge) -> Vec<f64> {
    /// Questions per region: an odd number, enough that one piece beside a sheet does not decide.
    const ASK: u32 = 9;
    let mut size = vec![0u32; count];
    region.iter().for_each(|r| size[*r as usize] += 1);
    let mut seen = vec![0u32; count];
    let mut ask = Vec::new();
    for (i, &r) in region.iter().enumerate() {
        let (n, k) = (size[r as usize], seen[r as usize]);
        seen[r as usize] += 1;
        // evenly spread ordinals
        if r != 0 && (n <= ASK || u64::from(k) * u64::from(ASK) % u64::from(n) < u64::from(ASK)) {
            ask.push(i);
        }
    }
    let answer: Vec<f64> = ask
        .par_iter()
        .map(|i| {
            let q = grid.centre(free.voxel[*i] as usize, middle_bit(free.mask[*i])).to_array();
            judge.closed.at(q) + judge.open.at(q)
        })
        .collect();
    let mut depth = vec![(0.0, 0.0); count];
    for (i, w) in ask.iter().zip(answer) {
        let d = &mut depth[region[*i] as usize];
        *d = (d.0 + w, d.1 + 1.0);
    }
    depth
        .into_iter()
        .map(|(sum, n): (f64, f64)| {
            let mean = if n > 0.0 { sum / n } else { 0.0 };
            // closed in by a surface whose winding says nothing: material
            if n > 0.0 && !judge.trusted { mean.max(1.0) } else { mean }
        })
        .collect()
}

/// The bit of a mask nearest to the middle of its bits.
fn middle_bit(mask: u64) -> u32 {
    let at = |b: u32| [b % 4, b / 4 % 4, b / 16].map(f64::from);
    let bits = || (0..64u32).filter(|b| mask >> b & 1 == 1);
    let n = f64::from(mask.count_ones().max(1));
    let mean = bits().fold([0.0; 3], |m, b| std::array::from_fn(|k| m[k] + at(b)[k] / n));
    let off = |b: u32| (0..3).map(|k| (at(b)[k] - mean[k]).powi(2)).sum::<f64>();
    bits().min_by(|a, b| off(*a).total_cmp(&off(*b))).unwrap_or(0)
}

/// Asks for the winding number of open parts where the outside reaches into them.
fn leaks(
    grid: &Grid,
    surface: &Oriented,
    judge: &Judge,
    reach: (DVec3, DVec3),
    free: &Free,
    region: &[u32],
    out: &mut Inside,
) {
    // voxels close to a boundary edge: the winding number goes from 0 to 1 around it
    let mut rim = vec![false; grid.voxel_count()];
    for e in &surface.boundary {
        let [a, b] = e.map(|v| surface.positions[v as usize]);
        let steps = (a.distance(b) / (0.5 * grid.spacing)).ceil().max(1.0);
        for s in 0..=steps as usize {
            let p = a.lerp(b, s as f64 / steps);
            let [lo, hi] = [-0.75, 0.75].map(|d| grid.sub_of(p + DVec3::splat(d * grid.spacing)).map(|x| x / SUB));
            for z in lo[2]..=hi[2] {
                for y in lo[1]..=hi[1] {
                    for x in lo[0]..=hi[0] {
                        rim[grid.index([x, y, z])] = true;
                    }
                }
            }
        }
    }
    let settled = settle_blocks(grid, judge, free, region, &rim, out);
    let half = DVec3::splat(0.5 * grid.spacing);
    let ask: Vec<usize> = (0..free.mask.len())
        .filter(|i| !settled[free.voxel[*i] as usize])
        .filter(|i| {
            let c = grid.centre(free.voxel[*i] as usize, 42);
            region[*i] == 0 && (c + half).cmpge(reach.0).all() && (c - half).cmple(reach.1).all()
        })
        .collect();
    let found: Vec<u64> = ask
        .par_iter()
        .with_min_len(64)
        .map(|i| {
            let (voxel, mask) = (free.voxel[*i] as usize, free.mask[*i]);
            let asked = |bit| judge.open.exceeds(grid.centre(voxel, bit), INSIDE);
            if rim[voxel] {
                (0..64u32).filter(|b| mask >> b & 1 == 1 && asked(*b)).fold(0, |m, b| m | 1 << b)
            } else if asked(middle_bit(mask)) {
                mask
            } else {
                0
            }
        })
        .collect();
    for (i, mask) in ask.into_iter().zip(found) {
        out.mask[free.voxel[i] as usize] |= mask;
    }
}

/// Settles blocks of 4x4x4 and 2x2x2 voxels of free outside at once, where their middle is far from the level: the winding
/// number is harmonic there, and its sources, boundary edges, keep away. Returns which voxels need no further question.
fn settle_blocks(grid: &Grid, judge: &Judge, free: &Free, region: &[u32], rim: &[bool], out: &mut Inside) -> Vec<bool> {
    let mut settled = vec![false; grid.voxel_count()];
    let plain = |v: usize| {
        let first = free.start[v] as usize;
        free.mask[first] == u64::MAX && region[first] == 0 && !rim[v]
    };
    for edge in [4, 2] {
        let blocks = grid.size.map(|s| s / edge);
        let voxels = |b: usize| {
            let at = [b % blocks[0], b / blocks[0] % blocks[1], b / (blocks[0] * blocks[1])];
            (0..edge * edge * edge).map(move |i| {
                [at[0] * edge + i % edge, at[1] * edge + i / edge % edge, at[2] * edge + i / (edge * edge)]
            })
        };
        let answers: Vec<Option<bool>> = (0..blocks.iter().product::<usize>())
            .into_par_iter()
            .with_min_len(64)
            .map(|b| {
                if voxels(b).any(|v| settled[grid.index(v)] || !plain(grid.index(v))) {
                    return None;
                }
                let corner = voxels(b).next()?;
                let middle = DVec3::from(corner.map(|x| x as f64 + edge as f64 / 2.0));
                judge.open.clearly(grid.origin + middle * grid.spacing, 0.5, 0.3)
            })
            .collect();
        for (b, answer) in answers.into_iter().enumerate() {
            if let Some(above) = answer {
                for v in voxels(b).map(|v| grid.index(v)) {
                    settled[v] = true;
                    out.mask[v] = if above { u64::MAX } else { 0 };
                }
            }
        }
    }
    settled
}

/// Adds material where the skin is thinner than a sub-voxel: the sub-voxels that hold such skin, and the skin around them as far as solid
/// material. Returns the mask of added sub-voxels for each voxel; empty where nothing is thin.
pub(super) fn sheets(grid: &Grid, surface: &Oriented, inside: &[u64]) -> Vec<u64> {
    let n = grid.size.map(|s| s * SUB);
    let near = |s: [usize; 3], mask: &dyn Fn(usize) -> u64| {
        for z in s[2].saturating_sub(1)..(s[2] + 2).min(n[2]) {
            for y in s[1].saturating_sub(1)..(s[1] + 2).min(n[1]) {
                for x in s[0].saturating_sub(1)..(s[0] + 2).min(n[0]) {
                    let (voxel, bit) = grid.sub([x, y, z]);
                    if mask(voxel) >> bit & 1 == 1 {
                        return true;
                    }
                }
            }
        }
        false
    };
    // skin without solid material around it
    let touched = touched(grid, surface);
    let thin: Vec<[usize; 3]> = touched
        .par_iter()
        .with_min_len(1024)
        .copied()
        .filter(|s| {
            let (voxel, bit) = grid.sub(*s);
            inside[voxel] >> bit & 1 == 0 && !near(*s, &|v| inside[v])
        })
        .collect();
    if thin.is_empty() {
        return Vec::new();
    }
    let mut out = vec![0u64; grid.voxel_count()];
    for s in &thin {
        let (voxel, bit) = grid.sub(*s);
        out[voxel] |= 1 << bit;
    }
    // two rounds reach across the ring of skin that borders solid material
    for _ in 0..2 {
        let more: Vec<(usize, u32)> = touched
            .par_iter()
            .with_min_len(1024)
            .filter(|s| {
                let (voxel, bit) = grid.sub(**s);
                (inside[voxel] | out[voxel]) >> bit & 1 == 0 && near(**s, &|v| out[v])
            })
            .map(|s| grid.sub(*s))
            .collect();
        for (voxel, bit) in more {
            out[voxel] |= 1 << bit;
        }
    }
    out
}

/// Sub-voxels that hold points of the surface, each once, in order.
fn touched(grid: &Grid, surface: &Oriented) -> Vec<[usize; 3]> {
    let step = 0.7 * grid.spacing / SUB as f64;
    let chunks: Vec<Vec<[usize; 3]>> = surface
        .triangles
        .par_chunks(512)
        .map(|list| {
            let mut found = Vec::new();
            for t in list {
                let p = t.map(|v| surface.positions[v as usize]);
                crate::mesh::samples::on_triangle(p, step, |w| {
                    let s = grid.sub_of(p[0] * w[0] + p[1] * w[1] + p[2] * w[2]);
                    if found.last() != Some(&s) {
                        found.push(s);
                    }
                });
            }
            found.sort_unstable();
            found.dedup();
            found
        })
        .collect();
    let mut all = chunks.concat();
    all.par_sort_unstable();
    all.dedup();
    all
}

/// Whether the material at both ends of links is cut: walls that matter between solid sub-voxels of one voxel.
pub(super) fn cuts(walls: &Walls, inside: u64, deep: u64, k: usize) -> u64 {
    // sheets have no inside that a gap could separate
    walls.gap[k] & inside & !deep
}
