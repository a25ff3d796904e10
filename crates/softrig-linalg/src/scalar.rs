//! The numbers softrig computes with.

use crate::lane::Lane;
use crate::solver::sliced::{self, SLICE, Step};
#[cfg(all(target_arch = "x86_64", not(miri)))]
use crate::wide::Instructions;
use std::any::{Any, TypeId};

mod sealed {
    pub trait Sealed {}
    impl Sealed for f32 {}
    impl Sealed for f64 {}
}

/// `f32` or `f64`: the one bound on data. Precision is chosen at run time by choosing the type, never by a cargo feature.
pub trait Scalar:
    sealed::Sealed + Lane<Scalar = Self> + PartialOrd + std::fmt::Debug + std::fmt::Display + Default + 'static
{
    /// Distance from 1 to the next larger number.
    const EPSILON: Self;
    /// Largest finite number.
    const MAX: Self;
    /// `"f32"` or `"f64"`, for reports.
    const NAME: &'static str;
    /// Nearest representable number.
    fn from_f64(value: f64) -> Self;
    /// Exact for both types.
    fn to_f64(self) -> f64;
    /// Neither infinite nor NaN.
    fn is_finite(self) -> bool;
    /// The bits, widened: for hashes of a state.
    fn bits(self) -> u64;
    /// Four rows of four become four columns, in registers.
    #[doc(hidden)]
    fn transposed(rows: [&[Self; 4]; 4]) -> [[Self; 4]; 4] {
        std::array::from_fn(|c| rows.map(|r| r[c]))
    }
    /// Sum of blocks times entries of `x`, for eight rows side by side.
    ///
    /// # Safety
    /// Columns are below `x.len()`.
    #[doc(hidden)]
    #[inline(always)]
    unsafe fn slice_times(values: &[Step<Self>], column: &[[u32; SLICE]], x: &[[Self; 4]]) -> [[Self; SLICE]; 3] {
        // SAFETY: as promised by the caller.
        unsafe { sliced::slice_times(values, column, x) }
    }
}

macro_rules! scalar {
    ($t:ident, $transposed:ident, $slice_times:ident) => {
        impl Scalar for $t {
            #[cfg(all(target_arch = "x86_64", not(miri)))]
            #[inline(always)]
            unsafe fn slice_times(values: &[Step<$t>], column: &[[u32; SLICE]], x: &[[$t; 4]]) -> [[$t; SLICE]; 3] {
                if Instructions::best() >= Instructions::Avx2 {
                    // SAFETY: the machine has the instructions; columns are promised by the caller.
                    unsafe { sliced::$slice_times(values, column, x) }
                } else {
                    // SAFETY: as promised by the caller.
                    unsafe { sliced::slice_times(values, column, x) }
                }
            }
            #[cfg(all(target_arch = "x86_64", not(miri)))]
            #[inline(always)]
            fn transposed(rows: [&[Self; 4]; 4]) -> [[Self; 4]; 4] {
                $transposed(rows)
            }
            const EPSILON: Self = $t::EPSILON;
            const MAX: Self = $t::MAX;
            const NAME: &'static str = stringify!($t);
            #[inline(always)]
            #[allow(clippy::cast_possible_truncation, reason = "rounding to f32 is the purpose")]
            fn from_f64(value: f64) -> Self {
                value as $t
            }
            #[inline(always)]
            fn to_f64(self) -> f64 {
                f64::from(self)
            }
            #[inline(always)]
            fn is_finite(self) -> bool {
                $t::is_finite(self)
            }
            #[inline(always)]
            fn bits(self) -> u64 {
                u64::from(self.to_bits())
            }
        }
    };
}
scalar!(f32, transposed_f32, slice_times_avx2);
scalar!(f64, transposed_f64, slice_times_avx2_f64);

// compilers take a plain transposition apart into single numbers
#[cfg(all(target_arch = "x86_64", not(miri)))]
#[inline(always)]
fn transposed_f32(rows: [&[f32; 4]; 4]) -> [[f32; 4]; 4] {
    use std::arch::x86_64::{
        _mm_loadu_ps, _mm_movehl_ps, _mm_movelh_ps, _mm_storeu_ps, _mm_unpackhi_ps, _mm_unpacklo_ps,
    };
    let mut out = [[0.0; 4]; 4];
    // SAFETY: SSE is part of every x86-64, and each pointer is that of four numbers.
    unsafe {
        let [a, b, c, d] = rows.map(|r| _mm_loadu_ps(r.as_ptr()));
        let (ab, cd) = (_mm_unpacklo_ps(a, b), _mm_unpacklo_ps(c, d));
        let (ab_high, cd_high) = (_mm_unpackhi_ps(a, b), _mm_unpackhi_ps(c, d));
        _mm_storeu_ps(out[0].as_mut_ptr(), _mm_movelh_ps(ab, cd));
        _mm_storeu_ps(out[1].as_mut_ptr(), _mm_movehl_ps(cd, ab));
        _mm_storeu_ps(out[2].as_mut_ptr(), _mm_movelh_ps(ab_high, cd_high));
        _mm_storeu_ps(out[3].as_mut_ptr(), _mm_movehl_ps(cd_high, ab_high));
    }
    out
}

#[cfg(all(target_arch = "x86_64", not(miri)))]
#[inline(always)]
fn transposed_f64(rows: [&[f64; 4]; 4]) -> [[f64; 4]; 4] {
    use std::arch::x86_64::{_mm_loadu_pd, _mm_storeu_pd, _mm_unpackhi_pd, _mm_unpacklo_pd};
    let mut out = [[0.0; 4]; 4];
    for i in [0, 2] {
        for j in [0, 2] {
            // SAFETY: SSE2 is part of every x86-64, and each pointer is followed by two numbers of its array of four.
            unsafe {
                let (a, b) = (_mm_loadu_pd(rows[i].as_ptr().add(j)), _mm_loadu_pd(rows[i + 1].as_ptr().add(j)));
                _mm_storeu_pd(out[j].as_mut_ptr().add(i), _mm_unpacklo_pd(a, b));
                _mm_storeu_pd(out[j + 1].as_mut_ptr().add(i), _mm_unpackhi_pd(a, b));
            }
        }
    }
    out
}

/// `single()` where `R` is f32, `double()` where it is f64: both are `T`, spelled with the number in place of `R`.
///
/// A generic type is compiled anew in every crate that makes one. With constructors that are not generic behind this it is compiled
/// once, where it is written: for kernels in three instruction sets that is minutes.
///
/// ```
/// use softrig_linalg::{Scalar, either};
///
/// fn name<R: Scalar>() -> Vec<R> {
///     either(|| vec![1.0f32], || vec![1.0f64])
/// }
/// assert_eq!(name::<f64>(), [1.0]);
/// ```
///
/// # Panics
/// When `S` is not `T` for f32, or `D` is not for f64.
pub fn either<T: 'static, S: 'static, D: 'static>(single: impl FnOnce() -> S, double: impl FnOnce() -> D) -> T {
    let made: Box<dyn Any> =
        if TypeId::of::<T>() == TypeId::of::<S>() { Box::new(single()) } else { Box::new(double()) };
    *made.downcast().expect("a scalar is f32 or f64")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rows_become_columns<R: Scalar>() {
        let m: [[R; 4]; 4] = std::array::from_fn(|i| std::array::from_fn(|j| R::from_f64((4 * i + j) as f64)));
        let t = R::transposed([&m[0], &m[1], &m[2], &m[3]]);
        for i in 0..4 {
            for j in 0..4 {
                assert_eq!(t[i][j], m[j][i], "{} {i} {j}", R::NAME);
            }
        }
    }

    #[test]
    fn transposition_turns_rows_into_columns() {
        rows_become_columns::<f32>();
        rows_become_columns::<f64>();
    }
}
