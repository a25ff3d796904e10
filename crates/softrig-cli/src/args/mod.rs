//! The command line. Help texts and `docs/cli.md` come from here.

mod bake;
mod values;

pub use bake::{BakeArgs, BodyArgs, ImportArgs};
pub use values::{
    ColorName, DynamicsName, FrameRange, InstructionsName, KindName, MethodName, PaperName, PictureSize, Precision,
    SolverName, StepName, Stress, TooLongName, UpAxis, preset_named,
};

use clap::{Args, Parser, Subcommand};
use softrig_render::View;
use std::path::PathBuf;
use values::{at_least_one, positive, view_named};

/// Physical flesh for rigged characters.
///
/// A skinned mesh, its skeleton and a clip go in; the same character with soft tissue that follows the bones, swings and
/// squashes comes out, as a cache that other programs play.
#[derive(Debug, Parser)]
#[command(
    name = "softrig",
    version,
    max_term_width = 110,
    after_help = "\
Exit codes: 0 done, 1 the input's fault, 2 usage, 3 the machine's fault (disk full, no permission), 4 the simulation \
could not be kept valid, 130 after Ctrl-C. Whatever the exit, finished frames stay valid and `softrig bake --resume` goes \
on from them."
)]
pub struct Cli {
    /// What to do.
    #[command(subcommand)]
    pub command: Command,
    /// Number of threads [default: all the machine has]. Results do not depend on it
    #[arg(long, global = true, value_name = "N", value_parser = at_least_one)]
    pub threads: Option<usize>,
}

/// What to do.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Bakes the built-in character and renders it: the quickest way to see what softrig does
    Demo(DemoArgs),
    /// Says what is in a character, surface or volume mesh, what is wrong with it, and what softrig would do about it
    Inspect(InspectArgs),
    /// Fills a surface or character with cells and writes the volume mesh
    Mesh(MeshArgs),
    /// Simulates the flesh of a character while a clip moves its skeleton, and writes the moving skin
    Bake(Box<BakeArgs>),
    /// Draws a character, a scene or a cache without any graphics hardware
    Render(RenderArgs),
    /// Converts between the mesh, cache and clip formats softrig knows, and makes caches from the journal of a stopped bake
    Convert(ConvertArgs),
    /// Measures softrig on standard bodies
    Bench(BenchArgs),
    /// Reproduces tables and figures of the papers softrig implements, as CSV files and plots
    Papers(PapersArgs),
    /// Prints a completion script for a shell
    Completions(CompletionsArgs),
}

/// `softrig demo`.
#[derive(Debug, Args)]
pub struct DemoArgs {
    /// Folder for the results
    #[arg(short, long, value_name = "DIR", default_value = "softrig-demo")]
    pub output: PathBuf,
    /// Clip of the built-in character: walk, jump or turn
    #[arg(long, value_name = "NAME", default_value = "jump")]
    pub clip: String,
    /// Number of cells of its body
    #[arg(long, value_name = "N", default_value = "3000", value_parser = at_least_one, allow_negative_numbers = true)]
    pub cells: usize,
    /// Replace the results of an earlier demo
    #[arg(long)]
    pub force: bool,
}

/// `softrig inspect`.
#[derive(Debug, Args)]
pub struct InspectArgs {
    /// Character (.glb .gltf), surface (.obj .ply .stl), volume mesh (.msh .mesh .node .veg .vtk .vtu), clip (.bvh) or scene (.toml)
    pub file: PathBuf,
    /// Print JSON with stable keys
    #[arg(long)]
    pub json: bool,
    /// Print a scene file for this character instead, with every setting explained
    #[arg(long, conflicts_with = "json")]
    pub scene: bool,
    /// How to read the file.
    #[command(flatten)]
    pub import: ImportArgs,
}

/// `softrig mesh`.
#[derive(Debug, Args)]
pub struct MeshArgs {
    /// Character, surface, or volume mesh to fill or convert
    pub file: PathBuf,
    /// Volume mesh to write: .vtu, or .msh (Gmsh 4.1)
    #[arg(short, long, value_name = "OUT")]
    pub output: PathBuf,
    /// How to read the file.
    #[command(flatten)]
    pub import: ImportArgs,
    /// Which cells.
    #[command(flatten)]
    pub body: BodyArgs,
    /// Replace OUT if it exists
    #[arg(long)]
    pub force: bool,
    /// Print what was made as JSON with stable keys
    #[arg(long)]
    pub json: bool,
}

/// `softrig render`.
#[derive(Debug, Args)]
pub struct RenderArgs {
    /// Character, surface, scene (.toml), journal of a bake, or cache (.pc2 .mdd, these with --with)
    pub file: PathBuf,
    /// Picture (.png), moving picture (.gif), or a folder for one .png per frame
    #[arg(short, long, value_name = "OUT")]
    pub output: PathBuf,
    /// Character or scene the cache belongs to: a cache alone has no faces, colours or bones
    #[arg(long, value_name = "CHARACTER|SCENE")]
    pub with: Option<PathBuf>,
    /// Only this frame, counted from 0 [default: the first for .png, where a character without --clip stands in its bind pose;
    /// all otherwise]
    #[arg(long, value_name = "N", conflicts_with = "frames", allow_negative_numbers = true)]
    pub frame: Option<usize>,
    /// Only these frames; B is left out
    #[arg(long, value_name = "A..B", allow_negative_numbers = true)]
    pub frames: Option<FrameRange>,
    /// Clip that moves a character or scene: a name or number [default: the first]
    #[arg(long, value_name = "NAME|N")]
    pub clip: Option<String>,
    /// Frames per second of a character's clip and of the .gif [default: those of the cache, 25 for a character]
    #[arg(long, value_name = "F", value_parser = positive, allow_negative_numbers = true)]
    pub fps: Option<f64>,
    /// Where to look from: front, side, back, three-quarter, top, or an angle about the vertical in degrees
    #[arg(long, value_name = "NAME", default_value = "three-quarter", value_parser = view_named, allow_negative_numbers = true)]
    pub view: View,
    /// Size of the picture in pixels
    #[arg(long, value_name = "WxH", default_value = "640x480")]
    pub size: PictureSize,
    /// Draw the cells of the body
    #[arg(long)]
    pub cells: bool,
    /// Draw the bones
    #[arg(long)]
    pub bones: bool,
    /// Draw the nodes that hang on bones, in the colour of their bone
    #[arg(long)]
    pub bound: bool,
    /// Colour the skin by a quantity, with a legend
    #[arg(long, value_name = "QUANTITY")]
    pub map: Option<Stress>,
    /// How to read the file.
    #[command(flatten)]
    pub import: ImportArgs,
    /// Replace OUT if it exists
    #[arg(long)]
    pub force: bool,
}

/// `softrig convert`.
#[derive(Debug, Args)]
pub struct ConvertArgs {
    /// Journal of a bake (.softrig-journal), cache (.pc2 .mdd, with --with), volume mesh, character or motion (.bvh)
    pub input: PathBuf,
    /// What to write; the ending picks the format: .pc2 .mdd .usda .glb .vtu or a folder from journals and caches, .vtu .msh from
    /// volume meshes, .bvh from characters and motions
    pub output: PathBuf,
    /// Character or scene a cache belongs to
    #[arg(long, value_name = "CHARACTER|SCENE")]
    pub with: Option<PathBuf>,
    /// Clip of a character to write as .bvh: a name or number [default: the first]
    #[arg(long, value_name = "NAME|N")]
    pub clip: Option<String>,
    /// Frames per second of a .bvh [default: 30]
    #[arg(long, value_name = "F", value_parser = positive, allow_negative_numbers = true)]
    pub fps: Option<f64>,
    /// Most morph targets of a .glb [default: 64]
    #[arg(long, value_name = "N", value_parser = at_least_one, allow_negative_numbers = true)]
    pub morphs: Option<usize>,
    /// Colour the vertices of an OBJ series, a PLY series or a .glb by a quantity of the flesh; the journal must keep the volume mesh
    #[arg(long, value_name = "QUANTITY")]
    pub colors: Option<ColorName>,
    /// How to read the file.
    #[command(flatten)]
    pub import: ImportArgs,
    /// Replace OUTPUT if it exists
    #[arg(long)]
    pub force: bool,
}

/// `softrig bench`.
#[derive(Debug, Args)]
pub struct BenchArgs {
    /// Bodies to measure: bar, cow, bar_s, bar_m, bar_l, dragon, character_N with N cells, as in character_8k, and two_way_N, that one way and two-way [default: bar cow]
    pub names: Vec<String>,
    /// Linear solver [default: multigrid]
    #[arg(long, value_name = "NAME")]
    pub solver: Option<SolverName>,
    /// Vector instructions [default: the best of this machine]. Results do not depend on them
    #[arg(long, value_name = "NAME")]
    pub instructions: Option<InstructionsName>,
    /// Instead of a falling body, solve for the balance of a twisted and bent one to a residual of 1e-6, setup included
    #[arg(long = "static")]
    pub statics: bool,
    /// Print one JSON object for each body
    #[arg(long)]
    pub json: bool,
    /// Folder that holds `bench/` and `data/` with the bodies that are read [default: $SOFTRIG_SHARED, or else ../shared]
    #[arg(long, value_name = "DIR")]
    pub shared: Option<PathBuf>,
}

/// `softrig papers`.
#[derive(Debug, Args)]
pub struct PapersArgs {
    /// Which papers [default: all]
    #[arg(value_name = "PAPER")]
    pub papers: Vec<PaperName>,
    /// Folder for the results, one folder in it for each paper
    #[arg(short, long, value_name = "DIR", default_value = "softrig-papers")]
    pub output: PathBuf,
    /// Small bodies and few steps: to see that everything works, not for the figures
    #[arg(long)]
    pub quick: bool,
    /// Folder that holds `data/` with the bodies of the papers [default: $SOFTRIG_SHARED, or else ../shared]; what is not there is
    /// replaced by the built-in character
    #[arg(long, value_name = "DIR")]
    pub shared: Option<PathBuf>,
    /// Replace the results of an earlier run
    #[arg(long)]
    pub force: bool,
}

/// `softrig completions`.
#[derive(Debug, Args)]
pub struct CompletionsArgs {
    /// Which shell
    pub shell: clap_complete::Shell,
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    #[test]
    fn the_command_line_is_consistent() {
        Cli::command().debug_assert();
    }
}
