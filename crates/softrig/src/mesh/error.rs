//! What can be wrong with a surface or a volume mesh.

/// Why a mesh operation gave up.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum MeshError {
    /// No triangle to build around.
    #[error("the surface has no triangles; give a mesh with at least one")]
    NoTriangles,
    /// A triangle names a vertex that does not exist.
    #[error(
        "triangle {triangle} uses vertex {vertex}, but the surface has {count} vertices; repair or re-export the file"
    )]
    TriangleIndex {
        /// Which triangle.
        triangle: usize,
        /// The vertex it names.
        vertex: u32,
        /// How many there are.
        count: usize,
    },
    /// A cell names a node that does not exist.
    #[error("cell {cell} uses node {node}, but the mesh has {count} nodes; repair or re-export the file")]
    CellIndex {
        /// Which cell, tetrahedra first.
        cell: usize,
        /// The node it names.
        node: u32,
        /// How many there are.
        count: usize,
    },
    /// A coordinate is infinite or not a number.
    #[error("{what} {index} has a coordinate that is not a finite number; repair or re-export the file")]
    NonFinite {
        /// Kind of point: vertex, node, point.
        what: &'static str,
        /// Which one.
        index: usize,
    },
    /// Every vertex is at the same place, or so far out that sizes overflow.
    #[error("the surface is {size:e} m across: no cell fits around that; check its unit and scale")]
    Extent {
        /// Diagonal of the bounding box [m].
        size: f64,
    },
    /// Edge of a voxel not a positive number, or a cell count of zero.
    #[error("a lattice with {what} cannot be built; give a positive number")]
    Resolution {
        /// What was asked for.
        what: String,
    },
    /// The lattice would not fit in memory.
    #[error("voxels of {spacing:.3e} m would make {what}; use fewer cells or a spacing of about {suggestion:.3e} m")]
    TooFine {
        /// Edge of a voxel [m].
        spacing: f64,
        /// What would be too many.
        what: String,
        /// A spacing that fits [m].
        suggestion: f64,
    },
    /// No cell to embed in, or to work on.
    #[error("the volume mesh has no cells of positive volume; generate one around the surface or give another file")]
    NoCells,
    /// Parallel lists of a volume mesh differ in length.
    #[error("the volume mesh has {found} entries in `{list}` where {expected} are needed; fill it or leave it empty")]
    ListLength {
        /// Name of the list.
        list: &'static str,
        /// Its length.
        found: usize,
        /// The length needed.
        expected: usize,
    },
}
