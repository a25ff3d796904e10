//! Time integrators in one form: x(t+h) = A s + c F, v(t+h) = B s + d F.
//!
//! Implements [Gissler2006 §3]. Deviations: B of the Runge-Kutta scheme is (0, I + h²/2m J), the printed one loses the
//! velocity; explicit Euler, which is named but not given there, has c = 0.
//! Terms: s = (x, v), for Verlet (x(t), x(t-h)); J = dF/dx of the node's own force [N/m]; m mass [kg]; h step [s].
#![allow(non_snake_case, reason = "symbols of [Gissler2006]")]

use softrig_linalg::Mat3;

/// How a step is taken.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Scheme {
    /// x' = x + h v, v' = v + h a(x, v). Order 1; gains energy without damping. A force moves a node only one step later, so
    /// positions cannot be constrained.
    ExplicitEuler,
    /// v' = v + h a(x, v), x' = x + h v'. Order 1 in the velocity, energy stays bounded.
    EulerCromer,
    /// The derivative half a step ahead. Order 2; two forces a step; gains energy slowly without damping.
    Midpoint,
    /// Mean of the derivatives at both ends (Heun). Order 2; two forces a step; gains energy slowly without damping.
    RungeKutta2,
    /// x' = 2 x - x(t-h) + h² a(x, v). Order 2, energy stays bounded, one force a step. The default, as in [Gissler2006 §5].
    #[default]
    Verlet,
    /// v' = v + h a(x', v'), x' = x + h v'. Order 1, damps, stable for any step; needs a solve.
    ImplicitEuler,
}

/// What one newton on a node adds to its state at the end of the step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gain {
    /// c [m/N].
    pub position: f64,
    /// Of the velocity at the end of the step [m/(N s)]. For [`Scheme::Verlet`] that is 3h/2m: d = h/2m of [`Form`] is for the
    /// velocity one step earlier.
    pub velocity: f64,
}

/// The second part of the vector s of a [`Form`]; the first is the position.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SecondState {
    /// v(t) [m/s].
    Velocity,
    /// x(t-h) [m].
    PreviousPosition,
}

/// A scheme in the form of [Gissler2006 eq. 1] for one node.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Form {
    /// What the second part of s is.
    pub second: SecondState,
    /// A = (A_x, A_2).
    pub A: [Mat3<f64>; 2],
    /// B = (B_x, B_2). For Verlet B s + d F is the central difference, the velocity at t and not at t+h as printed.
    pub B: [Mat3<f64>; 2],
    /// c [m/N].
    pub c: f64,
    /// d [m/(N s)].
    pub d: f64,
}

impl Scheme {
    /// All schemes.
    pub const ALL: [Self; 6] =
        [Self::ExplicitEuler, Self::EulerCromer, Self::Midpoint, Self::RungeKutta2, Self::Verlet, Self::ImplicitEuler];

    /// Name in files and on the command line.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::ExplicitEuler => "explicit-euler",
            Self::EulerCromer => "euler-cromer",
            Self::Midpoint => "midpoint",
            Self::RungeKutta2 => "runge-kutta-2",
            Self::Verlet => "verlet",
            Self::ImplicitEuler => "implicit-euler",
        }
    }

    /// Order of accuracy of positions.
    #[must_use]
    pub fn order(self) -> u32 {
        match self {
            Self::Midpoint | Self::RungeKutta2 | Self::Verlet => 2,
            Self::ExplicitEuler | Self::EulerCromer | Self::ImplicitEuler => 1,
        }
    }

    /// What a force on a node of this mass [kg] does within a step of `dt` [s]; nothing where `inverse_mass` is zero.
    #[inline]
    #[must_use]
    pub fn gain(self, inverse_mass: f64, dt: f64) -> Gain {
        let (h, w) = (dt, inverse_mass);
        let (position, velocity) = match self {
            Self::ExplicitEuler => (0.0, h * w),
            Self::EulerCromer | Self::ImplicitEuler => (h * h * w, h * w),
            Self::Midpoint | Self::RungeKutta2 => (0.5 * h * h * w, h * w),
            Self::Verlet => (h * h * w, 1.5 * h * w),
        };
        Gain { position, velocity }
    }

    /// The form of [Gissler2006 eq. 1] for a node of mass `mass` [kg] whose force changes with its position by `jacobian` [N/m].
    /// For midpoint, Runge-Kutta and implicit Euler a linearisation; constraints do not need it, see [`crate::constraint`].
    #[must_use]
    pub fn form(self, mass: f64, dt: f64, jacobian: Mat3<f64>) -> Form {
        let (h, J) = (dt, jacobian);
        let (O, I) = (Mat3::zero(), Mat3::identity());
        let second = if self == Self::Verlet { SecondState::PreviousPosition } else { SecondState::Velocity };
        let A = [I, Mat3::diagonal(h)];
        let (A, B, c, d) = match self {
            Self::ExplicitEuler => (A, [O, I], 0.0, h / mass),
            Self::EulerCromer => (A, [O, I], h * h / mass, h / mass),
            Self::Midpoint => (A, [O, I], h * h / (2.0 * mass), h / mass),
            Self::RungeKutta2 => (A, [O, I + J.scale(h * h / (2.0 * mass))], h * h / (2.0 * mass), h / mass),
            Self::Verlet => {
                let A = [Mat3::diagonal(2.0), Mat3::diagonal(-1.0)];
                (A, [Mat3::diagonal(1.0 / h), Mat3::diagonal(-1.0 / h)], h * h / mass, h / (2.0 * mass))
            }
            Self::ImplicitEuler => {
                let A = [I, Mat3::diagonal(h) + J.scale(h * h * h / mass)];
                (A, [O, I + J.scale(h * h / mass)], h * h / mass, h / mass)
            }
        };
        Form { second, A, B, c, d }
    }
}
