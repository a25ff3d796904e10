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

    /// The same entries, those of fine nodes in `held` without weight; and which coarse nodes the others then leave out. These have
    /// no weight either.
    pub(super) fn masked(mut self, held: &[bool], marking: Marking) -> (Self, Vec<bool>) {
        let free: Vec<u32> = (0..held.len() as u32).filter(|i| !held[*i as usize]).collect();
        let seen = match marking {
            Marking::EmptyColumns => self.seen(&free),
            Marking::Greedy => self.matched(&free),
        };
        let mut left_out = vec![true; self.coarse_count];
        seen.iter().for_each(|c| left_out[*c as usize] = false);
        for (i, held) in held.iter().enumerate() {
            for k in self.row(i) {
                if *held || left_out[self.column[k] as usize] {
                    self.weight[k] = 0.0;
                }
            }
        }
        (self, left_out)
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

/// An [`Interpolation`] as cycles use it, in f32.
#[derive(Debug, Default)]
pub(super) struct Weights {
    pub start: Vec<u32>,
    pub column: Vec<u32>,
    pub weight: Vec<f32>,
}

impl Weights {
    pub fn row_count(&self) -> usize {
        self.start.len().saturating_sub(1)
    }

    #[inline(always)]
    pub fn row(&self, i: usize) -> std::ops::Range<usize> {
        self.start[i] as usize..self.start[i + 1] as usize
    }
}

impl From<&Interpolation> for Weights {
    fn from(p: &Interpolation) -> Self {
        let weight = p.weight.iter().map(|w| *w as f32).collect();
        Self { start: p.start.clone(), column: p.column.clone(), weight }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    fn random(fine: usize, coarse: usize, seed: &mut u32) -> Interpolation {
        let mut next = move || {
            *seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            *seed >> 8
        };
        let mut p = Interpolation { coarse_count: coarse, start: vec![0], ..Interpolation::default() };
        for _ in 0..fine {
            let columns: BTreeSet<u32> = (0..1 + next() % 5).map(|_| next() % coarse as u32).collect();
            for c in columns {
                p.column.push(c);
                // few different weights, so that there are ties
                p.weight.push([0.125, 0.25, 0.5, 1.0, 0.0][(next() % 5) as usize]);
            }
            p.start.push(p.column.len() as u32);
        }
        p
    }

    /// The rule of Georgii 2010 §3.2 word by word: a set for each coarse node, the largest weight taken out of all sets.
    fn greedy(p: &Interpolation, kept: &[u32]) -> Vec<u32> {
        let mut sets: Vec<Vec<(u32, f64)>> = vec![Vec::new(); p.coarse_count];
        for &i in kept {
            for k in p.row(i as usize).filter(|k| p.weight[*k] != 0.0) {
                sets[p.column[k] as usize].push((i, p.weight[k]));
            }
        }
        let mut matched = Vec::new();
        for c in 0..p.coarse_count {
            let Some(largest) = sets[c].iter().map(|e| e.1).max_by(f64::total_cmp) else { continue };
            let taken = sets[c].iter().filter(|e| e.1 == largest).map(|e| e.0).min().unwrap();
            sets.iter_mut().for_each(|s| s.retain(|e| e.0 != taken));
            matched.push(c as u32);
        }
        matched
    }

    #[test]
    fn greedy_marking_is_the_rule_word_by_word() {
        let mut seed = 1;
        let mut fewer = 0;
        for case in 0..400 {
            let (fine, coarse) = (5 + case % 40, 2 + case % 17);
            let p = random(fine, coarse, &mut seed);
            let kept: Vec<u32> = (0..fine as u32).filter(|i| !(i * 7 + case as u32).is_multiple_of(5)).collect();
            let (restricted, matched) = p.restricted(&kept, Marking::Greedy);
            assert_eq!(matched, greedy(&p, &kept));
            assert_eq!((restricted.fine_count(), restricted.coarse_count), (kept.len(), matched.len()));
            // what is kept is seen, and no more coarse nodes than fine ones are
            let (_, seen) = p.restricted(&kept, Marking::EmptyColumns);
            assert!(matched.iter().all(|c| seen.contains(c)) && matched.len() <= kept.len());
            fewer += usize::from(matched.len() < seen.len());
        }
        assert!(fewer > 50, "only {fewer} cases had anything to mark");
    }
}
