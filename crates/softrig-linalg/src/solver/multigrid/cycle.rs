//! The V-cycle.

use super::SINGLE;
use super::coarsest::Coarsest;
use super::galerkin::{Galerkin, coarse_pattern};
use super::interpolation::Interpolation;
use super::level::{Level, order_for};
use super::settings::{Marking, MultigridSettings, Smoother};
use crate::par::Each;
use crate::solver::LinearSystem;
use crate::solver::free::{Blocks, FreePattern};
use crate::solver::quads::Quads;
use crate::solver::sliced::{Fault, Sliced};
use crate::{CubeMatrix, Rows, Scalar, Traffic, par};
use rayon::prelude::*;

/// Products of a cycle and the iteration around it: smoothing before and after, the residual between, the iteration's own.
fn products(smoother: Smoother) -> usize {
    match smoother {
        Smoother::Chebyshev { degree, .. } => 2 * degree.max(1) + 1,
        Smoother::GaussSeidel { before, after } => before.max(1) + after + 2,
    }
}

/// All levels of a constrained body.
pub(crate) struct Cycle {
    levels: Vec<Level>,
    /// Between level `l` and `l + 1`.
    galerkin: Vec<Galerkin>,
    coarsest: Coarsest,
}

impl std::fmt::Debug for Cycle {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Cycle").field("levels", &self.levels).finish_non_exhaustive()
    }
}

impl Cycle {
    /// `free` are the rows of the system, in the order of `colours`, both as [`order_for`] gives them. `None` when there is nothing
    /// to coarsen.
    pub fn new(
        hierarchy: &[Interpolation],
        free: Blocks,
        colours: Option<Vec<u32>>,
        settings: &MultigridSettings,
    ) -> Option<Self> {
        let first = hierarchy.first()?;
        let fits = free.node.iter().all(|n| (*n as usize) < first.fine_count());
        if free.row_count() == 0 || !fits {
            return None;
        }
        let mut kept = free.node.clone();
        let mut levels = vec![Level::new(&free, settings.smoother, colours)];
        let mut fine = free;
        let mut galerkin = Vec::new();
        for p in hierarchy {
            let (mut restricted, mut seen) = p.restricted(&kept, settings.marking);
            if restricted.coarse_count == 0 {
                break;
            }
            let mut colours = None;
            let found = || coarse_pattern(&fine, &restricted, seen.clone());
            if let Some((order, starts)) = order_for(settings.smoother, found) {
                seen = order.iter().map(|i| seen[*i as usize]).collect();
                restricted = p.between(&kept, &seen);
                colours = Some(starts);
            }
            let product = Galerkin::new(&fine, levels[levels.len() - 1].matrix(), &restricted);
            kept = seen;
            fine = product.coarse_pattern(kept.clone());
            levels.push(Level::new(&fine, settings.smoother, colours));
            galerkin.push(product);
        }
        if galerkin.is_empty() {
            return None;
        }
        Some(Self { levels, galerkin, coarsest: Coarsest::new(fine) })
    }

    /// Takes the rows of the system, whose pattern is `free`: products use these from now on.
    pub fn load<R: Scalar>(&mut self, free: &FreePattern, rows: &dyn Rows<R>) -> Result<(), Fault> {
        self.levels[0].load_rows(free, rows)
    }

    /// The matrix of the finest level.
    pub fn finest(&self) -> &Sliced<f32> {
        self.levels[0].matrix()
    }

    /// Takes the cubes of the finest level, whose pattern is `free`: products use these from now on.
    pub fn load_cubes<R: Scalar>(&mut self, matrix: &CubeMatrix<R>, free: &FreePattern) {
        self.levels[0].load_cubes(matrix, free);
    }

    /// The pattern stays, but other rows of it are held. Coarse operators have to be rebuilt.
    pub fn hold(&mut self, hierarchy: &[Interpolation], free: &FreePattern, marking: Marking) {
        self.levels[0].hold();
        let mut held: Vec<bool> = (0..free.row_count()).map(|row| free.is_held(row)).collect();
        for ((p, galerkin), levels) in hierarchy.iter().zip(&mut self.galerkin).zip(self.levels.windows(2)) {
            let whole = p.between(&levels[0].pattern.node, &levels[1].pattern.node);
            let (masked, left_out) = whole.masked(&held, marking);
            galerkin.set_weights(&masked);
            held = left_out;
        }
    }

    /// Lets coarse operators turn with the cells of this system: those of the second level, in whose frames all below it are.
    pub fn follow<R: Scalar>(&mut self, system: &mut dyn LinearSystem<R>) {
        let (node, rotation) = self.levels[0].scratch();
        let turns = system.rotations(node, rotation);
        self.galerkin[0].follow(turns.then_some(rotation));
    }

    /// How far parts of the body have turned against their surroundings since the coarse operators were made [rad]; NaN where nobody
    /// knows.
    pub fn shear(&self) -> f64 {
        self.galerkin[0].shear()
    }

    /// Rows of the finest level without a single entry.
    pub fn identity(&self) -> &[bool] {
        self.levels[0].identity()
    }

    /// Drops what it knows of earlier matrices.
    pub fn forget(&mut self) {
        self.levels.iter_mut().for_each(Level::forget);
        self.galerkin[0].follow(None);
    }

    /// Products with the finest matrix that a cycle and the iteration around it are worth, in f64.
    pub fn work(&self, smoother: Smoother) -> f64 {
        let products = products(smoother);
        let blocks = |level: &Level| level.pattern.block_count() as f64;
        let all: f64 = self.levels[..self.levels.len() - 1].iter().map(blocks).sum();
        SINGLE * products as f64 * all / blocks(&self.levels[0]).max(1.0)
    }

    /// What a cycle and the iteration around it read and write.
    pub fn traffic(&self, smoother: Smoother) -> Traffic {
        let fine: usize = self.levels[..self.levels.len() - 1].iter().map(Level::bytes).sum();
        // up and down between the levels
        let between: usize = self.galerkin.iter().map(|g| 2 * 8 * g.interpolation().column.len()).sum();
        Traffic { moved: products(smoother) * fine + between, held: fine + between / 2 }
    }

    /// `q = A p` on the finest level; returns `pᵀ q`.
    pub fn product_dot(&mut self, p: &Quads<f32>, q: &mut Quads<f32>) -> f64 {
        self.levels[0].product_dot(p, q)
    }

    /// Makes the coarse operators from the blocks of the finest level, whose rows have been loaded.
    pub fn rebuild(&mut self) {
        for (l, galerkin) in self.galerkin.iter_mut().enumerate() {
            let (fine, coarse) = self.levels.split_at_mut(l + 1);
            galerkin.refresh(&fine[l].pattern, fine[l].matrix());
            // a diagonal block that has no inverse is left out of the smoothing
            let _ = coarse[0].load(&|row, k| galerkin.coarse_block(row, k));
        }
        for level in &mut self.levels {
            level.estimate_spectrum();
        }
        self.coarsest.expire();
    }

    /// `z = V r`: one cycle from zero.
    pub fn apply<R: Scalar>(&mut self, r: &[[R; 4]], z: &mut [[R; 4]]) {
        // f32 has room for the residual of any scaled system, but not for squares of tiny ones: scale to about 1
        let largest_of = |r: &[[R; 4]]| {
            let larger =
                |m: [R; 4], r: &[R; 4]| std::array::from_fn(|k| if r[k].abs() > m[k] { r[k].abs() } else { m[k] });
            r.iter().fold([R::zero(); 4], larger).iter().fold(0.0, |m: f64, v| m.max(v.to_f64()))
        };
        let largest = par::fold(r.len(), |range| largest_of(&r[range]), f64::max);
        // by a power of two, which rounds nothing
        let exponent = if largest > 0.0 { -largest.log2().floor().clamp(-1000.0, 1000.0) } else { 0.0 };
        let (scale, back) = (exponent.exp2(), (-exponent).exp2());
        self.levels[0].b.get_mut().par_iter_mut().zip(r).with_min_len(par::CHUNK).each(|(b, r)| {
            *b = r.map(|v| (v.to_f64() * scale) as f32);
        });
        self.descend(0);
        z.par_iter_mut().zip(self.levels[0].x.get()).with_min_len(par::CHUNK).each(|(z, x)| {
            *z = x.map(|v| R::from_f64(f64::from(v) * back));
        });
    }

    fn descend(&mut self, l: usize) {
        if l + 1 == self.levels.len() {
            self.coarsest.solve(&mut self.levels[l]);
            return;
        }
        let Self { levels, galerkin, coarsest } = self;
        if coarsest.is_due() {
            // on one thread, while the other ones smooth
            let last = &galerkin[galerkin.len() - 1];
            rayon::join(|| coarsest.factorise(last), || levels[l].smooth_from_zero());
        } else {
            levels[l].smooth_from_zero();
        }
        let (fine, coarse) = self.levels.split_at_mut(l + 1);
        self.galerkin[l].restrict(fine[l].r.get(), coarse[0].b.get_mut());
        self.descend(l + 1);
        let (fine, coarse) = self.levels.split_at_mut(l + 1);
        self.galerkin[l].interpolate_add(coarse[0].x.get_mut(), fine[l].x.get_mut());
        fine[l].smooth();
    }
}
