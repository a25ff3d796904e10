//! Skin vertices carried by the cells of a volume mesh.

use softrig_linalg::Scalar;

/// Every embedded point as a weighted sum of the nodes of one cell. Weights sum to 1, reproduce linear functions, and may be
/// negative for points outside their cell (extrapolated, never clamped).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Embedding {
    /// Cell of each point.
    pub cell: Vec<u32>,
    /// First entry of each point in `node` and `weight`, and one past the last: `point_count() + 1` entries.
    pub start: Vec<u32>,
    /// Nodes of the cell of each point.
    pub node: Vec<u32>,
    /// Weight of each node [-].
    pub weight: Vec<f64>,
}

impl Embedding {
    /// Number of embedded points.
    #[must_use]
    pub fn point_count(&self) -> usize {
        self.cell.len()
    }

    /// Positions of all points for the given node positions [m]. Computed in f64; `positions.len() == point_count()`.
    ///
    /// # Panics
    /// When `positions` has another length, or a node is missing.
    pub fn apply<R: Scalar>(&self, nodes: &[[R; 3]], positions: &mut [[f64; 3]]) {
        assert_eq!(positions.len(), self.point_count(), "one position per embedded point");
        for (i, p) in positions.iter_mut().enumerate() {
            let mut sum = [0.0; 3];
            for k in self.start[i] as usize..self.start[i + 1] as usize {
                let x = nodes[self.node[k] as usize];
                for c in 0..3 {
                    sum[c] += self.weight[k] * x[c].to_f64();
                }
            }
            *p = sum;
        }
    }
}
