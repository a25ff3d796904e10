//! A small quadratic problem with limits: the damped steps of inverse kinematics.

use super::articulation::Limit;
use super::dense::Cholesky;

/// How much stiffer than the stiffest unknown a limit is while it holds: what is left of the gap is rounding.
pub(crate) const HOLD: f64 = 1e7;

/// Memory of [`settle`], and the increment it found.
#[derive(Clone, Debug, Default)]
pub(crate) struct Settling {
    /// The increment.
    pub x: Vec<f64>,
    held: Vec<f64>,
    factor: Cholesky,
}

/// The increment that minimises ½ xᵀ H x − gᵀ x with every limit kept, by an active set. `hessian` holds full rows.
/// Returns how many limits hold.
pub(crate) fn solve(hessian: &[f64], gradient: &[f64], limits: &[Limit], x: &mut Vec<f64>) -> usize {
    let (mut active, mut memory) = (Vec::new(), Settling::default());
    settle(hessian, gradient, limits, &mut active, &mut memory);
    std::mem::swap(x, &mut memory.x);
    active.iter().filter(|on| **on).count()
}

/// As [`solve`], in memory that is there; `active` says which limits hold.
pub(crate) fn settle(
    hessian: &[f64],
    gradient: &[f64],
    limits: &[Limit],
    active: &mut Vec<bool>,
    memory: &mut Settling,
) {
    let n = gradient.len();
    let Settling { x, held, factor } = memory;
    active.clear();
    active.resize(limits.len(), false);
    let largest = (0..n).map(|i| hessian[i * n + i]).fold(f64::MIN_POSITIVE, f64::max);
    // each round adds or drops limits; it ends when nothing changes, and in any case
    for _ in 0..2 * limits.len().min(20) + 1 {
        held.clear();
        held.extend_from_slice(hessian);
        x.clear();
        x.extend_from_slice(gradient);
        for (limit, _) in limits.iter().zip(&*active).filter(|(_, on)| **on) {
            hold(limit, HOLD * largest, n, held, x);
        }
        factor.factorise(n, held);
        factor.solve(x);
        let mut changed = false;
        for (limit, on) in limits.iter().zip(&mut *active) {
            let over = reach(limit, x) - limit.gap;
            if *on {
                // a limit that would have to pull lets go
                if over < 0.0 {
                    (*on, changed) = (false, true);
                }
            } else if over > 1e-12 {
                (*on, changed) = (true, true);
            }
        }
        if !changed {
            break;
        }
    }
}

/// normal · x.
pub(crate) fn reach(limit: &Limit, x: &[f64]) -> f64 {
    (0..limit.count).map(|k| limit.normal[k] * x[limit.first + k]).sum()
}

/// Adds a limit that holds to a system: a spring of that stiffness to its gap.
pub(crate) fn hold(limit: &Limit, stiffness: f64, n: usize, matrix: &mut [f64], rhs: &mut [f64]) {
    hold_matrix(limit, stiffness, n, matrix);
    (0..limit.count).for_each(|a| rhs[limit.first + a] += stiffness * limit.normal[a] * limit.gap);
}

/// The matrix of [`hold`].
pub(crate) fn hold_matrix(limit: &Limit, stiffness: f64, n: usize, matrix: &mut [f64]) {
    for a in 0..limit.count {
        for b in 0..limit.count {
            matrix[(limit.first + a) * n + limit.first + b] += stiffness * limit.normal[a] * limit.normal[b];
        }
    }
}
