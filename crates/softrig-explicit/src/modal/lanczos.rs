//! Lowest modes by block Lanczos on the shifted and inverted problem.
//!
//! (K + s M)⁻¹ M has the same vectors as K φ = ω² M φ and its largest eigenvalues 1 / (ω² + s) belong to the lowest modes. Blocks of
//! vectors find equal frequencies, of which symmetric bodies have many; every vector is made M-orthogonal to all before it, twice.
//! The shift s is small and positive, so that bodies that nothing holds, with rigid modes at ω = 0, can be factorised too.

use faer::prelude::Solve;
use faer::sparse::{SparseColMat, Triplet};
use faer::{Mat, Side};
use softrig::body::Body;
use softrig_linalg::{BlockCsr, Scalar};

/// Vectors per block: no frequency of a body is equal more often by symmetry, but for its six rigid motions.
const BLOCK: usize = 6;
/// Residual of a mode, relative to its eigenvalue [-]: frequencies are then good to its square, shapes to about its size.
const TOLERANCE: f64 = 1e-9;
/// No residual gets below the rounding of the largest eigenvalue: in free bodies those of the rigid modes are a million times those
/// of the elastic ones, and waiting for less ends with a basis of the whole space.
const ROUNDING: f64 = 64.0 * f64::EPSILON;

/// Why there are no modes.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ModalError {
    /// More modes than unknowns, or none.
    #[error("{wanted} modes of a body with {unknowns} free unknowns; ask for 1 to {unknowns}")]
    Count {
        /// How many were asked for.
        wanted: usize,
        /// How many there are.
        unknowns: usize,
    },
    /// The stiffness is not positive semidefinite.
    #[error("the stiffness matrix could not be factorised; check for cells without volume or material")]
    NotPositiveDefinite,
    /// The dense eigenvalue problem failed.
    #[error("the projected eigenvalue problem did not converge; the stiffness may hold values that are not finite")]
    NotConverged,
}

/// Modes of the free nodes of a body, lowest first.
#[derive(Clone, Debug)]
pub struct Modes {
    /// Angular frequencies ω [1/s].
    pub frequency: Vec<f64>,
    /// Shapes φ [1/sqrt(kg)], one vector per node, zero on prescribed ones; φᵀ M φ = 1.
    pub shape: Vec<Vec<[f64; 3]>>,
    /// Dimension of the Lanczos basis that gave them.
    pub basis: usize,
}

impl Modes {
    /// The lowest `count` modes of a body at rest, with the prescribed nodes held.
    ///
    /// # Errors
    /// [`ModalError`].
    pub fn new<R: Scalar>(body: &mut Body<R>, count: usize) -> Result<Self, ModalError> {
        let rest: Vec<[R; 3]> = body.mesh.nodes.iter().map(|p| p.map(R::from_f64)).collect();
        let history = body.model.history();
        body.model.linearise(&rest);
        let mut stiffness = BlockCsr::zero(body.pattern.clone());
        body.model.stiffness(R::zero(), R::zero(), &mut stiffness);
        body.model.restore(&history);
        let free: Vec<usize> = (0..rest.len()).filter(|i| !body.constraints.is_constrained(*i)).collect();
        let mass: Vec<f64> = free.iter().flat_map(|i| [body.mass[*i].to_f64(); 3]).collect();
        let unknowns = mass.len();
        if count == 0 || count > unknowns {
            return Err(ModalError::Count { wanted: count, unknowns });
        }
        let problem = Problem::new(&stiffness, &free, mass)?;
        let (frequency, vectors, basis) = problem.lowest(count)?;
        let shape = vectors.into_iter().map(|v| {
            let mut shape = vec![[0.0; 3]; rest.len()];
            for (i, v) in free.iter().zip(v.as_chunks::<3>().0) {
                shape[*i] = *v;
            }
            shape
        });
        Ok(Self { frequency, shape: shape.collect(), basis })
    }
}

struct Problem {
    mass: Vec<f64>,
    shift: f64,
    factor: faer::sparse::linalg::solvers::Llt<usize, f64>,
}

impl Problem {
    fn new<R: Scalar>(stiffness: &BlockCsr<R>, free: &[usize], mass: Vec<f64>) -> Result<Self, ModalError> {
        let n = mass.len();
        let mut index = vec![usize::MAX; stiffness.pattern.row_count()];
        free.iter().enumerate().for_each(|(new, old)| index[*old] = new);
        // a small part of the mean eigenvalue: far below the elastic modes, far above rounding
        let trace: f64 = free
            .iter()
            .zip(mass.as_chunks::<3>().0)
            .map(|(i, m)| {
                let d = &stiffness.values[stiffness.pattern.diagonal()[*i] as usize];
                (0..3).map(|k| d[4 * k].to_f64()).sum::<f64>() / m[0]
            })
            .sum();
        let shift = 1e-7 * (trace / n as f64).max(f64::MIN_POSITIVE);
        let mut entries = Vec::new();
        for &i in free {
            for k in stiffness.pattern.row(i) {
                let j = stiffness.pattern.column()[k] as usize;
                if index[j] == usize::MAX {
                    continue;
                }
                for e in 0..9 {
                    let (row, col) = (3 * index[i] + e / 3, 3 * index[j] + e % 3);
                    let val = stiffness.values[k][e].to_f64() + if row == col { shift * mass[row] } else { 0.0 };
                    entries.push(Triplet { row, col, val });
                }
            }
        }
        let matrix = SparseColMat::<usize, f64>::try_new_from_triplets(n, n, &entries)
            .map_err(|_| ModalError::NotPositiveDefinite)?;
        let factor = matrix.sp_cholesky(Side::Lower).map_err(|_| ModalError::NotPositiveDefinite)?;
        Ok(Self { mass, shift, factor })
    }

    fn dot(&self, a: &[f64], b: &[f64]) -> f64 {
        a.iter().zip(b).zip(&self.mass).map(|((a, b), m)| a * b * m).sum()
    }

    /// Makes `w` M-orthogonal to the basis and of length one; a random vector takes its place when nothing is left of it.
    fn orthonormal(&self, basis: &[Vec<f64>], mut w: Vec<f64>, bits: &mut u64) -> Vec<f64> {
        loop {
            let before = self.dot(&w, &w).sqrt();
            for _ in 0..2 {
                for v in basis {
                    let c = self.dot(v, &w);
                    w.iter_mut().zip(v).for_each(|(w, v)| *w -= c * v);
                }
            }
            let norm = self.dot(&w, &w).sqrt();
            if norm > 1e-10 * before && norm.is_finite() && norm > 0.0 {
                // once more: what was lost to cancellation is noise along the basis
                w.iter_mut().for_each(|w| *w /= norm);
                for v in basis {
                    let c = self.dot(v, &w);
                    w.iter_mut().zip(v).for_each(|(w, v)| *w -= c * v);
                }
                let norm = self.dot(&w, &w).sqrt();
                w.iter_mut().for_each(|w| *w /= norm);
                return w;
            }
            w = random(self.mass.len(), bits);
        }
    }

    /// Frequencies, vectors, and the size of the basis.
    fn lowest(&self, count: usize) -> Result<(Vec<f64>, Vec<Vec<f64>>, usize), ModalError> {
        let n = self.mass.len();
        let mut bits = 0x2545_F491_4F6C_DD1Du64;
        let (mut basis, mut images): (Vec<Vec<f64>>, Vec<Vec<f64>>) = (Vec::new(), Vec::new());
        let mut fresh: Vec<Vec<f64>> = (0..BLOCK.min(n)).map(|_| random(n, &mut bits)).collect();
        let mut check = (2 * count + 2 * BLOCK).min(n);
        loop {
            let first = basis.len();
            for w in fresh.drain(..) {
                if basis.len() < n {
                    let w = self.orthonormal(&basis, w, &mut bits);
                    basis.push(w);
                }
            }
            let mut rhs = Mat::from_fn(n, basis.len() - first, |i, j| basis[first + j][i] * self.mass[i]);
            self.factor.solve_in_place(&mut rhs);
            for j in 0..rhs.ncols() {
                images.push((0..n).map(|i| rhs[(i, j)]).collect());
            }
            fresh.extend_from_slice(&images[first..]);
            let p = basis.len();
            if p < check && p < n {
                continue;
            }
            let h =
                Mat::from_fn(p, p, |i, j| 0.5 * (self.dot(&basis[i], &images[j]) + self.dot(&basis[j], &images[i])));
            let eigen = h.self_adjoint_eigen(Side::Lower).map_err(|_| ModalError::NotConverged)?;
            let (values, vectors) = (eigen.S(), eigen.U());
            let combine = |list: &[Vec<f64>], k: usize| {
                let mut out = vec![0.0; n];
                for (i, v) in list.iter().enumerate() {
                    let c = vectors[(i, k)];
                    out.iter_mut().zip(v).for_each(|(o, v)| *o += c * v);
                }
                out
            };
            // the largest come last
            let wanted: Vec<usize> = (p - count..p).rev().collect();
            let mut done = p == n;
            if !done {
                done = wanted.iter().all(|&k| {
                    let theta = values[k];
                    let (y, mut r) = (combine(&basis, k), combine(&images, k));
                    r.iter_mut().zip(&y).for_each(|(r, y)| *r -= theta * y);
                    self.dot(&r, &r).sqrt() <= (TOLERANCE * theta).max(ROUNDING * values[p - 1])
                });
            }
            if done {
                let frequency = wanted.iter().map(|&k| (1.0 / values[k] - self.shift).max(0.0).sqrt()).collect();
                let shapes = wanted.iter().map(|&k| combine(&basis, k)).collect();
                return Ok((frequency, shapes, p));
            }
            check = (p + count.max(4 * BLOCK) / 2).min(n);
        }
    }
}

/// Numbers in [-1, 1), a fixed sequence.
fn random(n: usize, bits: &mut u64) -> Vec<f64> {
    let mut next = || {
        *bits ^= *bits << 13;
        *bits ^= *bits >> 7;
        *bits ^= *bits << 17;
        (*bits >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    };
    (0..n).map(|_| next()).collect()
}
