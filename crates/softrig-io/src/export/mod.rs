//! From a journal to the formats other programs play.
//!
//! Everything is written under a temporary name in the folder of the output and renamed at the end: an output that is there is
//! whole, and one that was there before stays as it was until the new one is.

mod cache;
mod cache_reader;
mod colors;
mod glb;
mod glb_file;
mod normals;
mod output;
mod principal;
mod rigid;
mod series;
mod skeleton;
mod space;
mod usda;
mod vtu;

pub use cache_reader::{CacheError, PointCache};
pub use colors::FleshField;
pub(crate) use output::temporary_beside;
pub use skeleton::{clip_of_poses, gltf_with_clip};

use crate::error::in_words;
use crate::journal::{Existing, JournalError, JournalReader};
use softrig::character::Character;
use std::io::{Read, Seek};
use std::path::{Path, PathBuf};

/// What to make of a journal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Format {
    /// 3ds Max point cache, little-endian: one file for each mesh, in its local space. Blender's Mesh Cache modifier reads it.
    Pc2,
    /// LightWave motion designer, big-endian: as [`Format::Pc2`], with times in seconds.
    Mdd,
    /// glTF: the motion as morph targets with animated weights. Metres, Y up.
    Glb,
    /// USD text: meshes with points over time. Metres, Y up.
    Usda,
    /// A folder of VTU files, one per frame, of the volume mesh with displacement, stress and strain, and a PVD file that
    /// lists them. Metres, Y up.
    Vtu,
    /// A folder of OBJ files, one per frame, in the units and axes of the character's file.
    ObjSeries,
    /// A folder of PLY files, one per frame, in the units and axes of the character's file.
    PlySeries,
}

impl Format {
    /// Whether vertices can have colours of the flesh in it.
    #[must_use]
    pub fn holds_colors(self) -> bool {
        matches!(self, Self::ObjSeries | Self::PlySeries | Self::Glb)
    }

    /// The format that the ending of an output stands for; no ending is a folder of OBJ files, and `.ply` one of PLY files.
    ///
    /// # Errors
    /// [`ExportError::Unsupported`] names what to use instead.
    pub fn from_path(out: &Path) -> Result<Self, ExportError> {
        let ending = out.extension().map(|e| e.to_string_lossy().to_lowercase());
        let refuse = |instead: &str| {
            let what = format!(".{} files", ending.as_deref().unwrap_or_default());
            Err(ExportError::Unsupported { what, instead: String::from(instead) })
        };
        match ending.as_deref() {
            Some("pc2") => Ok(Self::Pc2),
            Some("mdd") => Ok(Self::Mdd),
            Some("glb") => Ok(Self::Glb),
            Some("usda") => Ok(Self::Usda),
            Some("vtu" | "pvd") => Ok(Self::Vtu),
            Some("ply") => Ok(Self::PlySeries),
            None => Ok(Self::ObjSeries),
            Some("usdc" | "usd" | "usdz") => {
                refuse("use .usda, which every USD program reads; `usdcat out.usda -o out.usdc` makes it binary")
            }
            Some("gltf") => refuse("use .glb, the same in one file"),
            Some("abc") => refuse("use .usda or .pc2, which the programs that read Alembic read too"),
            Some("fbx") => refuse("use .glb, .usda or .pc2"),
            Some("obj") => refuse("name a folder, in which every frame gets a file"),
            Some("vtk") => refuse("use .vtu"),
            _ => refuse("use .pc2, .mdd, .glb, .usda, .vtu, .ply for a folder of PLY files, or a folder for OBJ files"),
        }
    }
}

/// How to write.
#[derive(Clone, Debug, PartialEq)]
pub struct ExportOptions {
    /// What to do about an output that is there already.
    pub existing: Existing,
    /// Most morph targets of each mesh in a glTF file. Default 64: engines hold the weights of that many, and a clip of ten
    /// seconds needs fewer.
    pub morphs: usize,
    /// Fitting error of morph targets that counts as good, as a share of the character's height [-]. Default 1e-3: 1.7 mm on
    /// a person.
    pub morph_tolerance: f64,
    /// Colours of the skin's vertices; needs a journal that keeps the volume mesh. In OBJ and PLY series they are those of each frame; glTF has no
    /// colours over time, and a .glb gets those of the largest value that a vertex has in any frame. Other formats carry none.
    pub colors: Option<FleshField>,
}

impl Default for ExportOptions {
    fn default() -> Self {
        Self { existing: Existing::Refuse, morphs: 64, morph_tolerance: 1e-3, colors: None }
    }
}

/// How well morph targets show the motion.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MorphFit {
    /// Morph targets of the mesh that has most of them.
    pub used: usize,
    /// Largest distance of any vertex in any frame from where it should be, as a share of the character's height [-].
    pub error: f64,
    /// What `error` should not exceed [-].
    pub tolerance: f64,
    /// Morph targets with which it would not.
    pub needed: usize,
}

/// What was written.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ExportReport {
    /// The files, one per mesh or frame where the format wants that.
    pub files: Vec<PathBuf>,
    /// Frames in them.
    pub frames: usize,
    /// What a reader of the result should know, in plain words.
    pub notes: Vec<String>,
    /// For glTF: how well it shows the motion.
    pub morphs: Option<MorphFit>,
}

/// Why an output could not be written. What was there before is untouched.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ExportError {
    /// The operating system refused.
    #[error(
        "cannot write {}: {}; the frames are safe in the journal: --resume tries again, `softrig convert` writes it elsewhere",
        file.display(),
        in_words(source)
    )]
    Io {
        /// The output.
        file: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// There is one already.
    #[error("{} exists; replace it with --force or choose another output", file.display())]
    Exists {
        /// The output.
        file: PathBuf,
    },
    /// A folder that is to be replaced holds something softrig did not write.
    #[error("{} is not replaced because it holds `{file}`, which softrig did not write; choose another output", folder.display())]
    ForeignFolder {
        /// The folder.
        folder: PathBuf,
        /// First such file.
        file: String,
    },
    /// softrig does not write this.
    #[error("softrig cannot write {what}; {instead}")]
    Unsupported {
        /// What was asked for.
        what: String,
        /// What to do instead.
        instead: String,
    },
    /// The journal holds no frame yet.
    #[error("the journal {} holds no finished frame; go on with the bake first (--resume)", journal.display())]
    NoFrames {
        /// The journal.
        journal: PathBuf,
    },
    /// The journal was made with another character.
    #[error("the journal was made with another character: {what} differs; name the character it was baked from")]
    OtherCharacter {
        /// What differs.
        what: String,
    },
    /// More than the format can hold.
    #[error("{what} is more than {format} can hold ({limit}); {instead}")]
    TooLarge {
        /// What is too large, and how large it is.
        what: String,
        /// The format.
        format: &'static str,
        /// The most it holds.
        limit: u64,
        /// What to do instead.
        instead: &'static str,
    },
    /// The journal could not be read.
    #[error(transparent)]
    Journal(#[from] JournalError),
}

impl ExportError {
    /// Whether the machine is at fault (disk full, no permission) and not what was asked for.
    #[must_use]
    pub fn is_machine_fault(&self) -> bool {
        match self {
            Self::Io { .. } => true,
            Self::Journal(e) => e.is_machine_fault(),
            _ => false,
        }
    }
}

/// Writes all frames of a journal, finished or torn, as `format`.
///
/// # Errors
/// [`ExportError`]; nothing that was there before has changed.
pub fn write<S: Read + Seek>(
    journal: &mut JournalReader<S>,
    character: &Character,
    format: Format,
    out: &Path,
    options: &ExportOptions,
) -> Result<ExportReport, ExportError> {
    check_character(journal, character)?;
    if journal.frame_count() == 0 {
        return Err(ExportError::NoFrames { journal: journal.path().to_owned() });
    }
    if options.existing == Existing::Refuse && out.symlink_metadata().is_ok() {
        return Err(ExportError::Exists { file: out.to_owned() });
    }
    if options.colors.is_some() && !format.holds_colors() {
        let instead =
            "name a folder for an OBJ series, a .ply or a .glb; .vtu has stress and strain of every cell in any case";
        let what = String::from("colours of the flesh in this format");
        return Err(ExportError::Unsupported { what, instead: instead.into() });
    }
    match format {
        Format::Pc2 | Format::Mdd => cache::write(journal, character, format, out, options),
        Format::Glb => glb::write(journal, character, out, options),
        Format::Usda => usda::write(journal, character, out, options),
        Format::Vtu => vtu::write(journal, out, options),
        Format::ObjSeries | Format::PlySeries => series::write(journal, character, format, out, options),
    }
}

/// The journal's frames belong to this character.
fn check_character<S: Read + Seek>(journal: &JournalReader<S>, character: &Character) -> Result<(), ExportError> {
    let other = |what: String| Err(ExportError::OtherCharacter { what });
    let header = journal.header();
    if header.joint_count as usize != character.skeleton.joint_count() {
        return other(format!(
            "the number of joints ({} and {})",
            header.joint_count,
            character.skeleton.joint_count()
        ));
    }
    if header.meshes.len() != character.meshes.len() {
        return other(format!("the number of meshes ({} and {})", header.meshes.len(), character.meshes.len()));
    }
    for (a, b) in header.meshes.iter().zip(&character.meshes) {
        if a.name != b.name || a.vertex_count as usize != b.positions.len() {
            let (n, m) = (a.vertex_count, b.positions.len());
            return other(format!("a mesh (`{}` with {n} vertices, `{}` with {m})", a.name, b.name));
        }
    }
    let known = |j: &softrig::rig::JointId| j.index() < character.skeleton.joint_count();
    if !character.meshes.iter().all(|m| m.object.as_ref().is_none_or(known)) {
        return other(String::from("an object frame"));
    }
    Ok(())
}
