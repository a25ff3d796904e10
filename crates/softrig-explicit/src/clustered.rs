//! Clustered evaluation of f = K u + D v: block rows of each node, computed once.
//!
//! Implements [Tang2009 §3]. The element matrices of all cells around a node are summed into one row of 3x3 blocks per node
//! (its cluster), nodes of several cells (shared) and of one cell (boundary) alike; nothing is left out, so forces are those of the
//! element-by-element evaluation to rounding. Deviations: eq. 6 lacks the minus of eq. 4, and its "diagonal" matrices are these
//! rows. K_ij = K_jiᵀ is stored once and used for both nodes. With D = ξ M + ζ K, one product serves both terms: K (u + ζ v).
//! Terms: u = x - X displacement [m]; v velocity [m/s]. Sign: f_int as on the left of `M a + C v + f_int(x) = f_ext`.

use crate::part::{self, Part};
use softrig::body::Body;
use softrig::force::{ForceModel, Increment};
use softrig_linalg::{BlockCsr, BlockPattern, Kernel, Lane, Scalar, Wide, run_wide};
use std::sync::Arc;

/// Rows of three, padded to four so that a row is one register.
type Block<R> = [[R; 4]; 3];

/// Linear elasticity by block rows.
pub struct Clustered<R> {
    parts: Vec<Rows<R>>,
    /// Σ b K of the cells where b differs between them; otherwise `damping` is b.
    damping_parts: Vec<Rows<R>>,
    damping: R,
    rest: Vec<[R; 3]>,
    stiffness: BlockCsr<R>,
    damping_matrix: BlockCsr<R>,
    clusters: Clusters,
}

/// How many nodes belong to several cells and to one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Clusters {
    /// Nodes of two or more cells.
    pub shared: usize,
    /// Nodes of one cell.
    pub boundary: usize,
    /// Blocks of all rows.
    pub blocks: usize,
}

/// The rows of one part.
struct Rows<R> {
    part: Part,
    rest: Vec<[R; 3]>,
    diagonal: Vec<Block<R>>,
    /// Per row: first pair, first one-sided block, end.
    start: Vec<[u32; 3]>,
    column: Vec<u32>,
    block: Vec<Block<R>>,
    u: Vec<[R; 4]>,
    f: Vec<[R; 4]>,
}

impl<R: Scalar> Clustered<R> {
    /// The rows of a body: its stiffness at rest, whatever cells it has.
    pub fn new(body: &mut Body<R>) -> Self {
        let rest: Vec<[R; 3]> = body.mesh.nodes.iter().map(|p| p.map(R::from_f64)).collect();
        let history = body.model.history();
        body.model.linearise(&rest);
        let mut stiffness = BlockCsr::zero(body.pattern.clone());
        body.model.stiffness(R::zero(), R::zero(), &mut stiffness);
        let mut damped = BlockCsr::zero(body.pattern.clone());
        body.model.stiffness(R::one(), R::zero(), &mut damped);
        body.model.restore(&history);
        for (d, k) in damped.values.iter_mut().zip(&stiffness.values) {
            (0..9).for_each(|i| d[i] -= k[i]);
        }
        let uniform = proportion(&damped, &stiffness);
        let mut cells = vec![0u32; rest.len()];
        body.mesh.cells().flatten().for_each(|n| cells[*n as usize] += 1);
        let count = |f: &dyn Fn(u32) -> bool| cells.iter().filter(|c| f(**c)).count();
        let clusters = Clusters {
            shared: count(&|c| c > 1),
            boundary: count(&|c| c == 1),
            blocks: stiffness.pattern.block_count(),
        };
        Self {
            parts: rows(&stiffness, &rest),
            damping_parts: if uniform.is_some() { Vec::new() } else { rows(&damped, &rest) },
            damping: uniform.unwrap_or_else(R::zero),
            rest,
            stiffness,
            damping_matrix: damped,
            clusters,
        }
    }

    /// How the nodes fall into clusters.
    #[must_use]
    pub fn clusters(&self) -> Clusters {
        self.clusters
    }

    /// Writes K (x - X) + D v [N], with the stiffness-proportional damping of the materials and `damping` [s] more.
    ///
    /// # Panics
    /// When a list has another length than the body.
    pub fn internal_force(&mut self, position: &[[R; 3]], velocity: &[[R; 3]], damping: R, force: &mut [[R; 3]]) {
        let n = self.rest.len();
        assert!(position.len() == n && velocity.len() == n && force.len() == n, "one entry per node");
        let b = self.damping + damping;
        run(&mut self.parts, Load { position: Some(position), added: Some(velocity), factor: b }, false, force);
        if !self.damping_parts.is_empty() {
            let load = Load { position: None, added: Some(velocity), factor: R::one() };
            run(&mut self.damping_parts, load, true, force);
        }
    }
}

/// b where `damped` = b `stiffness`.
fn proportion<R: Scalar>(damped: &BlockCsr<R>, stiffness: &BlockCsr<R>) -> Option<R> {
    let pairs = || damped.values.as_flattened().iter().zip(stiffness.values.as_flattened());
    let (d, k) = pairs().max_by(|a, b| a.1.abs().to_f64().total_cmp(&b.1.abs().to_f64()))?;
    let b = *d / *k;
    let slack = k.abs() * R::from_f64(64.0 * R::EPSILON.to_f64());
    pairs().all(|(d, k)| (*d - b * *k).abs() <= slack * (R::one() + b)).then_some(b)
}

fn padded<R: Scalar>(b: &[R; 9]) -> Block<R> {
    std::array::from_fn(|r| [b[3 * r], b[3 * r + 1], b[3 * r + 2], R::zero()])
}

fn rows<R: Scalar>(matrix: &BlockCsr<R>, rest: &[[R; 3]]) -> Vec<Rows<R>> {
    let pattern = &matrix.pattern;
    let pairs: Vec<[u32; 2]> = (0..pattern.row_count())
        .flat_map(|i| pattern.row(i).map(move |k| (i, k)))
        .map(|(i, k)| [i as u32, pattern.column()[k]])
        .collect();
    part::parts(pattern.row_count(), &pairs)
        .into_iter()
        .map(|(part, _)| {
            let mut out = Rows {
                rest: (0..part.len()).map(|l| rest[part.global(l)]).collect(),
                diagonal: Vec::with_capacity(part.own.len()),
                start: Vec::with_capacity(part.own.len()),
                column: Vec::new(),
                block: Vec::new(),
                u: vec![[R::zero(); 4]; part.len()],
                f: vec![[R::zero(); 4]; part.own.len()],
                part,
            };
            for i in out.part.own.clone() {
                out.diagonal.push(padded(&matrix.values[pattern.diagonal()[i] as usize]));
                let mut start = [out.column.len() as u32; 3];
                for pass in 0..2 {
                    for k in pattern.row(i) {
                        let j = pattern.column()[k] as usize;
                        let own = out.part.own.contains(&j);
                        // the lower half is the upper one, transposed
                        if (pass == 0) != own || (own && j <= i) {
                            continue;
                        }
                        out.column.push(out.part.local(j as u32).expect("rows read only what the part has"));
                        out.block.push(padded(&matrix.values[k]));
                    }
                    start[pass + 1] = out.column.len() as u32;
                }
                out.start.push(start);
            }
            out
        })
        .collect()
}

/// What the rows are multiplied by: (x - X) + factor * added, without x only the second.
#[derive(Clone, Copy)]
struct Load<'a, R> {
    position: Option<&'a [[R; 3]]>,
    added: Option<&'a [[R; 3]]>,
    factor: R,
}

fn run<R: Scalar>(parts: &mut [Rows<R>], load: Load<'_, R>, add: bool, force: &mut [[R; 3]]) {
    part::run(
        parts,
        |r| r.part.own.clone(),
        force,
        |rows, out| {
            run_wide::<R, _>(Product { rows, load, add, out });
        },
    );
}

struct Product<'a, R> {
    rows: &'a mut Rows<R>,
    load: Load<'a, R>,
    add: bool,
    out: &'a mut [[R; 3]],
}

impl<R: Scalar> Kernel for Product<'_, R> {
    type Output = ();

    /// Rows as four lanes, the fourth idle: the width of the machine does not matter here.
    #[inline(always)]
    fn run<const W: usize>(self) {
        let Self { rows, load, add, out } = self;
        let Rows { part, rest, diagonal, start, column, block, u, f } = rows;
        fill(part, rest, load, u);
        f.fill([R::zero(); 4]);
        let u = &u[..];
        for (i, [first, middle, last]) in start.iter().map(|s| s.map(|s| s as usize)).enumerate() {
            let own = Wide(u[i]);
            let (x, y, z) = (Wide::<R, 4>::splat(own.0[0]), Wide::splat(own.0[1]), Wide::splat(own.0[2]));
            let d = &diagonal[i];
            let mut sum = [Wide(d[0]) * own, Wide(d[1]) * own, Wide(d[2]) * own];
            for (b, j) in block[first..middle].iter().zip(&column[first..middle]) {
                let j = *j as usize;
                let (a, b, c) = (Wide(b[0]), Wide(b[1]), Wide(b[2]));
                let other = Wide(u[j]);
                sum[0] += a * other;
                sum[1] += b * other;
                sum[2] += c * other;
                // and the transposed block for the other node
                let to = &mut f[j];
                *to = (Wide(*to) + (a * x + (b * y + c * z))).0;
            }
            for (b, j) in block[middle..last].iter().zip(&column[middle..last]) {
                let other = Wide(u[*j as usize]);
                sum[0] += Wide(b[0]) * other;
                sum[1] += Wide(b[1]) * other;
                sum[2] += Wide(b[2]) * other;
            }
            let t = std::hint::black_box(sum);
            let part = |c: usize| Wide([t[0].0[c], t[1].0[c], t[2].0[c], R::zero()]);
            let row = (part(0) + part(1)) + part(2);
            f[i] = (Wide(f[i]) + row).0;
        }
        if add {
            for (o, f) in out.iter_mut().zip(f.iter()) {
                (0..3).for_each(|k| o[k] += f[k]);
            }
        } else {
            for (o, f) in out.iter_mut().zip(f.iter()) {
                *o = [f[0], f[1], f[2]];
            }
        }
    }
}

/// Gathers what a part is multiplied by.
#[inline(always)]
fn fill<R: Scalar>(part: &Part, rest: &[[R; 3]], load: Load<'_, R>, u: &mut [[R; 4]]) {
    let at = |n: usize, rest: &[R; 3]| -> [R; 4] {
        let mut out = [R::zero(); 4];
        if let Some(x) = load.position {
            (0..3).for_each(|k| out[k] = x[n][k] - rest[k]);
        }
        if let Some(v) = load.added {
            (0..3).for_each(|k| out[k] += load.factor * v[n][k]);
        }
        out
    };
    let own = part.own.len();
    let (u_own, u_copies) = u.split_at_mut(own);
    match (load.position, load.added) {
        // the common case without a branch per node
        (Some(x), Some(v)) => {
            let (x, v) = (&x[part.own.clone()], &v[part.own.clone()]);
            for (((u, x), v), rest) in u_own.iter_mut().zip(x).zip(v).zip(rest) {
                for k in 0..3 {
                    u[k] = (x[k] - rest[k]) + load.factor * v[k];
                }
            }
        }
        _ => {
            for ((u, n), rest) in u_own.iter_mut().zip(part.own.clone()).zip(rest) {
                *u = at(n, rest);
            }
        }
    }
    for ((u, n), rest) in u_copies.iter_mut().zip(&part.copies).zip(&rest[own..]) {
        *u = at(*n as usize, rest);
    }
}

impl<R: Scalar> ForceModel<R> for Clustered<R> {
    fn linearise(&mut self, _: &[[R; 3]]) {}

    fn force(&mut self, position: &[[R; 3]], increment: Increment<'_, R>, force: &mut [[R; 3]]) -> f64 {
        // first K u alone, for the energy
        run(&mut self.parts, Load { position: Some(position), added: None, factor: R::zero() }, false, force);
        let energy = (0..force.len())
            .map(|i| (0..3).map(|k| ((position[i][k] - self.rest[i][k]) * force[i][k]).to_f64()).sum::<f64>())
            .sum::<f64>()
            * 0.5;
        let one = R::one();
        if increment.displacement.is_some() {
            run(&mut self.parts, Load { position: None, added: increment.displacement, factor: one }, true, force);
        }
        if increment.velocity.is_some() {
            let factor = self.damping + increment.damping;
            run(&mut self.parts, Load { position: None, added: increment.velocity, factor }, true, force);
            if !self.damping_parts.is_empty() {
                let load = Load { position: None, added: increment.velocity, factor: one };
                run(&mut self.damping_parts, load, true, force);
            }
        }
        energy
    }

    fn stiffness(&mut self, rate: R, damping: R, matrix: &mut BlockCsr<R>) {
        let (k, d) = (&self.stiffness.values, &self.damping_matrix.values);
        for ((to, k), d) in matrix.values.iter_mut().zip(k).zip(d) {
            *to = std::array::from_fn(|i| k[i] + rate * (d[i] + damping * k[i]));
        }
    }

    fn save(&mut self) {}
    fn roll_back(&mut self) {}
    fn history(&self) -> Vec<[R; 4]> {
        Vec::new()
    }
    fn restore(&mut self, _: &[[R; 4]]) {}
}

impl<R: Scalar> Clustered<R> {
    /// Where the blocks of the stiffness are.
    #[must_use]
    pub fn pattern(&self) -> &Arc<BlockPattern> {
        &self.stiffness.pattern
    }

    /// The stiffness at rest [N/m].
    #[must_use]
    pub fn matrix(&self) -> &BlockCsr<R> {
        &self.stiffness
    }
}
