//! What flesh is made of.

use serde::{Deserialize, Serialize};

/// An isotropic elastic material with Rayleigh damping `C = a M + b K`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
pub struct Material {
    /// Young's modulus E [Pa].
    pub young_modulus: f64,
    /// Poisson's ratio nu [-], in [0, 0.49].
    pub poisson_ratio: f64,
    /// Density rho [kg/m3].
    pub density: f64,
    /// Mass-proportional damping a [1/s]: drag on the absolute velocity.
    pub mass_damping: f64,
    /// Stiffness-proportional damping b [s]: damps deformation, never rigid motion.
    pub stiffness_damping: f64,
}

/// Why a material cannot be computed with.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum MaterialError {
    /// A number is outside the range in which the model holds.
    #[error("material: {field} is {value}, it must be {expected}")]
    OutOfRange {
        /// Which field.
        field: &'static str,
        /// Its value.
        value: f64,
        /// What it must be.
        expected: &'static str,
    },
}

/// Named materials to start from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum MaterialPreset {
    /// Soft tissue of a whole character: the default.
    #[default]
    Flesh,
    /// Belly, cheeks: swings visibly.
    Fat,
    /// Relaxed muscle.
    Muscle,
    /// Firm outer layer.
    Skin,
    /// Ears, nose.
    Cartilage,
    /// Soft rubber, for toys and tests.
    Rubber,
}

impl MaterialPreset {
    /// All presets, softest first.
    pub const ALL: [Self; 6] = [Self::Fat, Self::Flesh, Self::Muscle, Self::Skin, Self::Cartilage, Self::Rubber];

    /// Name as written in scene files and on the command line.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Flesh => "flesh",
            Self::Fat => "fat",
            Self::Muscle => "muscle",
            Self::Skin => "skin",
            Self::Cartilage => "cartilage",
            Self::Rubber => "rubber",
        }
    }

    /// The material. Flesh moves 0.8 cm under its own weight on a 1.5 m character (numerics 14); the others are in
    /// proportion to it rather than to laboratory samples, because bones and skin hold real tissue that a voxel body lacks.
    #[must_use]
    pub fn material(self) -> Material {
        let (young_modulus, poisson_ratio, density) = match self {
            Self::Fat => (1e4, 0.42, 950.0),
            Self::Flesh => (2e4, 0.40, 1000.0),
            Self::Muscle => (5e4, 0.42, 1060.0),
            Self::Skin => (1e5, 0.42, 1100.0),
            Self::Cartilage => (5e5, 0.40, 1100.0),
            Self::Rubber => (1e6, 0.45, 1100.0),
        };
        Material { young_modulus, poisson_ratio, density, mass_damping: 0.2, stiffness_damping: 0.005 }
    }
}

impl Default for Material {
    fn default() -> Self {
        MaterialPreset::default().material()
    }
}

impl Material {
    /// First Lamé constant [Pa].
    #[must_use]
    pub fn lambda(&self) -> f64 {
        self.young_modulus * self.poisson_ratio / ((1.0 + self.poisson_ratio) * (1.0 - 2.0 * self.poisson_ratio))
    }

    /// Shear modulus mu [Pa].
    #[must_use]
    pub fn shear_modulus(&self) -> f64 {
        self.young_modulus / (2.0 * (1.0 + self.poisson_ratio))
    }

    /// Checks the ranges in which the model holds.
    ///
    /// # Errors
    /// [`MaterialError::OutOfRange`] names the first field outside its range.
    pub fn check(&self) -> Result<(), MaterialError> {
        let fields = [
            ("young_modulus", self.young_modulus, 1.0..=1e12, "between 1 and 1e12 Pa"),
            ("poisson_ratio", self.poisson_ratio, 0.0..=0.49, "between 0 and 0.49"),
            ("density", self.density, 1.0..=1e5, "between 1 and 1e5 kg/m3"),
            ("mass_damping", self.mass_damping, 0.0..=1e3, "between 0 and 1000 1/s"),
            ("stiffness_damping", self.stiffness_damping, 0.0..=10.0, "between 0 and 10 s"),
        ];
        for (field, value, range, expected) in fields {
            if !range.contains(&value) {
                return Err(MaterialError::OutOfRange { field, value, expected });
            }
        }
        Ok(())
    }
}

/// A material for every cell.
#[derive(Clone, Debug, PartialEq)]
pub struct MaterialMap {
    /// The distinct materials.
    pub materials: Vec<Material>,
    /// Index into `materials`, one per cell; empty: the first material everywhere.
    pub of_cell: Vec<u32>,
    /// Factor on Young's modulus, one per cell [-]; empty: 1 everywhere. Stiffer near bones is written here.
    pub stiffness_factor: Vec<f32>,
}

impl MaterialMap {
    /// One material everywhere.
    #[must_use]
    pub fn uniform(material: Material) -> Self {
        Self { materials: vec![material], of_cell: Vec::new(), stiffness_factor: Vec::new() }
    }

    /// Multiplies the stiffness of every cell by its factor [-].
    ///
    /// # Panics
    /// When the map has factors for another number of cells.
    pub fn stiffen(&mut self, factors: &[f32]) {
        if self.stiffness_factor.is_empty() {
            self.stiffness_factor = factors.to_vec();
            return;
        }
        assert_eq!(self.stiffness_factor.len(), factors.len(), "one factor per cell");
        self.stiffness_factor.iter_mut().zip(factors).for_each(|(to, f)| *to *= f);
    }

    /// Material of cell `i`, its Young's modulus times the cell's factor.
    ///
    /// # Panics
    /// When the map has no material for the cell.
    #[must_use]
    pub fn get(&self, i: usize) -> Material {
        let mut m = self.materials[self.of_cell.get(i).map_or(0, |k| *k as usize)];
        m.young_modulus *= self.stiffness_factor.get(i).map_or(1.0, |f| f64::from(*f));
        m
    }
}
