//! Loops of a level, each over the rows of one chunk: a row of a product is used the moment it is there.

use crate::solver::cubes::FreeCubes;
use crate::solver::pcg::kernel::{Inverse, StoreAndDot};
use crate::solver::sliced::{RowWork, Sliced};
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
    fn for_rows(self, chunk: usize, x: &[Quad], rows: usize, work: &mut impl RowWork<f32>) {
        match self {
            Self::Stored(matrix) => matrix.for_rows(chunk, x, work),
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
        let rows = y.len();
        let mut work = StoreAndDot { own, y, dot: Wide::zero() };
        matrix.for_rows(chunk, x, rows, &mut work);
        work.total()
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
    fn run<const W: usize>(mut self) {
        self.matrix.for_rows(self.chunk, self.x, self.b.len(), &mut self);
    }
}

impl RowWork<f32> for Again<'_> {
    #[inline(always)]
    fn row(&mut self, row: usize, q: Wide<f32, 4>) {
        let v = Wide(self.b[row]) - q;
        self.r[row] = v.0;
        self.d[row] = (Wide::splat(self.gain) * times(&self.inverse[row], v)).0;
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
    fn run<const W: usize>(mut self) {
        self.matrix.for_rows(self.chunk, self.d, self.own.len(), &mut self);
    }
}

impl RowWork<f32> for Advance<'_> {
    #[inline(always)]
    fn row(&mut self, row: usize, q: Wide<f32, 4>) {
        let (v, old) = (Wide(self.r[row]) - q, Wide(self.own[row]));
        self.r[row] = v.0;
        let step = Wide::splat(self.keep) * old + Wide::splat(self.gain) * times(&self.inverse[row], v);
        self.e[row] = step.0;
        let before = if self.late { Wide(self.x[row]) + old } else { Wide(self.x[row]) };
        self.x[row] = (before + step).0;
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
    fn run<const W: usize>(mut self) {
        self.matrix.for_rows(self.chunk, self.d, self.r.len(), &mut self);
    }
}

impl RowWork<f32> for Reduce<'_> {
    #[inline(always)]
    fn row(&mut self, row: usize, q: Wide<f32, 4>) {
        self.r[row] = (Wide(self.r[row]) - q).0;
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
    fn run<const W: usize>(mut self) {
        self.matrix.for_rows(self.chunk, self.x, self.b.len(), &mut self);
    }
}

impl RowWork<f32> for Relax<'_> {
    #[inline(always)]
    fn row(&mut self, row: usize, q: Wide<f32, 4>) {
        let step = times(&self.inverse[row], Wide(self.b[row]) - q);
        self.y[row] = (Wide(self.own[row]) + step).0;
    }
}
