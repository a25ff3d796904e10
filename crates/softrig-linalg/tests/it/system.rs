//! Systems to solve, and independent ways to solve and judge them.

use faer::linalg::solvers::Solve;
use softrig_linalg::{BlockCsr, BlockPattern, DofConstraints, Scalar};
use std::sync::Arc;

/// Numbers in [0, 1) from a seed: xorshift, enough for test data.
pub struct Random(pub u64);
impl Random {
    pub fn next(&mut self) -> f64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }
    pub fn below(&mut self, n: usize) -> usize {
        (self.next() * n as f64) as usize
    }
}

/// A matrix, a right-hand side and constraints.
pub struct System<R> {
    pub matrix: BlockCsr<R>,
    pub rhs: Vec<[R; 3]>,
    pub constraints: DofConstraints,
}

/// A chain of random four-node cells, each contributing `B Bᵀ` with stiffness between 1 and `contrast`, plus mass: symmetric
/// positive definite. About `fixed` of the nodes are constrained, and their rows and columns hold NaN, which nobody may read.
pub fn random_system<R: Scalar>(nodes: usize, cells: usize, contrast: f64, fixed: f64, seed: u64) -> System<R> {
    let mut random = Random(seed | 1);
    for _ in 0..8 {
        random.next();
    }
    let mut list: Vec<Vec<u32>> = Vec::new();
    for _ in 0..cells {
        let near = random.below(nodes);
        let mut cell: Vec<u32> = (0..4).map(|_| ((near + random.below(12)) % nodes) as u32).collect();
        cell.sort_unstable();
        cell.dedup();
        list.push(cell);
    }
    let pattern = Arc::new(BlockPattern::from_cells(nodes, list.iter().map(|c| &c[..])));
    let mut values = vec![[0.0_f64; 9]; pattern.block_count()];
    for cell in &list {
        let stiffness = contrast.powf(random.next());
        let b: Vec<[f64; 3]> = (0..3 * cell.len()).map(|_| std::array::from_fn(|_| random.next() - 0.5)).collect();
        for (i, &ni) in cell.iter().enumerate() {
            for (j, &nj) in cell.iter().enumerate() {
                let k = pattern.find(ni as usize, nj as usize).expect("both nodes are in the cell");
                for c in 0..3 {
                    for d in 0..3 {
                        let (u, v) = (b[3 * i + c], b[3 * j + d]);
                        values[k][3 * c + d] += stiffness * (u[0] * v[0] + u[1] * v[1] + u[2] * v[2]);
                    }
                }
            }
        }
    }
    for d in pattern.diagonal() {
        for c in 0..3 {
            values[*d as usize][4 * c] += 0.05 + 0.1 * random.next();
        }
    }
    let mask: Vec<bool> = (0..nodes).map(|_| random.next() < fixed).collect();
    for i in 0..nodes {
        for k in pattern.row(i) {
            if mask[i] || mask[pattern.column()[k] as usize] {
                values[k] = [f64::NAN; 9];
            }
        }
    }
    let rhs = (0..nodes)
        .map(|i| {
            if mask[i] { [R::from_f64(f64::NAN); 3] } else { std::array::from_fn(|_| R::from_f64(random.next() - 0.5)) }
        })
        .collect();
    let values = values.iter().map(|b| b.map(R::from_f64)).collect();
    System { matrix: BlockCsr { pattern, values }, rhs, constraints: DofConstraints::from_mask(mask) }
}

impl<R: Scalar> System<R> {
    /// Unknowns that are not constrained.
    fn free(&self) -> Vec<usize> {
        (0..3 * self.rhs.len()).filter(|u| !self.constraints.is_constrained(u / 3)).collect()
    }

    fn entry(&self, row: usize, column: usize) -> f64 {
        let k = self.matrix.pattern.find(row / 3, column / 3);
        k.map_or(0.0, |k| self.matrix.values[k][3 * (row % 3) + column % 3].to_f64())
    }

    /// Solution by dense LU in f64.
    pub fn dense_solution(&self) -> Vec<[f64; 3]> {
        let free = self.free();
        let n = free.len();
        let mut x = vec![[0.0; 3]; self.rhs.len()];
        if n > 0 {
            let a = faer::Mat::from_fn(n, n, |i, j| self.entry(free[i], free[j]));
            let b = faer::Mat::from_fn(n, 1, |i, _| self.rhs[free[i] / 3][free[i] % 3].to_f64());
            let s = a.partial_piv_lu().solve(&b);
            for (i, u) in free.iter().enumerate() {
                x[u / 3][u % 3] = s[(i, 0)];
            }
        }
        x
    }

    /// `|b - A x| / |b|` over the free unknowns, entry by entry.
    pub fn residual(&self, x: &[[R; 3]]) -> f64 {
        let free = self.free();
        let (mut rr, mut bb) = (0.0, 0.0);
        for &i in &free {
            let b = self.rhs[i / 3][i % 3].to_f64();
            let mut r = b;
            for k in self.matrix.pattern.row(i / 3) {
                let j = self.matrix.pattern.column()[k] as usize;
                if !self.constraints.is_constrained(j) {
                    for d in 0..3 {
                        r -= self.matrix.values[k][3 * (i % 3) + d].to_f64() * x[j][d].to_f64();
                    }
                }
            }
            rr += r * r;
            bb += b * b;
        }
        if bb == 0.0 { 0.0 } else { (rr / bb).sqrt() }
    }
}

/// Largest difference relative to the largest entry of `b`.
pub fn difference<R: Scalar>(a: &[[R; 3]], b: &[[f64; 3]]) -> f64 {
    let size = b.as_flattened().iter().fold(0.0_f64, |m, v| m.max(v.abs()));
    let worst = a.as_flattened().iter().zip(b.as_flattened()).fold(0.0_f64, |m, (a, b)| m.max((a.to_f64() - b).abs()));
    if size == 0.0 { worst } else { worst / size }
}
