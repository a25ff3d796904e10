//! The scene file: what a character file cannot say, in TOML. One tree of structs is the single source for reading, writing,
//! the JSON schema and `docs/scene.md`.

mod coupling;
mod multigrid;
mod object;
mod overrides;
mod read;
mod rigid;
mod template;

pub use coupling::{Chosen, Coupling, Event, Joint, JointName, RootName, SchemeName};
pub use multigrid::{Multigrid, SmootherName};
pub use object::{ConstraintKind, Object, SceneConstraint, SceneEnergies};
pub use read::{SceneError, is_bvh, parse, read};
pub use template::template;

use crate::args::{
    DynamicsName, FrameRange, KindName, MethodName, Precision, SolverName, StepName, TooLongName, UpAxis,
};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use softrig::material::{Material, MaterialPreset};
use std::path::PathBuf;

/// A scene: one character and how to bake it, or objects without bones. Everything but `character`, or one `[[object]]`, has a default.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Scene {
    /// Character file, relative to this scene file. Scenes of objects have none.
    #[serde(default)]
    pub character: PathBuf,
    /// How to read the character.
    #[serde(default)]
    pub import: Import,
    /// Which motion, and how it is sampled.
    #[serde(default)]
    pub motion: Motion,
    /// The cells of the body.
    #[serde(default)]
    pub body: Body,
    /// How the body is simulated.
    #[serde(default)]
    pub simulation: Simulation,
    /// Levels and smoother of the solvers `multigrid` and `auto`.
    #[serde(default)]
    pub multigrid: Multigrid,
    /// What the flesh is made of where no region says otherwise.
    #[serde(default)]
    pub material: BaseMaterial,
    /// Parts of the flesh that are made of something else; a later region wins over an earlier one.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub region: Vec<Region>,
    /// How single bones hold the flesh.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub bone: Vec<Bone>,
    /// Meshes that are carried whole by one joint instead of getting flesh: armour, eyes, teeth.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub rigid: Vec<Rigid>,
    /// Whether flesh moves the skeleton too, and how far the clip leads it.
    #[serde(default)]
    pub coupling: Coupling,
    /// What single joints can do in a two-way coupling, instead of what is chosen from clips and names.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub joint: Vec<Joint>,
    /// What happens to the character: drags, pulls, pins, wind. Baked again, it happens again exactly.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub event: Vec<Event>,
    /// Bodies without bones, instead of a character.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub object: Vec<Object>,
    /// What holds objects, and when.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub constraint: Vec<SceneConstraint>,
    /// What objects of mass points resist with. Without it: about what the material does.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub energies: Option<SceneEnergies>,
}

/// How to read the character. `height` and `unit` exclude each other; without either the unit is guessed and said.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Import {
    /// Height of the character [m].
    #[serde(skip_serializing_if = "Option::is_none")]
    pub height: Option<f64>,
    /// Metres per unit of the file [m].
    #[serde(skip_serializing_if = "Option::is_none")]
    pub unit: Option<f64>,
    /// Which axis of the file points up. Without it: Y, as glTF says.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub up: Option<UpAxis>,
}

/// Which motion, and how it is sampled.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Motion {
    /// Name or number of a clip in the character file, `all`, or a .bvh file relative to this scene. Without it: the first clip.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub clip: Option<String>,
    /// Pairs of joint names, `[[motion, character], ...]`, for a .bvh file whose joints are called otherwise.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub names: Vec<[String; 2]>,
    /// Frames per second of the result [1/s].
    pub fps: f64,
    /// Frames to bake, `"A..B"`, counted from 0, B left out. Without it: the whole clip.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub frames: Option<FrameRange>,
    /// Plays the clip this many times as fast [-].
    pub speed: f64,
    /// How long a scene of objects lasts [s]. Without it: 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub duration: Option<f64>,
    /// Time in which the flesh settles before the first frame [s].
    pub preroll: f64,
    /// Whether gravity bends the bind shape. `false` takes that shape as already in balance.
    pub sag: bool,
}

impl Default for Motion {
    fn default() -> Self {
        // 30 frames per second is what most game and web clips are sampled at
        Self {
            clip: None,
            names: Vec::new(),
            fps: 30.0,
            frames: None,
            speed: 1.0,
            duration: None,
            preroll: 0.5,
            sag: true,
        }
    }
}

/// The cells of the body. `cells` and `spacing` exclude each other.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Body {
    /// Number of cells, met within 10 %. Without it: 8000.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub cells: Option<usize>,
    /// Edge of a cell [m].
    #[serde(skip_serializing_if = "Option::is_none")]
    pub spacing: Option<f64>,
    /// Shape of the cells.
    pub kind: KindName,
}

/// Cells when neither their number nor their size is given: arms are then three cells across [numerics 14], and a bake still
/// runs at several frames per second on a laptop.
pub const DEFAULT_CELLS: usize = 8000;

/// How the body is simulated.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Simulation {
    /// What computes the flesh.
    pub method: MethodName,
    /// How the steps of explicit methods are taken.
    pub scheme: StepName,
    /// What happens to explicit steps longer than is stable.
    pub too_long: TooLongName,
    /// Longest time step [s]. Without it: 1/60.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub step: Option<f64>,
    /// Modes of the method `modal`.
    pub modes: usize,
    /// How time passes in implicit steps.
    pub dynamics: DynamicsName,
    /// Linear solver.
    pub solver: SolverName,
    /// Relative residual asked of every linear solve [-].
    pub tolerance: f64,
    /// Numbers to compute with.
    pub precision: Precision,
    /// Gravity in the world, Y up [m/s2].
    pub gravity: [f64; 3],
    /// Makes flesh stiffer where the clip's accelerations would crush it.
    pub stiffen: bool,
}

impl Default for Simulation {
    fn default() -> Self {
        Self {
            method: MethodName::default(),
            scheme: StepName::default(),
            too_long: TooLongName::default(),
            step: None,
            // as in the table of [Tang2009]
            modes: 30,
            dynamics: DynamicsName::default(),
            solver: SolverName::default(),
            // a bake is kept: smaller changes nothing that can be seen, and resumed bakes stay comparable
            tolerance: 1e-6,
            precision: Precision::default(),
            gravity: [0.0, -9.81, 0.0],
            stiffen: true,
        }
    }
}

/// What flesh is made of: a preset, of which single numbers may be changed.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct BaseMaterial {
    /// Material to start from.
    pub preset: MaterialPreset,
    /// Young's modulus [Pa].
    #[serde(skip_serializing_if = "Option::is_none")]
    pub young_modulus: Option<f64>,
    /// Poisson's ratio [-], from 0 to 0.49: how well volume is kept.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub poisson_ratio: Option<f64>,
    /// Density [kg/m3].
    #[serde(skip_serializing_if = "Option::is_none")]
    pub density: Option<f64>,
    /// Damping of motion as such [1/s].
    #[serde(skip_serializing_if = "Option::is_none")]
    pub mass_damping: Option<f64>,
    /// Damping of deformation [s].
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stiffness_damping: Option<f64>,
    /// Makes flesh stiffer near bones.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub near_bones: Option<NearBones>,
}

/// Stiffer near bones: Young's modulus is multiplied by `factor` at the bone, falling to 1 at `radius`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct NearBones {
    /// Factor on Young's modulus at the bone [-].
    pub factor: f64,
    /// Distance from the bone at which it ends [m].
    pub radius: f64,
}

/// A part of the flesh made of something else. Chosen by exactly one of `look`, `group` and `bone`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Region {
    /// The flesh under triangles with this material (look) of the character file.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub look: Option<String>,
    /// The flesh under vertices where this vertex group or attribute is at least `threshold`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub group: Option<String>,
    /// Smallest value of the group that counts [-]. Without it: 0.5.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub threshold: Option<f64>,
    /// The flesh under vertices that follow this joint more than any other.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub bone: Option<String>,
    /// Another material. Without it: the scene's, with the numbers below changed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub preset: Option<MaterialPreset>,
    /// Factor on Young's modulus [-].
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stiffness: Option<f64>,
    /// Young's modulus [Pa].
    #[serde(skip_serializing_if = "Option::is_none")]
    pub young_modulus: Option<f64>,
    /// Poisson's ratio [-], from 0 to 0.49.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub poisson_ratio: Option<f64>,
    /// Density [kg/m3].
    #[serde(skip_serializing_if = "Option::is_none")]
    pub density: Option<f64>,
}

/// How one bone holds the flesh.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Bone {
    /// Name of the joint.
    pub joint: String,
    /// Binds no flesh to it.
    #[serde(default)]
    pub exclude: bool,
    /// Binds the nodes closer to the bone than this, instead of what the thickness of the limb suggests [m].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub radius: Option<f64>,
    /// Binds all the flesh it moves: a rigid hand, a horn.
    #[serde(default)]
    pub whole: bool,
}

/// A mesh carried whole by one joint.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Rigid {
    /// Name of the mesh.
    pub mesh: String,
    /// Name of the joint that carries it.
    pub joint: String,
}

impl BaseMaterial {
    /// The preset with the given numbers changed.
    #[must_use]
    pub fn material(&self) -> Material {
        let mut m = self.preset.material();
        let fields = [
            (&mut m.young_modulus, self.young_modulus),
            (&mut m.poisson_ratio, self.poisson_ratio),
            (&mut m.density, self.density),
            (&mut m.mass_damping, self.mass_damping),
            (&mut m.stiffness_damping, self.stiffness_damping),
        ];
        for (field, value) in fields {
            *field = value.unwrap_or(*field);
        }
        m
    }
}

impl Region {
    /// The region's material, for a body made of `base` elsewhere.
    #[must_use]
    pub fn material(&self, base: Material) -> Material {
        let mut m = self.preset.map_or(base, MaterialPreset::material);
        m.young_modulus = self.young_modulus.unwrap_or(m.young_modulus) * self.stiffness.unwrap_or(1.0);
        m.poisson_ratio = self.poisson_ratio.unwrap_or(m.poisson_ratio);
        m.density = self.density.unwrap_or(m.density);
        m
    }
}
