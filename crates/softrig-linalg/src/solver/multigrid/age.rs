//! How long coarse operators are worth keeping.
//!
//! Those of an earlier matrix still precondition a later one, by more and more iterations. The mean cost of a solve between two
//! rebuilds, (a rebuild + all iterations lost) / solves, falls as long as the last solve lost less than that mean: then is the time.

use crate::solver::SolveReport;

/// What is known since the last rebuild.
#[derive(Debug, Default)]
pub(super) struct Age {
    /// Digits an iteration gained in the first solve; absent before there was one, and when it is time for a rebuild.
    fresh: Option<f64>,
    /// Iterations that later solves needed beyond that.
    lost: f64,
    /// Number of later solves.
    solves: f64,
}

impl Age {
    /// Of operators that others iterate with: never too old.
    pub fn unknown() -> Self {
        Self { fresh: Some(0.0), ..Self::default() }
    }

    /// Is it time for a rebuild?
    pub fn is_over(&self) -> bool {
        self.fresh.is_none()
    }

    /// After a solve; `rebuild` is what a rebuild costs, in iterations.
    pub fn note(&mut self, report: &SolveReport, rebuild: f64) {
        let iterations = report.iterations as f64;
        let digits = (report.start / report.residual.max(1e-16)).log10();
        let gained = iterations > 0.0 && digits > 0.0;
        let Some(fresh) = self.fresh else {
            self.fresh = Some(if gained { digits / iterations } else { 0.0 });
            return;
        };
        // of a system without a right-hand side, or others' iterations, there is nothing to learn
        if !gained || fresh <= 0.0 {
            return;
        }
        let lost = (iterations - digits / fresh).max(0.0);
        (self.lost, self.solves) = (self.lost + lost, self.solves + 1.0);
        if lost * self.solves >= rebuild + self.lost {
            self.fresh = None;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn solve(iterations: usize, residual: f64) -> SolveReport {
        SolveReport { solver: "mgpcg", iterations, residual, converged: true, rebuilt: false, start: 1.0 }
    }

    /// Solves until it is time, each with so many iterations more than the last.
    fn life(growth: f64, rebuild: f64) -> usize {
        let mut age = Age::default();
        age.note(&solve(100, 1e-5), rebuild);
        (1..10_000)
            .find(|k| {
                age.note(&solve(100 + (growth * *k as f64) as usize, 1e-5), rebuild);
                age.is_over()
            })
            .unwrap_or(usize::MAX)
    }

    /// With g iterations more each time the mean cost is least after sqrt(2 R / g) solves.
    #[test]
    fn operators_are_kept_as_long_as_the_mean_cost_falls() {
        for (growth, rebuild) in [(1.0_f64, 50.0_f64), (1.0, 800.0), (2.0, 400.0), (5.0, 40.0)] {
            let best = (2.0 * rebuild / growth).sqrt();
            assert!(
                (life(growth, rebuild) as f64 - best).abs() <= 1.5,
                "{growth} {rebuild}: {}",
                life(growth, rebuild)
            );
        }
        assert_eq!(life(0.0, 1.0), usize::MAX);
    }

    /// More digits asked for are no sign of age.
    #[test]
    fn tolerances_may_differ() {
        let mut age = Age::default();
        age.note(&solve(3, 1e-3), 4.0);
        for k in 0..50 {
            age.note(&if k % 2 == 0 { solve(6, 1e-6) } else { solve(3, 1e-3) }, 4.0);
        }
        assert!(!age.is_over());
        age.note(&solve(9, 1e-3), 4.0);
        assert!(age.is_over());
        let mut others = Age::unknown();
        others.note(&solve(900, 1e-1), 4.0);
        assert!(!others.is_over());
    }
}
