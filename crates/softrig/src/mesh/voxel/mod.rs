//! A lattice of hexahedral cells around any surface.
//!
//! Space is cut into voxels of 4x4x4 sub-voxels. [`grid`] finds which links between neighbouring sub-voxel centres the surface crosses,
//! [`region`] which sub-voxels are inside, [`cells`] splits the material of each voxel into connected pieces and joins their nodes,
//! [`tidy`] sees to loose ends,
//! and [`search`] looks for the spacing that gives a wanted number of cells.

mod cells;
mod grid;
mod region;
mod search;
mod tidy;

pub use search::{LatticeOptions, LatticeReport, Resolution, voxelize, voxelize_with_report};
