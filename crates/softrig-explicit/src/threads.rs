//! Threads that stay awake between the parts of short steps.

use rayon::Yield;
use std::sync::atomic::{AtomicBool, Ordering};

/// Set when it is dropped, also by a panic.
struct Finish<'a>(&'a AtomicBool);

impl Drop for Finish<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Release);
    }
}

/// Does `work` while the other threads of the pool look for its parts without going to sleep: waking one takes some 20 us, as long as a part of
/// a small body. Results are those without it. Meant for many steps in a row; nothing else gets those threads meanwhile.
pub fn awake<T: Send>(work: impl FnOnce() -> T + Send) -> T {
    let Some(here) = rayon::current_thread_index() else {
        return rayon::scope(|_| awake(work));
    };
    let done = &AtomicBool::new(false);
    rayon::scope(|scope| {
        for _ in 1..rayon::current_num_threads() {
            scope.spawn(move |_| {
                // the thread that does the work must not wait for itself
                while rayon::current_thread_index() != Some(here) && !done.load(Ordering::Acquire) {
                    if rayon::yield_now() != Some(Yield::Executed) {
                        std::hint::spin_loop();
                    }
                }
            });
        }
        let _finish = Finish(done);
        work()
    })
}

#[cfg(test)]
mod tests {
    use super::awake;
    use rayon::prelude::*;

    /// Whatever the number of threads, also from outside the pool and one inside the other, it ends, and with what the work gave.
    #[test]
    fn it_ends_with_what_the_work_gave() {
        for threads in [1, 2, 4] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let sum = || (0..200).map(|_| (0..64u64).into_par_iter().map(|i| i * i).sum::<u64>()).sum::<u64>();
            let twice = pool.install(|| awake(|| awake(sum)));
            assert_eq!((twice, awake(sum)), (200 * 85344, 200 * 85344));
            let failing =
                std::panic::AssertUnwindSafe(|| pool.install(|| awake(|| assert_eq!(threads, 0, "as meant"))));
            let panics = std::panic::catch_unwind(failing);
            assert!(panics.is_err());
        }
    }
}
