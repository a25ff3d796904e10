//! The numbers softrig computes with.

use crate::lane::Lane;

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
}

macro_rules! scalar {
    ($t:ident) => {
        impl Scalar for $t {
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
scalar!(f32);
scalar!(f64);
