//! Colours for Gauss-Seidel: rows of one colour have no block in common, so that their order does not matter.

use crate::solver::free::Blocks;

/// An order of the rows in which those of one colour are neighbours, and the first row of each colour and one past the last.
/// Every row takes the first colour that none of its neighbours has.
pub(super) fn by_colour(pattern: &Blocks) -> (Vec<u32>, Vec<u32>) {
    let rows = pattern.row_count();
    let mut colour = vec![u32::MAX; rows];
    let mut taken: Vec<usize> = Vec::new();
    let mut count: Vec<u32> = Vec::new();
    for i in 0..rows {
        for k in pattern.row(i) {
            if let Some(slot) = taken.get_mut(colour[pattern.column[k] as usize] as usize) {
                *slot = i + 1;
            }
        }
        let free = taken.iter().position(|t| *t != i + 1).unwrap_or_else(|| {
            taken.push(0);
            count.push(0);
            taken.len() - 1
        });
        colour[i] = free as u32;
        count[free] += 1;
    }
    let mut start = vec![0u32];
    for c in &count {
        start.push(start[start.len() - 1] + c);
    }
    let mut order: Vec<u32> = (0..rows as u32).collect();
    // stable: rows of a colour stay in order
    order.sort_by_key(|i| colour[*i as usize]);
    (order, start)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::solver::free::FreePattern;
    use crate::{BlockPattern, DofConstraints};

    #[test]
    fn rows_of_a_colour_have_no_block_in_common() {
        let cells: Vec<[u32; 3]> = (0..40).map(|i| [i, (i * 7 + 3) % 41, (i * 5 + 1) % 43]).collect();
        let pattern = BlockPattern::from_cells(43, cells.iter().map(|c| &c[..]));
        let free = FreePattern::new(&pattern, &DofConstraints::none(43)).blocks(&pattern);
        let (order, start) = by_colour(&free);
        let mut seen = order.clone();
        seen.sort_unstable();
        assert_eq!(seen, (0..43).collect::<Vec<u32>>());
        assert!(start.len() > 2 && start[start.len() - 1] == 43);
        for c in start.windows(2) {
            let same = &order[c[0] as usize..c[1] as usize];
            for i in same {
                for k in free.row(*i as usize) {
                    assert!(free.column[k] == *i || !same.contains(&free.column[k]));
                }
            }
        }
    }
}
