//! Which cells meet at a node, and where their blocks are in its row.

use softrig_linalg::BlockPattern;
use std::ops::Range;

/// The corners of cells that meet at each node, for cells of `N` corners.
#[derive(Clone, Debug)]
pub(super) struct Incidence<const N: usize> {
    start: Vec<u32>,
    /// cell * N + corner, ascending at each node.
    slot: Vec<u32>,
    /// Where the blocks (node, corner b of the cell) are, counted from the start of the node's row.
    block: Vec<[u16; N]>,
}

impl<const N: usize> Incidence<N> {
    pub(super) fn new(node_count: usize, cells: &[[u32; N]], pattern: &BlockPattern) -> Self {
        let mut start = vec![0u32; node_count + 1];
        for n in cells.iter().flatten() {
            start[*n as usize + 1] += 1;
        }
        for i in 0..node_count {
            start[i + 1] += start[i];
        }
        let mut next = start.clone();
        let mut slot = vec![0; cells.len() * N];
        for (k, n) in cells.iter().flatten().enumerate() {
            let at = &mut next[*n as usize];
            slot[*at as usize] = k as u32;
            *at += 1;
        }
        let mut block = Vec::with_capacity(slot.len());
        for i in 0..node_count {
            for &s in &slot[start[i] as usize..start[i + 1] as usize] {
                block.push(cells[s as usize / N].map(|n| {
                    let at = pattern.find(i, n as usize).expect("the pattern was made from these cells");
                    u16::try_from(at - pattern.row(i).start).expect("a body has no longer rows")
                }));
            }
        }
        Self { start, slot, block }
    }

    /// Slots, cell * N + corner, and blocks of a node.
    #[inline(always)]
    pub(super) fn at(&self, node: usize) -> (&[u32], &[[u16; N]]) {
        let range = self.range(node);
        (&self.slot[range.clone()], &self.block[range])
    }

    #[inline(always)]
    fn range(&self, node: usize) -> Range<usize> {
        self.start[node] as usize..self.start[node + 1] as usize
    }
}

impl Incidence<4> {
    /// The corners at a node, with the blocks of the others.
    fn corners(&self, node: usize) -> impl Iterator<Item = Corner> + '_ {
        let (slots, blocks) = self.at(node);
        slots.iter().zip(blocks).map(|(slot, block)| {
            let own = *slot as usize % 4;
            Corner { slot: *slot, block: std::array::from_fn(|k| block[(own + 1 + k) % 4]) }
        })
    }
}

/// Cells of a group: they are turned together.
pub(super) const GROUP: usize = 8;
/// Most groups of a strip.
pub(super) const GROUPS: usize = 160;
/// Most nodes of a strip.
const NODES: usize = 128;

/// The tetrahedra at each node, for nodes taken strip by strip: the cells that meet at the nodes of a strip are few enough to be
/// turned on the stack and read from there, node by node. Keeping what all cells turn into would take as much memory as everything
/// else of a cell, and turning the cells of each node anew half as long again as the rest of the assembly.
#[derive(Clone, Debug)]
pub(super) struct Strips {
    /// First node of each strip, and one past the last.
    node: Vec<u32>,
    /// Groups of cells of each strip: first of them, and one past the last; which.
    start: Vec<u32>,
    group: Vec<u32>,
    /// Incidence of each node: first of it, and one past the last; slots, counted in the groups of the strip; and blocks.
    first: Vec<u32>,
    slot: Vec<u16>,
    block: Vec<[u8; 3]>,
    /// Nodes that are a strip each and have none of the above, ascending: those with more than [`GROUPS`] groups, or with a row that
    /// [`Self::block`] cannot count.
    crowded: Vec<(u32, Vec<Corner>)>,
}

/// A corner of a cell at a crowded node.
#[derive(Clone, Copy, Debug)]
pub(super) struct Corner {
    /// cell * 4 + corner
    pub slot: u32,
    /// Where the blocks of the three corners after this one, taken round, are in the row of the node.
    pub block: [u16; 3],
}

impl Strips {
    pub(super) fn new(incidence: &Incidence<4>) -> Self {
        let nodes = incidence.start.len() - 1;
        let mut out = Self {
            node: vec![0],
            start: vec![0],
            group: Vec::new(),
            first: Vec::with_capacity(nodes + 1),
            slot: Vec::with_capacity(incidence.slot.len()),
            block: Vec::with_capacity(incidence.slot.len()),
            crowded: Vec::new(),
        };
        out.first.push(0);
        let group_of = |slot: &u32| *slot / (4 * GROUP as u32);
        let is_long = |n: usize| incidence.at(n).1.iter().flatten().any(|b| *b > u16::from(u8::MAX));
        let (mut here, mut more): (Vec<u32>, Vec<u32>) = (Vec::new(), Vec::new());
        let mut n = 0;
        while n < nodes {
            let first = n;
            let mut crowded = false;
            here.clear();
            while n < nodes && n < first + NODES && !crowded {
                more.clone_from(&here);
                more.extend(incidence.at(n).0.iter().map(group_of));
                more.sort_unstable();
                more.dedup();
                let fits = more.len() <= GROUPS && !is_long(n);
                if !fits && n > first {
                    break;
                }
                crowded = !fits;
                std::mem::swap(&mut here, &mut more);
                n += 1;
            }
            if crowded {
                out.crowded.push((first as u32, incidence.corners(first).collect()));
                out.first.push(out.slot.len() as u32);
            } else {
                for node in first..n {
                    for Corner { slot, block } in incidence.corners(node) {
                        let at = here.partition_point(|g| *g < group_of(&slot));
                        out.slot.push((at * 4 * GROUP) as u16 + (slot % (4 * GROUP as u32)) as u16);
                        out.block.push(block.map(|b| b as u8));
                    }
                    out.first.push(out.slot.len() as u32);
                }
                out.group.extend_from_slice(&here);
            }
            out.start.push(out.group.len() as u32);
            out.node.push(n as u32);
        }
        out.group.shrink_to_fit();
        out.start.shrink_to_fit();
        out.node.shrink_to_fit();
        out
    }

    pub(super) fn count(&self) -> usize {
        self.node.len() - 1
    }

    /// Its nodes.
    #[inline(always)]
    pub(super) fn nodes(&self, strip: usize) -> Range<usize> {
        self.node[strip] as usize..self.node[strip + 1] as usize
    }

    /// Its groups of cells, or the corners at its only node.
    #[inline(always)]
    pub(super) fn cells(&self, strip: usize) -> Cells<'_> {
        let groups = &self.group[self.start[strip] as usize..self.start[strip + 1] as usize];
        if groups.is_empty() { Cells::Crowded(self.corners(self.node[strip])) } else { Cells::Groups(groups) }
    }

    /// The corners at a crowded node; none at others.
    #[inline(never)]
    fn corners(&self, node: u32) -> &[Corner] {
        let found = self.crowded.binary_search_by_key(&node, |c| c.0);
        found.map_or(&[], |i| &self.crowded[i].1)
    }

    /// Slots, counted in the groups of the strip, and blocks of a node: those of the three corners after its own, taken round.
    #[inline(always)]
    pub(super) fn at(&self, node: usize) -> (&[u16], &[[u8; 3]]) {
        let range = self.first[node] as usize..self.first[node + 1] as usize;
        (&self.slot[range.clone()], &self.block[range])
    }
}

/// The cells of a strip.
pub(super) enum Cells<'a> {
    Groups(&'a [u32]),
    Crowded(&'a [Corner]),
}
