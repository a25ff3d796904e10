//! How nodes move with bones, and bones with the unknowns of a skeleton: x' = G ξ per node, ξ = H q' per bone.
//!
//! A bone's twist ξ is its angular velocity and its velocity at its joint, in world axes; a wrench is the torque about the joint and
//! the force. Free nodes have a G as well: that of blended skinning, the best guess of how flesh follows.

use super::binding::Binding;
use super::blend::{BoneMotion, blend_derivative, blend_point};
use crate::rig::{Articulation, Column, Pose, Skeleton};
use glam::{DMat3, DQuat, DVec3};
use rayon::prelude::*;
use softrig_linalg::{BlockCsr, Scalar};

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
    entries: Vec<[f64; 18]>,
    /// Where blended skinning has each node [m].
    pub placed: Vec<[f64; 3]>,
    /// Place of each bone's joint.
    pub origin: Vec<DVec3>,
    /// Rotation of each bone since rest.
    pub rotation: Vec<DMat3>,
    partial: Vec<[f64; 6]>,
}

impl NodeJacobian {
    /// Takes a pose.
    pub fn set(&mut self, binding: &Binding, motions: &[BoneMotion], pose: &Pose, rest: &[[f64; 3]]) {
        self.origin.clear();
        self.origin.extend(binding.bones.iter().map(|b| DVec3::from(pose.joint(b.joint).translation)));
        self.rotation.clear();
        self.rotation.extend(motions.iter().map(|m| DMat3::from_quat(DQuat::from_array(m.rotation()))));
        self.entries.resize(binding.entry.len(), [0.0; 18]);
        self.placed.resize(rest.len(), [0.0; 3]);
        let origin = &self.origin;
        // each task owns the entries of its nodes
        let mut tasks = Vec::with_capacity(rest.len().div_ceil(CHUNK));
        let (mut entries, mut placed) = (&mut self.entries[..], &mut self.placed[..]);
        for first in (0..rest.len()).step_by(CHUNK) {
            let last = (first + CHUNK).min(rest.len());
            let (e, e_after) = entries.split_at_mut((binding.start[last] - binding.start[first]) as usize);
            let (p, p_after) = placed.split_at_mut(last - first);
            tasks.push((first, e, p));
            (entries, placed) = (e_after, p_after);
        }
        tasks.into_par_iter().for_each(|(first, mut entries, placed)| {
            for (k, place) in placed.iter_mut().enumerate() {
                let (weights, p) = (binding.blend(first + k), rest[first + k]);
                let (own, after) = std::mem::take(&mut entries).split_at_mut(weights.len());
                entries = after;
                *place = blend_point(motions, weights, p);
                blend_derivative(motions, weights, p, origin, own);
            }
        });
    }

    fn of(&self, binding: &Binding, n: usize) -> impl Iterator<Item = (usize, &[f64; 18])> {
        let range = binding.start[n] as usize..binding.start[n + 1] as usize;
        binding.entry[range.clone()].iter().map(|e| e.0 as usize).zip(&self.entries[range])
    }

    /// `y = G ξ` at the nodes with that role; others stay as they are.
    pub fn spread(&self, binding: &Binding, role: &[Role], which: Role, twist: &[[f64; 6]], y: &mut [[f64; 3]]) {
        self.each_moved(binding, role, which, twist, y, |y, moved| *y = moved);
    }

    /// `y += G ξ` at the nodes with that role; others stay as they are.
    pub fn spread_add(&self, binding: &Binding, role: &[Role], which: Role, twist: &[[f64; 6]], y: &mut [[f64; 3]]) {
        self.each_moved(binding, role, which, twist, y, |y, moved| (0..3).for_each(|r| y[r] += moved[r]));
    }

    /// Hands each node with that role its entry of `y` and its part of `G ξ`.
    fn each_moved(
        &self,
        binding: &Binding,
        role: &[Role],
        which: Role,
        twist: &[[f64; 6]],
        y: &mut [[f64; 3]],
        put: impl Fn(&mut [f64; 3], [f64; 3]) + Sync,
    ) {
        y.par_chunks_mut(CHUNK).enumerate().for_each(|(c, y)| {
            for (k, y) in y.iter_mut().enumerate() {
                let n = c * CHUNK + k;
                if role[n] != which {
                    continue;
                }
                let mut sum = [0.0; 3];
                for (bone, g) in self.of(binding, n) {
                    let t = &twist[bone];
                    for r in 0..3 {
                        let row = &g[6 * r..6 * r + 6];
                        sum[r] += (row[0] * t[0] + row[1] * t[1] + row[2] * t[2])
                            + (row[3] * t[3] + row[4] * t[4] + row[5] * t[5]);
                    }
                }
                put(y, sum);
            }
        });
    }

    /// `wrench = Σ Gᵀ f` over the nodes with that role.
    pub fn gather(&mut self, binding: &Binding, role: &[Role], which: Role, f: &[[f64; 3]], wrench: &mut [[f64; 6]]) {
        let bones = wrench.len();
        let chunks = f.len().div_ceil(CHUNK);
        let mut partial = std::mem::take(&mut self.partial);
        partial.clear();
        partial.resize(chunks * bones, [0.0; 6]);
        partial.par_chunks_mut(bones.max(1)).enumerate().for_each(|(c, sum)| {
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

    /// Σ Gᵀ A G over all bones and nodes, as full rows of 6 numbers per bone, in the bones' own axes: what a skeleton feels
    /// of a system when flesh follows as blended skinning. `shift` is added to the diagonal of A at each node.
    pub fn bone_matrix<R: Scalar>(
        &self,
        binding: &Binding,
        role: &[Role],
        matrix: &BlockCsr<R>,
        shift: &[f64],
        out: &mut Vec<f64>,
    ) {
        let width = 6 * self.origin.len();
        out.clear();
        out.resize(width * width, 0.0);
        let rows = role.len();
        // A G of some rows at a time in parallel, then added up in order
        for first in (0..rows).step_by(32 * CHUNK) {
            let last = (first + 32 * CHUNK).min(rows);
            let images: Vec<Vec<(u32, u32, [f64; 18])>> = (first..last)
                .into_par_iter()
                .step_by(CHUNK)
                .map(|at| {
                    let mut images = Vec::new();
                    for n in (at..(at + CHUNK).min(last)).filter(|n| role[*n] != Role::Held) {
                        self.image_of_row(binding, role, matrix, shift[n], n, &mut images);
                    }
                    images
                })
                .collect();
            for (n, b, image) in images.into_iter().flatten() {
                for (a, g) in self.of(binding, n as usize) {
                    for i in 0..6 {
                        let row = &mut out[(6 * a + i) * width + 6 * b as usize..][..6];
                        for (j, s) in row.iter_mut().enumerate() {
                            *s += g[i] * image[j] + g[6 + i] * image[6 + j] + g[12 + i] * image[12 + j];
                        }
                    }
                }
            }
        }
        self.turn_blocks(out, true);
    }

    /// Adds a spring of that stiffness at a weighted sum of nodes to a bone matrix in world axes.
    pub fn add_spring(&self, binding: &Binding, role: &[Role], nodes: &[(u32, f64)], stiffness: f64, out: &mut [f64]) {
        let width = 6 * self.origin.len();
        let mut of_bone: Vec<(usize, [f64; 18])> = Vec::new();
        for (n, w) in nodes.iter().filter(|(n, _)| role[*n as usize] != Role::Held) {
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

    /// Row `n` of A G: one 3x6 matrix for each bone that its neighbours hang on.
    fn image_of_row<R: Scalar>(
        &self,
        binding: &Binding,
        role: &[Role],
        matrix: &BlockCsr<R>,
        shift: f64,
        n: usize,
        images: &mut Vec<(u32, u32, [f64; 18])>,
    ) {
        let begin = images.len();
        let row = matrix.pattern.row(n);
        for (block, column) in matrix.values[row.clone()].iter().zip(&matrix.pattern.column()[row]) {
            let column = *column as usize;
            if role[column] == Role::Held {
                continue;
            }
            let mut m = block.map(Scalar::to_f64);
            if column == n {
                (0..3).for_each(|k| m[4 * k] += shift);
            }
            for (bone, g) in self.of(binding, column) {
                let at = match images[begin..].iter().position(|i| i.1 as usize == bone) {
                    Some(k) => begin + k,
                    None => {
                        images.push((n as u32, bone as u32, [0.0; 18]));
                        images.len() - 1
                    }
                };
                let image = &mut images[at].2;
                for r in 0..3 {
                    for c in 0..6 {
                        image[6 * r + c] += m[3 * r] * g[c] + m[3 * r + 1] * g[6 + c] + m[3 * r + 2] * g[12 + c];
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
