//! Sparse matrices between nodes and bones in f32, a 3x6 block per entry: how a node moves with the twists of bones, or what
//! force their twists make at it. What an iteration multiplies by many times is kept as small as it can be.

use rayon::prelude::*;
use softrig_linalg::par::Each;

/// Nodes per task, and per partial sum.
const CHUNK: usize = 512;

/// Three rows of six numbers, each filled up to a register's eight.
pub(crate) type Block = [[f32; 8]; 3];

/// A twist or a wrench, filled up to a register's eight numbers.
pub(crate) type Wide6 = [f32; 8];

/// One row of blocks per node.
#[derive(Debug, Default)]
pub(crate) struct BoneRows {
    /// First entry of each node, and one past the last.
    pub start: Vec<u32>,
    pub bone: Vec<u32>,
    pub value: Vec<Block>,
}

/// Partial sums of [`BoneRows::gather`].
#[derive(Debug, Default)]
pub(crate) struct Partial(Vec<Wide6>);

impl BoneRows {
    /// Node `n` of M ξ.
    #[inline]
    pub fn moved(&self, n: usize, twist: &[Wide6]) -> [f32; 3] {
        let mut sum = [[0.0f32; 8]; 3];
        for e in self.start[n] as usize..self.start[n + 1] as usize {
            let (block, t) = (&self.value[e], &twist[self.bone[e] as usize]);
            for r in 0..3 {
                for k in 0..8 {
                    sum[r][k] += block[r][k] * t[k];
                }
            }
        }
        sum.map(|s| ((s[0] + s[4]) + (s[1] + s[5])) + (s[2] + s[3]))
    }

    /// Adds Mᵀ f of node `n` to one wrench per bone.
    #[inline]
    fn add_transposed(&self, n: usize, f: [f32; 3], wrench: &mut [Wide6]) {
        for e in self.start[n] as usize..self.start[n + 1] as usize {
            let (block, w) = (&self.value[e], &mut wrench[self.bone[e] as usize]);
            for k in 0..8 {
                w[k] += (block[0][k] * f[0] + block[1][k] * f[1]) + block[2][k] * f[2];
            }
        }
    }

    /// `wrench = Σ Mᵀ f` over `count` items; `force` says which node an item is, and its force.
    pub fn gather(
        &self,
        count: usize,
        force: impl Fn(usize) -> (usize, [f32; 3]) + Sync,
        partial: &mut Partial,
        wrench: &mut [[f64; 6]],
    ) {
        let bones = wrench.len().max(1);
        let partial = &mut partial.0;
        partial.clear();
        partial.resize(count.div_ceil(CHUNK) * bones, [0.0; 8]);
        partial.par_chunks_mut(bones).enumerate().each(|(c, sum)| {
            for item in c * CHUNK..((c + 1) * CHUNK).min(count) {
                let (n, f) = force(item);
                self.add_transposed(n, f, sum);
            }
        });
        wrench.fill([0.0; 6]);
        for chunk in partial.chunks(bones) {
            for (w, p) in wrench.iter_mut().zip(chunk) {
                (0..6).for_each(|k| w[k] += f64::from(p[k]));
            }
        }
    }
}

/// In f32, filled up.
pub(crate) fn wide6(v: &[f64; 6]) -> Wide6 {
    std::array::from_fn(|k| if k < 6 { v[k] as f32 } else { 0.0 })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// ⟨f, M ξ⟩ = ⟨Mᵀ f, ξ⟩ for any f and ξ.
    #[test]
    fn gathering_is_the_transpose_of_moving() {
        let number = |k: usize| ((k * 2_654_435_761) % 1000) as f32 / 500.0 - 1.0;
        let (nodes, bones) = (1300, 5);
        let mut rows = BoneRows { start: vec![0], ..BoneRows::default() };
        for n in 0..nodes {
            for e in 0..n % 3 {
                rows.bone.push(((n + 2 * e) % bones) as u32);
                rows.value.push(std::array::from_fn(|r| {
                    std::array::from_fn(|k| if k < 6 { number(n * 18 + r * 6 + k + e) } else { 0.0 })
                }));
            }
            rows.start.push(rows.bone.len() as u32);
        }
        let twist: Vec<[f64; 6]> = (0..bones).map(|b| std::array::from_fn(|k| f64::from(number(7 * b + k)))).collect();
        let light: Vec<Wide6> = twist.iter().map(wide6).collect();
        let force = |n: usize| [number(n + 1), number(n + 2), number(n + 3)];
        let mut wrench = vec![[0.0; 6]; bones];
        rows.gather(nodes, |n| (n, force(n)), &mut Partial::default(), &mut wrench);
        let dot = |a: [f32; 3], b: [f32; 3]| (0..3).map(|k| f64::from(a[k]) * f64::from(b[k])).sum::<f64>();
        let one: f64 = (0..nodes).map(|n| dot(force(n), rows.moved(n, &light))).sum();
        let other: f64 = wrench.iter().flatten().zip(twist.iter().flatten()).map(|(a, b)| a * b).sum();
        assert!(one.abs() > 1.0 && (one - other).abs() < 1e-4 * one.abs(), "{one} {other}");
    }
}
