//! Inverse kinematics with a goal for any number of joints, limits kept exactly.
//!
//! Damped least squares by default. The transpose of the Jacobian is [Georgii2010 §4.3], with half of the exact line search along
//! it: the whole of it zig-zags and needs two to three times as many iterations.

use super::articulation::{Articulation, Base, Column, Configuration, Limit};
use super::limited;
use super::skeleton::{JointId, Pose, Skeleton};
use glam::DVec3;

/// Where a joint shall be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Goal {
    /// The joint.
    pub joint: JointId,
    /// Its place in the world [m].
    pub position: [f64; 3],
    /// How much it counts against other goals [-].
    pub weight: f64,
}

/// How steps are found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum IkMethod {
    /// Least squares with this damping, as a share of `length` [-].
    DampedLeastSquares {
        /// Larger is slower and steadier where goals are out of reach.
        damping: f64,
    },
    /// Half a line search along the transpose of the Jacobian.
    JacobianTranspose,
}

/// Settings of inverse kinematics.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct IkSettings {
    /// How steps are found. Default: least squares with damping 0.02, which needs 3 to 9 steps.
    pub method: IkMethod,
    /// At most so many steps. Default 20.
    pub iterations: usize,
    /// Ends when no unknown moves by more [rad; m as a share of `length`]. Default 1e-7.
    pub tolerance: f64,
    /// A typical length of the skeleton, such as that of its longest bone [m].
    pub length: f64,
}

impl Default for IkSettings {
    fn default() -> Self {
        Self { method: IkMethod::DampedLeastSquares { damping: 0.02 }, iterations: 20, tolerance: 1e-7, length: 0.5 }
    }
}

/// What inverse kinematics did.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct IkReport {
    /// Steps done.
    pub iterations: usize,
    /// Root of the weighted sum of squares of the distances from the goals [m].
    pub error: f64,
    /// Limits that hold.
    pub limited: usize,
    /// Whether it came to rest.
    pub converged: bool,
}

/// A step turns no joint further [rad], nor moves a root by more lengths.
const LONGEST_STEP: f64 = 0.5;

/// Moves `configuration` so that joints come as near to their goals as their limits let them.
pub fn reach(
    articulation: &Articulation,
    skeleton: &Skeleton,
    base: &Base,
    goals: &[Goal],
    settings: &IkSettings,
    configuration: &mut Configuration,
) -> IkReport {
    let n = articulation.unknown_count();
    let mut pose = Pose::default();
    let (mut columns, mut limits, mut step) = (Vec::new(), Vec::new(), Vec::new());
    let mut report = IkReport::default();
    // unknown goals, far goals: bounded by what a skeleton can reach from here
    let goals: Vec<Goal> = goals
        .iter()
        .copied()
        .filter(|g| g.weight > 0.0 && g.weight.is_finite() && g.position.iter().all(|v| v.is_finite()))
        .filter(|g| g.joint.index() < skeleton.joint_count())
        .collect();
    articulation.clamp(configuration);
    articulation.pose_into(skeleton, base, configuration, &mut pose);
    if n > 0 && !goals.is_empty() {
        for iteration in 1..=settings.iterations {
            report.iterations = iteration;
            articulation.columns_into(skeleton, &pose, &mut columns);
            articulation.limits_into(skeleton, &pose, configuration, &mut limits);
            let jacobian = Jacobian::new(articulation, &columns, &goals, &pose);
            report.limited = match settings.method {
                IkMethod::DampedLeastSquares { damping } => {
                    jacobian.least_squares(n, (damping * settings.length).max(1e-9), &limits, &mut step)
                }
                IkMethod::JacobianTranspose => jacobian.transpose(n, settings.length, &limits, &mut step),
            };
            let largest = step.iter().fold(0.0f64, |m, s| m.max(s.abs()));
            if !largest.is_finite() {
                break;
            }
            if largest > LONGEST_STEP {
                step.iter_mut().for_each(|s| *s *= LONGEST_STEP / largest);
            }
            articulation.advance(skeleton, &pose, &step, configuration);
            articulation.clamp(configuration);
            articulation.pose_into(skeleton, base, configuration, &mut pose);
            if largest < settings.tolerance {
                report.converged = true;
                break;
            }
        }
    } else {
        report.converged = true;
    }
    report.error = goals
        .iter()
        .map(|g| g.weight * DVec3::from(g.position).distance_squared(DVec3::from(pose.joint(g.joint).translation)))
        .sum::<f64>()
        .sqrt();
    report
}

/// Weighted rows of all goals.
struct Jacobian {
    /// Three rows per goal: the unknowns that move it, and by what.
    rows: Vec<Vec<(usize, DVec3)>>,
    /// What is left to the goals, weighted.
    error: Vec<DVec3>,
}

impl Jacobian {
    fn new(articulation: &Articulation, columns: &[Column], goals: &[Goal], pose: &Pose) -> Self {
        let mut out = Self { rows: Vec::new(), error: Vec::new() };
        for goal in goals {
            let (at, w) = (DVec3::from(pose.joint(goal.joint).translation), goal.weight.sqrt());
            let unknowns = articulation.moved_by(goal.joint).iter().flat_map(|e| {
                let entry = articulation.entries()[*e as usize];
                entry.first..entry.first + entry.count()
            });
            let moved = |k: usize| DVec3::from(columns[k].omega).cross(at) + DVec3::from(columns[k].velocity);
            out.rows.push(unknowns.map(|k| (k, moved(k) * w)).collect());
            out.error.push((DVec3::from(goal.position) - at) * w);
        }
        out
    }

    /// Jᵀ e.
    fn gradient(&self, n: usize) -> Vec<f64> {
        let mut out = vec![0.0; n];
        for (row, e) in self.rows.iter().zip(&self.error) {
            row.iter().for_each(|(k, c)| out[*k] += c.dot(*e));
        }
        out
    }

    fn least_squares(&self, n: usize, damping: f64, limits: &[Limit], step: &mut Vec<f64>) -> usize {
        let mut normal = vec![0.0; n * n];
        for row in &self.rows {
            for (i, a) in row {
                row.iter().for_each(|(j, b)| normal[i * n + j] += a.dot(*b));
            }
        }
        (0..n).for_each(|i| normal[i * n + i] += damping * damping);
        limited::solve(&normal, &self.gradient(n), limits, step)
    }

    fn transpose(&self, n: usize, length: f64, limits: &[Limit], step: &mut Vec<f64>) -> usize {
        *step = self.gradient(n);
        // limits that the step would leave take their part out of it
        let mut holding = 0;
        for limit in limits {
            let over = limited::reach(limit, step);
            let size: f64 = limit.normal.iter().map(|c| c * c).sum();
            if limit.gap < 1e-9 && over > 0.0 && size > 0.0 {
                (0..limit.count).for_each(|k| step[limit.first + k] -= limit.normal[k] * over / size);
                holding += 1;
            }
        }
        let (mut along, mut square) = (0.0, 0.0);
        for (row, e) in self.rows.iter().zip(&self.error) {
            let moved: DVec3 = row.iter().map(|(k, c)| *c * step[*k]).sum();
            along += moved.dot(*e);
            square += moved.length_squared();
        }
        let alpha = if square > 1e-30 * length * length { 0.5 * along / square } else { 0.0 };
        step.iter_mut().for_each(|s| *s *= alpha);
        holding
    }
}
