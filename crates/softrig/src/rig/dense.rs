//! Small dense symmetric systems: as many unknowns as a skeleton has angles.

/// `L Lᵀ` of a symmetric positive definite matrix.
#[derive(Clone, Debug, Default)]
pub(crate) struct Cholesky {
    n: usize,
    /// Lower triangle, row by row in full rows.
    lower: Vec<f64>,
}

impl Cholesky {
    /// Factorises the matrix (full rows; its lower triangle is read). Pivots that rounding has made non-positive are replaced by the
    /// diagonal itself, so that a redundant unknown stays where it is. The memory of an earlier factor is used again.
    pub fn factorise(&mut self, n: usize, matrix: &[f64]) {
        assert_eq!(matrix.len(), n * n, "a square matrix");
        self.n = n;
        self.lower.clear();
        self.lower.extend_from_slice(matrix);
        let l = &mut self.lower;
        for i in 0..n {
            for j in 0..=i {
                let mut sum = l[i * n + j];
                for k in 0..j {
                    sum -= l[i * n + k] * l[j * n + k];
                }
                if i == j {
                    let diagonal = matrix[i * n + i].abs().max(f64::MIN_POSITIVE);
                    l[i * n + i] = if sum > 1e-14 * diagonal { sum } else { diagonal }.sqrt();
                } else {
                    l[i * n + j] = sum / l[j * n + j];
                }
            }
        }
    }

    /// Solves in place.
    pub fn solve(&self, b: &mut [f64]) {
        let (n, l) = (self.n, &self.lower);
        for i in 0..n {
            let sum: f64 = (0..i).map(|k| l[i * n + k] * b[k]).sum();
            b[i] = (b[i] - sum) / l[i * n + i];
        }
        for i in (0..n).rev() {
            let sum: f64 = (i + 1..n).map(|k| l[k * n + i] * b[k]).sum();
            b[i] = (b[i] - sum) / l[i * n + i];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_solution_solves() {
        let a = [4.0, 1.0, 0.5, 1.0, 3.0, -0.2, 0.5, -0.2, 2.0];
        let x = [1.0, -2.0, 0.5];
        let mut b: Vec<f64> = (0..3).map(|i| (0..3).map(|j| a[3 * i + j] * x[j]).sum()).collect();
        let mut factor = Cholesky::default();
        factor.factorise(3, &a);
        factor.solve(&mut b);
        assert!(b.iter().zip(x).all(|(a, b)| (a - b).abs() < 1e-14), "{b:?}");
    }

    /// Two joints at one place can only be told apart by what holds them: a singular matrix must not end in NaN.
    #[test]
    fn a_redundant_unknown_stays_finite() {
        let mut factor = Cholesky::default();
        factor.factorise(2, &[1.0, 1.0, 1.0, 1.0]);
        let mut b = [1.0, 1.0];
        factor.solve(&mut b);
        assert!(b.iter().all(|v| v.is_finite()));
    }
}
