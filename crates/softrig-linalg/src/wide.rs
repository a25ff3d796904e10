//! Wide instructions, chosen at run time.
//!
//! A [`Kernel`] is a loop body written once over [`crate::Wide`] lanes. [`run_wide`] compiles it for every instruction set we
//! know and runs the best one this machine has. Lane operations are plain IEEE ones, never fused, so the width changes no bit
//! of the result.
//!
//! ```
//! use softrig_linalg::{Kernel, Lane, Wide, run_wide};
//!
//! struct Double<'a>(&'a mut [f64]);
//! impl Kernel for Double<'_> {
//!     type Output = ();
//!     #[inline(always)] // or the body is compiled without the wide instructions
//!     fn run<const W: usize>(self) {
//!         let (body, rest) = self.0.as_chunks_mut::<W>();
//!         for chunk in body {
//!             *chunk = (Wide(*chunk) + Wide(*chunk)).0;
//!         }
//!         for x in rest {
//!             *x += *x;
//!         }
//!     }
//! }
//! let mut x = [1.0, 2.0, 3.0, 4.0, 5.0];
//! run_wide::<f64, _>(Double(&mut x));
//! assert_eq!(x, [2.0, 4.0, 6.0, 8.0, 10.0]);
//! ```
//!
//! Rules for a body: every function it calls is `#[inline(always)]`, and threads are outside: call [`run_wide`] once per chunk
//! *inside* the parallel loop, because a closure handed to another thread is compiled on its own, without wide instructions.

use crate::scalar::Scalar;
use std::sync::atomic::{AtomicU8, Ordering};

/// Code compiled once per instruction set, with the matching number of lanes.
pub trait Kernel {
    /// What the kernel returns.
    type Output;
    /// Does the work `W` numbers at a time. Implementations must be `#[inline(always)]`.
    fn run<const W: usize>(self) -> Self::Output;
}

/// The best set that kernels of this process may use.
static LIMIT: AtomicU8 = AtomicU8::new(Instructions::Avx512 as u8);

/// A set of vector instructions.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[non_exhaustive]
pub enum Instructions {
    /// What every machine of this architecture has: 16 bytes (SSE2, NEON).
    Portable,
    /// x86-64 with AVX2: 32 bytes.
    Avx2,
    /// x86-64 with AVX-512 (F, BW, DQ, VL): 32 bytes too, in twice as many registers. Kernels of 64 bytes were several times as much
    /// code, in which the compiler spread numbers over memory one by one.
    Avx512,
}

impl Instructions {
    /// All sets, the least first.
    pub const ALL: [Self; 3] = [Self::Portable, Self::Avx2, Self::Avx512];

    /// The best set of this machine that may be used.
    #[inline]
    #[must_use]
    pub fn best() -> Self {
        let limit = LIMIT.load(Ordering::Relaxed);
        if limit >= Self::Avx512 as u8 && Self::Avx512.is_available() {
            Self::Avx512
        } else if limit >= Self::Avx2 as u8 && Self::Avx2.is_available() {
            Self::Avx2
        } else {
            Self::Portable
        }
    }

    /// From now on kernels of this process use no better set than this one: to measure it, or to see that results have the same
    /// bits. False, and nothing is changed, on a machine that does not have it.
    #[must_use]
    pub fn use_at_most(self) -> bool {
        let available = self.is_available();
        if available {
            LIMIT.store(self as u8, Ordering::Relaxed);
        }
        available
    }

    /// Does this machine have the set?
    #[inline]
    #[must_use]
    pub fn is_available(self) -> bool {
        match self {
            Self::Portable => true,
            #[cfg(all(target_arch = "x86_64", not(miri)))]
            Self::Avx2 => is_x86_feature_detected!("avx2"),
            #[cfg(all(target_arch = "x86_64", not(miri)))]
            Self::Avx512 => {
                is_x86_feature_detected!("avx512f")
                    && is_x86_feature_detected!("avx512bw")
                    && is_x86_feature_detected!("avx512dq")
                    && is_x86_feature_detected!("avx512vl")
            }
            #[cfg(not(all(target_arch = "x86_64", not(miri))))]
            _ => false,
        }
    }

    /// Numbers of type `R` side by side in one register: the `W` a kernel is run with.
    #[must_use]
    pub const fn lane_count<R: Scalar>(self) -> usize {
        let bytes = match self {
            Self::Portable => 16,
            Self::Avx2 | Self::Avx512 => 32,
        };
        bytes / size_of::<R>()
    }
}

/// Runs the kernel with the best instructions of this machine, on lanes of `R`.
#[inline]
pub fn run_wide<R: Scalar, K: Kernel>(kernel: K) -> K::Output {
    run_wide_with::<R, K>(Instructions::best(), kernel)
}

/// Runs the kernel with the given instructions, or portably on a machine without them: for tests that compare sets.
#[inline]
pub fn run_wide_with<R: Scalar, K: Kernel>(instructions: Instructions, kernel: K) -> K::Output {
    const { assert!(size_of::<R>() == 4 || size_of::<R>() == 8) };
    match instructions {
        #[cfg(target_arch = "x86_64")]
        Instructions::Avx512 if instructions.is_available() => {
            // SAFETY: the machine has these instructions, it was asked on the line above.
            if size_of::<R>() == 4 { unsafe { avx512::<K, 8>(kernel) } } else { unsafe { avx512::<K, 4>(kernel) } }
        }
        #[cfg(target_arch = "x86_64")]
        Instructions::Avx2 if instructions.is_available() => {
            // SAFETY: as above.
            if size_of::<R>() == 4 { unsafe { avx2::<K, 8>(kernel) } } else { unsafe { avx2::<K, 4>(kernel) } }
        }
        _ if size_of::<R>() == 4 => portable::<K, 4>(kernel),
        _ => portable::<K, 2>(kernel),
    }
}

/// Out of line as the others are: what a kernel keeps on the stack is not to lie there while callers divide their work further.
#[inline(never)]
fn portable<K: Kernel, const W: usize>(kernel: K) -> K::Output {
    kernel.run::<W>()
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn avx2<K: Kernel, const W: usize>(kernel: K) -> K::Output {
    kernel.run::<W>()
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,avx512f,avx512bw,avx512dq,avx512vl")]
fn avx512<K: Kernel, const W: usize>(kernel: K) -> K::Output {
    kernel.run::<W>()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Lane, Mat3, Wide};

    /// Inverse times matrix times matrix: divisions, products and sums in an order a compiler would like to change.
    struct Work<'a, R>(&'a [[[R; 3]; 3]], &'a mut [[[R; 3]; 3]]);
    impl<R: Scalar> Kernel for Work<'_, R> {
        type Output = ();
        #[inline(always)]
        fn run<const W: usize>(self) {
            for (from, to) in self.0.chunks_exact(W).zip(self.1.chunks_exact_mut(W)) {
                let mut m = Mat3::<Wide<R, W>>::zero();
                for i in 0..W {
                    for a in 0..3 {
                        for b in 0..3 {
                            m.0[a][b].set(i, from[i][a][b]);
                        }
                    }
                }
                let r = work(m);
                for i in 0..W {
                    to[i] = r.0.map(|row| row.map(|x| x.get(i)));
                }
            }
        }
    }
    #[inline(always)]
    fn work<S: Lane>(m: Mat3<S>) -> Mat3<S> {
        (m.inverse().transpose() * m * m).scale(m.frobenius_norm())
    }

    fn every_set_gives_the_scalar_bits<R: Scalar>() {
        let m: Vec<[[R; 3]; 3]> = (0..64)
            .map(|k| {
                std::array::from_fn(|a| std::array::from_fn(|b| R::from_f64(((k * 7 + a * 3 + b * b) as f64).sin())))
            })
            .collect();
        let bits = |m: [[R; 3]; 3]| m.map(|r| r.map(Scalar::bits));
        for set in Instructions::ALL {
            let mut out = vec![[[R::zero(); 3]; 3]; m.len()];
            run_wide_with::<R, _>(set, Work(&m, &mut out));
            for (m, out) in m.iter().zip(&out) {
                assert_eq!(bits(work(Mat3(*m)).0), bits(*out), "{set:?} {}", R::NAME);
            }
        }
    }

    /// The claim of the module, and what makes results equal on all machines: neither width nor instruction set is seen.
    #[test]
    fn every_instruction_set_gives_the_scalar_bits() {
        every_set_gives_the_scalar_bits::<f32>();
        every_set_gives_the_scalar_bits::<f64>();
    }

    #[test]
    fn best_is_available_and_portable_always_is() {
        assert!(Instructions::best().is_available());
        assert!(Instructions::Portable.is_available());
        assert_eq!(Instructions::Avx2.lane_count::<f32>(), 8);
    }
}
