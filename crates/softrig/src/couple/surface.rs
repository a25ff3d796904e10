//! The skinned meshes of a character as one surface with bone weights.

use super::bone::{Bone, OwnedVertex};
use crate::character::{Character, Skin};
use crate::mesh::{self, Embedding, MeshError, SurfaceMesh, VolumeMesh};
use glam::DVec3;

/// A point on the skin, the cell that carries it, and its weights.
pub(crate) struct CellSample {
    pub cell: u32,
    /// (bone, weight), ascending by bone.
    pub weights: Vec<(usize, f64)>,
    /// (mesh, triangle) it lies on.
    pub triangle: (u32, u32),
}

/// A cell with a larger part inside the skin has none of the outside in it.
const FULL: f32 = 0.999;

/// All skinned meshes of a character; rigid parts are left out, they need no flesh.
pub(crate) struct WeightedSurface<'a> {
    character: &'a Character,
    pub surface: SurfaceMesh,
    /// Mesh and vertex of each surface vertex.
    vertex: Vec<(u32, u32)>,
    /// Mesh and triangle of each surface triangle.
    triangle: Vec<(u32, u32)>,
    weighted: Vec<bool>,
}

impl<'a> WeightedSurface<'a> {
    /// `None` when no mesh has skin weights.
    pub fn new(character: &'a Character) -> Option<Self> {
        let mut vertex = Vec::new();
        let mut triangle = Vec::new();
        let mut weighted = vec![false; character.skeleton.joint_count()];
        for (m, mesh) in character.meshes.iter().enumerate() {
            if let Skin::Weighted(weights) = &mesh.skin {
                vertex.extend((0..mesh.positions.len() as u32).map(|v| (m as u32, v)));
                triangle.extend((0..mesh.triangles.len() as u32).map(|t| (m as u32, t)));
                weights.joint.iter().for_each(|j| weighted[j.index()] = true);
            }
        }
        if vertex.is_empty() || triangle.is_empty() {
            return None;
        }
        Some(Self { character, surface: character.surface(true), vertex, triangle, weighted })
    }

    /// One flag per joint: has skin weight.
    pub fn weighted_joints(&self) -> &[bool] {
        &self.weighted
    }

    /// Every surface vertex with the bone that moves it most.
    pub fn owned_vertices(&self, bones: &[Bone], mesh: &VolumeMesh) -> Result<Vec<OwnedVertex>, MeshError> {
        let embedding = Embedding::embed(mesh, &self.surface.positions, None)?;
        // a shell buried in flesh (a face under its helmet, eyes) lies in cells that are full
        let exposed = |v: usize| mesh.fill(embedding.cell[v] as usize) < FULL;
        Ok((0..self.vertex.len())
            .filter_map(|v| {
                let heaviest =
                    self.vertex_weights(bones, v).fold(None, |best: Option<(usize, f64)>, w| match best {
                        Some(b) if b.1 >= w.1 => best,
                        _ => Some(w),
                    })?;
                Some(OwnedVertex { position: self.surface.positions[v], bone: heaviest.0, exposed: exposed(v) })
            })
            .collect())
    }

    fn vertex_weights<'b>(&'b self, bones: &'b [Bone], v: usize) -> impl Iterator<Item = (usize, f64)> + 'b {
        let (m, local) = self.vertex[v];
        let weights = match &self.character.meshes[m as usize].skin {
            Skin::Weighted(w) => Some(w),
            _ => None,
        };
        weights.into_iter().flat_map(move |w| w.of(local as usize)).filter_map(move |(joint, w)| {
            // bones are in joint order
            bones.binary_search_by(|b| b.joint.cmp(&joint)).ok().map(|b| (b, f64::from(w)))
        })
    }

    /// Unit normal of a triangle; zero for one without area.
    fn normal(&self, triangle: u32) -> [f64; 3] {
        let [a, b, c] =
            self.surface.triangles[triangle as usize].map(|v| DVec3::from(self.surface.positions[v as usize]));
        (b - a).cross(c - a).normalize_or_zero().into()
    }

    /// Points spread over the skin, half a cell apart, each with the cell that carries it.
    pub fn samples(&self, bones: &[Bone], cell_size: f64, mesh: &VolumeMesh) -> Result<Vec<CellSample>, MeshError> {
        let samples = mesh::surface_samples(&self.surface, 0.5 * cell_size);
        let positions: Vec<[f64; 3]> = samples.iter().map(|s| s.position).collect();
        let normals: Vec<[f64; 3]> = samples.iter().map(|s| self.normal(s.triangle)).collect();
        let embedding = Embedding::embed(mesh, &positions, Some(&normals))?;
        Ok(samples
            .iter()
            .zip(&embedding.cell)
            .map(|(s, &cell)| {
                let corners = self.surface.triangles[s.triangle as usize];
                let mut weights: Vec<(usize, f64)> = Vec::new();
                for k in 0..3 {
                    for (bone, w) in self.vertex_weights(bones, corners[k] as usize) {
                        match weights.binary_search_by_key(&bone, |e| e.0) {
                            Ok(i) => weights[i].1 += w * s.weights[k],
                            Err(i) => weights.insert(i, (bone, w * s.weights[k])),
                        }
                    }
                }
                CellSample { cell, weights, triangle: self.triangle[s.triangle as usize] }
            })
            .collect())
    }
}
