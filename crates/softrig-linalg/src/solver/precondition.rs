//! Parts of solvers for those who iterate themselves: a preconditioner, and products with a whole system.
//!
//! A system that is larger than the nodes (joints on top of them, springs between them) is solved by an iteration around both.

use super::cubes::FreeCubes;
use super::free::FreePattern;
use super::quads::Quads;
use super::{LinearSystem, SolveError};
use crate::{BlockCsr, Scalar};
use rayon::prelude::*;

/// An approximate inverse of a system on its free nodes: symmetric positive definite up to rounding.
pub trait Preconditioner<R> {
    /// Takes the numbers of a system on the pattern and constraints its solver was prepared for. What is costly and may lag
    /// behind is kept from earlier calls until the solver is told to forget.
    ///
    /// # Errors
    /// [`SolveError`] when the solver was not prepared for it, or it is not positive definite.
    fn load(&mut self, system: &mut dyn LinearSystem<R>) -> Result<(), SolveError>;

    /// Node of each free row.
    fn free_nodes(&self) -> &[u32];

    /// `z ≈ A⁻¹ r` on free rows; the fourth numbers are zero.
    fn apply(&mut self, r: &[[f64; 4]], z: &mut [[f64; 4]]);
}

/// Products with a system on all of its nodes, constrained ones included, in f64. Bitwise equal for any thread count.
#[derive(Debug, Default)]
pub struct Operator {
    cubes: Option<Cubes>,
}

#[derive(Debug)]
struct Cubes {
    all: FreePattern,
    free: FreeCubes<f64>,
    x: Quads<f64>,
    y: Quads<f64>,
}

impl Operator {
    /// Takes the numbers of a system. Returns whether products need its entries: then they must be given to
    /// [`Self::product`], and are not read otherwise.
    pub fn load<R: Scalar>(&mut self, system: &mut dyn LinearSystem<R>) -> bool {
        let Some(matrix) = system.cubes() else {
            self.cubes = None;
            return true;
        };
        if !self.cubes.as_ref().is_some_and(|c| c.free.belongs_to(&matrix.pattern)) {
            let n = matrix.pattern.node_count;
            // the cubes need the numbering of the nodes only
            let all = FreePattern::numbering((0..n as u32).collect());
            let (x, y) = (Quads::zero(n), Quads::zero(n));
            self.cubes = Some(Cubes { free: FreeCubes::new(&matrix.pattern, &all), all, x, y });
        }
        if let Some(cubes) = &mut self.cubes {
            cubes.free.load(matrix, &cubes.all);
        }
        false
    }

    /// `y = A x`.
    ///
    /// # Panics
    /// When the vectors do not have one entry per node.
    pub fn product<R: Scalar>(&mut self, stored: &BlockCsr<R>, x: &[[f64; 3]], y: &mut [[f64; 3]]) {
        assert_eq!(x.len(), y.len(), "one entry per node in both vectors");
        if let Some(cubes) = &mut self.cubes {
            for (to, v) in cubes.x.get_mut().iter_mut().zip(x) {
                *to = [v[0], v[1], v[2], 0.0];
            }
            cubes.free.product(cubes.x.padded(), cubes.y.get_mut());
            for (y, from) in y.iter_mut().zip(cubes.y.get()) {
                *y = [from[0], from[1], from[2]];
            }
            return;
        }
        let pattern = &stored.pattern;
        y.par_chunks_mut(ROWS).enumerate().for_each(|(c, y)| {
            for (k, y) in y.iter_mut().enumerate() {
                let row = pattern.row(c * ROWS + k);
                let mut sum = [0.0; 3];
                for (m, column) in stored.values[row.clone()].iter().zip(&pattern.column()[row]) {
                    let v = x[*column as usize];
                    for r in 0..3 {
                        sum[r] +=
                            m[3 * r].to_f64() * v[0] + m[3 * r + 1].to_f64() * v[1] + m[3 * r + 2].to_f64() * v[2];
                    }
                }
                *y = sum;
            }
        });
    }
}

/// Rows per task.
const ROWS: usize = 256;
