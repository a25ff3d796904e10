//! One kernel body for one number or several side by side.

use crate::scalar::Scalar;
use std::ops::{Add, AddAssign, Div, Mul, MulAssign, Neg, Sub, SubAssign};

/// A number, or `WIDTH` independent numbers computed in step: what kernels are generic over.
///
/// Operations are the plain IEEE ones, lane by lane and never fused, so that a wide kernel gives the bits of the scalar one.
pub trait Lane:
    Copy
    + Send
    + Sync
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
    + AddAssign
    + SubAssign
    + MulAssign
{
    /// The number in each lane.
    type Scalar: Scalar;
    /// How many lanes.
    const WIDTH: usize;
    /// The same number in every lane.
    fn splat(value: Self::Scalar) -> Self;
    /// The number in lane `i`.
    fn get(self, i: usize) -> Self::Scalar;
    /// Replaces the number in lane `i`.
    fn set(&mut self, i: usize, value: Self::Scalar);
    /// Square root.
    fn sqrt(self) -> Self;
    /// Absolute value.
    fn abs(self) -> Self;
    /// Smaller of the two.
    fn min(self, other: Self) -> Self;
    /// Larger of the two.
    fn max(self, other: Self) -> Self;
    /// Where `a < b` holds: `yes`, elsewhere (also for NaN) `no`.
    fn select_lt(a: Self, b: Self, yes: Self, no: Self) -> Self;
    /// A constant in every lane.
    #[inline(always)]
    fn constant(value: f64) -> Self {
        Self::splat(Self::Scalar::from_f64(value))
    }
    /// Zero in every lane.
    #[inline(always)]
    fn zero() -> Self {
        Self::constant(0.0)
    }
    /// One in every lane.
    #[inline(always)]
    fn one() -> Self {
        Self::constant(1.0)
    }
}

macro_rules! scalar_lane {
    ($t:ident) => {
        impl Lane for $t {
            type Scalar = $t;
            const WIDTH: usize = 1;
            #[inline(always)]
            fn splat(value: $t) -> Self {
                value
            }
            #[inline(always)]
            fn get(self, _: usize) -> $t {
                self
            }
            #[inline(always)]
            fn set(&mut self, _: usize, value: $t) {
                *self = value;
            }
            #[inline(always)]
            fn sqrt(self) -> Self {
                $t::sqrt(self)
            }
            #[inline(always)]
            fn abs(self) -> Self {
                $t::abs(self)
            }
            #[inline(always)]
            fn min(self, other: Self) -> Self {
                if self < other { self } else { other }
            }
            #[inline(always)]
            fn max(self, other: Self) -> Self {
                if self > other { self } else { other }
            }
            #[inline(always)]
            fn select_lt(a: Self, b: Self, yes: Self, no: Self) -> Self {
                if a < b { yes } else { no }
            }
        }
    };
}
scalar_lane!(f32);
scalar_lane!(f64);

/// `W` numbers side by side. Inside a [`crate::Kernel`] operations on it become vector instructions.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(transparent)]
pub struct Wide<R, const W: usize>(pub [R; W]);

macro_rules! wide_op {
    ($trait:ident, $f:ident, $op:tt) => {
        impl<R: Scalar, const W: usize> $trait for Wide<R, W> {
            type Output = Self;
            #[inline(always)]
            fn $f(self, other: Self) -> Self {
                let mut out = self;
                for i in 0..W {
                    out.0[i] = self.0[i] $op other.0[i];
                }
                out
            }
        }
    };
}
wide_op!(Add, add, +);
wide_op!(Sub, sub, -);
wide_op!(Mul, mul, *);
wide_op!(Div, div, /);

macro_rules! wide_op_assign {
    ($trait:ident, $f:ident, $op:tt) => {
        impl<R: Scalar, const W: usize> $trait for Wide<R, W> {
            #[inline(always)]
            fn $f(&mut self, other: Self) {
                *self = *self $op other;
            }
        }
    };
}
wide_op_assign!(AddAssign, add_assign, +);
wide_op_assign!(SubAssign, sub_assign, -);
wide_op_assign!(MulAssign, mul_assign, *);

impl<R: Scalar, const W: usize> Neg for Wide<R, W> {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        let mut out = self;
        for i in 0..W {
            out.0[i] = -self.0[i];
        }
        out
    }
}

impl<R: Scalar, const W: usize> Wide<R, W> {
    #[inline(always)]
    fn map2(self, other: Self, f: impl Fn(R, R) -> R) -> Self {
        let mut out = self;
        for i in 0..W {
            out.0[i] = f(self.0[i], other.0[i]);
        }
        out
    }
}

impl<R: Scalar, const W: usize> Lane for Wide<R, W> {
    type Scalar = R;
    const WIDTH: usize = W;
    #[inline(always)]
    fn splat(value: R) -> Self {
        Self([value; W])
    }
    #[inline(always)]
    fn get(self, i: usize) -> R {
        self.0[i]
    }
    #[inline(always)]
    fn set(&mut self, i: usize, value: R) {
        self.0[i] = value;
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        self.map2(self, |a, _| Lane::sqrt(a))
    }
    #[inline(always)]
    fn abs(self) -> Self {
        self.map2(self, |a, _| Lane::abs(a))
    }
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        self.map2(other, Lane::min)
    }
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        self.map2(other, Lane::max)
    }
    #[inline(always)]
    fn select_lt(a: Self, b: Self, yes: Self, no: Self) -> Self {
        let mut out = no;
        for i in 0..W {
            out.0[i] = if a.0[i] < b.0[i] { yes.0[i] } else { no.0[i] };
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Lanes do not talk to each other: a wide operation is the scalar one, lane by lane, bit for bit.
    #[test]
    fn wide_operations_equal_scalar_ones() {
        let a = Wide::<f64, 4>([1.5, -2.25, 0.1, 1e300]);
        let b = Wide::<f64, 4>([0.3, 7.0, -0.1, 1e10]);
        for i in 0..4 {
            assert_eq!((a * b + a / b).get(i).to_bits(), (a.get(i) * b.get(i) + a.get(i) / b.get(i)).to_bits());
            assert_eq!(Wide::select_lt(a, b, a, b).get(i), if a.get(i) < b.get(i) { a.get(i) } else { b.get(i) });
        }
    }
}
