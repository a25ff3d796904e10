//! Geometric multigrid on eliminated systems [Georgii2010 §3.2].
//!
//! By default one symmetric V-cycle preconditions each iteration of conjugate gradients: Chebyshev smoothing, Galerkin coarse
//! operators, dense Cholesky on the coarsest level. [`MultigridSettings`] has the other choices, those of the paper among them.
//! Constrained nodes take no part: their rows of the interpolation are left out, and so are coarse nodes that [`Marking`]
//! finds to be left without free nodes. Cycle and iteration run in f32 on what is left to solve for (the iteration in
//! the caller's numbers where many digits are asked for); residuals are those of the caller's system in f64, and what is
//! reported is the true residual.

mod colour;
mod cycle;
mod galerkin;
mod interpolation;
mod level;
mod precondition;
mod products;
mod settings;

pub use interpolation::Interpolation;
pub use settings::{Marking, MultigridSettings, Outer, Rebuild, Smoother};

pub(super) use cycle::Cycle;

use super::free::FreePattern;
use super::pcg::{Pcg, Source};
use super::{LinearSolver, LinearSystem, Preconditioner, SolveError, SolveReport, Stored, Traffic};
use crate::{BlockCsr, BlockPattern, DofConstraints, Scalar};
use level::order_for;
use std::sync::Arc;

/// Below this tolerance the iteration runs in the caller's numbers: f32 would have to start again too often.
const BELOW_SINGLE: f64 = 1e-5;

/// Loading a system and the coarse operators that have to be made now and then, in products in f64.
const SETUP_WORK: f64 = 6.0;
/// A product in f32 in products in f64: half the bytes.
const SINGLE: f64 = 0.5;

/// Conjugate gradients preconditioned by one multigrid V-cycle, or cycles alone.
#[derive(Debug)]
pub struct Multigrid<R> {
    settings: MultigridSettings,
    /// Interpolations from level to level of the unconstrained body, finest first.
    hierarchy: Arc<[Interpolation]>,
    pcg: Pcg<f32>,
    /// For systems f32 cannot hold; made when one comes.
    exact: Option<Pcg<R>>,
    prepared: Option<Prepared>,
    cycle: Option<Cycle>,
    /// Iterations of the first solve after the last rebuild of the coarse operators.
    fresh: Option<usize>,
    /// Rotations of the cells at the last rebuild, and now.
    built: Vec<[R; 4]>,
    turned: Vec<[R; 4]>,
}

/// What the system was prepared for: its pattern, and the nodes of its free rows in their order.
#[derive(Debug)]
struct Prepared {
    pattern: Arc<BlockPattern>,
    order: Vec<u32>,
}

impl<R: Scalar> Multigrid<R> {
    /// `hierarchy[0].start` has one row per node of the systems to come. An empty hierarchy makes this plain [`Pcg`].
    #[must_use]
    pub fn new(hierarchy: Vec<Interpolation>) -> Self {
        Self::with_settings(hierarchy, MultigridSettings::default())
    }

    /// With other settings.
    #[must_use]
    pub fn with_settings(hierarchy: Vec<Interpolation>, settings: MultigridSettings) -> Self {
        Self {
            settings,
            hierarchy: hierarchy.into(),
            pcg: Pcg::new(),
            exact: None,
            prepared: None,
            cycle: None,
            fresh: None,
            built: Vec::new(),
            turned: Vec::new(),
        }
    }

    /// What a solve of so many iterations costs, in products with the matrix of the system by one that is stored in f64.
    pub(super) fn work(&self, iterations: usize) -> f64 {
        self.cycle.as_ref().map_or(iterations as f64, |c| c.work(self.settings.smoother) * iterations as f64)
            + SETUP_WORK
    }

    /// In the caller's numbers: where there is nothing to coarsen, and where f32 has failed.
    fn solve_exactly(
        &mut self,
        system: &mut dyn LinearSystem<R>,
        rhs: &[[R; 3]],
        solution: &mut [[R; 3]],
        tolerance: f64,
    ) -> Result<SolveReport, SolveError> {
        let exact = exact_solver(&mut self.exact, self.prepared.as_ref())?;
        exact.solve_with(Source::of(system), rhs, solution, tolerance, self.cycle.as_mut(), true)
    }

    /// Are the coarse operators too old for this system?
    fn is_stale(&mut self, system: &mut dyn LinearSystem<R>) -> bool {
        match self.settings.rebuild {
            Rebuild::WhenSlower => false,
            Rebuild::EverySolve => true,
            Rebuild::WhenTurned(angle) => {
                system.rotations(&mut self.turned);
                let least = (0.5 * angle.clamp(0.0, std::f64::consts::PI)).cos();
                let same = |(a, b): (&[R; 4], &[R; 4])| {
                    (0..4).map(|k| a[k].to_f64() * b[k].to_f64()).sum::<f64>().abs() >= least
                };
                let known = !self.turned.is_empty() && self.turned.len() == self.built.len();
                !(known && self.turned.iter().zip(&self.built).all(same))
            }
        }
    }

    /// Keeps count of what the last rebuild is still worth.
    fn note(&mut self, iterations: usize) {
        let fresh = *self.fresh.get_or_insert(iterations.max(1));
        // half as many again, and two: small counts jitter
        if self.settings.rebuild == Rebuild::WhenSlower && iterations > fresh + fresh / 2 + 2 {
            self.fresh = None;
        }
    }
}

impl<R: Scalar> LinearSolver<R> for Multigrid<R> {
    fn name(&self) -> &'static str {
        match self.settings.outer {
            Outer::ConjugateGradients => "mgpcg",
            Outer::Cycles { .. } => "multigrid",
        }
    }

    fn traffic(&self) -> Option<Traffic> {
        self.cycle.as_ref().map(|c| c.traffic(self.settings.smoother))
    }

    fn prepare(&mut self, pattern: &Arc<BlockPattern>, constraints: &DofConstraints) -> Result<(), SolveError> {
        let mut free = FreePattern::new(pattern, constraints);
        let colours = order_for(self.settings.smoother, &free).map(|(order, colours)| {
            let node = order.iter().map(|row| free.node[*row as usize]).collect();
            free = FreePattern::in_order(pattern, node);
            colours
        });
        self.cycle = Cycle::new(&self.hierarchy, &free, colours, &self.settings);
        self.prepared = Some(Prepared { pattern: pattern.clone(), order: free.node.clone() });
        self.pcg.prepare_free(pattern, free);
        self.exact = None;
        self.fresh = None;
        Ok(())
    }

    fn solve(
        &mut self,
        matrix: &BlockCsr<R>,
        rhs: &[[R; 3]],
        solution: &mut [[R; 3]],
        tolerance: f64,
    ) -> Result<SolveReport, SolveError> {
        self.solve_system(&mut Stored(matrix), rhs, solution, tolerance)
    }

    fn solve_system(
        &mut self,
        system: &mut dyn LinearSystem<R>,
        rhs: &[[R; 3]],
        solution: &mut [[R; 3]],
        tolerance: f64,
    ) -> Result<SolveReport, SolveError> {
        if self.cycle.is_none() {
            return self.solve_exactly(system, rhs, solution, tolerance);
        }
        let rebuild = self.is_stale(system) || self.fresh.is_none();
        let Some(cycle) = &mut self.cycle else { return Err(SolveError::NotPrepared) };
        let cubes = matches!(self.settings.smoother, Smoother::Chebyshev { .. }) && system.cubes().is_some();
        if !cubes {
            let matrix = system.assembled();
            self.pcg.check(matrix, rhs, solution)?;
            let free = self.pcg.free();
            cycle.load(&free.block_of(matrix)).map_err(|fault| free.blame(&fault))?;
            if rebuild {
                cycle.rebuild(&free.block_of(matrix));
            }
            self.pcg.set_identity(cycle.identity());
        } else {
            if let Some(matrix) = system.cubes() {
                cycle.load_cubes(matrix);
            }
            if rebuild {
                let matrix = system.assembled();
                self.pcg.check(matrix, rhs, solution)?;
                cycle.rebuild(&self.pcg.free().block_of(matrix));
            }
        }
        if rebuild {
            std::mem::swap(&mut self.built, &mut self.turned);
        }
        let source = if cubes { Source::of(system) } else { Source::Stored(system.assembled()) };
        let report = match self.settings.outer {
            Outer::Cycles { count } => self.pcg.cycle_with(source, rhs, solution, tolerance, cycle, count),
            Outer::ConjugateGradients if tolerance < BELOW_SINGLE => {
                let exact = exact_solver(&mut self.exact, self.prepared.as_ref())?;
                exact.solve_with(source, rhs, solution, tolerance, Some(cycle), true)
            }
            Outer::ConjugateGradients => self.pcg.solve_with(source, rhs, solution, tolerance, Some(cycle), false),
        };
        match report {
            Ok(r) => {
                self.note(r.iterations);
                Ok(SolveReport { solver: self.name(), rebuilt: rebuild, ..r })
            }
            // stale coarse operators must not fail a solve
            Err(_) if !rebuild => {
                self.fresh = None;
                self.solve_system(system, rhs, solution, tolerance)
            }
            Err(e) => {
                self.fresh = None;
                match self.settings.outer {
                    Outer::ConjugateGradients => self.solve_exactly(system, rhs, solution, tolerance),
                    Outer::Cycles { .. } => Err(e),
                }
            }
        }
    }

    fn forget(&mut self) {
        self.fresh = None;
        self.built.clear();
        if let Some(cycle) = &mut self.cycle {
            cycle.forget();
        }
    }

    fn preconditioner(&mut self) -> Option<&mut dyn Preconditioner<R>> {
        // a multicolour sweep and a product go through the entries; whichever smoother, one cycle is symmetric
        if self.cycle.is_some() { Some(self) } else { None }
    }
}

/// The iteration in the caller's numbers, made on first use.
fn exact_solver<'a, R: Scalar>(
    exact: &'a mut Option<Pcg<R>>,
    prepared: Option<&Prepared>,
) -> Result<&'a mut Pcg<R>, SolveError> {
    let prepared = prepared.ok_or(SolveError::NotPrepared)?;
    Ok(exact.get_or_insert_with(|| {
        let mut made = Pcg::new();
        made.prepare_free(&prepared.pattern, FreePattern::in_order(&prepared.pattern, prepared.order.clone()));
        made
    }))
}
