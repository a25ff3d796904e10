//! Interpolation between the levels of a hierarchy.

use super::settings::Marking;

/// Scalar interpolation weights from a coarse level to the next finer one, applied to each of the three components:
/// compressed rows, one per fine node.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Interpolation {
    /// Number of coarse nodes.
    pub coarse_count: usize,
    /// First entry of each fine node, and one past the last.
    pub start: Vec<u32>,
    /// Coarse node of each entry.
    pub column: Vec<u32>,
    /// Its weight [-].
    pub weight: Vec<f64>,
}

impl Interpolation {
    /// Number of fine nodes.
    #[must_use]
    pub fn fine_count(&self) -> usize {
        self.start.len().saturating_sub(1)
    }

    #[inline(always)]
    pub(super) fn row(&self, i: usize) -> std::ops::Range<usize> {
        self.start[i] as usize..self.start[i + 1] as usize
    }

    /// Only the rows of `kept` fine nodes, and only the coarse nodes these see: eliminated nodes take no part on any level
    /// [Georgii2010 §3.2]. Also returns the coarse nodes kept, ascending.
    pub(super) fn restricted(&self, kept: &[u32], marking: Marking) -> (Self, Vec<u32>) {
        let seen = match marking {
            Marking::EmptyColumns => self.seen(kept),
            Marking::Greedy => self.matched(kept),
        };
        (self.between(kept, &seen), seen)
    }

    /// Only those rows and columns, in that order.
    pub(super) fn between(&self, fine: &[u32], coarse: &[u32]) -> Self {
        let mut new_of_old = vec![u32::MAX; self.coarse_count];
        for (new, old) in coarse.iter().enumerate() {
            new_of_old[*old as usize] = new as u32;
        }
        let mut out = Self { coarse_count: coarse.len(), start: vec![0], ..Self::default() };
        for &i in fine {
            for k in self.row(i as usize) {
                let column = new_of_old[self.column[k] as usize];
                if self.weight[k] != 0.0 && column != u32::MAX {
                    out.column.push(column);
                    out.weight.push(self.weight[k]);
                }
            }
            out.start.push(out.column.len() as u32);
        }
        out
    }

    /// Coarse nodes that one of the `kept` fine nodes interpolates from, ascending.
    fn seen(&self, kept: &[u32]) -> Vec<u32> {
        let mut seen = vec![false; self.coarse_count];
        for &i in kept {
            for k in self.row(i as usize).filter(|k| self.weight[*k] != 0.0) {
                seen[self.column[k] as usize] = true;
            }
        }
        (0..self.coarse_count as u32).filter(|c| seen[*c as usize]).collect()
    }

    /// Coarse nodes that find a kept fine node of their own: in ascending order, each takes the one with the largest weight on
    /// it that is still there (the lowest of equals).
    fn matched(&self, kept: &[u32]) -> Vec<u32> {
        let mut there = vec![false; self.fine_count()];
        kept.iter().for_each(|i| there[*i as usize] = true);
        let transposed = self.transposed();
        let mut out = Vec::new();
        for c in 0..self.coarse_count {
            let mut best: Option<(f64, usize)> = None;
            for k in transposed.row(c) {
                let (w, i) = (transposed.weight[k], transposed.column[k] as usize);
                if there[i] && w != 0.0 && best.is_none_or(|(largest, _)| w > largest) {
                    best = Some((w, i));
                }
            }
            if let Some((_, i)) = best {
                there[i] = false;
                out.push(c as u32);
            }
        }
        out
    }

    /// Rows become columns: for every coarse node, the fine nodes that interpolate from it, ascending.
    pub(super) fn transposed(&self) -> Self {
        let mut start = vec![0u32; self.coarse_count + 1];
        for c in &self.column {
            start[*c as usize + 1] += 1;
        }
        for i in 0..self.coarse_count {
            start[i + 1] += start[i];
        }
        let mut at = start.clone();
        let mut column = vec![0; self.column.len()];
        let mut weight = vec![0.0; self.column.len()];
        for i in 0..self.fine_count() {
            for k in self.row(i) {
                let to = &mut at[self.column[k] as usize];
                column[*to as usize] = i as u32;
                weight[*to as usize] = self.weight[k];
                *to += 1;
            }
        }
        Self { coarse_count: self.fine_count(), start, column, weight }
    }
}
