//! Products of operators against dense ones.

use super::super::settings::Marking;
use super::*;
use crate::{BlockPattern, DofConstraints};

/// Coarse blocks against the triple product of dense matrices.
#[test]
fn coarse_operators_are_the_dense_triple_product() {
    for case in 0..6usize {
        let (n, coarse) = (30 + 301 * case, 4 + 3 * case);
        let cells: Vec<[u32; 3]> =
            (0..2 * n as u32).map(|i| [i % n as u32, (i * i + 3) % n as u32, (i * 7 + 1) % n as u32]).collect();
        let pattern = BlockPattern::from_cells(n, cells.iter().map(|c| &c[..]));
        let fine = crate::solver::free::FreePattern::new(
            &pattern,
            &DofConstraints::from_mask((0..n).map(|i| i % 4 == case % 4).collect()),
        )
        .blocks(&pattern);
        let mut p = Interpolation { coarse_count: coarse, start: vec![0], ..Interpolation::default() };
        for i in 0..n {
            for c in 0..1 + i % 3 {
                p.column.push(((i * 5 + c * 11) % coarse) as u32);
                p.weight.push(0.25 + 0.125 * ((i + c) % 5) as f64);
            }
            p.start.push(p.column.len() as u32);
        }
        let (p, _) = p.restricted(&fine.node, Marking::EmptyColumns);
        // symmetric, as systems are
        let number = |a: usize, b: usize| ((a.min(b) * 13 + a.max(b) * 5) as f32).sin();
        let row_of = |k: usize| fine.row_start.partition_point(|s| *s as usize <= k) - 1;
        let block = |k: usize| -> [f32; 9] {
            let (i, j) = (row_of(k), fine.column[k] as usize);
            std::array::from_fn(|e| number(3 * i + e / 3, 3 * j + e % 3))
        };
        // whole strips, or some that end early
        let n = fine.row_count();
        let mut matrix = Sliced::new(&fine, &[0, n as u32]);
        let (mut inverse, mut identity) = (vec![[[0.0; 4]; 3]; n], vec![false; n]);
        // whatever the diagonal blocks are, the numbers are taken
        let _ = matrix.load_blocks(&fine, &|_, k| block(k), &mut inverse, &mut identity);
        let most = [[STRIP, COLUMNS], [300, COLUMNS], [STRIP, 6]][case % 3];
        let mut galerkin = Galerkin::in_strips(&fine, &matrix, &p, most);
        assert!(galerkin.strips.len() > [1, 2, 4][case % 3] || case < 3);
        galerkin.refresh(&fine, &matrix);
        let mut dense = vec![vec![[0.0f64; 9]; p.coarse_count]; p.coarse_count];
        for i in 0..fine.row_count() {
            for k in fine.row(i) {
                for a in p.row(i) {
                    for b in p.row(fine.column[k] as usize) {
                        let to = &mut dense[p.column[a] as usize][p.column[b] as usize];
                        let w = p.weight[a] * p.weight[b];
                        (0..9).for_each(|e| to[e] += w * f64::from(block(k)[e]));
                    }
                }
            }
        }
        let coarse_pattern = galerkin.coarse_pattern((0..p.coarse_count as u32).collect());
        let mut there = vec![vec![false; p.coarse_count]; p.coarse_count];
        for i in 0..p.coarse_count {
            for k in coarse_pattern.row(i) {
                let j = coarse_pattern.column[k] as usize;
                there[i][j] = true;
                for e in 0..9 {
                    let (a, b) = (f64::from(galerkin.coarse_block(i, k)[e]), dense[i][j][e]);
                    assert!((a - b).abs() < 1e-5 * b.abs().max(100.0), "block {i} {j}: {a} {b}");
                }
            }
        }
        let missing = |(i, j): (usize, usize)| !there[i][j] && dense[i][j] != [0.0; 9];
        assert!(!(0..p.coarse_count).flat_map(|i| (0..p.coarse_count).map(move |j| (i, j))).any(missing));
    }
}
