//! Skin weights carried from the surface to the nodes of the volume.
//!
//! A node takes the mean weight of the surface samples in its cells; inside, weights are harmonic on the node graph
//! (rule M, step 1). Every node ends with weights that sum to 1 over the bones.

use crate::mesh::VolumeMesh;

/// A sample of the weighted surface: the cell it lies in, and its weights.
pub(crate) struct WeightSample<'a> {
    /// Cell of the volume mesh.
    pub cell: u32,
    /// Bone indices and weights.
    pub weights: &'a [(usize, f64)],
}

/// Weight of every bone on every node, row by row.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct NodeWeights {
    pub bone_count: usize,
    values: Vec<f64>,
}

impl NodeWeights {
    pub fn row(&self, node: usize) -> &[f64] {
        &self.values[node * self.bone_count..(node + 1) * self.bone_count]
    }

    /// The bone with the largest weight; the first one on a tie.
    pub fn owner(&self, node: usize) -> usize {
        let row = self.row(node);
        (1..row.len()).fold(0, |best, b| if row[b] > row[best] { b } else { best })
    }
}

/// Largest change of a weight in the last sweep of the harmonic fill. Weights decide ownership and blending: a thousandth is
/// far below what either notices.
const TOLERANCE: f64 = 1e-3;
/// Sweeps at most: Gauss-Seidel crosses a limb of ten cells in a few dozen.
const SWEEPS: usize = 200;

pub(crate) fn node_weights<'a>(
    mesh: &VolumeMesh,
    bone_count: usize,
    samples: impl Iterator<Item = WeightSample<'a>>,
) -> NodeWeights {
    let node_count = mesh.node_count();
    let mut values = vec![0.0; node_count * bone_count];
    let mut total = vec![0.0; node_count];
    for sample in samples {
        for &n in mesh.cell(sample.cell as usize) {
            total[n as usize] += 1.0;
            let row = &mut values[n as usize * bone_count..][..bone_count];
            for &(bone, w) in sample.weights {
                row[bone] += w;
            }
        }
    }
    let mut known = vec![false; node_count];
    for n in 0..node_count {
        if total[n] > 0.0 {
            known[n] = true;
            values[n * bone_count..][..bone_count].iter_mut().for_each(|w| *w /= total[n]);
        }
    }
    let neighbours = neighbours(mesh);
    spread(&mut values, bone_count, &mut known.clone(), &neighbours);
    relax(&mut values, bone_count, &known, &neighbours);
    NodeWeights { bone_count, values }
}

/// First guess inside: each unknown node takes the mean of the known ones around it, layer by layer.
fn spread(values: &mut [f64], bone_count: usize, known: &mut [bool], neighbours: &Rows) {
    loop {
        let layer: Vec<usize> =
            (0..known.len()).filter(|n| !known[*n] && neighbours.of(*n).iter().any(|m| known[*m as usize])).collect();
        if layer.is_empty() {
            return;
        }
        for &n in &layer {
            mean_of_neighbours(values, bone_count, n, neighbours.of(n).iter().filter(|m| known[**m as usize]));
        }
        layer.iter().for_each(|n| known[*n] = true);
    }
}

/// Gauss-Seidel on the graph Laplacian, in node order.
fn relax(values: &mut [f64], bone_count: usize, fixed: &[bool], neighbours: &Rows) {
    let free: Vec<usize> = (0..fixed.len()).filter(|n| !fixed[*n] && !neighbours.of(*n).is_empty()).collect();
    let mut before = vec![0.0; bone_count];
    for _ in 0..SWEEPS {
        let mut change = 0.0f64;
        for &n in &free {
            before.copy_from_slice(&values[n * bone_count..][..bone_count]);
            mean_of_neighbours(values, bone_count, n, neighbours.of(n).iter());
            for (b, old) in before.iter().enumerate() {
                change = change.max((values[n * bone_count + b] - old).abs());
            }
        }
        if change < TOLERANCE {
            break;
        }
    }
}

fn mean_of_neighbours<'a>(
    values: &mut [f64],
    bone_count: usize,
    node: usize,
    around: impl Iterator<Item = &'a u32> + Clone,
) {
    let count = around.clone().count().max(1) as f64;
    for b in 0..bone_count {
        let sum: f64 = around.clone().map(|m| values[*m as usize * bone_count + b]).sum();
        values[node * bone_count + b] = sum / count;
    }
}

/// Compressed rows of node indices.
pub(crate) struct Rows {
    start: Vec<u32>,
    entry: Vec<u32>,
}

impl Rows {
    pub fn of(&self, row: usize) -> &[u32] {
        &self.entry[self.start[row] as usize..self.start[row + 1] as usize]
    }
}

/// Nodes joined by an edge of some cell.
pub(crate) fn neighbours(mesh: &VolumeMesh) -> Rows {
    const TET: &[[usize; 2]] = &[[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]];
    const HEX: &[[usize; 2]] =
        &[[0, 1], [1, 2], [2, 3], [3, 0], [4, 5], [5, 6], [6, 7], [7, 4], [0, 4], [1, 5], [2, 6], [3, 7]];
    let mut pairs = Vec::new();
    for cell in mesh.cells() {
        for &[a, b] in if cell.len() == 4 { TET } else { HEX } {
            pairs.push((cell[a], cell[b]));
            pairs.push((cell[b], cell[a]));
        }
    }
    pairs.sort_unstable();
    pairs.dedup();
    let mut start = vec![0u32; mesh.node_count() + 1];
    for (a, _) in &pairs {
        start[*a as usize + 1] += 1;
    }
    for i in 0..mesh.node_count() {
        start[i + 1] += start[i];
    }
    Rows { start, entry: pairs.into_iter().map(|(_, b)| b).collect() }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A row of cubes with bone 0 at the left end and bone 1 at the right: harmonic means linear in between.
    #[test]
    fn weights_are_harmonic_between_the_ends_of_a_row() {
        let cubes = 8usize;
        let mut mesh = VolumeMesh::default();
        for x in 0..=cubes {
            for (y, z) in [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)] {
                mesh.nodes.push([x as f64, y, z]);
            }
        }
        for x in 0..cubes as u32 {
            mesh.hexes.push([4 * x, 4 * x + 4, 4 * x + 5, 4 * x + 1, 4 * x + 3, 4 * x + 7, 4 * x + 6, 4 * x + 2]);
        }
        let samples = [
            WeightSample { cell: 0, weights: &[(0, 1.0)] },
            WeightSample { cell: cubes as u32 - 1, weights: &[(1, 1.0)] },
        ];
        let w = node_weights(&mesh, 2, samples.into_iter());
        for x in 1..cubes {
            let expected = (x - 1) as f64 / (cubes - 2) as f64;
            let row = w.row(4 * x);
            assert!((row[1] - expected).abs() < 0.02, "{x}: {row:?}");
            assert!((row[0] + row[1] - 1.0).abs() < 1e-9);
        }
        assert_eq!(w.owner(0), 0);
        assert_eq!(w.owner(4 * cubes), 1);
    }
}
