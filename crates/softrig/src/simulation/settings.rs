//! How a simulation is computed, and what a frame reports.

use crate::integrate::{Dynamics, StepOutput};
use crate::mesh::{HierarchyOptions, Prolongation, VolumeMesh, hierarchy};
use softrig_linalg::solver::{Auto, Direct, Interpolation, Multigrid, MultigridSettings, Pcg};
use softrig_linalg::{LinearSolver, Scalar, either};

/// Which linear solver.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SolverKind {
    /// Conjugate gradients preconditioned by a multigrid cycle, on the body's own lattice or on one laid under it: the
    /// default. Bodies of a few nodes are solved as by `Pcg`.
    #[default]
    Multigrid,
    /// Conjugate gradients with inverted 3x3 diagonal blocks: least memory, and faster for small steps of stiff bodies.
    Pcg,
    /// Sparse Cholesky factorisation: for small or very stiff bodies.
    Direct,
    /// `Multigrid` or `Pcg` for every solve, by counted work.
    Auto,
}

impl SolverKind {
    /// Name as written in scene files and on the command line.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Multigrid => "multigrid",
            Self::Pcg => "pcg",
            Self::Direct => "direct",
            Self::Auto => "auto",
        }
    }

    /// The solver for a body of that mesh, with the default levels and smoother.
    #[must_use]
    pub fn build<R: Scalar>(self, mesh: &VolumeMesh) -> Box<dyn LinearSolver<R>> {
        self.build_with(mesh, &MultigridOptions::default())
    }

    /// The solver for a body of that mesh.
    #[must_use]
    pub fn build_with<R: Scalar>(self, mesh: &VolumeMesh, options: &MultigridOptions) -> Box<dyn LinearSolver<R>> {
        either(|| single(self, mesh, options), || double(self, mesh, options))
    }
}

fn single(kind: SolverKind, mesh: &VolumeMesh, options: &MultigridOptions) -> Box<dyn LinearSolver<f32>> {
    build(kind, mesh, options)
}

fn double(kind: SolverKind, mesh: &VolumeMesh, options: &MultigridOptions) -> Box<dyn LinearSolver<f64>> {
    build(kind, mesh, options)
}

fn build<R: Scalar>(kind: SolverKind, mesh: &VolumeMesh, options: &MultigridOptions) -> Box<dyn LinearSolver<R>> {
    let levels = || interpolations(hierarchy(mesh, &options.hierarchy));
    let multigrid = || Multigrid::with_settings(levels(), options.settings);
    match kind {
        SolverKind::Multigrid => Box::new(multigrid()),
        SolverKind::Pcg => Box::new(Pcg::default()),
        SolverKind::Direct => Box::new(Direct::default()),
        SolverKind::Auto => Box::new(Auto::new(multigrid())),
    }
}

/// What multigrid solvers are made of.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct MultigridOptions {
    /// Number and size of the levels.
    pub hierarchy: HierarchyOptions,
    /// What is done on them.
    pub settings: MultigridSettings,
}

/// Interpolations as the solvers take them.
#[must_use]
pub fn interpolations(levels: Vec<Prolongation>) -> Vec<Interpolation> {
    let level = |mut p: Prolongation| {
        p.column.shrink_to_fit();
        p.weight.shrink_to_fit();
        Interpolation { coarse_count: p.coarse_count, start: p.start, column: p.column, weight: p.weight }
    };
    levels.into_iter().map(level).collect()
}

/// Settings of a simulation.
#[derive(Clone, Debug, PartialEq)]
pub struct SimulationSettings {
    /// Time integration preset.
    pub dynamics: Dynamics,
    /// Linear solver.
    pub solver: SolverKind,
    /// What [`SolverKind::Multigrid`] and [`SolverKind::Auto`] are made of.
    pub multigrid: MultigridOptions,
    /// Relative residual of every linear solve [-]. Default 1e-3: the motion repeats to a millimetre; baking uses 1e-6.
    pub tolerance: f64,
    /// Acceleration of gravity [m/s2].
    pub gravity: [f64; 3],
    /// How long the flesh settles in the first pose [s]. Default 0.5.
    pub preroll: f64,
    /// Whether the rest shape sags under gravity. Without, it is taken as already in balance.
    pub sag: bool,
    /// Longest time step [s]. Default 1/60: longer frames are cut into steps.
    pub longest_step: f64,
    /// A two-way step is linearised at least so often [-]. Default 2: joints that turn by finite angles need the second look where
    /// flesh is stiff (3e7 Pa swings to and fro with one); soft flesh in calm motion does with 1, at half the cost.
    pub coupled_linearisations: usize,
}

impl Default for SimulationSettings {
    fn default() -> Self {
        Self {
            dynamics: Dynamics::default(),
            solver: SolverKind::default(),
            multigrid: MultigridOptions::default(),
            tolerance: 1e-3,
            gravity: [0.0, -9.81, 0.0],
            preroll: 0.5,
            sag: true,
            longest_step: 1.0 / 60.0,
            coupled_linearisations: 2,
        }
    }
}

/// What advancing by one frame did.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FrameReport {
    /// Time steps of the frame.
    pub substeps: usize,
    /// Explicit steps they were cut into; 0 for implicit methods.
    pub explicit_steps: usize,
    /// Linear iterations of all its solves.
    pub iterations: usize,
    /// Largest true relative residual [-].
    pub residual: f64,
    /// Steps in which a solve missed the tolerance.
    pub unconverged_steps: usize,
    /// Steps the growth guard redid with implicit Euler.
    pub guarded_steps: usize,
    /// The bones jumped and the flesh was carried over instead of simulated through.
    pub teleported: bool,
}

impl FrameReport {
    pub(super) fn add_step<R>(&mut self, step: &StepOutput<R>) {
        self.explicit_steps += step.substeps;
        self.iterations += step.iterations;
        self.residual = self.residual.max(step.residual);
        self.unconverged_steps += usize::from(!step.converged);
        self.guarded_steps += usize::from(step.guarded);
    }
}
