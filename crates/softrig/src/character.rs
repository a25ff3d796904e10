//! A character as files describe it: meshes, skin weights, skeleton, clips, in metres and Y up.

use crate::mesh::SurfaceMesh;
use crate::rig::{Affine, Clip, Joint, JointId, Pose, Skeleton};

/// A rigged character, or a bare surface (no joints, no clips).
#[derive(Clone, Debug, PartialEq)]
pub struct Character {
    /// Name of the file without its ending.
    pub name: String,
    /// One per mesh node of the file, in the file's order.
    pub meshes: Vec<CharacterMesh>,
    /// All nodes of the file's scene.
    pub skeleton: Skeleton,
    /// All clips of the file.
    pub clips: Vec<Clip>,
    /// How its surfaces look.
    pub looks: Vec<Look>,
    /// Decoded pictures that `looks` refer to.
    pub textures: Vec<Texture>,
    /// What the importer assumed, repaired or dropped, in plain words.
    pub notes: Vec<String>,
}

/// One mesh node of a file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CharacterMesh {
    /// Name of the node, made unique: names the cache file.
    pub name: String,
    /// Rest (bind) position of each vertex in the world [m], in the file's own order: primitives one after the other.
    pub positions: Vec<[f64; 3]>,
    /// Vertex indices of each triangle.
    pub triangles: Vec<[u32; 3]>,
    /// Look of each triangle, an index into [`Character::looks`]; empty: none.
    pub look: Vec<u32>,
    /// Texture coordinates of each vertex, (0, 0) at the upper left; empty: none.
    pub texture_coordinates: Vec<[f32; 2]>,
    /// Linear RGBA of each vertex; empty: none.
    pub colors: Vec<[f32; 4]>,
    /// Which joints move it.
    pub skin: Skin,
    /// The rig node whose frame is the local space of the mesh object; `None`: the file's own world.
    pub object: Option<JointId>,
    /// Further named per-vertex numbers (vertex groups, custom attributes), for material regions.
    pub groups: Vec<(String, Vec<f32>)>,
}

/// How a mesh hangs on the skeleton.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum Skin {
    /// Not at all: a bare surface.
    #[default]
    Free,
    /// Every vertex follows one joint.
    Rigid(JointId),
    /// Weighted joints for each vertex, weights summing to 1.
    Weighted(SkinWeights),
}

/// Joint weights of each vertex, as compressed rows.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SkinWeights {
    /// First entry of each vertex, and one past the last.
    pub start: Vec<u32>,
    /// Joint of each entry.
    pub joint: Vec<JointId>,
    /// Its weight, in (0, 1].
    pub weight: Vec<f32>,
}

impl SkinWeights {
    /// Joints and weights of one vertex.
    pub fn of(&self, vertex: usize) -> impl Iterator<Item = (JointId, f32)> + '_ {
        let range = self.start[vertex] as usize..self.start[vertex + 1] as usize;
        range.map(|k| (self.joint[k], self.weight[k]))
    }

    /// Appends the weights of the next vertex: normalised to sum 1, zero and non-finite ones dropped.
    /// Returns false, and appends an empty entry, when none is left.
    pub fn push(&mut self, influences: impl IntoIterator<Item = (JointId, f32)>) -> bool {
        if self.start.is_empty() {
            self.start.push(0);
        }
        let first = self.joint.len();
        for (joint, weight) in influences {
            if weight > 0.0 && weight.is_finite() {
                // one joint may be listed several times
                match self.joint[first..].iter().position(|j| *j == joint) {
                    Some(k) => self.weight[first + k] += weight,
                    None => {
                        self.joint.push(joint);
                        self.weight.push(weight);
                    }
                }
            }
        }
        let sum: f32 = self.weight[first..].iter().sum();
        self.weight[first..].iter_mut().for_each(|w| *w /= sum);
        self.start.push(self.joint.len() as u32);
        self.joint.len() > first
    }
}

/// Base colour of a surface.
#[derive(Clone, Debug, PartialEq)]
pub struct Look {
    /// Name of the file's material.
    pub name: String,
    /// Linear RGBA.
    pub base_color: [f32; 4],
    /// Index into [`Character::textures`].
    pub texture: Option<usize>,
}

/// A decoded picture.
#[derive(Clone, Debug, PartialEq)]
pub struct Texture {
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// sRGB and alpha, row by row from the top; `len == width * height`.
    pub rgba: Vec<[u8; 4]>,
}

impl CharacterMesh {
    /// Whether flesh is simulated for it: only meshes with skin weights move otherwise than rigidly.
    #[must_use]
    pub fn is_weighted(&self) -> bool {
        matches!(self.skin, Skin::Weighted(_))
    }
}

impl Character {
    /// Number of vertices of all meshes.
    #[must_use]
    pub fn vertex_count(&self) -> usize {
        self.meshes.iter().map(|m| m.positions.len()).sum()
    }

    /// All meshes in one surface, in rest position. With `weighted_only`, rigid parts stay out.
    #[must_use]
    pub fn surface(&self, weighted_only: bool) -> SurfaceMesh {
        let mut out = SurfaceMesh::default();
        for mesh in self.meshes.iter().filter(|m| !weighted_only || m.is_weighted()) {
            let base = out.positions.len() as u32;
            out.positions.extend_from_slice(&mesh.positions);
            out.triangles.extend(mesh.triangles.iter().map(|t| t.map(|v| v + base)));
        }
        out
    }

    /// Height of the rest shape along Y [m].
    #[must_use]
    pub fn height(&self) -> f64 {
        let y = || self.meshes.iter().flat_map(|m| &m.positions).map(|p| p[1]);
        let (lo, hi) = y().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), y| (l.min(y), h.max(y)));
        if hi >= lo { hi - lo } else { 0.0 }
    }

    /// Index of a clip by name or by number, names first.
    #[must_use]
    pub fn find_clip(&self, name: &str) -> Option<usize> {
        self.clips
            .iter()
            .position(|c| c.name == name)
            .or_else(|| name.parse().ok().filter(|i: &usize| *i < self.clips.len()))
    }

    /// Scales the whole character, skeleton included, about the origin.
    pub fn scale(&mut self, factor: f64) {
        let map = Affine::from_scale(factor);
        self.map_rest(&map);
        self.skeleton.set_to_world(map.after(self.skeleton.to_world()));
    }

    /// Moves the rest shape (vertices and rest frames) by a world map, leaving clips alone.
    pub fn map_rest(&mut self, map: &Affine) {
        for p in self.meshes.iter_mut().flat_map(|m| &mut m.positions) {
            *p = map.point(*p);
        }
        self.skeleton.map_rest(map);
    }

    /// The map each joint's frame has undergone since the rest shape: rest world to posed world.
    #[must_use]
    pub fn bone_maps(&self, pose: &Pose) -> Vec<Affine> {
        bone_maps(&self.skeleton, pose)
    }

    /// Linear blend skinning of one mesh: what the file alone would show [m]. One position per vertex.
    #[must_use]
    pub fn blend_skin(&self, mesh: usize, pose: &Pose) -> Vec<[f64; 3]> {
        let maps = self.bone_maps(pose);
        let mesh = &self.meshes[mesh];
        match &mesh.skin {
            Skin::Free => mesh.positions.clone(),
            Skin::Rigid(joint) => mesh.positions.iter().map(|p| maps[joint.index()].point(*p)).collect(),
            Skin::Weighted(weights) => mesh
                .positions
                .iter()
                .enumerate()
                .map(|(v, p)| {
                    let mut sum = [0.0; 3];
                    for (joint, w) in weights.of(v) {
                        let q = maps[joint.index()].point(*p);
                        (0..3).for_each(|k| sum[k] += f64::from(w) * q[k]);
                    }
                    sum
                })
                .collect(),
        }
    }
}

/// The map each joint's frame has undergone since the rest shape: rest world to posed world.
/// A joint whose rest frame cannot be inverted keeps the identity.
#[must_use]
pub fn bone_maps(skeleton: &Skeleton, pose: &Pose) -> Vec<Affine> {
    skeleton.joints().iter().zip(&pose.world).map(|(joint, world)| bone_map(joint, world)).collect()
}

/// The map of one joint's frame, as in [`bone_maps`].
pub(crate) fn bone_map(joint: &Joint, world: &Affine) -> Affine {
    joint.rest.inverse().map_or(Affine::IDENTITY, |back| world.after(&back))
}
