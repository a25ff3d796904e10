//! Sums over the corners of cells at nodes, chunk by chunk of the cells.
//!
//! The cells of a chunk add to *parts*, one for each node of the chunk, which lie together in the cache; a node then adds up its
//! parts, few as they are, in the order of the chunks. No two threads write the same number and every sum has a fixed order, so
//! results are bitwise equal for any thread count.

use crate::{Scalar, Wide, par};

/// Cells of a chunk.
pub const CELLS: usize = 256;

/// Where the corners of cells of `N` corners add to.
#[derive(Clone, Debug)]
pub struct Scatter<const N: usize> {
    /// Part of each corner, counted from the first of its chunk.
    local: Vec<[u16; N]>,
    /// First part of each chunk, and one past the last.
    first: Vec<u32>,
    /// Parts of each node: first of them, and one past the last; which.
    start: Vec<u32>,
    part: Vec<u32>,
    /// Node of each part.
    node: Vec<u32>,
}

impl<const N: usize> Scatter<N> {
    /// For so many nodes, and the nodes of each cell; corners at nodes beyond them are added nowhere.
    #[must_use]
    pub fn new(node_count: usize, cells: &[[u32; N]]) -> Self {
        let nowhere = node_count as u32;
        let mut out =
            Self { local: Vec::with_capacity(cells.len()), first: vec![0], start: vec![], part: vec![], node: vec![] };
        for chunk in cells.chunks(CELLS) {
            let mut here: Vec<u32> = chunk.iter().flatten().map(|n| (*n).min(nowhere)).collect();
            here.sort_unstable();
            here.dedup();
            let at = |n: u32| here.partition_point(|other| *other < n.min(nowhere)) as u16;
            out.local.extend(chunk.iter().map(|corners| corners.map(at)));
            out.node.extend(here);
            out.first.push(out.node.len() as u32);
        }
        out.start = vec![0; node_count + 2];
        for n in &out.node {
            out.start[*n as usize + 1] += 1;
        }
        for i in 0..=node_count {
            out.start[i + 1] += out.start[i];
        }
        let mut next = out.start.clone();
        out.part = vec![0; out.node.len()];
        for (k, n) in out.node.iter().enumerate() {
            let at = &mut next[*n as usize];
            out.part[*at as usize] = k as u32;
            *at += 1;
        }
        out.part.truncate(out.start[node_count] as usize);
        out.part.shrink_to_fit();
        out.node.shrink_to_fit();
        out.start.truncate(node_count + 1);
        out
    }

    /// How many parts there are.
    #[must_use]
    pub fn part_count(&self) -> usize {
        self.first[self.first.len() - 1] as usize
    }

    /// How many cells there are.
    #[must_use]
    pub fn cell_count(&self) -> usize {
        self.local.len()
    }

    /// The place of each corner of a chunk's cells among its parts.
    #[inline(always)]
    #[must_use]
    pub fn local(&self, chunk: usize) -> &[[u16; N]] {
        par::chunk(&self.local, chunk, CELLS)
    }

    /// The node of each part of a chunk; beyond the last node for corners that are added nowhere.
    #[inline(always)]
    #[must_use]
    pub fn nodes(&self, chunk: usize) -> &[u32] {
        &self.node[self.first[chunk] as usize..self.first[chunk + 1] as usize]
    }

    /// The parts of a node.
    #[inline(always)]
    #[must_use]
    pub fn parts(&self, node: usize) -> &[u32] {
        &self.part[self.start[node] as usize..self.start[node + 1] as usize]
    }

    /// Hands each chunk to `work`, on all threads: its number, the place of each corner of its cells among its parts, and these, which
    /// are what the last call left.
    ///
    /// # Panics
    /// When there are not [`Self::part_count`] parts.
    pub fn for_chunks<T: Send>(&self, parts: &mut [T], work: impl Fn(usize, &[[u16; N]], &mut [T]) + Sync) {
        let none: &mut [()] = &mut [];
        self.for_chunks_beside(parts, none, 0, |c, parts, _| work(c, self.local(c), parts));
    }

    /// As [`Self::for_chunks`], and beside the parts of a chunk what its cells have in `beside`, `size` items for each chunk.
    ///
    /// # Panics
    /// When there are not [`Self::part_count`] parts.
    pub fn for_chunks_beside<T: Send, U: Send>(
        &self,
        parts: &mut [T],
        beside: &mut [U],
        size: usize,
        work: impl Fn(usize, &mut [T], &mut [U]) + Sync,
    ) {
        assert_eq!(parts.len(), self.part_count());
        let (start, most) = (|c: usize| self.first[c] as usize, beside.len());
        let both = (&start, &|c: usize| (c * size).min(most));
        par::divide_both(0..self.first.len() - 1, 1, both, (parts, beside), &|chunks, parts, beside| {
            for c in chunks {
                work(c, &mut *parts, &mut *beside);
            }
        });
    }

    /// What a sum reads of it [bytes].
    #[must_use]
    pub fn bytes(&self) -> usize {
        size_of_val(&self.local[..]) + size_of_val(&self.start[..]) + size_of_val(&self.part[..])
    }
}

/// Adds to the parts at one corner of four cells, number by number: `numbers[i][l]` is the `i`th of cell `l`. `local` begins at the first
/// of these cells; what is beyond its end is added nowhere.
#[inline(always)]
pub fn add_four<A: Scalar, const N: usize>(
    numbers: [&[A; 4]; 4],
    local: &[[u16; N]],
    corner: usize,
    parts: &mut [[A; 4]],
) {
    let quads = A::transposed(numbers);
    for (l, at) in local.iter().take(4).enumerate() {
        let to = &mut parts[at[corner] as usize];
        *to = (Wide(*to) + Wide(quads[l])).0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every corner counts once at its node, those of nodes that are not there nowhere.
    #[test]
    fn sums_are_those_of_a_plain_loop() {
        let nodes = 700;
        let cells: Vec<[u32; 4]> =
            (0..1000u32).map(|i| std::array::from_fn(|a| (i / 2 + 37 * a as u32 * (i % 3)) % 750)).collect();
        let value = |cell: usize, a: usize| (cell * 4 + a) as u64;
        let mut plain = vec![0; nodes];
        for (i, cell) in cells.iter().enumerate() {
            for (a, n) in cell.iter().enumerate().filter(|(_, n)| (**n as usize) < nodes) {
                plain[*n as usize] += value(i, a);
            }
        }
        let scatter = Scatter::new(nodes, &cells);
        let mut parts = vec![9; scatter.part_count()];
        scatter.for_chunks(&mut parts, |c, local, parts: &mut [u64]| {
            parts.fill(0);
            for (i, at) in local.iter().enumerate() {
                (0..4).for_each(|a| parts[at[a] as usize] += value(c * CELLS + i, a));
            }
        });
        let sums: Vec<u64> = (0..nodes).map(|n| scatter.parts(n).iter().map(|p| parts[*p as usize]).sum()).collect();
        assert_eq!(sums, plain);
        // the parts of a chunk are those of the nodes of its cells
        for (c, chunk) in cells.chunks(CELLS).enumerate() {
            for (cell, at) in chunk.iter().zip(scatter.local(c)) {
                assert!((0..4).all(|a| scatter.nodes(c)[at[a] as usize] == cell[a].min(nodes as u32)));
            }
        }
        assert!(scatter.part_count() < 4000, "corners of a chunk share their nodes");
    }
}
