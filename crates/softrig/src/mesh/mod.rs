//! Surfaces, volume meshes around them, and what ties the two together.

mod embedding;
mod surface;
mod volume;

pub use embedding::Embedding;
pub use surface::SurfaceMesh;
pub use volume::{CellKind, Lattice, VolumeMesh};
