//! A motion as a few shapes with changing weights: its mean and its principal components.
//!
//! The offsets of all vertices from their mean over T frames form a matrix D, three rows per vertex and T columns.
//! The eigenvectors u of DᵀD (T by T, however many vertices there are) are the weights of the components over time, and D u
//! their shapes: the best approximation of every rank in the sense of least squares. What is promised to users is the largest
//! distance of any vertex in any frame, so that is measured on the fit itself.
//!
//! Importers and engines clamp weights to [0, 1] (Blender's does for all but the first key). So every component runs from its
//! lowest weight, 0, to its highest, 1, and the first shape, whose weight is always 1, leads from the rest shape to where all
//! of them are lowest.

use super::ExportError;
use super::normals::SmoothNormals;
use crate::journal::{JournalFrame, JournalReader};
use faer::linalg::matmul::matmul;
use faer::{Accum, Mat, MatRef, Par, Side};
use std::io::{Read, Seek};

/// Frames whose eigenvectors can be found in reasonable time.
const MOST_FRAMES: usize = 4096;
/// Bytes of offsets held at once; longer motions are read in several passes.
const SLAB_BYTES: usize = 512 << 20;
/// Vertices on which the number of components that would suffice is found: those that miss it most.
const WORST_VERTICES: usize = 500;

/// Shapes and weights that approximate a motion: position = rest + Σ weight · shape.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Components {
    /// Offset of each vertex [m], first for the shape that is always on, then for each component.
    pub shapes: Vec<Vec<[f32; 3]>>,
    /// Change of each vertex normal that goes with each shape [-].
    pub normals: Vec<Vec<[f32; 3]>>,
    /// Weight of each shape in each frame, within [0, 1].
    pub weights: Vec<Vec<f32>>,
    /// Largest distance of any vertex in any frame from where it should be [m].
    pub error: f64,
    /// Shapes that would bring the error to the tolerance.
    pub needed: usize,
}

/// How well to approximate.
#[derive(Clone, Copy, Debug)]
pub(super) struct Goal {
    /// Most shapes, at least one.
    pub most: usize,
    /// Error with which a motion counts as well approximated [m]. Shapes stop at a tenth of it.
    pub tolerance: f64,
}

/// Finds the components of one mesh of a journal.
pub(super) fn components<S: Read + Seek>(
    journal: &mut JournalReader<S>,
    mesh: usize,
    rest: &[[f64; 3]],
    normals: &SmoothNormals,
    goal: Goal,
) -> Result<Components, ExportError> {
    let frames = journal.frame_count();
    if frames > MOST_FRAMES {
        return Err(ExportError::TooLarge {
            what: format!("a motion of {frames} frames"),
            format: "glTF with morph targets",
            limit: MOST_FRAMES as u64,
            instead: "use .pc2, .mdd or .usda, or bake fewer frames",
        });
    }
    let basis = time_basis(journal, mesh, rest)?;
    let rank = basis.ncols();
    let most = goal.most.saturating_sub(1).min(rank);

    // fit: shapes by projection, and the error that is left with 0, 1, ... components
    let mut errors = vec![0.0f64; most + 1];
    let mut worst: Vec<(f64, usize)> = Vec::new();
    let mut fit = Fit::new(&basis, most);
    let mut coefficients = vec![[0f32; 3]; rest.len() * most];
    let mut means = Vec::with_capacity(rest.len());
    for_each_vertex(journal, mesh, rest, |vertex, mean, rows| {
        means.push(mean);
        fit.vertex(rows, &mut errors);
        for k in 0..most {
            coefficients[vertex * most + k] = std::array::from_fn(|c| fit.coefficients[c][k] as f32);
        }
        if fit.left > goal.tolerance {
            worst.push((fit.left, vertex));
        }
    })?;
    let enough = |target: f64| errors.iter().position(|e| *e <= target);
    let used = enough(0.1 * goal.tolerance).unwrap_or(most);
    let needed = match enough(goal.tolerance) {
        Some(k) => k,
        None => {
            worst.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
            worst.truncate(WORST_VERTICES);
            needed(journal, mesh, rest, &basis, &worst, goal.tolerance)?
        }
    };

    let ranges: Vec<Range> = (0..used).map(|k| Range::of((0..frames).map(|t| basis[(t, k)]))).collect();
    let mut weights = vec![vec![1.0; frames]];
    weights.extend((0..used).map(|k| (0..frames).map(|t| ranges[k].share(basis[(t, k)])).collect()));
    let component = |k: usize| (0..rest.len()).map(|v| coefficients[v * most + k].map(f64::from)).collect();
    let shapes = from_lowest(means, (0..used).map(component).collect(), &ranges);
    let (mean_normals, normals) = normal_components(journal, mesh, rest, normals, &basis, used)?;
    let normals = from_lowest(mean_normals, normals, &ranges);
    Ok(Components { shapes, normals, weights, error: errors[used], needed: needed + 1 })
}

/// Lowest and highest weight of a component.
#[derive(Clone, Copy, Debug)]
struct Range {
    lowest: f64,
    highest: f64,
}

impl Range {
    fn of(weights: impl Iterator<Item = f64>) -> Self {
        let start = Self { lowest: f64::INFINITY, highest: f64::NEG_INFINITY };
        weights.fold(start, |r, w| Self { lowest: r.lowest.min(w), highest: r.highest.max(w) })
    }

    /// Where a weight lies between the two.
    fn share(&self, weight: f64) -> f32 {
        let span = self.highest - self.lowest;
        if span > 0.0 { ((weight - self.lowest) / span) as f32 } else { 0.0 }
    }
}

/// The mean moved to where all components are lowest, and the components as the way from lowest to highest.
fn from_lowest(mean: Vec<[f64; 3]>, components: Vec<Vec<[f64; 3]>>, ranges: &[Range]) -> Vec<Vec<[f32; 3]>> {
    let mut first = mean;
    let mut shapes = vec![Vec::new()];
    for (component, range) in components.iter().zip(ranges) {
        for (sum, c) in first.iter_mut().zip(component) {
            (0..3).for_each(|i| sum[i] += range.lowest * c[i]);
        }
        let span = range.highest - range.lowest;
        shapes.push(component.iter().map(|c| c.map(|v| (v * span) as f32)).collect());
    }
    shapes[0] = first.iter().map(|p| p.map(|v| v as f32)).collect();
    shapes
}

/// Orthonormal weights over time, most important first, without those that are nothing but rounding.
fn time_basis<S: Read + Seek>(
    journal: &mut JournalReader<S>,
    mesh: usize,
    rest: &[[f64; 3]],
) -> Result<Mat<f64>, ExportError> {
    let frames = journal.frame_count();
    let mut gram = Mat::<f64>::zeros(frames, frames);
    for_each_slab(journal, mesh, rest, |_, _, slab| {
        let rows = MatRef::from_row_major_slice(slab, slab.len() / frames, frames);
        matmul(gram.as_mut(), Accum::Add, rows.transpose(), rows, 1.0, Par::Seq);
    })?;
    // a symmetric eigenproblem of finite numbers converges; if it ever did not, no component is better than a wrong one
    let Ok(eigen) = gram.self_adjoint_eigen(Side::Lower) else { return Ok(Mat::zeros(frames, 0)) };
    let values = eigen.S().column_vector();
    let largest = if frames == 0 { 0.0 } else { values[frames - 1].max(0.0) };
    // the eigenvalues are squares: rounding leaves 1e-16 of the largest
    let kept: Vec<usize> = (0..frames).rev().filter(|k| values[*k] > 1e-15 * frames as f64 * largest).collect();
    Ok(Mat::from_fn(frames, kept.len(), |t, k| eigen.U()[(t, kept[k])]))
}

/// Projection of one vertex's motion onto the components.
struct Fit {
    /// Weights over time, one row of frames for each component.
    basis: Vec<Vec<f64>>,
    /// Coefficient of each component along x, y and z.
    coefficients: [Vec<f64>; 3],
    residual: [Vec<f64>; 3],
    /// Largest distance over time with all components.
    left: f64,
}

impl Fit {
    fn new(basis: &Mat<f64>, count: usize) -> Self {
        let frames = basis.nrows();
        Self {
            basis: (0..count).map(|k| (0..frames).map(|t| basis[(t, k)]).collect()).collect(),
            coefficients: std::array::from_fn(|_| vec![0.0; count]),
            residual: std::array::from_fn(|_| vec![0.0; frames]),
            left: 0.0,
        }
    }

    /// Fits one vertex and raises `errors[k]`, the error with k components, to what it leaves.
    fn vertex(&mut self, rows: [&[f64]; 3], errors: &mut [f64]) {
        for c in 0..3 {
            self.residual[c].copy_from_slice(rows[c]);
        }
        self.left = largest_distance(&self.residual);
        errors[0] = errors[0].max(self.left);
        for (k, u) in self.basis.iter().enumerate() {
            for c in 0..3 {
                let a: f64 = rows[c].iter().zip(u).map(|(d, u)| d * u).sum();
                self.coefficients[c][k] = a;
                self.residual[c].iter_mut().zip(u).for_each(|(r, u)| *r -= a * u);
            }
            self.left = largest_distance(&self.residual);
            errors[k + 1] = errors[k + 1].max(self.left);
        }
    }
}

fn largest_distance([x, y, z]: &[Vec<f64>; 3]) -> f64 {
    x.iter().zip(y).zip(z).map(|((x, y), z)| x * x + y * y + z * z).fold(0.0, f64::max).sqrt()
}

/// How many components bring the worst vertices to the tolerance.
fn needed<S: Read + Seek>(
    journal: &mut JournalReader<S>,
    mesh: usize,
    rest: &[[f64; 3]],
    basis: &Mat<f64>,
    worst: &[(f64, usize)],
    tolerance: f64,
) -> Result<usize, ExportError> {
    let mut chosen: Vec<usize> = worst.iter().map(|(_, v)| *v).collect();
    chosen.sort_unstable();
    let mut fit = Fit::new(basis, basis.ncols());
    let mut errors = vec![0.0; basis.ncols() + 1];
    for_each_vertex(journal, mesh, rest, |vertex, _, rows| {
        if chosen.binary_search(&vertex).is_ok() {
            fit.vertex(rows, &mut errors);
        }
    })?;
    Ok(errors.iter().position(|e| *e <= tolerance).unwrap_or(basis.ncols()))
}

/// Mean change of the normals, and what goes with each component by least squares: its weights are orthonormal.
fn normal_components<S: Read + Seek>(
    journal: &mut JournalReader<S>,
    mesh: usize,
    rest: &[[f64; 3]],
    normals: &SmoothNormals,
    basis: &Mat<f64>,
    count: usize,
) -> Result<(Vec<[f64; 3]>, Vec<Vec<[f64; 3]>>), ExportError> {
    let frames = journal.frame_count();
    let mut mean = vec![[0.0; 3]; rest.len()];
    let mut components = vec![vec![[0.0; 3]; rest.len()]; count];
    let rest_normals = normals.of(|v| rest[v]);
    let mut frame = JournalFrame::default();
    for t in 0..frames {
        journal.read_frame(t, &mut frame)?;
        let skin = &frame.skin[mesh];
        let now = normals.of(|v| skin[v].map(f64::from));
        let add = |weight: f64, sums: &mut Vec<[f64; 3]>| {
            for ((sum, n), n0) in sums.iter_mut().zip(&now).zip(&rest_normals) {
                (0..3).for_each(|c| sum[c] += weight * f64::from(n[c] - n0[c]));
            }
        };
        add(1.0 / frames as f64, &mut mean);
        components.iter_mut().enumerate().for_each(|(k, sums)| add(basis[(t, k)], sums));
    }
    Ok((mean, components))
}

/// Calls `use_vertex` with each vertex's mean offset from rest, and its offsets from that over time, along x, y and z.
fn for_each_vertex<S: Read + Seek>(
    journal: &mut JournalReader<S>,
    mesh: usize,
    rest: &[[f64; 3]],
    mut use_vertex: impl FnMut(usize, [f64; 3], [&[f64]; 3]),
) -> Result<(), ExportError> {
    let frames = journal.frame_count();
    for_each_slab(journal, mesh, rest, |first, means, slab| {
        for (i, rows) in slab.chunks_exact(3 * frames).enumerate() {
            use_vertex(first + i, means[i], [&rows[..frames], &rows[frames..2 * frames], &rows[2 * frames..]]);
        }
    })
}

/// Calls `use_slab` with the first of some consecutive vertices, their mean offsets from rest, and their offsets from those:
/// for each vertex x over time, then y, then z.
fn for_each_slab<S: Read + Seek>(
    journal: &mut JournalReader<S>,
    mesh: usize,
    rest: &[[f64; 3]],
    mut use_slab: impl FnMut(usize, &[[f64; 3]], &[f64]),
) -> Result<(), ExportError> {
    let frames = journal.frame_count();
    let per_slab = (SLAB_BYTES / (24 * frames)).max(1);
    let mut frame = JournalFrame::default();
    let mut slab = Vec::new();
    for first in (0..rest.len()).step_by(per_slab) {
        let range = first..rest.len().min(first + per_slab);
        slab.clear();
        slab.resize(range.len() * 3 * frames, 0.0);
        for t in 0..frames {
            journal.read_frame(t, &mut frame)?;
            for (i, v) in range.clone().enumerate() {
                for c in 0..3 {
                    slab[(3 * i + c) * frames + t] = f64::from(frame.skin[mesh][v][c]) - rest[v][c];
                }
            }
        }
        let mut means = vec![[0.0; 3]; range.len()];
        for (row, mean) in slab.chunks_exact_mut(frames).zip(means.as_flattened_mut()) {
            *mean = row.iter().sum::<f64>() / frames as f64;
            row.iter_mut().for_each(|v| *v -= *mean);
        }
        use_slab(first, &means, &slab);
    }
    Ok(())
}
