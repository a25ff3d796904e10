//! The system without its dependent nodes: Tᵀ A T y = Tᵀ b.

use super::{Elimination, LinkError};
use softrig_linalg::{BlockCsr, BlockPattern, DofConstraints, LinearSolver, Scalar, SolveError, SolveReport};
use std::sync::Arc;

/// A block of A that goes into a block of Tᵀ A T.
#[derive(Clone, Copy, Debug)]
struct Entry {
    from: u32,
    to: u32,
    weight: f64,
}

/// Memory of a reduced system: blocks of independent nodes only.
#[derive(Debug)]
pub struct Reduced<R> {
    elimination: Arc<Elimination>,
    /// Of the reduced matrix; dependent and prescribed nodes have no blocks but their diagonals.
    pub pattern: Arc<BlockPattern>,
    /// Dependent and prescribed nodes.
    pub constraints: DofConstraints,
    prescribed: Vec<bool>,
    entries: Vec<Entry>,
    matrix: BlockCsr<R>,
    rhs: Vec<[R; 3]>,
    solution: Vec<[R; 3]>,
}

impl<R: Scalar> Reduced<R> {
    /// For matrices of a pattern made from these cells.
    ///
    /// # Errors
    /// [`LinkError::TooDense`].
    ///
    /// # Panics
    /// When the pattern is not made from the cells.
    pub fn new<'a>(
        elimination: Arc<Elimination>,
        whole: &BlockPattern,
        cells: impl Iterator<Item = &'a [u32]>,
        prescribed: &DofConstraints,
    ) -> Result<Self, LinkError> {
        let prescribed = prescribed.mask().to_vec();
        let n = prescribed.len();
        let parts = elimination.expansions(&prescribed)?;
        let mut lists = Vec::new();
        for cell in cells {
            let mut list: Vec<u32> = cell.iter().flat_map(|n| parts[*n as usize].iter().map(|t| t.0)).collect();
            list.sort_unstable();
            list.dedup();
            lists.push(list);
        }
        let pattern = Arc::new(BlockPattern::from_cells(n, lists.iter().map(|l| &l[..])));
        let mut entries = Vec::with_capacity(whole.block_count());
        for i in 0..n {
            for from in whole.row(i) {
                let j = whole.column()[from] as usize;
                for &(a, wa) in &parts[i] {
                    for &(b, wb) in &parts[j] {
                        let to = pattern.find(a as usize, b as usize).expect("the nodes of a cell are coupled");
                        entries.push(Entry { from: from as u32, to: to as u32, weight: wa * wb });
                    }
                }
            }
        }
        let mask = prescribed.iter().zip(elimination.dependent()).map(|(p, d)| *p || *d).collect();
        Ok(Self {
            elimination,
            matrix: BlockCsr::zero(pattern.clone()),
            pattern,
            constraints: DofConstraints::from_mask(mask),
            prescribed,
            entries,
            rhs: vec![[R::zero(); 3]; n],
            solution: vec![[R::zero(); 3]; n],
        })
    }

    /// Solves A x = b among the x = T y, and writes A x − b, the force by which the links hold the nodes.
    ///
    /// # Errors
    /// As [`LinearSolver::solve`]; `solution` and `force` are unchanged then.
    pub fn solve(
        &mut self,
        solver: &mut dyn LinearSolver<R>,
        matrix: &BlockCsr<R>,
        rhs: &[[R; 3]],
        tolerance: f64,
        solution: &mut [[R; 3]],
        force: &mut [[R; 3]],
    ) -> Result<SolveReport, SolveError> {
        let n = self.rhs.len();
        if rhs.len() != n || solution.len() != n || force.len() != n {
            return Err(SolveError::NotPrepared);
        }
        for i in 0..n {
            self.rhs[i] = if self.prescribed[i] { [R::zero(); 3] } else { rhs[i] };
        }
        let whole = norm(&self.rhs);
        self.elimination.gather(&mut self.rhs);
        let left = norm(&self.rhs);
        // what links hold takes no solving; below that is rounding of it
        let rounding = 64.0 * R::EPSILON.to_f64() * whole;
        let asked = (tolerance * left).max(rounding);
        self.solution.fill([R::zero(); 3]);
        let report = if left <= rounding {
            let residual = if whole > 0.0 { left / whole } else { 0.0 };
            SolveReport { solver: solver.name(), iterations: 0, residual, converged: true, rebuilt: false, start: 1.0 }
        } else {
            self.matrix.values.fill([R::zero(); 9]);
            for e in &self.entries {
                let (to, from) = (&mut self.matrix.values[e.to as usize], &matrix.values[e.from as usize]);
                let w = R::from_f64(e.weight);
                (0..9).for_each(|k| to[k] += w * from[k]);
            }
            solver.solve(&self.matrix, &self.rhs, &mut self.solution, (asked / left).min(0.5))?
        };
        self.elimination.spread(&mut self.solution);
        for i in 0..n {
            force[i] = [R::zero(); 3];
            if self.prescribed[i] {
                continue;
            }
            let mut f = rhs[i].map(|b| -b);
            for k in matrix.pattern.row(i) {
                let (m, x) = (&matrix.values[k], self.solution[matrix.pattern.column()[k] as usize]);
                (0..3).for_each(|r| f[r] += m[3 * r] * x[0] + m[3 * r + 1] * x[1] + m[3 * r + 2] * x[2]);
            }
            force[i] = f;
        }
        solution.copy_from_slice(&self.solution);
        Ok(report)
    }
}

fn norm<R: Scalar>(v: &[[R; 3]]) -> f64 {
    v.iter().flatten().map(|x| x.to_f64() * x.to_f64()).sum::<f64>().sqrt()
}

/// A solver that keeps what it solves within the links.
pub(crate) struct Within<'a, R> {
    pub inner: &'a mut dyn LinearSolver<R>,
    pub reduced: &'a mut Reduced<R>,
    pub force: &'a mut [[R; 3]],
}

impl<R: Scalar> LinearSolver<R> for Within<'_, R> {
    fn name(&self) -> &'static str {
        self.inner.name()
    }

    /// The one inside is prepared for the reduced system by whoever made this.
    fn prepare(&mut self, _: &Arc<BlockPattern>, _: &DofConstraints) -> Result<(), SolveError> {
        Ok(())
    }

    fn solve(
        &mut self,
        matrix: &BlockCsr<R>,
        rhs: &[[R; 3]],
        solution: &mut [[R; 3]],
        tolerance: f64,
    ) -> Result<SolveReport, SolveError> {
        self.reduced.solve(self.inner, matrix, rhs, tolerance, solution, self.force)
    }
}
