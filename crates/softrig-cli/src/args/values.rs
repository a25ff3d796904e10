//! Values that arguments and scene files share, and how they are read.

use clap::ValueEnum;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use softrig::material::MaterialPreset;
use softrig::simulation::SolverKind;
use softrig_linalg::Instructions;
use softrig_render::View;
use std::fmt;
use std::str::FromStr;

/// Which axis of a file points up.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum UpAxis {
    /// Y up, as glTF has it.
    Y,
    /// Z up, as many modellers have it.
    Z,
}

/// Shape of the cells.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum KindName {
    /// Voxel hexahedra: works for any surface.
    #[default]
    Hex,
    /// Tetrahedra cut from the same voxels.
    Tet,
}

/// How time passes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum DynamicsName {
    /// Newmark with a little numerical damping: swings visibly.
    #[default]
    Lively,
    /// Implicit Euler: about half the motion, never explodes.
    Calm,
    /// The literal scheme of Georgii et al. 2010.
    Paper,
}

/// What computes the flesh.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum MethodName {
    /// Implicit steps with a linear system: any stiffness, long steps.
    #[default]
    Implicit,
    /// Explicit steps, forces cell by cell.
    Elements,
    /// Explicit steps, linear forces by precomputed rows, as deviations from skinning.
    Clustered,
    /// The lowest modes, as deviations from skinning: least work.
    Modal,
    /// Explicit steps of masses that keep distances and volumes; needs tetrahedra.
    MassPoints,
}

impl MethodName {
    /// Name in files and reports.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Implicit => "implicit",
            Self::Elements => "elements",
            Self::Clustered => "clustered",
            Self::Modal => "modal",
            Self::MassPoints => "mass-points",
        }
    }
}

/// How an explicit step is taken.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum StepName {
    /// Order 1, damps nothing it should not, gains energy without damping.
    ExplicitEuler,
    /// Order 1, keeps energy bounded.
    EulerCromer,
    /// Order 2, two forces a step.
    Midpoint,
    /// Order 2, two forces a step.
    #[value(name = "runge-kutta-2")]
    #[serde(rename = "runge-kutta-2")]
    RungeKutta2,
    /// Order 2, keeps energy bounded, one force a step.
    #[default]
    Verlet,
    /// Order 1, damps, needs a solve; only for objects.
    ImplicitEuler,
}

impl From<StepName> for softrig_explicit::scheme::Scheme {
    fn from(name: StepName) -> Self {
        match name {
            StepName::ExplicitEuler => Self::ExplicitEuler,
            StepName::EulerCromer => Self::EulerCromer,
            StepName::Midpoint => Self::Midpoint,
            StepName::RungeKutta2 => Self::RungeKutta2,
            StepName::Verlet => Self::Verlet,
            StepName::ImplicitEuler => Self::ImplicitEuler,
        }
    }
}

/// What happens to explicit steps that are longer than is stable.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum TooLongName {
    /// They are cut into equal ones that are short enough.
    #[default]
    Substep,
    /// The bake stops and says the limit.
    Refuse,
}

impl From<TooLongName> for softrig_explicit::stepper::TooLong {
    fn from(name: TooLongName) -> Self {
        match name {
            TooLongName::Substep => Self::Substep,
            TooLongName::Refuse => Self::Refuse,
        }
    }
}

/// Linear solver.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum SolverName {
    /// Conjugate gradients preconditioned by a multigrid cycle.
    #[default]
    Multigrid,
    /// Conjugate gradients with inverted 3x3 diagonal blocks: least memory.
    Pcg,
    /// Sparse Cholesky factorisation: for small or very stiff bodies.
    Direct,
    /// The one of `multigrid` and `pcg` that does less work, for every solve.
    Auto,
}

impl From<SolverName> for SolverKind {
    fn from(name: SolverName) -> Self {
        match name {
            SolverName::Multigrid => Self::Multigrid,
            SolverName::Pcg => Self::Pcg,
            SolverName::Direct => Self::Direct,
            SolverName::Auto => Self::Auto,
        }
    }
}

/// Vector instructions.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum InstructionsName {
    /// What every machine of this architecture has.
    Portable,
    /// x86-64 with AVX2.
    Avx2,
    /// x86-64 with AVX-512 (F, BW, DQ, VL).
    Avx512,
}

impl From<InstructionsName> for Instructions {
    fn from(name: InstructionsName) -> Self {
        match name {
            InstructionsName::Portable => Self::Portable,
            InstructionsName::Avx2 => Self::Avx2,
            InstructionsName::Avx512 => Self::Avx512,
        }
    }
}

/// A paper whose figures are reproduced.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum PaperName {
    /// Georgii, Lagler, Dick, Westermann 2010: multigrid with skeletal constraints
    G10,
    /// Tang, Wan, Niquin, Schildknecht 2009: clustered finite elements with skeleton constraints
    T09,
    /// Gissler, Becker, Teschner 2006: local constraints of deformable bodies
    S06,
}

/// Numbers the simulation computes with.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Precision {
    /// Single precision: less memory.
    F32,
    /// Double precision.
    #[default]
    F64,
}

/// A quantity to colour the skin by.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Stress {
    /// Von Mises stress of the flesh below [Pa].
    Stress,
    /// Distance from where plain skinning would put the vertex [m].
    Displacement,
}

/// A quantity of the flesh to colour the vertices of a result by.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum ColorName {
    /// Von Mises stress [Pa].
    Stress,
    /// Largest principal strain by size [-].
    Strain,
}

impl From<ColorName> for softrig_io::export::FleshField {
    fn from(name: ColorName) -> Self {
        match name {
            ColorName::Stress => Self::VonMises,
            ColorName::Strain => Self::PrincipalStrain,
        }
    }
}

/// Frames `A..B`, B left out; an open end is the clip's own.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct FrameRange {
    /// First frame.
    pub start: usize,
    /// One past the last frame.
    pub end: Option<usize>,
}

impl FromStr for FrameRange {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let bad =
            || format!("`{text}` is no range of frames; write `A..B`, `A..` or `..B`, counted from 0, B left out");
        let (a, b) = text.split_once("..").ok_or_else(bad)?;
        let number = |s: &str| s.trim().parse::<usize>().map_err(|_| bad());
        let start = if a.trim().is_empty() { 0 } else { number(a)? };
        let end = if b.trim().is_empty() { None } else { Some(number(b)?) };
        if end.is_some_and(|end| end <= start) {
            return Err(format!("`{text}` holds no frame; B must be larger than A"));
        }
        Ok(Self { start, end })
    }
}

impl TryFrom<String> for FrameRange {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        text.parse()
    }
}

impl From<FrameRange> for String {
    fn from(r: FrameRange) -> Self {
        r.to_string()
    }
}

impl fmt::Display for FrameRange {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.end {
            Some(end) => write!(f, "{}..{end}", self.start),
            None => write!(f, "{}..", self.start),
        }
    }
}

impl JsonSchema for FrameRange {
    fn schema_name() -> std::borrow::Cow<'static, str> {
        "FrameRange".into()
    }

    fn json_schema(_: &mut schemars::SchemaGenerator) -> schemars::Schema {
        schemars::json_schema!({ "type": "string", "pattern": r"^\s*\d*\s*\.\.\s*\d*\s*$" })
    }
}

/// Size of a picture in pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PictureSize {
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
}

/// A picture of this size and its buffers stay well within the memory of a small machine.
const LARGEST_SIDE: u32 = 8192;

impl FromStr for PictureSize {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let bad = || format!("`{text}` is no size; write WIDTHxHEIGHT, each from 16 to {LARGEST_SIDE} pixels");
        let (w, h) = text.split_once(['x', 'X']).ok_or_else(bad)?;
        let side = |s: &str| s.parse().ok().filter(|n| (16..=LARGEST_SIDE).contains(n)).ok_or_else(bad);
        Ok(Self { width: side(w)?, height: side(h)? })
    }
}

/// A number above zero.
pub fn positive(text: &str) -> Result<f64, String> {
    finite(text)?.filter(|v| *v > 0.0).ok_or_else(|| "must be a number above 0".into())
}

/// A number of at least zero.
pub fn not_negative(text: &str) -> Result<f64, String> {
    finite(text)?.filter(|v| *v >= 0.0).ok_or_else(|| "must be a number, 0 or more".into())
}

fn finite(text: &str) -> Result<Option<f64>, String> {
    let value: f64 = text.parse().map_err(|_| "is not a number".to_owned())?;
    Ok(value.is_finite().then_some(value))
}

/// A count of at least one.
pub fn at_least_one(text: &str) -> Result<usize, String> {
    match text.parse() {
        Ok(0) | Err(_) => Err("must be a whole number of at least 1".into()),
        Ok(n) => Ok(n),
    }
}

/// A view by its name.
pub fn view_named(name: &str) -> Result<View, String> {
    View::parse(name).ok_or_else(|| "choose front, side, back, three-quarter, top, or an angle in degrees".into())
}

/// A material preset by its name.
pub fn preset_named(name: &str) -> Result<MaterialPreset, String> {
    MaterialPreset::ALL.into_iter().find(|p| p.name() == name).ok_or_else(|| {
        let names: Vec<_> = MaterialPreset::ALL.iter().map(|p| p.name()).collect();
        format!("there is no such preset; choose one of {}", names.join(", "))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frame_ranges_read_back_what_they_print() {
        for (text, range) in [("3..9", (3, Some(9))), ("..9", (0, Some(9))), ("3..", (3, None))] {
            let r: FrameRange = text.parse().unwrap();
            assert_eq!((r.start, r.end), range);
            assert_eq!(r.to_string().parse::<FrameRange>().unwrap(), r);
        }
        for bad in ["", "3", "9..3", "3..3", "a..b", "-1..4", "1.5..2"] {
            assert!(bad.parse::<FrameRange>().is_err(), "{bad}");
        }
    }

    #[test]
    fn sizes_are_bounded() {
        assert_eq!("640x480".parse(), Ok(PictureSize { width: 640, height: 480 }));
        for bad in ["640", "0x480", "640x99999", "axb", "640x"] {
            assert!(bad.parse::<PictureSize>().is_err(), "{bad}");
        }
    }

    #[test]
    fn infinities_are_no_numbers() {
        assert!(
            positive("inf").is_err() && positive("nan").is_err() && positive("0").is_err() && positive("-1").is_err()
        );
        assert!(not_negative("0").is_ok());
    }
}
