//! Arguments of `softrig bake`, and the groups of them that other commands share.

use super::values::{
    ColorName, DynamicsName, FrameRange, KindName, MethodName, Precision, SolverName, StepName, TooLongName, UpAxis,
    at_least_one, not_negative, positive, preset_named,
};
use crate::scene::RootName;
use clap::Args;
use softrig::material::MaterialPreset;
use std::path::PathBuf;

/// How to read a character.
#[derive(Clone, Debug, Default, Args)]
#[command(next_help_heading = "Reading the file")]
pub struct ImportArgs {
    /// Height of the character in metres [default: guessed from the file's numbers, and said]
    #[arg(long, value_name = "M", value_parser = positive, allow_negative_numbers = true, conflicts_with = "unit")]
    pub height: Option<f64>,
    /// Metres per unit of the file [default: guessed from its numbers, and said]
    #[arg(long, value_name = "M", value_parser = positive, allow_negative_numbers = true)]
    pub unit: Option<f64>,
    /// Which axis of the file points up [default: y, as glTF says; a file that looks otherwise is reported]
    #[arg(long, value_name = "AXIS")]
    pub up: Option<UpAxis>,
}

/// Which cells the body is made of.
#[derive(Clone, Debug, Default, Args)]
#[command(next_help_heading = "Cells")]
pub struct BodyArgs {
    /// Number of cells, met within 10 % from 1000 on [default: 8000]
    #[arg(long, value_name = "N", value_parser = at_least_one, allow_negative_numbers = true, conflicts_with = "spacing")]
    pub cells: Option<usize>,
    /// Edge of a cell in metres, instead of --cells
    #[arg(long, value_name = "M", value_parser = positive, allow_negative_numbers = true)]
    pub spacing: Option<f64>,
    /// Hexahedra (voxels) or tetrahedra [default: hex]
    #[arg(long, value_name = "KIND")]
    pub kind: Option<KindName>,
}

/// `softrig bake`. What is not given comes from the scene file, or else from its defaults.
#[derive(Debug, Args)]
pub struct BakeArgs {
    /// Character (.glb .gltf), or a scene (.toml) that names one
    pub file: PathBuf,
    /// What to write: .pc2 .mdd .usda .glb .vtu, a folder for an OBJ series, or .ply for a folder with a PLY series. A character
    /// of several meshes makes a folder with one cache for each. Folders that are not there are made
    #[arg(short, long, value_name = "OUT", required_unless_present = "write_scene")]
    pub output: Option<PathBuf>,

    /// Name or number of a clip in the file, `all`, or a .bvh file with the same joint names [default: the first]
    #[arg(long, value_name = "NAME|N|all|FILE.bvh", help_heading = "Motion")]
    pub clip: Option<String>,
    /// Frames per second of the result [default: 30]
    #[arg(long, value_name = "F", value_parser = positive, allow_negative_numbers = true, help_heading = "Motion")]
    pub fps: Option<f64>,
    /// Only these frames of the clip; B is left out [default: the whole clip]
    #[arg(long, value_name = "A..B", allow_negative_numbers = true, help_heading = "Motion")]
    pub frames: Option<FrameRange>,
    /// Plays the clip this many times as fast [default: 1]
    #[arg(long, value_name = "X", value_parser = positive, allow_negative_numbers = true, help_heading = "Motion")]
    pub speed: Option<f64>,
    /// Seconds in which the flesh settles before the first frame [default: 0.5]
    #[arg(long, value_name = "S", value_parser = not_negative, allow_negative_numbers = true, help_heading = "Motion")]
    pub preroll: Option<f64>,
    /// Takes the bind shape as already in balance with gravity, so nothing sags
    #[arg(long, help_heading = "Motion")]
    pub no_sag: bool,

    /// Material of the flesh: fat, flesh, muscle, skin, cartilage or rubber [default: flesh]
    #[arg(long, value_name = "NAME", value_parser = preset_named, help_heading = "Physics")]
    pub preset: Option<MaterialPreset>,
    /// What computes the flesh [default: implicit]
    #[arg(long, value_name = "NAME", help_heading = "Physics")]
    pub method: Option<MethodName>,
    /// How the steps of an explicit method are taken [default: verlet]
    #[arg(long, value_name = "NAME", help_heading = "Physics")]
    pub scheme: Option<StepName>,
    /// Longest time step in seconds [default: 1/60]; explicit methods cut it to what is stable
    #[arg(long, value_name = "S", value_parser = positive, allow_negative_numbers = true, help_heading = "Physics")]
    pub step: Option<f64>,
    /// What happens to explicit steps longer than is stable [default: substep]
    #[arg(long, value_name = "WHAT", help_heading = "Physics")]
    pub too_long: Option<TooLongName>,
    /// Modes of the method `modal` [default: 30]
    #[arg(long, value_name = "N", value_parser = at_least_one, allow_negative_numbers = true, help_heading = "Physics")]
    pub modes: Option<usize>,
    /// How time passes: `lively` swings, `calm` damps, `paper` is the literal scheme of Georgii et al. [default: lively]
    #[arg(long, value_name = "NAME", help_heading = "Physics")]
    pub dynamics: Option<DynamicsName>,
    /// Linear solver [default: multigrid]
    #[arg(long, value_name = "NAME", help_heading = "Physics")]
    pub solver: Option<SolverName>,
    /// Relative residual asked of every linear solve [default: 1e-6]
    #[arg(long, value_name = "X", value_parser = positive, allow_negative_numbers = true, help_heading = "Physics")]
    pub tolerance: Option<f64>,
    /// Numbers to compute with [default: f64]
    #[arg(long, value_name = "P", help_heading = "Physics")]
    pub precision: Option<Precision>,

    /// Lets flesh and gravity move the skeleton too: joints within limits, bones rigid
    #[arg(long, help_heading = "Two-way coupling")]
    pub two_way: bool,
    /// How much the clip leads the joints, 0 (limp) to 1 (exactly) [default: 0.9]
    #[arg(long, value_name = "X", value_parser = not_negative, allow_negative_numbers = true, help_heading = "Two-way coupling")]
    pub drive: Option<f64>,
    /// How the skeleton as a whole is held [default: driven]
    #[arg(long, value_name = "HOW", help_heading = "Two-way coupling")]
    pub root: Option<RootName>,
    /// Write the moved skeleton as a clip: .glb or .gltf (a copy of the character with one more clip) or .bvh
    #[arg(long, value_name = "S.glb|S.bvh", help_heading = "Two-way coupling")]
    pub skeleton: Option<PathBuf>,
    /// Write force and torque that every joint passes on in every frame as CSV
    #[arg(long, value_name = "R.csv", help_heading = "Two-way coupling")]
    pub reactions: Option<PathBuf>,

    /// Which cells.
    #[command(flatten)]
    pub body: BodyArgs,
    /// How to read the file.
    #[command(flatten)]
    pub import: ImportArgs,

    /// Go on with a bake that was stopped: ends with the same bytes as one that was not
    #[arg(long, conflicts_with = "force", help_heading = "Results")]
    pub resume: bool,
    /// Replace OUT if it exists
    #[arg(long, help_heading = "Results")]
    pub force: bool,
    /// Write a report of the bake as JSON (docs/report.md)
    #[arg(long, value_name = "R.json", help_heading = "Results")]
    pub report: Option<PathBuf>,
    /// Write the force of the flesh on every joint in every frame as CSV
    #[arg(long, value_name = "F.csv", help_heading = "Results")]
    pub forces: Option<PathBuf>,
    /// Most morph targets of a .glb [default: 64]
    #[arg(long, value_name = "N", value_parser = at_least_one, allow_negative_numbers = true, help_heading = "Results")]
    pub morphs: Option<usize>,
    /// Colour the vertices of an OBJ series, a PLY series or a .glb by a quantity of the flesh
    #[arg(long, value_name = "QUANTITY", help_heading = "Results")]
    pub colors: Option<ColorName>,
    /// Write the settings of this bake as a scene file and stop
    #[arg(long, value_name = "SCENE.toml", help_heading = "Results")]
    pub write_scene: Option<PathBuf>,
    /// Print the report as JSON to stdout
    #[arg(long, help_heading = "Results")]
    pub json: bool,
}
