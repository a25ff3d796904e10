//! Loops of a level, each over the rows of one chunk: a row of a product is used the moment it is there.

use crate::solver::cubes::FreeCubes;
use crate::solver::pcg::kernel::Inverse;
use crate::solver::sliced::Sliced;
use crate::{Kernel, Lane, Wide};

type Quad = [f32; 4];

/// What multiplies: the blocks, or the cubes (whose corner forces are those of the `x` to come).
#[derive(Clone, Copy)]
pub(super) enum Matrix<'a> {
    Stored(&'a Sliced<f32>),
    Cubes(&'a FreeCubes<f32>),
}

impl Matrix<'_> {
    #[inline(always)]
    fn for_rows(self, chunk: usize, x: &[Quad], rows: usize, mut work: impl FnMut(usize, Wide<f32, 4>)) {
        match self {
            Self::Stored(matrix) => matrix.for_rows(chunk, x, |row, q| work(row, Wide(q))),
            Self::Cubes(cubes) => cubes.for_rows(chunk, x, rows, work),
        }
    }
}

#[inline(always)]
fn times(inverse: &Inverse<f32>, v: Wide<f32, 4>) -> Wide<f32, 4> {
    let m = inverse;
    (Wide(m[0]) * Wide::splat(v.0[0]) + Wide(m[1]) * Wide::splat(v.0[1])) + Wide(m[2]) * Wide::splat(v.0[2])
}

/// `y = A x`; returns `xᵀ y`.
pub(super) struct Product<'a> {
    pub matrix: Matrix<'a>,
    pub chunk: usize,
    pub x: &'a [Quad],
    /// The rows of the chunk in `x`.
    pub own: &'a [Quad],
    pub y: &'a mut [Quad],
}

impl Kernel for Product<'_> {
    type Output = f64;
    #[inline(always)]
    fn run<const W: usize>(self) -> f64 {
        let Self { matrix, chunk, x, own, y } = self;
        let mut dot = Wide::<f64, 4>::zero();
        matrix.for_rows(chunk, x, y.len(), |row, q| {
            y[row] = q.0;
            dot += Wide(q.0.map(f64::from)) * Wide(own[row].map(f64::from));
        });
        (dot.0[0] + dot.0[1]) + (dot.0[2] + dot.0[3])
    }
}

/// `r = b`, `x = d = gain D⁻¹ b`: the first step from zero.
pub(super) struct Start<'a> {
    pub gain: f32,
    pub inverse: &'a [Inverse<f32>],
    pub b: &'a [Quad],
    pub r: &'a mut [Quad],
    pub d: &'a mut [Quad],
    pub x: &'a mut [Quad],
}

impl Kernel for Start<'_> {
    type Output = ();
    #[inline(always)]
    fn run<const W: usize>(self) {
        let Self { gain, inverse, b, r, d, x } = self;
        for i in 0..b.len() {
            let v = Wide(b[i]);
            let step = Wide::splat(gain) * times(&inverse[i], v);
            (r[i], d[i], x[i]) = (v.0, step.0, step.0);
        }
    }
}

/// `r = b - A x`, `d = gain D⁻¹ r`.
pub(super) struct Again<'a> {
    pub matrix: Matrix<'a>,
    pub chunk: usize,
    pub gain: f32,
    pub x: &'a [Quad],
    pub inverse: &'a [Inverse<f32>],
    pub b: &'a [Quad],
    pub r: &'a mut [Quad],
    pub d: &'a mut [Quad],
}

impl Kernel for Again<'_> {
    type Output = ();
    #[inline(always)]
    fn run<const W: usize>(self) {
        let Self { matrix, chunk, gain, x, inverse, b, r, d } = self;
        matrix.for_rows(chunk, x, b.len(), |row, q| {
            let v = Wide(b[row]) - q;
            r[row] = v.0;
            d[row] = (Wide::splat(gain) * times(&inverse[row], v)).0;
        });
    }
}

/// `r -= A d`, `e = keep d + gain D⁻¹ r`, `x += e`, and `x += d` where the last step has left that out.
pub(super) struct Advance<'a> {
    pub matrix: Matrix<'a>,
    pub chunk: usize,
    pub keep: f32,
    pub gain: f32,
    pub late: bool,
    pub d: &'a [Quad],
    /// The rows of the chunk in `d`.
    pub own: &'a [Quad],
    pub inverse: &'a [Inverse<f32>],
    pub r: &'a mut [Quad],
    pub e: &'a mut [Quad],
    pub x: &'a mut [Quad],
}

impl Kernel for Advance<'_> {
    type Output = ();
    #[inline(always)]
    fn run<const W: usize>(self) {
        let Self { matrix, chunk, keep, gain, late, d, own, inverse, r, e, x } = self;
        matrix.for_rows(chunk, d, r.len(), |row, q| {
            let (v, old) = (Wide(r[row]) - q, Wide(own[row]));
            r[row] = v.0;
            let step = Wide::splat(keep) * old + Wide::splat(gain) * times(&inverse[row], v);
            e[row] = step.0;
            let before = if late { Wide(x[row]) + old } else { Wide(x[row]) };
            x[row] = (before + step).0;
        });
    }
}

/// `r -= A d`.
pub(super) struct Reduce<'a> {
    pub matrix: Matrix<'a>,
    pub chunk: usize,
    pub d: &'a [Quad],
    pub r: &'a mut [Quad],
}

impl Kernel for Reduce<'_> {
    type Output = ();
    #[inline(always)]
    fn run<const W: usize>(self) {
        let Self { matrix, chunk, d, r } = self;
        matrix.for_rows(chunk, d, r.len(), |row, q| r[row] = (Wide(r[row]) - q).0);
    }
}

/// `y = x + D⁻¹ (b - A x)`: rows of one colour of a Gauss-Seidel sweep.
pub(super) struct Relax<'a> {
    pub matrix: Matrix<'a>,
    pub chunk: usize,
    pub x: &'a [Quad],
    /// The rows of the chunk in `x`.
    pub own: &'a [Quad],
    pub inverse: &'a [Inverse<f32>],
    pub b: &'a [Quad],
    pub y: &'a mut [Quad],
}

impl Kernel for Relax<'_> {
    type Output = ();
    #[inline(always)]
    fn run<const W: usize>(self) {
        let Self { matrix, chunk, x, own, inverse, b, y } = self;
        matrix.for_rows(chunk, x, b.len(), |row, q| {
            y[row] = (Wide(own[row]) + times(&inverse[row], Wide(b[row]) - q)).0;
        });
    }
}
