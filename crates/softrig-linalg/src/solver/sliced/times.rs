//! Blocks times vectors, eight rows side by side, for the instruction sets there are.

use super::{SLICE, Step};
use crate::Scalar;

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
