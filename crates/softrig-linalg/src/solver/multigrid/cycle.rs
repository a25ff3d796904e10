//! The V-cycle.

use super::galerkin::{Galerkin, interpolate_add};
use super::interpolation::Interpolation;
use super::level::Level;
use crate::solver::free::FreePattern;
use crate::solver::pcg::kernel::Inverse;
use crate::solver::quads::Quads;
use crate::{CubeMatrix, Scalar};
use faer::linalg::solvers::{Llt, Solve};
use faer::{Mat, Side};

/// Relative shift of the coarsest diagonal: interpolation next to constraints can be rank deficient (numerics 5.3), and
/// rounding of the operators to f32 can leave the smallest pivots below zero.
const SHIFT: f64 = 1e-6;

/// All levels of a constrained body.
#[derive(Debug)]
pub(crate) struct Cycle {
    levels: Vec<Level>,
    /// Between level `l` and `l + 1`.
    galerkin: Vec<Galerkin>,
    coarsest: Option<Llt<f64>>,
    coarsest_rhs: Mat<f64>,
}

impl Cycle {
    /// `None` when there is nothing to coarsen.
    pub fn new(hierarchy: &[Interpolation], free: &FreePattern) -> Option<Self> {
        let first = hierarchy.first()?;
        let fits = free.node.last().is_none_or(|n| (*n as usize) < first.fine_count());
        if free.row_count() == 0 || !fits {
            return None;
        }
        let mut kept = free.node.clone();
        let mut levels = vec![Level::new(free.clone_structure())];
        let mut galerkin = Vec::new();
        for p in hierarchy {
            let (restricted, seen) = p.restricted(&kept);
            if restricted.coarse_count == 0 {
                break;
            }
            let fine = &levels[levels.len() - 1].pattern;
            let product = Galerkin::new(fine, restricted);
            levels.push(Level::new(product.coarse_pattern()));
            galerkin.push(product);
            kept = seen;
        }
        if galerkin.is_empty() {
            return None;
        }
        let n = 3 * levels[levels.len() - 1].pattern.row_count();
        Some(Self { levels, galerkin, coarsest: None, coarsest_rhs: Mat::zeros(n, 1) })
    }

    /// Blocks and inverted diagonal blocks of the finest level, to be filled.
    pub fn finest_mut(&mut self) -> (&mut [f32], &mut [Inverse<f32>]) {
        self.levels[0].parts_mut()
    }

    /// Makes the finest level use the blocks.
    pub fn forget_cubes(&mut self) {
        self.levels[0].set_cubes::<f32>(None);
    }

    /// `q = A p` on the finest level; writes the first of each `partial`: `pᵀ q` over a chunk of rows.
    pub fn product_dot<A: Scalar>(&mut self, p: &Quads<A>, q: &mut Quads<A>, partial: &mut [[f64; 2]]) {
        self.levels[0].product_dot(p, q, partial);
    }

    /// Takes the cubes for the finest level. For [`Self::rebuild`] it must have been given the stored matrix as well, before.
    pub fn load_cubes<R: Scalar>(&mut self, matrix: &CubeMatrix<R>) {
        self.levels[0].set_cubes(Some(matrix));
    }

    /// Makes the coarse operators from the matrix stored last.
    pub fn rebuild(&mut self) {
        for l in 0..self.galerkin.len() {
            let (fine, coarse) = self.levels.split_at_mut(l + 1);
            self.galerkin[l].refresh(&fine[l].pattern, fine[l].blocks(), coarse[0].blocks_mut());
            coarse[0].invert_diagonal();
        }
        for level in &mut self.levels {
            level.estimate_spectrum();
        }
        self.factorise();
    }

    fn factorise(&mut self) {
        let level = &self.levels[self.levels.len() - 1];
        let n = level.pattern.row_count();
        let mut a = Mat::<f64>::zeros(3 * n, 3 * n);
        for i in 0..n {
            for k in level.pattern.row(i) {
                let (j, block) = (level.pattern.column[k] as usize, level.blocks()[k]);
                for r in 0..3 {
                    for c in 0..3 {
                        a[(3 * i + r, 3 * j + c)] = f64::from(block[3 * r + c]);
                    }
                }
            }
        }
        let largest = (0..3 * n).map(|i| a[(i, i)]).fold(0.0, f64::max);
        for i in 0..3 * n {
            a[(i, i)] += SHIFT * a[(i, i)].max(1e-6 * largest);
        }
        self.coarsest = Llt::new(a.as_ref(), Side::Lower).ok();
    }

    /// `z = V r`: one cycle from zero.
    pub fn apply<R: Scalar>(&mut self, r: &[[R; 4]], z: &mut [[R; 4]]) {
        // f32 has room for the residual of any scaled system, but not for squares of tiny ones: scale to 1
        let largest = r.iter().flatten().fold(0.0f64, |m, v| m.max(v.to_f64().abs()));
        let scale = if largest > 0.0 { 1.0 / largest } else { 1.0 };
        for (b, r) in self.levels[0].b.get_mut().iter_mut().zip(r) {
            *b = r.map(|v| (v.to_f64() * scale) as f32);
        }
        self.descend(0);
        for (z, x) in z.iter_mut().zip(self.levels[0].x.get()) {
            *z = x.map(|v| R::from_f64(f64::from(v) / scale));
        }
    }

    fn descend(&mut self, l: usize) {
        if l + 1 == self.levels.len() {
            self.solve_coarsest();
            return;
        }
        self.levels[l].smooth_from_zero();
        let (fine, coarse) = self.levels.split_at_mut(l + 1);
        coarse[0].b.get_mut().fill([0.0; 4]);
        interpolate_add(self.galerkin[l].restriction(), fine[l].r.get(), coarse[0].b.get_mut());
        self.descend(l + 1);
        let (fine, coarse) = self.levels.split_at_mut(l + 1);
        interpolate_add(self.galerkin[l].interpolation(), coarse[0].x.get(), fine[l].x.get_mut());
        fine[l].smooth();
    }

    fn solve_coarsest(&mut self) {
        let last = self.levels.len() - 1;
        let level = &mut self.levels[last];
        let Some(factor) = &self.coarsest else {
            // not positive definite even with the shift: smoothing alone is still a valid preconditioner
            level.smooth_from_zero();
            return;
        };
        for (i, b) in level.b.get().iter().enumerate() {
            (0..3).for_each(|k| self.coarsest_rhs[(3 * i + k, 0)] = f64::from(b[k]));
        }
        factor.solve_in_place(self.coarsest_rhs.as_mut());
        for (i, x) in level.x.get_mut().iter_mut().enumerate() {
            *x = std::array::from_fn(|k| if k < 3 { self.coarsest_rhs[(3 * i + k, 0)] as f32 } else { 0.0 });
        }
    }
}
