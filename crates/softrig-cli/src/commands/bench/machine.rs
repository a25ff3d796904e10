//! What the machine itself can do.

use rayon::prelude::*;
use std::time::Instant;

/// Passes over the buffer, the fastest of which counts.
const PASSES: usize = 12;

/// Reading speed of all threads on a buffer of so many bytes that has just been read [GB/s].
pub fn bandwidth(bytes: usize) -> f64 {
    let buffer: Vec<u64> = (0..(bytes / 8).max(1024) as u64).collect();
    let part = buffer.len().div_ceil(rayon::current_num_threads());
    let mut best = f64::INFINITY;
    for _ in 0..PASSES {
        let start = Instant::now();
        let sum: u64 = buffer.par_chunks(part).map(sum).reduce(|| 0, u64::wrapping_add);
        std::hint::black_box(sum);
        best = best.min(start.elapsed().as_secs_f64());
    }
    8.0 * buffer.len() as f64 / best * 1e-9
}

/// Integers may be added in any order: the compiler takes as many at once as the machine can.
fn sum(part: &[u64]) -> u64 {
    struct Sum<'a>(&'a [u64]);
    impl softrig_linalg::Kernel for Sum<'_> {
        type Output = u64;
        #[inline(always)]
        fn run<const W: usize>(self) -> u64 {
            let (chunks, rest) = self.0.as_chunks::<32>();
            let mut sum = [0u64; 32];
            for chunk in chunks {
                for (s, v) in sum.iter_mut().zip(chunk) {
                    *s = s.wrapping_add(*v);
                }
            }
            sum.iter().chain(rest).fold(0, |a, b| a.wrapping_add(*b))
        }
    }
    softrig_linalg::run_wide::<f64, _>(Sum(part))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_is_read() {
        let numbers: Vec<u64> = (0..1000).collect();
        assert_eq!(sum(&numbers), 499_500);
        assert!(bandwidth(1 << 16) > 0.01);
    }
}
