//! Sparse matrices with eight rows side by side: every number of a register belongs to another row, so that a product is
//! multiplications and additions only and no row has to be summed up across a register.
//!
//! Rows are cut into chunks; within a chunk they are sorted by their number of blocks and taken eight at a time. Shorter rows of
//! a slice are filled up with blocks of zeros. Each row adds its blocks in the order of the pattern, whatever the machine's width.

use super::free::BlockRows;
use super::pcg::kernel::{Inverse, inverse_of_block};
use crate::{Scalar, Wide};
use std::ops::Range;

/// Rows of a slice.
pub(crate) const SLICE: usize = 8;
/// Rows per chunk: the unit of work of a thread, and of the order of summation.
pub(super) const ROWS: usize = super::cubes::ROWS;
/// One step through a slice: the blocks of eight rows, number by number.
pub(crate) type Step<A> = [[A; SLICE]; 9];

/// Square matrix of 3x3 blocks on the pattern it was made for.
#[derive(Debug, Default)]
pub(super) struct Sliced<A> {
    layout: Layout,
    values: Vec<Step<A>>,
}

/// Where which block is.
#[derive(Debug, Default)]
struct Layout {
    /// Rows of each slice, counted from the first of its chunk.
    row: Vec<[u16; SLICE]>,
    /// How many of them there are: fewer than [`SLICE`] only in the last slice of a chunk.
    filled: Vec<u8>,
    /// First step of each slice, and one past the last.
    start: Vec<u32>,
    /// First slice of each chunk, and one past the last.
    chunk: Vec<u32>,
    /// First row of each chunk, and one past the last.
    first_row: Vec<u32>,
    column: Vec<[u32; SLICE]>,
}

/// What is done with the rows of a product, one after the other. A trait and not a closure, because these must be part of the
/// loop's code to be compiled for the machine's instructions.
pub(super) trait RowWork<A> {
    /// Row `row` of the product, counted from the first of its chunk. Must be `#[inline(always)]`.
    fn row(&mut self, row: usize, product: Wide<A, 4>);
}

/// What is wrong with a row of a matrix.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Fault {
    /// A number is not finite.
    NotFinite { row: usize },
    /// The diagonal block is not positive definite.
    NotPositiveDefinite { row: usize },
}

impl<A: Scalar> Sliced<A> {
    /// A matrix on that pattern, all zero. Chunks also end at the rows of `breaks` (ascending, from 0 to the number of rows).
    pub fn new(pattern: &BlockRows, breaks: &[u32]) -> Self {
        let mut layout = Layout { start: vec![0], chunk: vec![0], first_row: vec![0], ..Layout::default() };
        let mut order: Vec<usize> = Vec::with_capacity(ROWS);
        for part in breaks.windows(2) {
            for first in (part[0] as usize..part[1] as usize).step_by(ROWS) {
                order.clear();
                order.extend(first..(first + ROWS).min(part[1] as usize));
                order.sort_by_key(|r| std::cmp::Reverse(pattern.row(*r).len()));
                order.chunks(SLICE).for_each(|slice| layout.push(pattern, first, slice));
                layout.chunk.push(layout.row.len() as u32);
                layout.first_row.push((first + order.len()) as u32);
            }
        }
        layout.column.shrink_to_fit();
        layout.row.shrink_to_fit();
        let values = vec![[[A::zero(); SLICE]; 9]; layout.column.len()];
        Self { layout, values }
    }

    /// What a product reads of the matrix [bytes].
    pub fn bytes(&self) -> usize {
        self.values.len() * (size_of::<Step<A>>() + size_of::<[u32; SLICE]>())
    }

    /// Number of chunks.
    pub fn chunk_count(&self) -> usize {
        self.layout.chunk.len() - 1
    }

    /// Takes the numbers of the blocks of the pattern and inverts the diagonal ones. A row without a single entry becomes one of
    /// the identity, and is marked.
    ///
    /// # Errors
    /// What is wrong with the first row something is wrong with.
    pub fn load(
        &mut self,
        pattern: &BlockRows,
        block_of: &(impl Fn(usize) -> [A; 9] + Sync),
        inverse: &mut [Inverse<A>],
        identity: &mut [bool],
    ) -> Result<(), Fault> {
        let chunks = 0..self.chunk_count();
        self.layout.load(pattern, chunks, block_of, (&mut self.values, inverse, identity))
    }

    /// Hands all rows of chunk `c` of the product with `x` to `work`; their fourth number is zero.
    #[inline(always)]
    pub fn for_rows(&self, c: usize, x: &[[A; 4]], work: &mut impl RowWork<A>) {
        let layout = &self.layout;
        assert!(x.len() >= layout.first_row[layout.first_row.len() - 1] as usize);
        let zero = [A::zero(); 4];
        for slice in layout.chunk[c] as usize..layout.chunk[c + 1] as usize {
            let steps = layout.steps(slice);
            // SAFETY: columns are those of `BlockRows`, below its row count, and `x` is that long (asserted above).
            let q = unsafe { A::slice_times(&self.values[steps.clone()], &layout.column[steps], x) };
            for (half, rows) in layout.rows(slice).chunks(4).enumerate() {
                let part = |k: usize| &q[k].as_chunks::<4>().0[half];
                let quads = A::transposed([part(0), part(1), part(2), &zero]);
                for (l, row) in rows.iter().enumerate() {
                    work.row(*row as usize, Wide(quads[l]));
                }
            }
        }
    }
}

/// Steps, inverted diagonal blocks and identity marks of some chunks.
type Parts<'a, A> = (&'a mut [Step<A>], &'a mut [Inverse<A>], &'a mut [bool]);

impl Layout {
    fn push(&mut self, pattern: &BlockRows, first: usize, slice: &[usize]) {
        self.row.push(std::array::from_fn(|l| slice.get(l).map_or(0, |r| (r - first) as u16)));
        self.filled.push(slice.len() as u8);
        for step in 0..pattern.row(slice[0]).len() {
            let block = |l: usize| slice.get(l).and_then(|r| pattern.row(*r).nth(step));
            // filled up with the row itself, which is in the cache
            let own = |l: usize| *slice.get(l).unwrap_or(&slice[0]) as u32;
            self.column.push(std::array::from_fn(|l| block(l).map_or(own(l), |k| pattern.column[k])));
        }
        self.start.push(self.column.len() as u32);
    }

    #[inline(always)]
    fn steps(&self, slice: usize) -> Range<usize> {
        self.start[slice] as usize..self.start[slice + 1] as usize
    }

    /// Rows of a slice, counted from the first of its chunk.
    #[inline(always)]
    fn rows(&self, slice: usize) -> &[u16] {
        &self.row[slice][..self.filled[slice] as usize]
    }

    /// [`Sliced::load`] for some chunks; halves the work between threads.
    fn load<A: Scalar>(
        &self,
        pattern: &BlockRows,
        chunks: Range<usize>,
        block_of: &(impl Fn(usize) -> [A; 9] + Sync),
        (values, inverse, identity): Parts<'_, A>,
    ) -> Result<(), Fault> {
        if chunks.len() > 1 {
            let half = chunks.start + chunks.len() / 2;
            let steps = (self.first_step(half) - self.first_step(chunks.start)).min(values.len());
            let rows = (self.first_row[half] - self.first_row[chunks.start]) as usize;
            let (values, values_after) = values.split_at_mut(steps);
            let (inverse, inverse_after) = inverse.split_at_mut(rows);
            let (identity, identity_after) = identity.split_at_mut(rows);
            let (a, b) = rayon::join(
                || self.load(pattern, chunks.start..half, block_of, (values, inverse, identity)),
                || self.load(pattern, half..chunks.end, block_of, (values_after, inverse_after, identity_after)),
            );
            return a.and(b);
        }
        let Some(c) = chunks.clone().next() else { return Ok(()) };
        let (first_step, first_row) = (self.first_step(c), self.first_row[c] as usize);
        let mut fault: Option<Fault> = None;
        for slice in self.chunk[c] as usize..self.chunk[c + 1] as usize {
            let steps = self.steps(slice);
            let values = &mut values[steps.start - first_step..steps.end - first_step];
            // zero times anything finite is zero
            let (mut finite, mut any) = ([A::zero(); SLICE], [A::zero(); SLICE]);
            for (l, local) in self.rows(slice).iter().enumerate() {
                for (values, k) in values.iter_mut().zip(pattern.row(first_row + *local as usize)) {
                    let block = block_of(k);
                    (0..9).for_each(|i| values[i][l] = block[i]);
                }
            }
            for values in &*values {
                for part in values {
                    for l in 0..SLICE {
                        finite[l] += part[l] * A::zero();
                        any[l] = any[l].max(part[l].abs());
                    }
                }
            }
            for (l, local) in self.rows(slice).iter().enumerate() {
                let (local, row) = (*local as usize, first_row + *local as usize);
                let diagonal = &mut values[(pattern.diagonal[row] - pattern.row_start[row]) as usize];
                identity[local] = any[l] == A::zero() && finite[l] == A::zero();
                if identity[local] {
                    (0..3).for_each(|i| diagonal[4 * i][l] = A::one());
                }
                let block = std::array::from_fn(|i| diagonal[i][l].to_f64());
                let inverted = inverse_of_block(block);
                inverse[local] = inverted.unwrap_or_default();
                let found = match inverted {
                    _ if finite[l] != A::zero() => Fault::NotFinite { row },
                    None => Fault::NotPositiveDefinite { row },
                    Some(_) => continue,
                };
                // rows of a chunk are not met in order
                let earlier = fault.as_ref().is_none_or(|f| row < f.row());
                if earlier {
                    fault = Some(found);
                }
            }
        }
        fault.map_or(Ok(()), Err)
    }

    fn first_step(&self, chunk: usize) -> usize {
        self.start[self.chunk[chunk] as usize] as usize
    }
}

impl Fault {
    fn row(&self) -> usize {
        match self {
            Self::NotFinite { row } | Self::NotPositiveDefinite { row } => *row,
        }
    }
}

/// [`Scalar::slice_times`] on any machine.
///
/// # Safety
/// Columns are below `x.len()`.
#[inline(always)]
pub(crate) unsafe fn slice_times<A: Scalar>(
    values: &[Step<A>],
    column: &[[u32; SLICE]],
    x: &[[A; 4]],
) -> [[A; SLICE]; 3] {
    let mut sum = [[A::zero(); SLICE]; 3];
    for (m, column) in values.iter().zip(column) {
        for l in 0..SLICE {
            // SAFETY: promised by the caller.
            let v = unsafe { x.get_unchecked(column[l] as usize) };
            for r in 0..3 {
                sum[r][l] += (m[3 * r][l] * v[0] + m[3 * r + 1][l] * v[1]) + m[3 * r + 2][l] * v[2];
            }
        }
    }
    sum
}

/// [`slice_times`] with AVX2, eight rows in a register.
///
/// # Safety
/// Columns are below `x.len()`.
#[cfg(all(target_arch = "x86_64", not(miri)))]
#[target_feature(enable = "avx2")]
pub(crate) unsafe fn slice_times_avx2(
    values: &[Step<f32>],
    column: &[[u32; SLICE]],
    x: &[[f32; 4]],
) -> [[f32; SLICE]; 3] {
    use std::arch::x86_64::{
        _mm_loadu_ps, _mm256_add_ps, _mm256_castps128_ps256, _mm256_insertf128_ps, _mm256_loadu_ps, _mm256_mul_ps,
        _mm256_setzero_ps, _mm256_shuffle_ps, _mm256_storeu_ps, _mm256_unpackhi_ps, _mm256_unpacklo_ps,
    };
    let mut sum = [_mm256_setzero_ps(); 3];
    for (m, column) in values.iter().zip(column) {
        // SAFETY: columns are below `x.len()`, promised by the caller, and every entry is four numbers.
        let pair = |l: usize| unsafe {
            let at = |l: usize| _mm_loadu_ps(x.get_unchecked(column[l] as usize).as_ptr());
            _mm256_insertf128_ps::<1>(_mm256_castps128_ps256(at(l)), at(l + 4))
        };
        let (a, b, c, d) = (pair(0), pair(1), pair(2), pair(3));
        let (ab, cd) = (_mm256_unpacklo_ps(a, b), _mm256_unpacklo_ps(c, d));
        let (ab_high, cd_high) = (_mm256_unpackhi_ps(a, b), _mm256_unpackhi_ps(c, d));
        let v = [
            _mm256_shuffle_ps::<0b01_00_01_00>(ab, cd),
            _mm256_shuffle_ps::<0b11_10_11_10>(ab, cd),
            _mm256_shuffle_ps::<0b01_00_01_00>(ab_high, cd_high),
        ];
        for r in 0..3 {
            // SAFETY: eight numbers each.
            let part = |c: usize| unsafe { _mm256_mul_ps(_mm256_loadu_ps(m[3 * r + c].as_ptr()), v[c]) };
            sum[r] = _mm256_add_ps(sum[r], _mm256_add_ps(_mm256_add_ps(part(0), part(1)), part(2)));
        }
    }
    let mut out = [[0.0; SLICE]; 3];
    for (out, sum) in out.iter_mut().zip(sum) {
        // SAFETY: eight numbers.
        unsafe { _mm256_storeu_ps(out.as_mut_ptr(), sum) };
    }
    out
}

/// [`slice_times`] with AVX2, four rows in a register.
///
/// # Safety
/// Columns are below `x.len()`.
#[cfg(all(target_arch = "x86_64", not(miri)))]
#[target_feature(enable = "avx2")]
pub(crate) unsafe fn slice_times_avx2_f64(
    values: &[Step<f64>],
    column: &[[u32; SLICE]],
    x: &[[f64; 4]],
) -> [[f64; SLICE]; 3] {
    use std::arch::x86_64::{
        _mm256_add_pd, _mm256_loadu_pd, _mm256_mul_pd, _mm256_permute2f128_pd, _mm256_setzero_pd, _mm256_storeu_pd,
        _mm256_unpackhi_pd, _mm256_unpacklo_pd,
    };
    let mut sum = [[_mm256_setzero_pd(); 3]; 2];
    for (m, column) in values.iter().zip(column) {
        for (half, sum) in sum.iter_mut().enumerate() {
            // SAFETY: columns are below `x.len()`, promised by the caller, and every entry is four numbers.
            let at = |l: usize| unsafe { _mm256_loadu_pd(x.get_unchecked(column[4 * half + l] as usize).as_ptr()) };
            let (a, b, c, d) = (at(0), at(1), at(2), at(3));
            let (ab, cd) = (_mm256_unpacklo_pd(a, b), _mm256_unpacklo_pd(c, d));
            let v = [
                _mm256_permute2f128_pd::<0x20>(ab, cd),
                _mm256_permute2f128_pd::<0x20>(_mm256_unpackhi_pd(a, b), _mm256_unpackhi_pd(c, d)),
                _mm256_permute2f128_pd::<0x31>(ab, cd),
            ];
            for r in 0..3 {
                // SAFETY: four of eight numbers.
                let part =
                    |c: usize| unsafe { _mm256_mul_pd(_mm256_loadu_pd(m[3 * r + c].as_ptr().add(4 * half)), v[c]) };
                sum[r] = _mm256_add_pd(sum[r], _mm256_add_pd(_mm256_add_pd(part(0), part(1)), part(2)));
            }
        }
    }
    let mut out = [[0.0; SLICE]; 3];
    for (half, sum) in sum.iter().enumerate() {
        for (out, sum) in out.iter_mut().zip(sum) {
            // SAFETY: four of eight numbers.
            unsafe { _mm256_storeu_pd(out.as_mut_ptr().add(4 * half), *sum) };
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::solver::free::FreePattern;
    use crate::{BlockPattern, DofConstraints};

    fn pattern(nodes: u32, mask: Vec<bool>) -> FreePattern {
        let cells: Vec<[u32; 4]> =
            (0..3 * nodes).map(|i| [i % nodes, (i * i + 1) % nodes, (i * 13 + 5) % nodes, (i + 1) % nodes]).collect();
        FreePattern::new(
            &BlockPattern::from_cells(nodes as usize, cells.iter().map(|c| &c[..])),
            &DofConstraints::from_mask(mask),
        )
    }

    struct Store<'a, A>(&'a mut [[A; 4]]);
    impl<A> RowWork<A> for Store<'_, A> {
        fn row(&mut self, row: usize, product: Wide<A, 4>) {
            self.0[row] = product.0;
        }
    }

    fn block<A: Scalar>(free: &FreePattern, k: usize) -> [A; 9] {
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
        matrix.load(&free, &|k| block(&free, k), &mut inverse, &mut identity).unwrap();
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
        matrix.load(&free, &|k| block(&free, k), &mut inverse, &mut identity).unwrap();
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
            let fault = matrix.load(
                &free,
                &|k| {
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
}
