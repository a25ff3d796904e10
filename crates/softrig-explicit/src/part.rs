//! Bodies in parts: consecutive nodes that one task owns, with copies of the nodes around them.
//!
//! A part reads its own nodes and those copies, and writes its own nodes only, so parts run on any number of threads with the
//! same bits. What crosses a border is computed on both sides. Small bodies are one part and cost no thread at all.

use rayon::prelude::*;
use softrig_linalg::Scalar;
use std::ops::Range;

/// Nodes of a part: at some ten nanoseconds a node, less is not worth waking a thread for.
pub(crate) const PART: usize = 896;

/// Nodes of one part. Local numbers: own nodes first, then copies.
#[derive(Clone, Debug)]
pub(crate) struct Part {
    pub own: Range<usize>,
    pub copies: Vec<u32>,
}

impl Part {
    pub fn len(&self) -> usize {
        self.own.len() + self.copies.len()
    }

    /// Local number of a node, when the part has it.
    pub fn local(&self, node: u32) -> Option<u32> {
        let n = node as usize;
        if self.own.contains(&n) {
            return Some((n - self.own.start) as u32);
        }
        self.copies.binary_search(&node).ok().map(|k| (self.own.len() + k) as u32)
    }

    /// Global number of a local one.
    #[inline(always)]
    pub fn global(&self, local: usize) -> usize {
        if local < self.own.len() { self.own.start + local } else { self.copies[local - self.own.len()] as usize }
    }
}

/// Cuts `node_count` nodes into parts; `groups` are sets of nodes that are read together. Returns the parts, and for each the
/// groups that touch one of its own nodes, ascending.
pub(crate) fn parts<const N: usize>(node_count: usize, groups: &[[u32; N]]) -> Vec<(Part, Vec<u32>)> {
    let count = node_count.div_ceil(PART).max(1);
    let size = node_count.div_ceil(count).max(1);
    let mut of: Vec<Vec<u32>> = vec![Vec::new(); count];
    for (i, g) in groups.iter().enumerate() {
        let mut last = usize::MAX;
        let mut owners = g.map(|n| n as usize / size);
        owners.sort_unstable();
        for p in owners {
            if p != last {
                of[p].push(i as u32);
                last = p;
            }
        }
    }
    of.into_iter()
        .enumerate()
        .map(|(p, own_groups)| {
            let own = p * size..((p + 1) * size).min(node_count);
            let mut copies: Vec<u32> =
                own_groups.iter().flat_map(|g| groups[*g as usize]).filter(|n| !own.contains(&(*n as usize))).collect();
            copies.sort_unstable();
            copies.dedup();
            (Part { own, copies }, own_groups)
        })
        .collect()
}

/// Runs every part with its own stretch of `out`; `range` tells a part's own nodes, which must follow one another.
pub(crate) fn run<P: Send, R: Scalar>(
    parts: &mut [P],
    range: impl Fn(&P) -> Range<usize> + Sync,
    out: &mut [[R; 3]],
    work: impl Fn(&mut P, &mut [[R; 3]]) + Sync,
) {
    if let [only] = parts {
        work(only, out);
        return;
    }
    let size = parts.first().map_or(1, |p| range(p).len()).max(1);
    parts.par_iter_mut().zip(out.par_chunks_mut(size)).for_each(|(part, out)| work(part, out));
}
