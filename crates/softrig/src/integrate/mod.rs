//! Time integration: one step of `M a + C v + f_int(x) = f_ext` with some nodes prescribed.
//!
//! [`Dynamics`] names what to use; [`Implicit`] is the method behind all of it, [`Guarded`] the safety net around it, and [`Linked`] keeps
//! it within linear conditions between nodes.

mod dynamics;
mod guard;
mod implicit;
mod linked;
mod start;
mod system;

pub use dynamics::Dynamics;
pub use guard::Guarded;
pub use implicit::{Implicit, Scheme, implicit};
pub use linked::Linked;
pub use start::initial_acceleration;
pub(crate) use system::StepSystem;

use crate::body::Body;
use crate::constraint::LinkError;
use softrig_linalg::{LinearSolver, Scalar, SolveError};

/// Residual asked of a solve that is not a step's last. What a linearisation leaves is about a hundredth of what it found
/// (measured: .012 on a walking character), a third of the digits of a bake; more would be lost with the rotations.
pub(crate) fn earlier_tolerance(tolerance: f64, linearisation: usize) -> f64 {
    tolerance.powf((linearisation + 1) as f64 / 3.0).max(tolerance)
}

/// Motion of every node at one instant. Plain data: `Clone` is a snapshot.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct State<R> {
    /// Time since the start [s].
    pub time: f64,
    /// Position of each node [m].
    pub position: Vec<[R; 3]>,
    /// Velocity of each node [m/s].
    pub velocity: Vec<[R; 3]>,
    /// Acceleration of each node [m/s2]; zero on prescribed nodes.
    pub acceleration: Vec<[R; 3]>,
}

impl<R: Scalar> State<R> {
    /// At rest in the given shape.
    #[must_use]
    pub fn at_rest(position: Vec<[R; 3]>) -> Self {
        let zero = vec![[R::zero(); 3]; position.len()];
        Self { time: 0.0, velocity: zero.clone(), acceleration: zero, position }
    }

    /// Becomes another, in the memory that is there.
    pub(crate) fn copy(&mut self, other: &Self) {
        self.time = other.time;
        self.position.clone_from(&other.position);
        self.velocity.clone_from(&other.velocity);
        self.acceleration.clone_from(&other.acceleration);
    }
}

/// What drives one step.
#[derive(Clone, Copy, Debug)]
pub struct StepInput<'a, R> {
    /// Where prescribed nodes are at the end of the step [m]; one entry per node, read for prescribed ones.
    pub target_position: &'a [[R; 3]],
    /// Their velocity at the end of the step [m/s]; one entry per node, read for prescribed ones.
    pub target_velocity: &'a [[R; 3]],
    /// External force on each node [N], gravity included.
    pub external_force: &'a [[R; 3]],
    /// Step length [s].
    pub dt: f64,
    /// Residual asked of the last linear solve of the step, relative to the right-hand side of the first [-]. Earlier ones
    /// need a third of the digits each: what they leave, the last one corrects.
    pub tolerance: f64,
    /// Whether the forces that hold prescribed nodes are wanted: they cost one more evaluation of all cells.
    pub reactions: bool,
}

/// What one step did.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StepOutput<R> {
    /// Force needed to hold each prescribed node [N], zero on free nodes: `f_int` at the end of the step, no inertia, no
    /// damping [Georgii2010 eq. 1]. The flesh pulls on its bone with `external_force - reaction`. Left alone when not asked for.
    pub reaction: Vec<[R; 3]>,
    /// Explicit steps it was cut into; 0 for implicit ones.
    pub substeps: usize,
    /// Linear iterations of all solves of the step.
    pub iterations: usize,
    /// True residual of its last solve, relative to the right-hand side of the first [-].
    pub residual: f64,
    /// Whether that solve reached the tolerance.
    pub converged: bool,
    /// The growth guard redid the step with implicit Euler.
    pub guarded: bool,
    /// Elastic energy [J]: at the end of the step where reactions were asked for, else where the step was last linearised.
    pub elastic_energy: f64,
    /// Kinetic energy at the end of the step [J].
    pub kinetic_energy: f64,
}

/// Why a step could not be done. The state is as it was before.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum StepError {
    /// A linear system could not be solved.
    #[error("at t = {time:.4} s: {source}")]
    Solve {
        /// Time of the failed step [s].
        time: f64,
        /// What the solver said.
        source: SolveError,
    },
    /// Positions, forces or targets are not finite numbers.
    #[error("at t = {time:.4} s: {what} of node {node} is not a finite number")]
    NotFinite {
        /// Time of the failed step [s].
        time: f64,
        /// Which quantity.
        what: &'static str,
        /// First such node.
        node: usize,
    },
    /// Even implicit Euler left a state that grows without bound.
    #[error(
        "at t = {time:.4} s: the body moves at {speed:.3e} m/s, beyond any physical bound; use a smaller time step or a stiffer material"
    )]
    Diverged {
        /// Time of the failed step [s].
        time: f64,
        /// Largest node speed [m/s].
        speed: f64,
    },
    /// Links between nodes cannot be met.
    #[error("at t = {time:.4} s: {source}")]
    Link {
        /// Time of the failed step [s].
        time: f64,
        /// Which ones, and why.
        source: LinkError,
    },
    /// The method cannot do what was asked.
    #[error("unsupported: {0}")]
    Unsupported(String),
}

/// Where blended skinning has a node, and how it has turned the flesh there since the rest shape.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NodeFrame {
    /// World position [m].
    pub place: [f64; 3],
    /// Unit quaternion (x, y, z, w).
    pub turn: [f64; 4],
}

/// Advances a state by one step. On `Err` the state is unchanged.
pub trait Integrator<R: Scalar>: Send {
    /// Name for reports.
    fn name(&self) -> &'static str;

    /// Whether it computes deviations from skinning, and so wants [`Self::carry`] before every step.
    fn is_carried(&self) -> bool {
        false
    }

    /// Takes where skinning has every node at the start and at the end of the next step.
    fn carry(&mut self, _before: &[NodeFrame], _after: &[NodeFrame]) {}

    /// One step from `state` to `state.time + input.dt`.
    ///
    /// # Errors
    /// [`StepError`]; state and body history are then as before the call.
    fn step(
        &mut self,
        body: &mut Body<R>,
        solver: &mut dyn LinearSolver<R>,
        input: &StepInput<'_, R>,
        state: &mut State<R>,
        output: &mut StepOutput<R>,
    ) -> Result<(), StepError>;
}
