//! The `[multigrid]` section: what the solvers `multigrid` and `auto` are made of.

use super::SceneError;
use super::read::within;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use softrig::mesh::HierarchyOptions;
use softrig::simulation::MultigridOptions;
use softrig_linalg::solver::{MultigridSettings, Rebuild};

/// Levels and smoother of the solvers `multigrid` and `auto`. The defaults are right for most bodies; all give the same motion, to
/// the tolerance.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Multigrid {
    /// Coarsening ends at so many nodes, which are solved for directly.
    pub coarsest: usize,
    /// Most levels, the body's own among them. Without it: as many as it takes.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub levels: Option<usize>,
    /// What reduces the rough part of the error on each level.
    pub smoother: SmootherName,
    /// Products of a Chebyshev smoothing, or sweeps of Gauss-Seidel, before and after the coarse correction. Without it: 3 and 2.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sweeps: Option<usize>,
    /// Coarse operators turn with the flesh, and are computed anew when neighbouring parts of it have turned apart by so much [degrees].
    /// Without it: when solves become slower.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rebuild_angle: Option<f64>,
}

impl Default for Multigrid {
    fn default() -> Self {
        let coarsest = HierarchyOptions::default().coarsest;
        Self { coarsest, levels: None, smoother: SmootherName::default(), sweeps: None, rebuild_angle: None }
    }
}

/// A smoother.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum SmootherName {
    /// Polynomial of the block-Jacobi iteration: fastest.
    #[default]
    Chebyshev,
    /// Block Gauss-Seidel in the order of colours.
    GaussSeidel,
}

impl Multigrid {
    pub(super) fn check(&self) -> Result<(), SceneError> {
        let number = |n: usize| Some(n as f64);
        // a dense factorisation of 3000 nodes takes seconds, and half a gigabyte
        within("multigrid.coarsest", number(self.coarsest), 1.0..=3000.0, "it must be between 1 and 3000")?;
        within("multigrid.levels", self.levels.and_then(number), 1.0..=30.0, "it must be between 1 and 30")?;
        within("multigrid.sweeps", self.sweeps.and_then(number), 1.0..=20.0, "it must be between 1 and 20")?;
        let angle = "it must be between 0.1 and 180 degrees";
        within("multigrid.rebuild_angle", self.rebuild_angle, 0.1..=180.0, angle)
    }

    /// As the simulation takes it.
    #[must_use]
    pub fn options(&self) -> MultigridOptions {
        use softrig_linalg::solver::Smoother;
        let smoother = match (self.smoother, Smoother::default()) {
            (SmootherName::Chebyshev, Smoother::Chebyshev { degree, ratio }) => {
                Smoother::Chebyshev { degree: self.sweeps.unwrap_or(degree), ratio }
            }
            (SmootherName::Chebyshev, other) => other,
            (SmootherName::GaussSeidel, _) => {
                let sweeps = self.sweeps.unwrap_or(2);
                Smoother::GaussSeidel { before: sweeps, after: sweeps }
            }
        };
        let rebuild = self.rebuild_angle.map_or(Rebuild::WhenSlower, |a| Rebuild::WhenTurned(a.to_radians()));
        MultigridOptions {
            hierarchy: HierarchyOptions { coarsest: self.coarsest, levels: self.levels, ..HierarchyOptions::default() },
            settings: MultigridSettings { smoother, rebuild, ..MultigridSettings::default() },
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::scene::parse;
    use softrig_linalg::solver::{Rebuild, Smoother};

    #[test]
    fn keys_become_settings_and_nonsense_is_refused() {
        let read = |keys: &str| parse(&format!("character = \"a.glb\"\n[multigrid]\n{keys}"));
        assert_eq!(read("").unwrap().multigrid.options(), softrig::simulation::MultigridOptions::default());
        let all = "coarsest = 40\nlevels = 3\nsmoother = \"gauss-seidel\"\nsweeps = 1\nrebuild_angle = 10.0";
        let options = read(all).unwrap().multigrid.options();
        assert_eq!((options.hierarchy.coarsest, options.hierarchy.levels), (40, Some(3)));
        assert_eq!(options.settings.smoother, Smoother::GaussSeidel { before: 1, after: 1 });
        assert!(matches!(options.settings.rebuild, Rebuild::WhenTurned(a) if (a.to_degrees() - 10.0).abs() < 1e-12));
        let degree = |keys: &str| match read(keys).unwrap().multigrid.options().settings.smoother {
            Smoother::Chebyshev { degree, .. } => degree,
            Smoother::GaussSeidel { .. } => 0,
        };
        assert_eq!((degree(""), degree("sweeps = 5")), (3, 5));
        for wrong in ["coarsest = 0", "levels = 0", "sweeps = 21", "rebuild_angle = 0.0", "smoother = \"jacobi\""] {
            let key = wrong.split(' ').next().unwrap();
            let said = read(wrong).unwrap_err().to_string();
            assert!(said.contains(key) || said.contains("jacobi"), "{said}");
        }
    }
}
