//! Surfaces, volume meshes around them, and what ties the two together.

mod bar;
mod boundary;
mod bvh;
mod check;
mod components;
mod deformation;
mod embed;
mod embedding;
mod error;
mod hierarchy;
mod orient;
mod samples;
mod sets;
mod shape;
mod surface;
mod tetrahedralize;
mod volume;
mod voxel;
mod weld;
mod winding;

pub use bar::bar;
pub use boundary::{BoundaryFaces, boundary_faces};
pub use check::{MeshReport, check};
pub use components::{Components, components, surface_components};
pub use deformation::{DeformationStats, deformation_stats};
pub use embed::EmbedReport;
pub use embedding::Embedding;
pub use error::MeshError;
pub use hierarchy::{Prolongation, lattice_hierarchy};
pub use samples::{SurfaceSample, surface_samples};
pub use surface::{SurfaceDefects, SurfaceMesh};
pub use tetrahedralize::tetrahedralize;
pub use volume::{CellKind, Lattice, VolumeMesh};
pub use voxel::{LatticeOptions, LatticeReport, Resolution, voxelize, voxelize_with_report};
pub use weld::{Weld, weld};
pub use winding::Winding;
