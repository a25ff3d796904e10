//! What a multigrid solver is made of.

/// Settings of [`super::Multigrid`]. The defaults are for preconditioning conjugate gradients.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MultigridSettings {
    /// What drives the cycles.
    pub outer: Outer,
    /// What reduces the rough part of the error on each level.
    pub smoother: Smoother,
    /// Which coarse nodes are left out next to constrained fine ones.
    pub marking: Marking,
    /// When the coarse operators are computed anew.
    pub rebuild: Rebuild,
}

impl Default for MultigridSettings {
    fn default() -> Self {
        Self {
            outer: Outer::ConjugateGradients,
            smoother: Smoother::default(),
            marking: Marking::EmptyColumns,
            rebuild: Rebuild::WhenSlower,
        }
    }
}

impl MultigridSettings {
    /// What [Georgii2010 §5] measures: two V(2,1) cycles of Gauss-Seidel, greedy marking, operators anew for every solve.
    #[must_use]
    pub fn paper() -> Self {
        Self {
            outer: Outer::Cycles { count: Some(2) },
            smoother: Smoother::GaussSeidel { before: 2, after: 1 },
            marking: Marking::Greedy,
            rebuild: Rebuild::EverySolve,
        }
    }
}

/// What drives the cycles.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outer {
    /// Conjugate gradients, preconditioned by one cycle per iteration.
    ConjugateGradients,
    /// Cycles alone: a fixed number of them, whatever residual they reach, or with `None` as many as the tolerance needs.
    Cycles {
        /// How many.
        count: Option<usize>,
    },
}

/// A smoother. Each is deterministic for any number of threads.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Smoother {
    /// Chebyshev polynomial of the block-Jacobi iteration, before and after the coarse correction: needs no colouring, and
    /// the fewest products for each digit (numerics 5.6). Default: degree 3, ratio 10.
    Chebyshev {
        /// Products per smoothing; at least 1 is done.
        degree: usize,
        /// Smoothed part of the spectrum: from the largest eigenvalue down by this ratio.
        ratio: f32,
    },
    /// Block Gauss-Seidel in the order of colours; the reverse order after the coarse correction, so that a cycle with as many
    /// sweeps before as after is symmetric.
    GaussSeidel {
        /// Sweeps before the coarse correction; at least 1 is done.
        before: usize,
        /// Sweeps after it.
        after: usize,
    },
}

impl Default for Smoother {
    fn default() -> Self {
        Self::Chebyshev { degree: 3, ratio: 10.0 }
    }
}

/// Which coarse nodes take no part because of constrained fine nodes [Georgii2010 §3.2].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Marking {
    /// Those that no free node interpolates from.
    EmptyColumns,
    /// Also those that find no free node of their own, coarse nodes choosing in order, each the free node it has the largest
    /// weight on: what remains is a matching, so that the interpolation has full structural rank.
    Greedy,
}

/// When the coarse operators are computed anew. Nothing depends on a clock.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Rebuild {
    /// When a solve lost more iterations to the age of the operators than a rebuild and all that was lost before cost on the mean.
    WhenSlower,
    /// When parts of the body have turned against their surroundings by more than this since the last rebuild [rad]: the frames of coarse
    /// nodes, which turn with the cells around them, against the mean of those that a fine node interpolates from. Every time
    /// for systems without rotations. Ten degrees keep cycles without conjugate gradients convergent.
    WhenTurned(f64),
    /// For every solve.
    EverySolve,
}
