//! The skin: carried by the flesh it lies in, or by the joint it is fixed to.

use crate::character::{Character, Skin, bone_maps};
use crate::mesh::{self, Embedding, VolumeMesh};
use crate::rig::{JointId, Pose, Skeleton};
use glam::DVec3;
use softrig_linalg::Scalar;

/// Skin vertices of all meshes: embedded ones by cells, rigid ones by their joint.
pub(super) struct SkinCarrier {
    embedding: Embedding,
    points: Vec<[f64; 3]>,
    meshes: Vec<CarriedMesh>,
    /// Skin of every mesh, as carried last [m].
    pub positions: Vec<Vec<[f64; 3]>>,
}

enum CarriedMesh {
    /// Embedded point of each vertex.
    Flesh(Vec<u32>),
    /// Rest positions, and the joint they follow; without one they stay.
    Rigid(Vec<[f64; 3]>, Option<JointId>),
}

impl SkinCarrier {
    pub fn new(character: &Character, mesh: &VolumeMesh) -> Result<Self, mesh::MeshError> {
        let surface = character.surface(true);
        let weld = mesh::weld(&surface.positions, 1e-6 * character.height());
        let triangles: Vec<[u32; 3]> =
            surface.triangles.iter().map(|t| t.map(|v| weld.vertex_to_welded[v as usize])).collect();
        let normals = vertex_normals(&weld.positions, &triangles);
        let embedding = Embedding::embed(mesh, &weld.positions, Some(&normals))?;
        let mut next = 0;
        let mut meshes = Vec::new();
        for m in &character.meshes {
            meshes.push(match &m.skin {
                Skin::Weighted(_) => {
                    let range = next..next + m.positions.len();
                    next = range.end;
                    CarriedMesh::Flesh(weld.vertex_to_welded[range].to_vec())
                }
                Skin::Rigid(joint) => CarriedMesh::Rigid(m.positions.clone(), Some(*joint)),
                Skin::Free => CarriedMesh::Rigid(m.positions.clone(), None),
            });
        }
        let positions = character.meshes.iter().map(|m| m.positions.clone()).collect();
        Ok(Self { points: weld.positions, embedding, meshes, positions })
    }

    /// Nodes and weights of a vertex that flesh carries.
    pub fn point(&self, mesh: usize, vertex: usize) -> Option<Vec<(u32, f64)>> {
        let CarriedMesh::Flesh(points) = self.meshes.get(mesh)? else { return None };
        let p = *points.get(vertex)? as usize;
        let range = self.embedding.start[p] as usize..self.embedding.start[p + 1] as usize;
        Some(range.map(|k| (self.embedding.node[k], self.embedding.weight[k])).collect())
    }

    /// Moves the skin to where the nodes and the bones are.
    pub fn carry<R: Scalar>(&mut self, nodes: &[[R; 3]], skeleton: &Skeleton, pose: &Pose) {
        self.embedding.apply(nodes, &mut self.points);
        let maps = bone_maps(skeleton, pose);
        for (mesh, out) in self.meshes.iter().zip(&mut self.positions) {
            match mesh {
                CarriedMesh::Flesh(point) => {
                    for (p, o) in point.iter().zip(out) {
                        *o = self.points[*p as usize];
                    }
                }
                CarriedMesh::Rigid(rest, Some(joint)) => {
                    for (r, o) in rest.iter().zip(out) {
                        *o = maps[joint.index()].point(*r);
                    }
                }
                CarriedMesh::Rigid(..) => {}
            }
        }
    }
}

/// Area-weighted normals; zero where a vertex has no triangle.
fn vertex_normals(positions: &[[f64; 3]], triangles: &[[u32; 3]]) -> Vec<[f64; 3]> {
    let mut normals = vec![DVec3::ZERO; positions.len()];
    for t in triangles {
        let [a, b, c] = t.map(|v| DVec3::from(positions[v as usize]));
        let n = (b - a).cross(c - a);
        t.iter().for_each(|v| normals[*v as usize] += n);
    }
    normals.into_iter().map(|n| n.normalize_or_zero().into()).collect()
}
