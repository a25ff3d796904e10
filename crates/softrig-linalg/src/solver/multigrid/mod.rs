//! Geometric multigrid on eliminated systems [Georgii2010 §3.2].
//!
//! By default one symmetric V-cycle preconditions each iteration of conjugate gradients: Chebyshev smoothing, Galerkin coarse
//! operators, dense Cholesky on the coarsest level. [`MultigridSettings`] has the other choices, those of the paper among them.
//! Constrained nodes take no part: their rows of the interpolation are left out, and so are coarse nodes that [`Marking`]
//! finds to be left without free nodes. Cycle and iteration run in f32 on what is left to solve for (the iteration in
//! the caller's numbers where many digits are asked for); residuals are those of the caller's system in f64, and what is
//! reported is the true residual.

mod age;
mod coarsest;
mod colour;
mod cycle;
mod frames;
mod galerkin;
mod interpolation;
mod level;
mod pattern;
mod precondition;
mod products;
mod settings;

pub use interpolation::Interpolation;
pub use settings::{Marking, MultigridSettings, Outer, Rebuild, Smoother};

pub(super) use cycle::Cycle;

use super::free::FreePattern;
use super::pcg::{Asked, ITERATION_LIMIT, Iteration};
use super::{BELOW_SINGLE, LinearSolver, LinearSystem, Preconditioner, SolveError, SolveReport, Stored, Traffic};
use crate::{BlockCsr, BlockPattern, DofConstraints, Scalar, either};
use age::Age;
use level::order_for;
use std::sync::Arc;

/// Loading a system and the coarse operators that have to be made now and then, in products in f64.
const SETUP_WORK: f64 = 6.0;
/// What a rebuild of the coarse operators costs, in iterations: of a stored matrix, and of cubes, which have to be assembled for it.
/// Counted in blocks for three levels, and about what is measured.
const REBUILD: [f64; 2] = [4.0, 6.0];
/// A product in f32 in products in f64: half the bytes.
pub(super) const SINGLE: f64 = 0.5;

/// Conjugate gradients preconditioned by one multigrid V-cycle, or cycles alone.
#[derive(Debug)]
pub struct Multigrid<R> {
    settings: MultigridSettings,
    /// Interpolations from level to level of the unconstrained body, finest first.
    hierarchy: Arc<[Interpolation]>,
    pcg: Iteration<f32>,
    /// For systems f32 cannot hold; made when one comes.
    exact: Option<Iteration<R>>,
    cycle: Option<Cycle>,
    age: Age,
    memory: Vec<[R; 3]>,
}

/// [`Multigrid`] behind its trait.
#[must_use]
pub fn multigrid<R: Scalar>(hierarchy: Vec<Interpolation>, settings: MultigridSettings) -> Box<dyn LinearSolver<R>> {
    either(|| single(hierarchy.clone(), settings), || double(hierarchy.clone(), settings))
}

fn single(hierarchy: Vec<Interpolation>, settings: MultigridSettings) -> Box<dyn LinearSolver<f32>> {
    Box::new(Multigrid::with_settings(hierarchy, settings))
}

fn double(hierarchy: Vec<Interpolation>, settings: MultigridSettings) -> Box<dyn LinearSolver<f64>> {
    Box::new(Multigrid::with_settings(hierarchy, settings))
}

impl<R: Scalar> Multigrid<R> {
    /// `hierarchy[0].start` has one row per node of the systems to come. An empty hierarchy makes this plain [`super::Pcg`].
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
            pcg: Iteration::new(ITERATION_LIMIT),
            exact: None,
            cycle: None,
            age: Age::default(),
            memory: Vec::new(),
        }
    }

    /// Symbolic work for these nodes.
    fn prepare_rows(&mut self, pattern: &Arc<BlockPattern>, node: Vec<u32>) {
        let mut free = FreePattern::in_order(pattern, node);
        let mut blocks = free.blocks(pattern);
        let colours = order_for(self.settings.smoother, || &blocks).map(|(order, colours)| {
            let node = order.iter().map(|row| free.node[*row as usize]).collect();
            free = FreePattern::in_order(pattern, node);
            blocks = free.blocks(pattern);
            colours
        });
        self.cycle = Cycle::new(&self.hierarchy, blocks, colours, &self.settings);
        self.pcg.prepare(pattern, Arc::new(free));
        self.exact = None;
        self.age = Age::default();
    }

    /// Rows stay, others of them are held: an exchange costs no symbolic work.
    fn hold(&mut self, free: Arc<FreePattern>) {
        if let Some(cycle) = &mut self.cycle {
            cycle.hold(&self.hierarchy, &free, self.settings.marking);
        }
        if let Some(exact) = &mut self.exact {
            exact.hold(free.clone());
        }
        self.pcg.hold(free);
    }

    /// Leaves out the rows that are held, so that nothing remains of the nodes that were free before.
    fn compact(&mut self) {
        if let Some(pattern) = self.pcg.prepared().cloned().filter(|_| self.pcg.free().is_masked()) {
            let mut node = self.pcg.free().free_nodes();
            node.sort_unstable();
            self.prepare_rows(&pattern, node);
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
        let exact = self.pcg.beside(&mut self.exact)?;
        let asked = &mut Asked { system, memory: &mut self.memory };
        exact.solve_with(asked, rhs, solution, tolerance, self.cycle.as_mut(), true)
    }

    /// Gives the cycle a system: the cubes where it has some and the smoother can use them, the rows otherwise, and for a rebuild.
    /// Returns whether products take the cubes.
    fn load_cycle(&mut self, system: &mut dyn LinearSystem<R>, rebuild: bool) -> Result<bool, SolveError> {
        let cycle = self.cycle.as_mut().ok_or(SolveError::NotPrepared)?;
        let free = self.pcg.free();
        let cubes = matches!(self.settings.smoother, Smoother::Chebyshev { .. }) && system.cubes().is_some();
        if rebuild || !cubes {
            cycle.load(free, system.rows()).map_err(|fault| free.blame(&fault))?;
        }
        if let Some(matrix) = system.cubes().filter(|_| cubes) {
            cycle.load_cubes(matrix, free);
        }
        if rebuild {
            cycle.rebuild();
        }
        Ok(cubes)
    }

    /// Turns the coarse operators with the cells of this system. Are they too old for it all the same?
    fn is_stale(&mut self, system: &mut dyn LinearSystem<R>) -> bool {
        let Some(cycle) = &mut self.cycle else { return true };
        if self.settings.rebuild == Rebuild::EverySolve {
            return true;
        }
        cycle.follow(system);
        let turned = |angle| {
            let shear = cycle.shear();
            shear.is_nan() || shear > angle
        };
        self.age.is_over() || matches!(self.settings.rebuild, Rebuild::WhenTurned(angle) if turned(angle))
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
        let known = self.pcg.prepared().is_some_and(|p| Arc::ptr_eq(p, pattern) || **p == **pattern);
        let exchanged = |free: &FreePattern| if known { free.exchanged(constraints) } else { None };
        let mut masked = exchanged(self.pcg.free());
        if masked.is_none() {
            // whoever exchanges once does it again: rows that have been free stay
            let united = if known { self.pcg.free().united(constraints) } else { None };
            let node = united.unwrap_or_else(|| constraints.free_nodes());
            self.prepare_rows(pattern, node);
            masked = exchanged(self.pcg.free());
        }
        if let Some(free) = masked.filter(|free| free.is_masked() || self.pcg.free().is_masked()) {
            self.hold(Arc::new(free));
        }
        self.age = Age::default();
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
        self.pcg.check(system, rhs, solution)?;
        let rebuild = self.is_stale(system);
        let cubes = self.load_cycle(system, rebuild)?;
        let Some(cycle) = &mut self.cycle else { return Err(SolveError::NotPrepared) };
        self.pcg.set_identity(cycle.identity());
        if rebuild {
            self.age = Age::default();
        }
        let asked = &mut Asked { system, memory: &mut self.memory };
        let report = match self.settings.outer {
            Outer::Cycles { count } => self.pcg.cycle_with(asked, rhs, solution, tolerance, cycle, count),
            Outer::ConjugateGradients if tolerance < BELOW_SINGLE => {
                let exact = self.pcg.beside(&mut self.exact)?;
                exact.solve_with(asked, rhs, solution, tolerance, Some(cycle), true)
            }
            Outer::ConjugateGradients => self.pcg.solve_with(asked, rhs, solution, tolerance, Some(cycle), false),
        };
        match report {
            Ok(r) => {
                let worth = match self.settings.rebuild {
                    Rebuild::WhenSlower => REBUILD[usize::from(cubes)],
                    _ => f64::INFINITY,
                };
                self.age.note(&r, worth);
                Ok(SolveReport { solver: self.name(), rebuilt: rebuild, ..r })
            }
            // stale coarse operators must not fail a solve
            Err(_) if !rebuild => {
                self.age = Age::default();
                self.solve_system(system, rhs, solution, tolerance)
            }
            Err(e) => {
                self.age = Age::default();
                match self.settings.outer {
                    Outer::ConjugateGradients => self.solve_exactly(system, rhs, solution, tolerance),
                    Outer::Cycles { .. } => Err(e),
                }
            }
        }
    }

    fn forget(&mut self) {
        self.compact();
        self.age = Age::default();
        if let Some(cycle) = &mut self.cycle {
            cycle.forget();
        }
    }

    fn preconditioner(&mut self) -> Option<&mut dyn Preconditioner<R>> {
        self.compact();
        // a multicolour sweep and a product go through the entries; whichever smoother, one cycle is symmetric
        if self.cycle.is_some() { Some(self) } else { None }
    }
}
