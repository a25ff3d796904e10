//! Loops whose threads are found by code that is compiled once.
//!
//! [`rayon`] compiles its whole way of dividing a loop for every loop body anew, which is more code than most bodies are. Here a loop is cut
//! into parts first, and what rayon divides are their numbers.

use rayon::iter::plumbing::{Producer, ProducerCallback};
use rayon::prelude::*;
use std::sync::{Mutex, PoisonError};

/// Most parts of a loop.
const PARTS: usize = 64;

/// Parts of a loop for each thread: more than one, for threads that are slower or come later.
const SHARE: usize = 4;

/// A loop over parts of what an iterator goes through.
pub trait Each: IndexedParallelIterator {
    /// As [`ParallelIterator::for_each`], in parts of no less than the iterator's least length, and compiled faster.
    fn each(self, work: impl Fn(Self::Item) + Sync) {
        let len = self.len();
        self.with_producer(Parts { work, len });
    }
}

impl<I: IndexedParallelIterator> Each for I {}

struct Parts<F> {
    work: F,
    len: usize,
}

impl<T, F: Fn(T) + Sync> ProducerCallback<T> for Parts<F> {
    type Output = ();
    fn callback<P: Producer<Item = T>>(self, producer: P) {
        let least = producer.min_len();
        in_parts(self.len, least, producer, P::split_at, |part: P| part.into_iter().for_each(&self.work));
    }
}

/// Cuts `whole`, which has `len` pieces, by `split(part, pieces)` into as many parts as suit the threads, none of less than `least` pieces,
/// and does `work` with each on one of them.
pub(super) fn in_parts<P: Send>(
    len: usize,
    least: usize,
    whole: P,
    split: impl Fn(P, usize) -> (P, P),
    work: impl Fn(P) + Sync,
) {
    let threads = rayon::current_num_threads();
    let count = if threads == 1 { 1 } else { (len / least.max(1)).min(SHARE * threads).min(PARTS) };
    if count <= 1 {
        return work(whole);
    }
    let parts = [const { Mutex::new(None) }; PARTS];
    let put = |k: usize, part| *parts[k].lock().unwrap_or_else(PoisonError::into_inner) = Some(part);
    let mut rest = whole;
    for k in 0..count - 1 {
        let (part, after) = split(rest, (k + 1) * len / count - k * len / count);
        put(k, part);
        rest = after;
    }
    put(count - 1, rest);
    on_threads(count, &|k| {
        let part = parts[k].lock().unwrap_or_else(PoisonError::into_inner).take();
        part.into_iter().for_each(&work);
    });
}

/// `work(0..count)` on all threads.
fn on_threads(count: usize, work: &(dyn Fn(usize) + Sync)) {
    (0..count).into_par_iter().for_each(work);
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::panic::{AssertUnwindSafe, catch_unwind};

    /// `x` after loops of different lengths, each of which sees what the one before has written.
    fn loops(x: &mut [u64], count: usize) {
        for k in 0..count {
            let len = k * 37 % x.len();
            x[..len].par_iter_mut().enumerate().each(|(i, x)| *x = x.wrapping_mul(31) + (i + k) as u64);
            x.par_chunks_mut(16).with_min_len(3).each(|x| x.reverse());
        }
    }

    #[test]
    fn every_part_is_done_once_on_any_number_of_threads() {
        let mut plain = vec![7u64; 500];
        for k in 0..300 {
            let len = k * 37 % plain.len();
            plain[..len].iter_mut().enumerate().for_each(|(i, x)| *x = x.wrapping_mul(31) + (i + k) as u64);
            plain.chunks_mut(16).for_each(|x| x.reverse());
        }
        for threads in [1, 2, 3, 8, 40] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let mut x = vec![7; 500];
            pool.install(|| loops(&mut x, 300));
            assert_eq!(x, plain, "{threads} threads");
        }
        let mut outside = vec![7; 500];
        loops(&mut outside, 300);
        assert_eq!(outside, plain);
    }

    #[test]
    fn a_panic_of_a_part_reaches_the_one_who_asked() {
        let failed = catch_unwind(AssertUnwindSafe(|| {
            (0..1000).into_par_iter().each(|i| assert!(i != 700, "part of {i}"));
        }));
        assert_eq!(failed.unwrap_err().downcast_ref::<String>().unwrap(), "part of 700");
    }
}
