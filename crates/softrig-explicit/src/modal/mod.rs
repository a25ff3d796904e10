//! Modal analysis: the lowest modes of a body as its unknowns.
//!
//! [`Modes`] solves K φ = ω² M φ on the free nodes; [`ModalIntegrator`] advances one damped oscillator per mode, exactly for a
//! constant force, and can turn what it finds by modal warping [Choi2005].

mod carried;
mod integrator;
mod lanczos;
mod warp;

pub use carried::CarriedModes;
pub use integrator::ModalIntegrator;
pub use lanczos::{ModalError, Modes};
