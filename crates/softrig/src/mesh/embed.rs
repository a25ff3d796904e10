//! Finds the cell and the weights of points: see [`Embedding::embed`].

use super::boundary::{BoundaryFaces, boundary_faces};
use super::bvh::{Bvh, nearest_on_triangle};
use super::shape::{hex_weights, tet_weights, trilinear};
use super::{Embedding, Lattice, MeshError, VolumeMesh};
use glam::DVec3;
use rayon::prelude::*;
use std::collections::HashMap;

/// How well points sat in their cells.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct EmbedReport {
    /// Points outside their cell: carried by extrapolation.
    pub outside: usize,
    /// Points more than two cell sizes outside: the mesh does not reach them.
    pub far: usize,
    /// Largest distance from a point to its cell, in cell sizes [-].
    pub farthest: f64,
}

/// Beyond this many cell sizes a point is counted as far.
const FAR: f64 = 2.0;

impl Embedding {
    /// Puts each point into one cell of the rest shape. Points inside the mesh get interpolating weights, others are extrapolated from the nearest cell. Where
    /// several cells share a voxel, a point belongs to the one whose material is nearest, seen from slightly behind the skin when
    /// outward `normals` are given (any length; zero: unknown). Equal points get equal entries.
    ///
    /// # Errors
    /// No usable cell, invalid indices, points or nodes that are not finite, or another number of normals than points.
    pub fn embed(mesh: &VolumeMesh, points: &[[f64; 3]], normals: Option<&[[f64; 3]]>) -> Result<Self, MeshError> {
        Self::embed_with_report(mesh, points, normals).map(|(e, _)| e)
    }

    /// [`Embedding::embed`], and how well it went.
    ///
    /// # Errors
    /// As [`Embedding::embed`].
    pub fn embed_with_report(
        mesh: &VolumeMesh,
        points: &[[f64; 3]],
        normals: Option<&[[f64; 3]]>,
    ) -> Result<(Self, EmbedReport), MeshError> {
        validate(mesh, points, normals)?;
        // each place once, with the sum of the normals there: copies of a vertex along a seam must not drift apart
        let mut first: HashMap<[u64; 3], u32> = HashMap::with_capacity(points.len());
        let mut places: Vec<(DVec3, DVec3)> = Vec::new();
        let mut place = Vec::with_capacity(points.len());
        for (i, p) in points.iter().enumerate() {
            // adding zero makes one zero of both
            let key = p.map(|x| (x + 0.0).to_bits());
            let n = *first.entry(key).or_insert_with(|| {
                places.push((DVec3::from_array(*p), DVec3::ZERO));
                places.len() as u32 - 1
            });
            place.push(n);
            if let Some(normals) = normals {
                places[n as usize].1 += DVec3::from_array(normals[i]).normalize_or_zero();
            }
        }
        let found: Vec<Option<Seat>> = match voxels(mesh) {
            Some(lattice) => {
                let finder = VoxelFinder::new(mesh, lattice);
                places.par_iter().with_min_len(64).map(|(p, n)| Some(finder.seat(*p, n.normalize_or_zero()))).collect()
            }
            None => {
                let finder = CellFinder::new(mesh);
                places.par_iter().with_min_len(64).map(|(p, _)| finder.seat(*p)).collect()
            }
        };
        let mut out = Self { start: vec![0], ..Self::default() };
        let mut report = EmbedReport::default();
        for n in place {
            let seat = found[n as usize].as_ref().ok_or(MeshError::NoCells)?;
            out.cell.push(seat.cell);
            let nodes = mesh.cell(seat.cell as usize);
            out.node.extend_from_slice(nodes);
            out.weight.extend_from_slice(&seat.weight[..nodes.len()]);
            out.start.push(out.node.len() as u32);
            report.outside += usize::from(seat.outside > 1e-9);
            report.far += usize::from(seat.outside > FAR);
            report.farthest = report.farthest.max(seat.outside);
        }
        Ok((out, report))
    }
}

/// One point's place.
struct Seat {
    cell: u32,
    weight: [f64; 8],
    /// Distance to the cell in cell sizes.
    outside: f64,
}

fn validate(mesh: &VolumeMesh, points: &[[f64; 3]], normals: Option<&[[f64; 3]]>) -> Result<(), MeshError> {
    if mesh.cell_count() == 0 {
        return Err(MeshError::NoCells);
    }
    let count = mesh.node_count();
    for (cell, nodes) in mesh.cells().enumerate() {
        if let Some(&node) = nodes.iter().find(|n| **n as usize >= count) {
            return Err(MeshError::CellIndex { cell, node, count });
        }
    }
    let bad = |p: &[f64; 3]| !p.iter().all(|x| x.is_finite());
    if let Some(index) = mesh.nodes.iter().position(bad) {
        return Err(MeshError::NonFinite { what: "node", index });
    }
    if let Some(index) = points.iter().position(bad) {
        return Err(MeshError::NonFinite { what: "point", index });
    }
    match normals {
        Some(n) if n.len() != points.len() => {
            Err(MeshError::ListLength { list: "normals", found: n.len(), expected: points.len() })
        }
        _ => Ok(()),
    }
}

/// The lattice, when every cell is a voxel of it.
fn voxels(mesh: &VolumeMesh) -> Option<&Lattice> {
    let n = mesh.hexes.len();
    let whole = |l: &&Lattice| l.spacing > 0.0 && l.voxel.len() == n && l.piece.len() == n;
    mesh.lattice.as_ref().filter(|_| mesh.tets.is_empty()).filter(whole)
}

/// Finds voxels in closed form.
struct VoxelFinder<'a> {
    lattice: &'a Lattice,
    /// Cells sorted by voxel, and where each voxel's begin and end.
    order: Vec<u32>,
    range: HashMap<[i32; 3], (u32, u32)>,
    tree: Bvh,
}

impl<'a> VoxelFinder<'a> {
    fn new(mesh: &VolumeMesh, lattice: &'a Lattice) -> Self {
        let mut order: Vec<u32> = (0..mesh.hexes.len() as u32).collect();
        order.sort_by_key(|c| lattice.voxel[*c as usize]);
        let mut range = HashMap::with_capacity(order.len());
        let mut start = 0;
        for group in order.chunk_by(|a, b| lattice.voxel[*a as usize] == lattice.voxel[*b as usize]) {
            range.insert(lattice.voxel[group[0] as usize], (start, start + group.len() as u32));
            start += group.len() as u32;
        }
        let boxes: Vec<(DVec3, DVec3)> = lattice
            .voxel
            .iter()
            .map(|v| {
                let lo = DVec3::from_array(v.map(f64::from));
                (lo, lo + 1.0)
            })
            .collect();
        Self { lattice, order, range, tree: Bvh::new(&boxes) }
    }

    fn seat(&self, p: DVec3, normal: DVec3) -> Seat {
        // in voxels; half a sub-voxel behind the skin is material of the right side
        let q = (p - DVec3::from_array(self.lattice.origin)) / self.lattice.spacing;
        let look = q - normal * 0.125;
        let cell = self.near(q, look).unwrap_or_else(|| {
            let gap = |c: u32| self.outside(c, q).length_squared();
            self.tree.nearest(q, gap).map_or(0, |(c, _)| c)
        });
        let local = q - DVec3::from_array(self.lattice.voxel[cell as usize].map(f64::from));
        Seat { cell, weight: trilinear(local), outside: self.outside(cell, q).length() }
    }

    /// Vector from a cell's box to a point [voxels].
    fn outside(&self, cell: u32, q: DVec3) -> DVec3 {
        let lo = DVec3::from_array(self.lattice.voxel[cell as usize].map(f64::from));
        (lo - q).max(q - lo - 1.0).max(DVec3::ZERO)
    }

    /// The best cell among those of the voxel that holds the point and its neighbours.
    fn near(&self, q: DVec3, look: DVec3) -> Option<u32> {
        let home = look.floor().to_array();
        // far outside of whole numbers there is no neighbourhood
        if home.iter().any(|x| x.abs() > 1e9) {
            return None;
        }
        let home = home.map(|x| x as i32);
        // the usual case: the point is inside a cell, and what is behind it is that cell's own material
        let part = ((look - look.floor()) * 4.0).to_array().map(|x| (x as u32).min(3));
        let bit = part[0] + 4 * part[1] + 16 * part[2];
        if let Some(&(a, b)) = self.range.get(&home) {
            let owner =
                self.order[a as usize..b as usize].iter().find(|c| self.lattice.piece[**c as usize] >> bit & 1 == 1);
            if let Some(&c) = owner.filter(|c| self.outside(**c, q) == DVec3::ZERO) {
                return Some(c);
            }
        }
        let mut best: Option<(f64, u32)> = None;
        for z in -1..=1 {
            for y in -1..=1 {
                for x in -1..=1 {
                    let Some(&(a, b)) = self.range.get(&[home[0] + x, home[1] + y, home[2] + z]) else { continue };
                    for &cell in &self.order[a as usize..b as usize] {
                        // distance to its material, and what would have to be extrapolated
                        let extra = self.outside(cell, q).length();
                        if best.is_some_and(|(c, _)| self.outside(cell, look).length() + extra > c) {
                            continue;
                        }
                        let cost = self.material(cell, look) + extra;
                        if best.is_none_or(|(c, i)| cost < c || (cost == c && cell < i)) {
                            best = Some((cost, cell));
                        }
                    }
                }
            }
        }
        best.map(|(_, c)| c)
    }

    /// Distance from a point to the nearest sub-voxel that a cell owns [voxels].
    fn material(&self, cell: u32, q: DVec3) -> f64 {
        let lo = DVec3::from_array(self.lattice.voxel[cell as usize].map(f64::from));
        let local = (q - lo) * 4.0;
        let mut mask = self.lattice.piece[cell as usize];
        // the usual case: a full voxel, or the point right inside owned material
        let gap = |s: DVec3| (s - local).max(local - s - 1.0).max(DVec3::ZERO).length_squared();
        let mut best = f64::INFINITY;
        while mask != 0 && best > 0.0 {
            let bit = mask.trailing_zeros();
            mask &= mask - 1;
            best = best.min(gap(DVec3::new(f64::from(bit % 4), f64::from(bit / 4 % 4), f64::from(bit / 16))));
        }
        best.sqrt() / 4.0
    }
}

/// Finds cells of any shape.
struct CellFinder<'a> {
    mesh: &'a VolumeMesh,
    cells: Bvh,
    faces: BoundaryFaces,
    skin: Bvh,
}

impl<'a> CellFinder<'a> {
    fn new(mesh: &'a VolumeMesh) -> Self {
        let bounds = |nodes: &[u32]| {
            let at = nodes.iter().map(|n| DVec3::from_array(mesh.nodes[*n as usize]));
            at.fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(l, h), p| (l.min(p), h.max(p)))
        };
        let faces = boundary_faces(mesh);
        let boxes: Vec<_> = mesh.cells().map(bounds).collect();
        let face_boxes: Vec<_> = faces.triangles.iter().map(|t| bounds(t)).collect();
        Self { mesh, cells: Bvh::new(&boxes), skin: Bvh::new(&face_boxes), faces }
    }

    fn corner<const N: usize>(&self, nodes: &[u32]) -> [DVec3; N] {
        std::array::from_fn(|k| DVec3::from_array(self.mesh.nodes[nodes[k] as usize]))
    }

    /// Weights in a cell, how far outside in local coordinates; `None` for flat cells.
    fn weights(&self, cell: u32, p: DVec3) -> Option<Seat> {
        let nodes = self.mesh.cell(cell as usize);
        let mut weight = [0.0; 8];
        let outside = if nodes.len() == 4 {
            let w = tet_weights(&self.corner(nodes), p)?;
            weight[..4].copy_from_slice(&w);
            w.iter().fold(0.0, |m: f64, w| m.max(-w))
        } else {
            let (w, outside) = hex_weights(&self.corner(nodes), p)?;
            weight = w;
            outside
        };
        weight.iter().all(|w| w.is_finite()).then_some(Seat { cell, weight, outside })
    }

    fn seat(&self, p: DVec3) -> Option<Seat> {
        let mut best: Option<Seat> = None;
        let mut keep = |seat: Option<Seat>| {
            if let Some(s) = seat {
                // within rounding of a shared face the lower cell wins
                let better =
                    |b: &Seat| s.outside + 1e-9 < b.outside || (s.outside <= b.outside + 1e-9 && s.cell < b.cell);
                if best.as_ref().is_none_or(better) {
                    best = Some(s);
                }
            }
        };
        self.cells.around(p, 0.0, |cell| keep(self.weights(cell, p)));
        if best.as_ref().is_some_and(|b| b.outside <= 1e-9) {
            return best;
        }
        // outside: the usable cell behind the nearest part of the skin
        let distance = |f: u32| {
            if self.weights(self.faces.cell[f as usize], p).is_none() {
                return f64::INFINITY;
            }
            nearest_on_triangle(self.corner(&self.faces.triangles[f as usize]), p).distance_squared(p)
        };
        let (face, d2) = self.skin.nearest(p, distance).filter(|(_, d)| d.is_finite())?;
        let mut seat = self.weights(self.faces.cell[face as usize], p)?;
        let x = self.mesh.cell(seat.cell as usize).iter().map(|n| DVec3::from_array(self.mesh.nodes[*n as usize]));
        let (lo, hi) = x.fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(l, h), p| (l.min(p), h.max(p)));
        seat.outside = d2.sqrt() / (hi - lo).max_element();
        Some(seat)
    }
}
