//! How nodes move with bones, and bones with the unknowns of a skeleton: x' = G ξ per node, ξ = H q' per bone.
//!
//! A bone's twist ξ is its angular velocity and its velocity at its joint, in world axes; a wrench is the torque about the joint and
//! the force. Free nodes have a G as well: that of blended skinning, the best guess of how flesh follows.

use super::binding::Binding;
use super::blend::{BoneMotion, blend_derivative, blend_point};
use crate::rig::{Articulation, Column, Pose, Skeleton};
use glam::{DMat3, DQuat, DVec3};
use rayon::prelude::*;
use softrig_linalg::par::Each;

/// Nodes per task, and per partial sum.
const CHUNK: usize = 512;

/// What a node is to the coupled system.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Role {
    /// Moved by the flesh.
    Free,
    /// Moved by its bones.
    Bound,
    /// Belongs to no cell and stays.
    Held,
}

/// Derivatives of all nodes in one pose.
#[derive(Debug, Default)]
pub(crate) struct NodeJacobian {
    /// One matrix for each entry of the binding.
    pub entries: Vec<[f64; 18]>,
    /// Where blended skinning has each node [m].
    pub placed: Vec<[f64; 3]>,
    /// Place of each bone's joint.
    pub origin: Vec<DVec3>,
    /// Rotation of each bone since rest.
    pub rotation: Vec<DMat3>,
    /// The same, row by row.
    pub frame: Vec<[[f32; 3]; 3]>,
    partial: Vec<[f64; 6]>,
}

impl NodeJacobian {
    /// Takes a pose.
    pub fn set(&mut self, binding: &Binding, motions: &[BoneMotion], pose: &Pose, rest: &[[f64; 3]]) {
        self.origin.clear();
        self.origin.extend(binding.bones.iter().map(|b| DVec3::from(pose.joint(b.joint).translation)));
        self.rotation.clear();
        self.rotation.extend(motions.iter().map(|m| DMat3::from_quat(DQuat::from_array(m.rotation()))));
        self.frame.clear();
        self.frame.extend(self.rotation.iter().map(|m| {
            let columns = m.to_cols_array_2d();
            std::array::from_fn(|r| std::array::from_fn(|c| columns[c][r] as f32))
        }));
        self.entries.resize(binding.entry.len(), [0.0; 18]);
        self.placed.resize(rest.len(), [0.0; 3]);
        let of = Placing { binding, motions, origin: &self.origin, rest };
        of.fill(0, &mut self.entries, &mut self.placed);
    }

    fn of(&self, binding: &Binding, n: usize) -> impl Iterator<Item = (usize, &[f64; 18])> {
        let range = binding.start[n] as usize..binding.start[n + 1] as usize;
        binding.entry[range.clone()].iter().map(|e| e.0 as usize).zip(&self.entries[range])
    }

    /// `G ξ` at node `n`.
    #[inline]
    pub fn moved(&self, binding: &Binding, n: usize, twist: &[[f64; 6]]) -> [f64; 3] {
        let mut sum = [0.0; 3];
        for (bone, g) in self.of(binding, n) {
            let t = &twist[bone];
            for r in 0..3 {
                let row = &g[6 * r..6 * r + 6];
                sum[r] +=
                    (row[0] * t[0] + row[1] * t[1] + row[2] * t[2]) + (row[3] * t[3] + row[4] * t[4] + row[5] * t[5]);
            }
        }
        sum
    }

    /// `wrench = Σ Gᵀ f` over the nodes with that role.
    pub fn gather(&mut self, binding: &Binding, role: &[Role], which: Role, f: &[[f64; 3]], wrench: &mut [[f64; 6]]) {
        let bones = wrench.len();
        let chunks = f.len().div_ceil(CHUNK);
        let mut partial = std::mem::take(&mut self.partial);
        partial.clear();
        partial.resize(chunks * bones, [0.0; 6]);
        partial.par_chunks_mut(bones.max(1)).enumerate().each(|(c, sum)| {
            for n in c * CHUNK..((c + 1) * CHUNK).min(f.len()) {
                if role[n] != which {
                    continue;
                }
                for (bone, g) in self.of(binding, n) {
                    for (k, s) in sum[bone].iter_mut().enumerate() {
                        *s += g[k] * f[n][0] + g[6 + k] * f[n][1] + g[12 + k] * f[n][2];
                    }
                }
            }
        });
        wrench.fill([0.0; 6]);
        for chunk in partial.chunks(bones.max(1)) {
            for (w, p) in wrench.iter_mut().zip(chunk) {
                (0..6).for_each(|k| w[k] += p[k]);
            }
        }
        self.partial = partial;
    }

    /// Adds a spring of that stiffness at a weighted sum of nodes, which follow their bones by their `share`, to a bone matrix in
    /// world axes.
    pub fn add_spring(&self, binding: &Binding, share: &[f64], nodes: &[(u32, f64)], stiffness: f64, out: &mut [f64]) {
        let width = 6 * self.origin.len();
        let mut of_bone: Vec<(usize, [f64; 18])> = Vec::new();
        for (n, w) in nodes {
            let w = w * share[*n as usize];
            for (bone, g) in self.of(binding, *n as usize) {
                let at = match of_bone.iter().position(|b| b.0 == bone) {
                    Some(k) => k,
                    None => {
                        of_bone.push((bone, [0.0; 18]));
                        of_bone.len() - 1
                    }
                };
                (0..18).for_each(|k| of_bone[at].1[k] += w * g[k]);
            }
        }
        for (a, g) in &of_bone {
            for (b, h) in &of_bone {
                for i in 0..6 {
                    for j in 0..6 {
                        let dot = g[i] * h[j] + g[6 + i] * h[6 + j] + g[12 + i] * h[12 + j];
                        out[(6 * a + i) * width + 6 * b + j] += stiffness * dot;
                    }
                }
            }
        }
    }

    /// Turns every 3x3 block from world axes to the axes of its bones, or back.
    pub fn turn_blocks(&self, matrix: &mut [f64], to_bones: bool) {
        let bones = self.origin.len();
        let width = 6 * bones;
        for a in 0..2 * bones {
            for b in 0..2 * bones {
                let at = |r: usize, c: usize| (3 * a + r) * width + 3 * b + c;
                let mut m = DMat3::ZERO;
                for r in 0..3 {
                    for c in 0..3 {
                        m.col_mut(c)[r] = matrix[at(r, c)];
                    }
                }
                if m == DMat3::ZERO {
                    continue;
                }
                let (ra, rb) = (self.rotation[a / 2], self.rotation[b / 2]);
                let m = if to_bones { ra.transpose() * m * rb } else { ra * m * rb.transpose() };
                for r in 0..3 {
                    for c in 0..3 {
                        matrix[at(r, c)] = m.col(c)[r];
                    }
                }
            }
        }
    }
}

/// What places and derivatives are computed from.
struct Placing<'a> {
    binding: &'a Binding,
    motions: &'a [BoneMotion],
    origin: &'a [DVec3],
    rest: &'a [[f64; 3]],
}

impl Placing<'_> {
    /// Fills the entries and places of the nodes from `first` on, in halves on different threads.
    fn fill(&self, first: usize, entries: &mut [[f64; 18]], placed: &mut [[f64; 3]]) {
        let Self { binding, motions, origin, rest } = self;
        if placed.len() > CHUNK {
            let half = placed.len() / 2;
            let (e, e_after) = entries.split_at_mut((binding.start[first + half] - binding.start[first]) as usize);
            let (p, p_after) = placed.split_at_mut(half);
            rayon::join(|| self.fill(first, e, p), || self.fill(first + half, e_after, p_after));
            return;
        }
        let mut entries = entries;
        for (k, place) in placed.iter_mut().enumerate() {
            let (weights, p) = (binding.blend(first + k), rest[first + k]);
            let (own, after) = std::mem::take(&mut entries).split_at_mut(weights.len());
            entries = after;
            *place = blend_point(motions, weights, p);
            blend_derivative(motions, weights, p, origin, own);
        }
    }
}

/// How bones move with the unknowns of an articulation.
#[derive(Debug, Default)]
pub(crate) struct JointJacobian {
    /// Per bone: the unknowns that move it, and the twist of each.
    of_bone: Vec<Vec<(usize, [f64; 6])>>,
    columns: Vec<Column>,
}

impl JointJacobian {
    /// Takes a pose.
    pub fn set(&mut self, articulation: &Articulation, skeleton: &Skeleton, binding: &Binding, pose: &Pose) {
        articulation.columns_into(skeleton, pose, &mut self.columns);
        self.of_bone.resize(binding.bones.len(), Vec::new());
        for (row, bone) in self.of_bone.iter_mut().zip(&binding.bones) {
            let origin = DVec3::from(pose.joint(bone.joint).translation);
            row.clear();
            for e in articulation.moved_by(bone.joint) {
                let entry = articulation.entries()[*e as usize];
                for k in entry.first..entry.first + entry.count() {
                    let omega = DVec3::from(self.columns[k].omega);
                    let v = omega.cross(origin) + DVec3::from(self.columns[k].velocity);
                    row.push((k, [omega.x, omega.y, omega.z, v.x, v.y, v.z]));
                }
            }
        }
    }

    /// How a point that moves with `joint` moves with each unknown.
    pub fn point(&self, articulation: &Articulation, joint: crate::rig::JointId, at: DVec3) -> Vec<(usize, DVec3)> {
        let unknowns = articulation.moved_by(joint).iter().flat_map(|e| {
            let entry = articulation.entries()[*e as usize];
            entry.first..entry.first + entry.count()
        });
        unknowns
            .map(|k| (k, DVec3::from(self.columns[k].omega).cross(at) + DVec3::from(self.columns[k].velocity)))
            .collect()
    }

    /// ξ = H q.
    pub fn twists(&self, q: &[f64], twist: &mut [[f64; 6]]) {
        for (t, row) in twist.iter_mut().zip(&self.of_bone) {
            *t = [0.0; 6];
            for (k, h) in row {
                (0..6).for_each(|i| t[i] += h[i] * q[*k]);
            }
        }
    }

    /// q += Hᵀ wrench.
    pub fn collect(&self, wrench: &[[f64; 6]], q: &mut [f64]) {
        for (w, row) in wrench.iter().zip(&self.of_bone) {
            for (k, h) in row {
                q[*k] += (0..6).map(|i| h[i] * w[i]).sum::<f64>();
            }
        }
    }

    /// Adds Hᵀ B H, for a bone matrix in world axes, to a matrix of full rows.
    pub fn reduce(&self, bone_matrix: &[f64], unknowns: usize, out: &mut [f64]) {
        let width = 6 * self.of_bone.len();
        for (a, row) in self.of_bone.iter().enumerate() {
            for (b, column) in self.of_bone.iter().enumerate() {
                let block = |i: usize, j: usize| bone_matrix[(6 * a + i) * width + 6 * b + j];
                if (0..36).all(|k| block(k / 6, k % 6) == 0.0) {
                    continue;
                }
                for (j, h) in column {
                    let image: [f64; 6] = std::array::from_fn(|r| (0..6).map(|c| block(r, c) * h[c]).sum());
                    for (i, g) in row {
                        out[i * unknowns + j] += (0..6).map(|r| g[r] * image[r]).sum::<f64>();
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::body::Body;
    use crate::character::bone_map;
    use crate::couple::BindSettings;
    use crate::force::{ElasticModel, Increment};
    use crate::material::{Material, MaterialMap};
    use crate::mesh::{LatticeOptions, Resolution, tetrahedralize, voxelize};
    use crate::rig::{Base, JointSetup, RootKind, automatic};
    use softrig_linalg::DofConstraints;

    /// Virtual work: the torque that deformed flesh exerts on every joint of a bent character, against central differences of its
    /// elastic energy as that joint alone turns, free nodes staying where they are.
    #[test]
    fn torques_are_the_derivatives_of_the_elastic_energy() {
        for tets in [false, true] {
            let character = crate::sample::character();
            let skeleton = &character.skeleton;
            let options = LatticeOptions { resolution: Resolution::Cells(500), ..LatticeOptions::default() };
            let mut volume = voxelize(&character.surface(true), &options).unwrap();
            if tets {
                volume = tetrahedralize(&volume);
            }
            let binding = Binding::new(&character, &volume, &BindSettings::default()).unwrap();
            let none = DofConstraints::none(volume.node_count());
            let materials = MaterialMap::uniform(Material::default());
            let mut body = Body::<f64>::new(volume, &materials, ElasticModel::Corotated, none).unwrap();
            let bones: Vec<_> = binding.bones.iter().map(|b| b.joint).collect();
            let mut setups = vec![JointSetup::default(); skeleton.joint_count()];
            for choice in automatic(skeleton, &bones, &character.clips) {
                setups[choice.joint.index()] = JointSetup { drive: 0.0, ..choice.setup };
            }
            let roots = crate::simulation::root_bones(skeleton, &binding);
            let articulation = Articulation::new(skeleton, setups, &roots, RootKind::Free).unwrap();
            let clip = skeleton.pose(&character.clips[0].sample(skeleton, 0.4));
            let mut base = Base::default();
            articulation.base_into(skeleton, &clip, &mut base);
            let start = articulation.configuration(&base);
            let count = articulation.unknown_count();
            let rest = body.mesh.nodes.clone();
            let role: Vec<Role> = binding.bound.iter().map(|b| if *b { Role::Bound } else { Role::Free }).collect();
            let (mut nodes, mut joints, mut pose) =
                (NodeJacobian::default(), JointJacobian::default(), Pose::default());
            let mut take = |increment: &[f64], nodes: &mut NodeJacobian, joints: &mut JointJacobian| {
                let mut configuration = start.clone();
                articulation.pose_into(skeleton, &base, &start, &mut pose);
                articulation.advance(skeleton, &pose, increment, &mut configuration);
                articulation.pose_into(skeleton, &base, &configuration, &mut pose);
                let motions: Vec<BoneMotion> = binding
                    .bones
                    .iter()
                    .map(|b| {
                        let joint = skeleton.joint(b.joint);
                        BoneMotion::new(&bone_map(joint, pose.joint(b.joint)), joint.rest.translation)
                    })
                    .collect();
                nodes.set(&binding, &motions, &pose, &rest);
                joints.set(&articulation, skeleton, &binding, &pose);
            };
            take(&vec![0.0; count], &mut nodes, &mut joints);
            // free flesh a little beside where blended skinning has it
            let wobble = |n: usize, k: usize| 0.01 * ((7 * n + 3 * k) as f64).sin();
            let free: Vec<[f64; 3]> =
                nodes.placed.iter().enumerate().map(|(n, p)| std::array::from_fn(|k| p[k] + wobble(n, k))).collect();
            let mut force = vec![[0.0; 3]; rest.len()];
            let mut energy = |nodes: &NodeJacobian, force: &mut Vec<[f64; 3]>| {
                let bound = binding.bound.iter().enumerate();
                let x: Vec<[f64; 3]> = bound.map(|(n, b)| if *b { nodes.placed[n] } else { free[n] }).collect();
                body.model.linearise(&x);
                body.model.force(&x, Increment::none(), force)
            };
            energy(&nodes, &mut force);
            let mut wrench = vec![[0.0; 6]; binding.bones.len()];
            nodes.gather(&binding, &role, Role::Bound, &force, &mut wrench);
            let mut torque = vec![0.0; count];
            joints.collect(&wrench, &mut torque);
            let largest = torque.iter().fold(0.0f64, |m, t| m.max(t.abs()));
            let mut other = force.clone();
            for (i, torque) in torque.iter().enumerate() {
                let mut side = |h: f64| {
                    let mut increment = vec![0.0; count];
                    increment[i] = h;
                    take(&increment, &mut nodes, &mut joints);
                    energy(&nodes, &mut other)
                };
                let difference = (side(1e-5) - side(-1e-5)) / 2e-5;
                // the energy of hexahedra is that of the mean rotation: its force leaves out what is singular
                let allowed = if tets { 1e-6 } else { 2e-3 };
                assert!((difference - torque).abs() < allowed * largest, "{tets} {i}: {difference} {torque} {largest}");
            }
            assert!(largest > 1e-3 && count > 30, "{largest} {count}");
        }
    }
}
