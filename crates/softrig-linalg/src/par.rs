//! Loops on threads whose results do not depend on how many there are.
//!
//! Work is cut into chunks of fixed size, each result belongs to the chunk that owns it, and sums add the chunks' partial sums
//! in chunk order. The thread count is that of the surrounding rayon pool.

mod each;

use each::in_parts;
use rayon::prelude::*;
use std::ops::Range;
use std::sync::atomic::{AtomicUsize, Ordering};

pub use each::Each;

/// Items per chunk of a reduction: fixed, so that the order of additions is.
pub const CHUNK: usize = 1024;

/// Sums `f(range)` over consecutive ranges of `CHUNK` items of `0..len`, in f64 and always in the same order.
pub fn sum(len: usize, f: impl Fn(Range<usize>) -> f64 + Sync) -> f64 {
    fold(len, f, |a, b| a + b)
}

/// Largest `f(i)` over `0..len`, and 0 for none of them or none above it. What is not a number does not count.
pub fn max(len: usize, f: impl Fn(usize) -> f64 + Sync) -> f64 {
    fold(len, |range| range.fold(0.0, |m: f64, i| m.max(f(i))), f64::max)
}

/// `f` of every chunk of `0..len`, put together in their order, beginning with 0.
pub fn fold(len: usize, f: impl Fn(Range<usize>) -> f64 + Sync, both: impl Fn(f64, f64) -> f64) -> f64 {
    let chunks = len.div_ceil(CHUNK);
    if chunks <= 1 {
        return f(0..len);
    }
    let mut partial = [0.0; 64];
    let mut total = 0.0;
    // in blocks of 64 chunks: no allocation, whatever the length
    for first in (0..chunks).step_by(64) {
        let n = (chunks - first).min(64);
        partial[..n].par_iter_mut().enumerate().each(|(k, p)| *p = f(range_of(first + k, len)));
        total = partial[..n].iter().fold(total, |total, p| both(total, *p));
    }
    total
}

/// The first of `0..len` that is as asked. A chunk is asked as a whole, without looking up after each, and once more where one of it is.
pub fn first(len: usize, is: impl Fn(usize) -> bool + Sync) -> Option<usize> {
    let chunks = len.div_ceil(CHUNK);
    let found = AtomicUsize::new(chunks);
    (0..chunks).into_par_iter().each(|c| {
        // not beyond what has been found already
        if c < found.load(Ordering::Relaxed) && range_of(c, len).fold(false, |some, i| some | is(i)) {
            found.fetch_min(c, Ordering::Relaxed);
        }
    });
    range_of(found.into_inner(), len).find(|i| is(*i))
}

/// The items of chunk `c` of `0..len`; none past the last.
fn range_of(c: usize, len: usize) -> Range<usize> {
    (c * CHUNK).min(len)..((c + 1) * CHUNK).min(len)
}

/// Chunk `c` of items that are cut into chunks of `size`; empty past the last.
#[inline(always)]
pub fn chunk<T>(items: &[T], c: usize, size: usize) -> &[T] {
    items.chunks(size).nth(c).unwrap_or_default()
}

/// Hands ranges of at most `most` items, with the values that begin at `start` of their first one, to all threads.
pub fn divide<T: Send>(
    range: Range<usize>,
    most: usize,
    start: &(impl Fn(usize) -> usize + Sync),
    values: &mut [T],
    work: &(impl Fn(Range<usize>, &mut [T]) + Sync),
) {
    let none: &mut [()] = &mut [];
    divide_both(range, most, (start, &|_| 0), (values, none), &|range, values, _| work(range, values));
}

/// As [`divide`], for two lists of values.
pub fn divide_both<T: Send, U: Send>(
    range: Range<usize>,
    most: usize,
    start: (&(impl Fn(usize) -> usize + Sync), &(impl Fn(usize) -> usize + Sync)),
    values: (&mut [T], &mut [U]),
    work: &(impl Fn(Range<usize>, &mut [T], &mut [U]) + Sync),
) {
    let most = most.max(1);
    let whole: Part<'_, T, U> = (range, values.0, values.1);
    in_parts(
        whole.0.len(),
        most,
        whole,
        |part, count| cut(part, count, start),
        |mut part| {
            while part.0.len() > most {
                let (first, rest) = cut(part, most, start);
                work(first.0, first.1, first.2);
                part = rest;
            }
            work(part.0, part.1, part.2);
        },
    );
}

/// A range of items and their values.
type Part<'a, T, U> = (Range<usize>, &'a mut [T], &'a mut [U]);

/// The first `count` items of a part, and the others.
fn cut<'a, T, U>(
    (range, a, b): Part<'a, T, U>,
    count: usize,
    start: (&impl Fn(usize) -> usize, &impl Fn(usize) -> usize),
) -> (Part<'a, T, U>, Part<'a, T, U>) {
    let middle = range.start + count;
    let a = a.split_at_mut(start.0(middle) - start.0(range.start));
    let b = b.split_at_mut(start.1(middle) - start.1(range.start));
    ((range.start..middle, a.0, b.0), (middle..range.end, a.1, b.1))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The claim of the module: the same bits on one thread and on four.
    #[test]
    fn sums_are_bitwise_equal_for_any_thread_count() {
        let x: Vec<f64> = (0..200_000).map(|i| ((i * 7919) % 1000) as f64 * 0.1 + 1e-7 * i as f64).collect();
        let run = |threads| {
            rayon::ThreadPoolBuilder::new()
                .num_threads(threads)
                .build()
                .unwrap()
                .install(|| sum(x.len(), |r| x[r].iter().sum()))
        };
        assert!(run(1) > 0.0);
        assert_eq!(run(1).to_bits(), run(4).to_bits());
    }

    #[test]
    fn the_largest_and_the_first_are_those_of_a_plain_loop() {
        let x: Vec<f64> = (0..10_000).map(|i| f64::from(i * 7919 % 10_007)).collect();
        assert_eq!(max(x.len(), |i| x[i]), 10_006.0);
        assert_eq!(max(x.len(), |i| if i % 2 == 0 { f64::NAN } else { -x[i] }), 0.0);
        assert_eq!(first(x.len(), |i| x[i] > 10_000.0), x.iter().position(|x| *x > 10_000.0));
        assert_eq!((max(0, |_| 1.0), first(x.len(), |i| x[i] < 0.0)), (0.0, None));
    }
}
