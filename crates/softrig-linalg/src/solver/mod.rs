//! Linear solvers behind one trait.

mod adapted;
mod auto;
mod cubes;
mod direct;
mod factor;
mod free;
mod multigrid;
mod pcg;
mod precondition;
mod quads;
mod residual;
pub(crate) mod sliced;

pub use adapted::Adapted;
pub use auto::Auto;
pub use direct::Direct;
pub use multigrid::{Interpolation, Marking, Multigrid, MultigridSettings, Outer, Rebuild, Smoother, multigrid};
pub use pcg::Pcg;
pub use precondition::{Operator, Preconditioner};

use crate::{BlockCsr, BlockPattern, CubeMatrix, DofConstraints, Rows, Scalar};
use std::sync::Arc;

/// Below this tolerance iterations run in the caller's numbers: f32 would have to start again too often.
const BELOW_SINGLE: f64 = 1e-5;

/// What a solve did. Residuals are true ones: `|b - A x| / |b|`, recomputed in f64 from the final `x`.
#[derive(Clone, Debug, PartialEq)]
pub struct SolveReport {
    /// Name of the solver that did the work, e.g. `"pcg"`.
    pub solver: &'static str,
    /// Iterations done; 0 for direct solvers and for a zero right-hand side.
    pub iterations: usize,
    /// Relative residual over the free nodes [-].
    pub residual: f64,
    /// Whether `residual` is at most the tolerance asked for.
    pub converged: bool,
    /// Whether coarse operators were made anew for it.
    pub rebuilt: bool,
    /// Relative residual that the iterations began with [-]: 1 from zero, less from a guess that was good for something.
    pub start: f64,
}

/// Memory traffic of an iteration.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Traffic {
    /// What it reads and writes [bytes].
    pub moved: usize,
    /// What of that is different memory: how large a cache would have to be [bytes].
    pub held: usize,
}

/// Why a system could not be solved. The solution passed in is unchanged.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum SolveError {
    /// The right-hand side or the matrix has an entry that is not a finite number.
    #[error("the linear system contains values that are not finite (first at node {node})")]
    NotFinite {
        /// First node with such a value.
        node: usize,
    },
    /// The iteration limit was reached.
    #[error(
        "the linear solver `{solver}` stopped at residual {residual:.1e} after {iterations} iterations, {tolerance:.1e} was asked for; raise the iteration limit or use the direct solver"
    )]
    NotConverged {
        /// Which solver.
        solver: &'static str,
        /// True relative residual reached.
        residual: f64,
        /// Iterations done.
        iterations: usize,
        /// Tolerance asked for.
        tolerance: f64,
    },
    /// The matrix is not positive definite on the free nodes.
    #[error("the stiffness matrix is not positive definite (node {node}); check for cells without volume or material")]
    NotPositiveDefinite {
        /// A node at which it was noticed.
        node: usize,
    },
    /// The solver was not prepared for this system, or its parts have different lengths.
    #[error(
        "the linear solver was not prepared for this system; call `prepare` with its pattern and constraints first"
    )]
    NotPrepared,
    /// The system is beyond what the solver can hold.
    #[error("the direct solver ran out of memory for {unknowns} unknowns; use the `pcg` solver")]
    OutOfMemory {
        /// Number of unknowns.
        unknowns: usize,
    },
}

/// A matrix that is assembled only when someone asks for its entries.
pub trait LinearSystem<R: Scalar> {
    /// All entries.
    fn assembled(&mut self) -> &BlockCsr<R>;

    /// The rows, for those who go through them once; made one by one where that is possible.
    fn rows(&mut self) -> &dyn Rows<R> {
        self.assembled()
    }

    /// Replaces x, one entry per node, by `A x`, where that can be done without the entries; otherwise returns false.
    fn product(&mut self, _x: &mut [[R; 3]]) -> bool {
        false
    }

    /// The same matrix as a sum of cubes, where it is one: its products cost a fraction of those of the entries.
    fn cubes(&mut self) -> Option<&CubeMatrix<R>> {
        None
    }

    /// A vector, one entry per node, of which some multiple may be close to the solution: iterations start from the best one. What it
    /// has at constrained nodes does not count.
    fn guess(&self) -> Option<&[[R; 3]]> {
        None
    }

    /// Writes how the cells at each of these nodes are turned in the matrix, as a quaternion (x, y, z, w) up to its sign and length. Returns
    /// false, and does nothing, where nothing turns. Solvers turn with it what they have kept of an earlier matrix.
    fn rotations(&mut self, _node: &[u32], _out: &mut [[f32; 4]]) -> bool {
        false
    }
}

/// Solves `A x = b` on the free nodes, for a symmetric positive definite `A`.
///
/// `A` may hold anything in the rows and columns of constrained nodes: solvers ignore them and leave `x` zero there.
pub trait LinearSolver<R: Scalar>: Send {
    /// Name for reports.
    fn name(&self) -> &'static str;

    /// Symbolic work; again whenever the pattern or the set of constrained nodes changes.
    ///
    /// # Errors
    /// [`SolveError::OutOfMemory`] when the solver cannot hold a system of this size.
    fn prepare(&mut self, pattern: &Arc<BlockPattern>, constraints: &DofConstraints) -> Result<(), SolveError>;

    /// Drops what a solve may keep from earlier ones, so that the next one depends on its arguments only.
    fn forget(&mut self) {}

    /// What an iteration reads and writes, by count; `None` for solvers that do not count it.
    fn traffic(&self) -> Option<Traffic> {
        None
    }

    /// The solver's preconditioner, where it has one that others can use.
    fn preconditioner(&mut self) -> Option<&mut dyn Preconditioner<R>> {
        None
    }

    /// Numeric solve, whatever `solution` holds. `rhs` and `solution` have one `[R; 3]` per node; `rhs` of constrained nodes is ignored.
    ///
    /// # Errors
    /// [`SolveError`]; then `solution` is unchanged.
    fn solve(
        &mut self,
        matrix: &BlockCsr<R>,
        rhs: &[[R; 3]],
        solution: &mut [[R; 3]],
        tolerance: f64,
    ) -> Result<SolveReport, SolveError>;

    /// As [`Self::solve`], with the entries assembled only if the solver reads them, and from the system's guess where it helps.
    ///
    /// # Errors
    /// As [`Self::solve`].
    fn solve_system(
        &mut self,
        system: &mut dyn LinearSystem<R>,
        rhs: &[[R; 3]],
        solution: &mut [[R; 3]],
        tolerance: f64,
    ) -> Result<SolveReport, SolveError> {
        self.solve(system.assembled(), rhs, solution, tolerance)
    }
}

/// A matrix that is there already.
struct Stored<'a, R>(&'a BlockCsr<R>);

impl<R: Scalar> LinearSystem<R> for Stored<'_, R> {
    fn assembled(&mut self) -> &BlockCsr<R> {
        self.0
    }
}

/// Do matrix and vectors belong to the prepared pattern?
fn check_system<R: Scalar>(
    prepared: &Arc<BlockPattern>,
    matrix: &BlockCsr<R>,
    rhs: &[[R; 3]],
    solution: &[[R; 3]],
) -> Result<(), SolveError> {
    let nodes = prepared.row_count();
    let fits = (Arc::ptr_eq(prepared, &matrix.pattern) || **prepared == *matrix.pattern)
        && matrix.values.len() == prepared.block_count()
        && rhs.len() == nodes
        && solution.len() == nodes;
    if fits { Ok(()) } else { Err(SolveError::NotPrepared) }
}
