//! What both engines are given.

/// Density of the flesh [kg/m3].
pub const DENSITY: f64 = 1000.0;
/// Poisson's ratio of the flesh [-].
pub const POISSON_RATIO: f64 = 0.45;
/// Length of a step [s].
pub const STEP: f64 = 1.0 / 60.0;
/// Relative residual of the linear systems [-]: the peer's default.
pub const TOLERANCE: f64 = 1e-5;
