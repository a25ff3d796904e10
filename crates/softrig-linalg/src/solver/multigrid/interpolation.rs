//! Interpolation between the levels of a hierarchy.

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
    pub(super) fn restricted(&self, kept: &[u32]) -> (Self, Vec<u32>) {
        let mut new_of_old = vec![u32::MAX; self.coarse_count];
        for &i in kept {
            for k in self.row(i as usize) {
                if self.weight[k] != 0.0 {
                    new_of_old[self.column[k] as usize] = 0;
                }
            }
        }
        let seen: Vec<u32> = (0..self.coarse_count as u32).filter(|c| new_of_old[*c as usize] == 0).collect();
        for (new, old) in seen.iter().enumerate() {
            new_of_old[*old as usize] = new as u32;
        }
        let mut out = Self { coarse_count: seen.len(), start: vec![0], ..Self::default() };
        for &i in kept {
            for k in self.row(i as usize).filter(|k| self.weight[*k] != 0.0) {
                out.column.push(new_of_old[self.column[k] as usize]);
                out.weight.push(self.weight[k]);
            }
            out.start.push(out.column.len() as u32);
        }
        (out, seen)
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
