//! The coarse space of the joints: flesh following its bones as far as it does within one step.
//!
//! W has a 3x6 block per node and bone: the derivative of blended skinning times the node's share of [`super::follow`]. What the
//! system makes of it, B = A W at the free nodes and Wᵀ A W, only feeds a preconditioner and may lag behind: both are kept in the
//! bones' own axes, in which they hardly change as the body moves.

use super::binding::Binding;
use super::follow::Following;
use super::jacobian::{NodeJacobian, Role};
use super::rows::{Block, BoneRows};
use rayon::prelude::*;
use softrig_linalg::par::Each;
use softrig_linalg::{BlockCsr, Scalar};

/// Rows per task.
const CHUNK: usize = 1024;

/// W, and what some system before made of it.
#[derive(Debug, Default)]
pub(crate) struct CoarseSpace {
    /// How far each node follows its bones.
    pub share: Vec<f64>,
    /// W in the present pose.
    pub along: BoneRows,
    /// Of each entry of W: its node, and its place among the entries of the binding.
    source: Vec<(u32, u32)>,
    /// B, in the axes of each node's own bone and of the bones.
    pub between: BoneRows,
    /// Wᵀ A W with full rows of 6 numbers per bone, in the bones' axes.
    matrix: Vec<f64>,
    /// The same in world axes.
    pub world: Vec<f64>,
    pieces: Vec<Piece>,
    following: Following,
}

/// What one task finds of A W, in memory that is kept.
#[derive(Debug, Default)]
struct Piece {
    count: Vec<u32>,
    bone: Vec<u32>,
    value: Vec<Block>,
    matrix: Vec<f64>,
    /// A W at one node.
    images: Vec<(u32, [f64; 18])>,
}

impl CoarseSpace {
    /// Does it belong to so many bones?
    pub fn fits(&self, bones: usize) -> bool {
        self.matrix.len() == (6 * bones).pow(2)
    }

    /// Makes everything anew from a system's entries, `shift` added to the diagonal at each node.
    pub fn renew<R: Scalar>(
        &mut self,
        nodes: &NodeJacobian,
        binding: &Binding,
        role: &[Role],
        matrix: &BlockCsr<R>,
        shift: &[f64],
    ) {
        self.following.shares(matrix, role, &mut self.share);
        let along = &mut self.along;
        along.start.clear();
        along.start.push(0);
        along.bone.clear();
        self.source.clear();
        for (n, share) in self.share.iter().enumerate() {
            if *share > 0.0 {
                let entries = binding.start[n]..binding.start[n + 1];
                along.bone.extend(binding.blend(n).iter().map(|e| e.0));
                self.source.extend(entries.map(|e| (n as u32, e)));
            }
            along.start.push(along.bone.len() as u32);
        }
        along.value.resize(along.bone.len(), [[0.0; 8]; 3]);
        self.turn(nodes);
        let width = 6 * nodes.origin.len();
        let images = Images { nodes, binding, role, matrix, shift, share: &self.share };
        let chunks = role.len().div_ceil(CHUNK);
        self.pieces.resize_with(chunks, Piece::default);
        self.pieces.par_iter_mut().enumerate().each(|(c, piece)| {
            images.fill(c * CHUNK..((c + 1) * CHUNK).min(role.len()), width, piece);
        });
        self.matrix.clear();
        self.matrix.resize(width * width, 0.0);
        let between = &mut self.between;
        between.start.clear();
        between.start.push(0);
        between.bone.clear();
        between.value.clear();
        let mut at = 0;
        for piece in &self.pieces {
            self.matrix.iter_mut().zip(&piece.matrix).for_each(|(m, p)| *m += p);
            for count in &piece.count {
                at += count;
                between.start.push(at);
            }
            between.bone.extend_from_slice(&piece.bone);
            between.value.extend_from_slice(&piece.value);
        }
        nodes.turn_blocks(&mut self.matrix, true);
    }

    /// W in the pose of `nodes`.
    pub fn turn(&mut self, nodes: &NodeJacobian) {
        let (share, entries) = (&self.share, &nodes.entries);
        self.along.value.par_chunks_mut(CHUNK).zip(self.source.par_chunks(CHUNK)).each(|(value, source)| {
            for (to, (n, e)) in value.iter_mut().zip(source) {
                let (g, s) = (&entries[*e as usize], share[*n as usize]);
                *to = std::array::from_fn(|r| {
                    std::array::from_fn(|k| if k < 6 { (s * g[6 * r + k]) as f32 } else { 0.0 })
                });
            }
        });
    }

    /// Wᵀ A W in world axes, as of the pose of `nodes`.
    pub fn turn_matrix(&mut self, nodes: &NodeJacobian) {
        self.world.clone_from(&self.matrix);
        nodes.turn_blocks(&mut self.world, false);
    }
}

/// What A W is computed from.
struct Images<'a, R> {
    nodes: &'a NodeJacobian,
    binding: &'a Binding,
    role: &'a [Role],
    matrix: &'a BlockCsr<R>,
    shift: &'a [f64],
    share: &'a [f64],
}

impl<R: Scalar> Images<'_, R> {
    fn entries(&self, n: usize) -> impl Iterator<Item = (u32, &[f64; 18])> {
        let range = self.binding.start[n] as usize..self.binding.start[n + 1] as usize;
        self.binding.entry[range.clone()].iter().map(|e| e.0).zip(&self.nodes.entries[range])
    }

    /// Some rows of A W, and their part of Wᵀ A W.
    fn fill(&self, rows: std::ops::Range<usize>, width: usize, piece: &mut Piece) {
        let Piece { count, bone, value, matrix, images } = piece;
        count.clear();
        bone.clear();
        value.clear();
        matrix.clear();
        matrix.resize(width * width, 0.0);
        for n in rows {
            images.clear();
            if self.role[n] != Role::Held {
                self.row(n, images);
            }
            let own = self.share[n];
            if own > 0.0 {
                for (a, g) in self.entries(n) {
                    for (b, image) in &*images {
                        add_product(own, g, image, matrix, (a as usize, *b as usize, width));
                    }
                }
            }
            if self.role[n] == Role::Free {
                count.push(images.len() as u32);
                for (b, image) in &*images {
                    bone.push(*b);
                    value.push(self.in_own_axes(n, *b as usize, image));
                }
            } else {
                count.push(0);
            }
        }
    }

    /// Row `n` of A W: one 3x6 matrix for each bone that its neighbours follow.
    fn row(&self, n: usize, images: &mut Vec<(u32, [f64; 18])>) {
        let row = self.matrix.pattern.row(n);
        for (block, column) in self.matrix.values[row.clone()].iter().zip(&self.matrix.pattern.column()[row]) {
            let column = *column as usize;
            let share = self.share[column];
            if share == 0.0 {
                continue;
            }
            let mut m = block.map(Scalar::to_f64);
            if column == n {
                (0..3).for_each(|k| m[4 * k] += self.shift[n]);
            }
            m = m.map(|m| m * share);
            for (bone, g) in self.entries(column) {
                let at = images.iter().position(|i| i.0 == bone).unwrap_or_else(|| {
                    images.push((bone, [0.0; 18]));
                    images.len() - 1
                });
                let image = &mut images[at].1;
                for r in 0..3 {
                    for c in 0..6 {
                        image[6 * r + c] += m[3 * r] * g[c] + m[3 * r + 1] * g[6 + c] + m[3 * r + 2] * g[12 + c];
                    }
                }
            }
        }
    }

    /// Forces in the axes of the node's own bone, twists in those of the bone that moves.
    fn in_own_axes(&self, n: usize, bone: usize, image: &[f64; 18]) -> Block {
        let left = self.nodes.rotation[self.binding.owner[n] as usize].transpose();
        let right = self.nodes.rotation[bone];
        let mut out = [[0.0f32; 8]; 3];
        for half in 0..2 {
            let mut m = glam::DMat3::ZERO;
            for r in 0..3 {
                (0..3).for_each(|c| m.col_mut(c)[r] = image[6 * r + 3 * half + c]);
            }
            let m = left * m * right;
            for r in 0..3 {
                (0..3).for_each(|c| out[r][3 * half + c] = m.col(c)[r] as f32);
            }
        }
        out
    }
}

/// Adds `factor` gᵀ image to the block of two bones.
fn add_product(factor: f64, g: &[f64; 18], image: &[f64; 18], out: &mut [f64], (a, b, width): (usize, usize, usize)) {
    for i in 0..6 {
        let row = &mut out[(6 * a + i) * width + 6 * b..][..6];
        for (j, s) in row.iter_mut().enumerate() {
            *s += factor * (g[i] * image[j] + g[6 + i] * image[6 + j] + g[12 + i] * image[12 + j]);
        }
    }
}
