//! Times of short works.

use softrig_explicit::awake;
use std::time::Instant;

/// How long something took, over many rounds.
#[derive(Clone, Copy, Debug)]
pub struct Times {
    /// Median [us].
    pub median: f64,
    /// Least [us].
    pub least: f64,
}

impl Times {
    /// Runs `work` so many times, after a tenth as many that are not counted, one after the other on threads that stay awake.
    pub fn of<E: Send>(rounds: usize, mut work: impl FnMut() -> Result<(), E> + Send) -> Result<Self, E> {
        let mut all = Vec::with_capacity(rounds);
        awake(|| {
            for _ in 0..rounds / 10 {
                work()?;
            }
            for _ in 0..rounds.max(1) {
                let start = Instant::now();
                work()?;
                all.push(start.elapsed().as_secs_f64() * 1e6);
            }
            Ok(())
        })?;
        all.sort_by(f64::total_cmp);
        Ok(Self { median: all[all.len() / 2], least: all[0] })
    }
}
