//! The explicit side of softrig: short cheap steps without a linear system, and constraints that hold exactly all the same.
//!
//! * [`scheme`] is the one form x' = A s + c F, v' = B s + d F of all time integrators here [Gissler2006 eq. 1]; [`stepper`]
//!   advances a body with any of them; [`stability`] says how long a step may be.
//! * [`constraint`] holds nodes on nails, on one another, on lines, triangles, tetrahedra and surfaces [Gissler2006 §4].
//! * [`clustered`] evaluates linear elasticity by precomputed rows [Tang2009 §3], [`element`] cell by cell with stiffness warping.
//! * [`modal`] finds the lowest modes and advances a body in them.
//! * [`elastic`] steps elastic bodies, also in the place of an implicit integrator; [`skeleton`] moves nodes with bones [Tang2009 §4.1].
//! * [`mass_point`] are bodies of masses with distance, area and volume energies [Teschner2004].
//!
//! All quantities are SI units. Sign: `M a = F(x, v)`, F the sum of everything that acts on a node.

pub mod clustered;
pub mod constraint;
pub mod elastic;
pub mod element;
pub mod explicit;
mod frames;
mod lanes;
pub mod mass_point;
pub mod method;
pub mod modal;
pub mod objects;
mod part;
pub mod sample;
pub mod scheme;
pub mod skeleton;
pub mod stability;
pub mod stepper;
pub mod stress;
mod threads;

pub use threads::awake;
