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

    /// Most cells around one edge of a node.
    fn most_around(&self, node: usize) -> usize {
        let mut blocks: Vec<u16> = self.corners(node).flat_map(|c| c.block).collect();
        blocks.sort_unstable();
        blocks.chunk_by(|a, b| a == b).map(<[u16]>::len).max().unwrap_or(0)
    }
}

/// Cells of a group: they are turned together.
pub(super) const GROUP: usize = 8;
/// Most groups of a strip.
pub(super) const GROUPS: usize = 160;
/// Most nodes of a strip.
pub(super) const NODES: usize = 128;
/// Most edges of a strip.
pub(super) const EDGES: usize = 2048;

/// The tetrahedra around each edge, for nodes taken strip by strip: the cells that meet at the nodes of a strip are few enough to be
/// turned on the stack and read from there, edge by edge. Keeping what all cells turn into would take as much memory as everything
/// else of a cell, and turning the cells of each node anew half as long again as the rest of the assembly.
///
/// The edges of a strip are those from its nodes, ascending, to the other nodes of their rows, ascending; an edge between two nodes of
/// the strip is that of the first of them.
#[derive(Clone, Debug)]
pub(super) struct Strips {
    /// First node of each strip, and one past the last.
    node: Vec<u32>,
    /// First group of cells, first edge and first cell around an edge of each strip, and one past the last.
    start: Vec<[u32; 3]>,
    /// Groups of cells.
    group: Vec<u32>,
    /// How many cells are around each edge.
    around: Vec<u8>,
    /// These: cell, counted in the groups of the strip, and its corners at both ends of the edge: (cell * 4 + corner) * 4 + corner.
    corners: Vec<u16>,
    /// Nodes that are a strip each and have none of the above, ascending: those with more than [`GROUPS`] groups, more than [`EDGES`] edges,
    /// or one with more cells around it than [`Self::around`] counts.
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

fn group_of(slot: u32) -> u32 {
    slot / (4 * GROUP as u32)
}

impl Strips {
    pub(super) fn new(incidence: &Incidence<4>, pattern: &BlockPattern) -> Self {
        let nodes = pattern.row_count();
        let mut out = Self {
            node: vec![0],
            start: vec![[0; 3]],
            group: Vec::new(),
            around: Vec::new(),
            corners: Vec::with_capacity(incidence.slot.len() * 2),
            crowded: Vec::new(),
        };
        let (mut here, mut more): (Vec<u32>, Vec<u32>) = (Vec::new(), Vec::new());
        let mut n = 0;
        while n < nodes {
            let first = n;
            let (mut crowded, mut edges) = (false, 0);
            here.clear();
            while n < nodes && n < first + NODES && !crowded {
                more.clone_from(&here);
                more.extend(incidence.at(n).0.iter().map(|slot| group_of(*slot)));
                more.sort_unstable();
                more.dedup();
                edges += pattern.row(n).len();
                let fits = more.len() <= GROUPS && edges <= EDGES && incidence.most_around(n) <= usize::from(u8::MAX);
                if !fits && n > first {
                    break;
                }
                crowded = !fits;
                std::mem::swap(&mut here, &mut more);
                n += 1;
            }
            if crowded {
                out.crowded.push((first as u32, incidence.corners(first).collect()));
            } else if !here.is_empty() {
                out.add_edges(incidence, pattern, first..n, &here);
                out.group.extend_from_slice(&here);
            }
            out.start.push([out.group.len(), out.around.len(), out.corners.len()].map(|len| len as u32));
            out.node.push(n as u32);
        }
        let Self { node, start, group, around, corners, .. } = &mut out;
        [node, group].into_iter().for_each(Vec::shrink_to_fit);
        start.shrink_to_fit();
        around.shrink_to_fit();
        corners.shrink_to_fit();
        out
    }

    /// The edges of a strip whose cells are in these groups.
    fn add_edges(&mut self, incidence: &Incidence<4>, pattern: &BlockPattern, strip: Range<usize>, groups: &[u32]) {
        let size = 4 * GROUP as u32;
        for node in strip.clone() {
            let row = pattern.row(node);
            for (k, column) in pattern.column()[row].iter().enumerate() {
                if (strip.start..=node).contains(&(*column as usize)) {
                    continue;
                }
                let before = self.corners.len();
                for corner in incidence.corners(node) {
                    let Some(turn) = corner.block.iter().position(|b| usize::from(*b) == k) else { continue };
                    let at = groups.partition_point(|g| *g < group_of(corner.slot)) as u32;
                    let own = at * size + corner.slot % size;
                    self.corners.push((own * 4 + (own + 1 + turn as u32) % 4) as u16);
                }
                self.around.push((self.corners.len() - before) as u8);
            }
        }
    }

    pub(super) fn count(&self) -> usize {
        self.node.len() - 1
    }

    /// Its nodes.
    #[inline(always)]
    pub(super) fn nodes(&self, strip: usize) -> Range<usize> {
        self.node[strip] as usize..self.node[strip + 1] as usize
    }

    /// Its groups of cells, and of each of its edges how many cells are around it, and all these. Empty for a crowded node, and
    /// for nodes without tetrahedra.
    #[inline(always)]
    pub(super) fn edges(&self, strip: usize) -> (&[u32], &[u8], &[u16]) {
        let ([a, b, c], [d, e, f]) = (self.start[strip], self.start[strip + 1]);
        let range = |a: u32, b: u32| a as usize..b as usize;
        (&self.group[range(a, d)], &self.around[range(b, e)], &self.corners[range(c, f)])
    }

    /// The corners at a crowded node; none at others.
    #[inline(never)]
    pub(super) fn crowded(&self, node: usize) -> &[Corner] {
        let found = self.crowded.binary_search_by_key(&(node as u32), |c| c.0);
        found.map_or(&[], |i| &self.crowded[i].1)
    }
}
