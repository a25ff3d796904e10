use super::*;
use crate::solver::free::FreePattern;
use crate::{BlockPattern, DofConstraints};

fn pattern(nodes: u32, mask: Vec<bool>) -> Blocks {
    let cells: Vec<[u32; 4]> =
        (0..3 * nodes).map(|i| [i % nodes, (i * i + 1) % nodes, (i * 13 + 5) % nodes, (i + 1) % nodes]).collect();
    let whole = BlockPattern::from_cells(nodes as usize, cells.iter().map(|c| &c[..]));
    FreePattern::new(&whole, &DofConstraints::from_mask(mask)).blocks(&whole)
}

struct Store<'a, A>(&'a mut [[A; 4]]);
impl<A> RowWork<A> for Store<'_, A> {
    fn row(&mut self, row: usize, product: Wide<A, 4>) {
        self.0[row] = product.0;
    }
}

fn block<A: Scalar>(free: &Blocks, k: usize) -> [A; 9] {
    let diagonal = free.diagonal.contains(&(k as u32));
    std::array::from_fn(|i| {
        A::from_f64(((k * 31 + i * 7) as f64).sin() + if diagonal && i % 4 == 0 { 9.0 } else { 0.0 })
    })
}

/// Rows of the product against a plain loop in f64, for rows of many lengths, and chunks that are not full.
fn product_is_right<A: Scalar>(bound: f64) {
    let free = pattern(611, (0..611).map(|i| i % 5 == 2).collect());
    let rows = free.row_count();
    let mut matrix = Sliced::<A>::new(&free, &[0, 100, 100, rows as u32]);
    let (mut inverse, mut identity) = (vec![Inverse::default(); rows], vec![true; rows]);
    matrix.load_blocks(&free, &|_, k| block(&free, k), &mut inverse, &mut identity).unwrap();
    assert!(identity.iter().all(|i| !i));
    let number = |i: usize, c: usize| A::from_f64(if c < 3 { ((3 * i + c) as f64).sin() } else { 0.0 });
    let x: Vec<[A; 4]> = (0..rows).map(|i| std::array::from_fn(|c| number(i, c))).collect();
    let mut y = vec![[A::zero(); 4]; rows];
    let mut first = 0;
    for c in 0..matrix.chunk_count() {
        matrix.for_rows(c, &x, &mut Store(&mut y[first..]));
        first = matrix.layout.first_row[c + 1] as usize;
    }
    for i in 0..rows {
        let mut sum = [0.0; 3];
        for k in free.row(i) {
            let (b, x) = (block::<f64>(&free, k), x[free.column[k] as usize].map(Scalar::to_f64));
            (0..3).for_each(|r| sum[r] += b[3 * r] * x[0] + b[3 * r + 1] * x[1] + b[3 * r + 2] * x[2]);
        }
        for r in 0..3 {
            assert!((sum[r] - y[i][r].to_f64()).abs() < bound, "row {i}: {sum:?} {:?}", y[i]);
        }
        // the inverse of the symmetric part of the diagonal block
        let d = block::<f64>(&free, free.diagonal[i] as usize);
        let e: f64 = (0..3).map(|k| 0.5 * (d[3 * k] + d[k]) * inverse[i][k][0].to_f64()).sum();
        assert!((e - 1.0).abs() < 100.0 * bound, "{e}");
    }
}

/// Rows in the sorted order are taken as they come.
#[test]
fn sorted_rows_lie_in_the_order_of_the_slices() {
    let whole = BlockPattern::from_cells(
        700,
        (0..2100u32).map(|i| [i % 700, (i * i + 1) % 700, (i + 1) % 700]).collect::<Vec<_>>().iter().map(|c| &c[..]),
    );
    let nodes = |order: &[u32]| FreePattern::in_order(&whole, order.to_vec()).blocks(&whole);
    let (natural, breaks) = ((0..700).collect::<Vec<u32>>(), [0, 90, 700]);
    let mut order = natural.clone();
    sort_rows(&nodes(&natural), &breaks, &mut order);
    assert_ne!(order, natural);
    let places = |order: &[u32]| Sliced::<f32>::new(&nodes(order), &breaks).layout.place;
    assert!(places(&order).is_sorted() && !places(&natural).is_sorted());
    let mut again = order.clone();
    again[..90].sort_unstable();
    again[90..].sort_unstable();
    assert_eq!(again, natural, "no row leaves its part");
}

#[test]
fn products_agree_with_a_plain_loop() {
    product_is_right::<f64>(1e-12);
    product_is_right::<f32>(1e-4);
}

/// The vector code adds in the order of the plain one.
fn wide_is_plain<A: Scalar>() {
    let free = pattern(97, vec![false; 97]);
    let mut matrix = Sliced::<A>::new(&free, &[0, 97]);
    let (mut inverse, mut identity) = (vec![Inverse::default(); 97], vec![false; 97]);
    matrix.load_blocks(&free, &|_, k| block(&free, k), &mut inverse, &mut identity).unwrap();
    let number = |i: usize, c: usize| A::from_f64(if c < 3 { (i as f64 + 0.7 * c as f64).sin() } else { 0.0 });
    let x: Vec<[A; 4]> = (0..97).map(|i| std::array::from_fn(|c| number(i, c))).collect();
    for slice in 0..matrix.layout.filled.len() {
        let steps = matrix.layout.steps(slice);
        let (values, column) = (&matrix.values[steps.clone()], &matrix.layout.column[steps]);
        // SAFETY: columns of a pattern of 97 rows.
        let [wide, plain] = unsafe { [A::slice_times(values, column, &x), slice_times(values, column, &x)] };
        assert_eq!(wide.map(|r| r.map(Scalar::bits)), plain.map(|r| r.map(Scalar::bits)));
    }
}

#[test]
fn wide_and_plain_rows_have_the_same_bits() {
    wide_is_plain::<f32>();
    wide_is_plain::<f64>();
}

#[test]
fn faults_name_the_first_row_and_empty_rows_become_the_identity() {
    let free = pattern(400, vec![false; 400]);
    let load = |bad: &[(usize, f64)], empty: usize| {
        let mut matrix = Sliced::<f64>::new(&free, &[0, 400]);
        let (mut inverse, mut identity) = (vec![Inverse::default(); 400], vec![false; 400]);
        let fault = matrix.load_blocks(
            &free,
            &|_, k| {
                let mut b = block(&free, k);
                for (row, v) in bad {
                    if free.diagonal[*row] as usize == k {
                        b[0] = *v;
                    }
                }
                if free.row(empty).contains(&k) { [0.0; 9] } else { b }
            },
            &mut inverse,
            &mut identity,
        );
        (fault, identity)
    };
    assert_eq!(load(&[(310, f64::NAN), (90, f64::INFINITY)], 7).0, Err(Fault::NotFinite { row: 90 }));
    assert_eq!(load(&[(310, f64::NAN), (305, -1.0)], 7).0, Err(Fault::NotPositiveDefinite { row: 305 }));
    let (fault, identity) = load(&[], 7);
    assert_eq!(fault, Ok(()));
    assert_eq!(identity.iter().position(|i| *i), Some(7));
}
