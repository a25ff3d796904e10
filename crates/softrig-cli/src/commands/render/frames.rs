//! Frames to draw, whatever they come from: a clip, a journal, or a point cache.

use crate::args::RenderArgs;
use crate::commands::bake::{clips, journal_failure};
use crate::failure::Failure;
use crate::load::{self, FileKind};
use crate::scene::Scene;
use softrig::character::Character;
use softrig::rig::{Affine, Clip, Pose};
use softrig::simulation::{ClipMotion, Motion, RestMotion};
use softrig_io::export::PointCache;
use softrig_io::journal::{JournalFrame, JournalHeader, JournalReader};
use std::path::{Path, PathBuf};

/// One frame in the world [m].
#[derive(Debug)]
pub struct Shape {
    /// Skin of each mesh.
    pub skin: Vec<Vec<[f64; 3]>>,
    /// The skeleton.
    pub pose: Pose,
    /// Nodes of the volume mesh, where the source has them.
    pub nodes: Vec<[f64; 3]>,
}

/// Where frames come from, and the character they show.
#[derive(Debug)]
pub struct Frames {
    /// The scene of the character: as given, or as a journal remembers it.
    pub scene: Scene,
    /// The character.
    pub character: Character,
    /// Frames there are.
    pub count: usize,
    /// Frames per second.
    pub fps: f64,
    clip: Option<Clip>,
    source: Source,
}

#[derive(Debug)]
enum Source {
    /// The character in its bind pose.
    Bind,
    /// Plain skinning by the clip.
    Skinned,
    Journal(Box<JournalReader>, JournalFrame),
    Caches(Vec<PointCache>),
}

/// Frames per second of a character's clip in a moving picture: what a GIF holds exactly, in whole hundredths of a second.
const CLIP_FPS: f64 = 25.0;

impl Frames {
    /// Opens what a command line names. `still`: only one picture is wanted.
    ///
    /// # Errors
    /// [`Failure`] when it cannot be read, or needs `--with`.
    pub fn open(args: &RenderArgs, still: bool) -> Result<Self, Failure> {
        match load::kind(&args.file) {
            FileKind::Journal => {
                let with = args.with.as_deref().map(|with| scene_of(args, with)).transpose()?;
                Self::of_journal(&args.file, with)
            }
            FileKind::PointCache => Self::named_caches(args),
            _ if args.file.is_dir() => Self::named_caches(args),
            FileKind::Motion | FileKind::Volume => Err(Failure::Input(format!(
                "{}: render draws characters, scenes, journals and caches; `softrig convert` and `softrig inspect` take this file",
                args.file.display()
            ))),
            FileKind::Scene | FileKind::Character => Self::of_character(args, still),
        }
    }

    fn named_caches(args: &RenderArgs) -> Result<Self, Failure> {
        let Some(with) = &args.with else {
            return Err(Failure::Usage(format!(
                "{} has positions only; say which character it is of: --with CHARACTER|SCENE",
                args.file.display()
            )));
        };
        let (scene, character) = scene_of(args, with)?;
        Self::of_caches(&args.file, scene, character, args.fps)
    }

    fn of_character(args: &RenderArgs, still: bool) -> Result<Self, Failure> {
        let (scene, character) = scene_of(args, &args.file)?;
        let posed = args.clip.is_some() || args.frame.is_some() || args.frames.is_some() || !still;
        // a character without clips can still be looked at, from all frames of its one pose
        if !posed || character.clips.is_empty() && scene.motion.clip.is_none() {
            return Ok(Self { scene, character, count: 1, fps: CLIP_FPS, clip: None, source: Source::Bind });
        }
        let fps = args.fps.unwrap_or(CLIP_FPS);
        let clip = clips(&scene, &character)?.swap_remove(0);
        let motion = ClipMotion { speed: scene.motion.speed, ..ClipMotion::new(&character.skeleton, &clip) };
        let count = motion.frame_count(fps);
        Ok(Self { scene, count, fps, clip: Some(clip), character, source: Source::Skinned })
    }

    /// Frames of a journal, of the character given or the one it remembers.
    ///
    /// # Errors
    /// [`Failure`] when the journal or its character cannot be read.
    pub fn of_journal(file: &Path, with: Option<(Scene, Character)>) -> Result<Self, Failure> {
        let journal = JournalReader::open(file).map_err(|e| journal_failure(&e))?;
        let (scene, character) = match with {
            Some(with) => with,
            None => journal_scene(&journal)?,
        };
        check_meshes(&character, journal.header(), file)?;
        let (count, fps) = (journal.frame_count(), journal.header().fps);
        if count == 0 {
            return Err(Failure::Input(format!("{} holds no finished frame yet", file.display())));
        }
        let source = Source::Journal(Box::new(journal), JournalFrame::default());
        Ok(Self { scene, character, count, fps, clip: None, source })
    }

    /// Frames of a point cache, or of a folder with one for each mesh.
    ///
    /// # Errors
    /// [`Failure`] when a cache cannot be read or is of another character.
    pub fn of_caches(path: &Path, scene: Scene, character: Character, fps: Option<f64>) -> Result<Self, Failure> {
        let files = if path.is_dir() { caches_in(path)? } else { vec![path.to_owned()] };
        let mut caches = Vec::new();
        for file in &files {
            caches.push(PointCache::open(file).map_err(|e| Failure::reading(file, &e))?);
        }
        let caches = match_caches(&character, files, caches)?;
        let count = caches.iter().map(PointCache::frame_count).min().unwrap_or(0);
        let fps = fps.or_else(|| caches.iter().find_map(PointCache::fps)).unwrap_or(scene.motion.fps);
        // objects that a clip moves carry their cache along
        let clip = clips(&scene, &character).ok().and_then(|mut c| (!c.is_empty()).then(|| c.swap_remove(0)));
        if count == 0 {
            return Err(Failure::Input(format!("{} holds no frame", path.display())));
        }
        Ok(Self { scene, character, count, fps, clip, source: Source::Caches(caches) })
    }

    /// The volume mesh and materials that a journal's nodes belong to.
    #[must_use]
    pub fn header(&self) -> Option<&JournalHeader> {
        match &self.source {
            Source::Journal(journal, _) => Some(journal.header()),
            _ => None,
        }
    }

    /// Whether frames show the character in its bind pose.
    #[must_use]
    pub fn is_bind_pose(&self) -> bool {
        matches!(self.source, Source::Bind)
    }

    fn pose(&self, frame: usize) -> Pose {
        let skeleton = &self.character.skeleton;
        match (&self.source, &self.clip) {
            (Source::Bind, _) => RestMotion(skeleton).pose(0.0),
            (_, clip) => {
                let motion = ClipMotion { skeleton, clip: clip.as_ref(), speed: self.scene.motion.speed };
                let first = if matches!(self.source, Source::Caches(_)) {
                    self.scene.motion.frames.map_or(0, |r| r.start)
                } else {
                    0
                };
                motion.pose((first + frame) as f64 / self.fps)
            }
        }
    }

    /// One frame.
    ///
    /// # Errors
    /// [`Failure`] when it cannot be read.
    pub fn shape(&mut self, index: usize) -> Result<Shape, Failure> {
        let pose = self.pose(index);
        let character = &self.character;
        match &mut self.source {
            Source::Bind => {
                let skin = character.meshes.iter().map(|m| m.positions.clone()).collect();
                Ok(Shape { skin, pose, nodes: Vec::new() })
            }
            Source::Skinned => {
                let skin = (0..character.meshes.len()).map(|m| character.blend_skin(m, &pose)).collect();
                Ok(Shape { skin, pose, nodes: Vec::new() })
            }
            Source::Journal(journal, frame) => {
                journal.read_frame(index, frame).map_err(|e| journal_failure(&e))?;
                let wide = |points: &Vec<[f32; 3]>| points.iter().map(|p| p.map(f64::from)).collect();
                Ok(Shape {
                    skin: frame.skin.iter().map(wide).collect(),
                    pose: frame.pose.clone(),
                    nodes: wide(&frame.nodes),
                })
            }
            Source::Caches(caches) => {
                let mut points = Vec::new();
                let mut skin = Vec::new();
                for (cache, mesh) in caches.iter_mut().zip(&character.meshes) {
                    cache.read_frame(index, &mut points).map_err(|e| Failure::Input(e.to_string()))?;
                    let to_world = match mesh.object {
                        Some(object) => *pose.joint(object),
                        None => *character.skeleton.to_world(),
                    };
                    let place = |p: &[f32; 3]| -> [f64; 3] { Affine::point(&to_world, p.map(f64::from)) };
                    skin.push(points.iter().map(place).collect());
                }
                Ok(Shape { skin, pose, nodes: Vec::new() })
            }
        }
    }
}

/// The scene and character of a file, with what the command line says about them.
fn scene_of(args: &RenderArgs, file: &Path) -> Result<(Scene, Character), Failure> {
    let mut scene = load::scene(file)?;
    scene.override_import(&args.import);
    if args.clip.is_some() {
        scene.motion.clip.clone_from(&args.clip);
    }
    let character = load::scene_character(&scene)?;
    Ok((scene, character))
}

/// The scene and character a journal was baked from.
///
/// # Errors
/// [`Failure`] when they are no longer where they were.
pub fn journal_scene(journal: &JournalReader) -> Result<(Scene, Character), Failure> {
    let lost = |e: &dyn std::fmt::Display| {
        Failure::Input(format!(
            "{}: the character it was baked from cannot be read ({e}); say where it is: --with CHARACTER|SCENE",
            journal.path().display()
        ))
    };
    let scene: Scene = toml::from_str(&journal.header().origin).map_err(|e| lost(&e.message()))?;
    let character = load::scene_character(&scene).map_err(|e| lost(&e))?;
    Ok((scene, character))
}

fn check_meshes(character: &Character, header: &JournalHeader, file: &Path) -> Result<(), Failure> {
    let own = character.meshes.iter().map(|m| (m.name.as_str(), m.positions.len()));
    let same = own.eq(header.meshes.iter().map(|m| (m.name.as_str(), m.vertex_count as usize)))
        && header.joint_count as usize == character.skeleton.joint_count();
    if same {
        Ok(())
    } else {
        Err(Failure::Input(format!(
            "{} was baked from another character than `{}`; say which one with --with",
            file.display(),
            character.name
        )))
    }
}

/// All caches of a folder.
fn caches_in(folder: &Path) -> Result<Vec<PathBuf>, Failure> {
    let entries = std::fs::read_dir(folder).map_err(|e| Failure::reading(folder, &e))?;
    let mut files: Vec<_> =
        entries.flatten().map(|e| e.path()).filter(|p| load::kind(p) == FileKind::PointCache).collect();
    files.sort();
    if files.is_empty() {
        return Err(Failure::Input(format!("the folder {} holds no .pc2 or .mdd file", folder.display())));
    }
    Ok(files)
}

/// Puts caches in the order of the character's meshes, by their names, or by the number of vertices of a single one.
fn match_caches(
    character: &Character,
    files: Vec<PathBuf>,
    caches: Vec<PointCache>,
) -> Result<Vec<PointCache>, Failure> {
    let mut named: Vec<_> = files.into_iter().zip(caches).map(Some).collect();
    let mut out = Vec::new();
    for mesh in &character.meshes {
        let single = character.meshes.len() == 1 && named.len() == 1;
        let found = named.iter_mut().find(|slot| {
            let stem = slot.as_ref().and_then(|(f, _)| f.file_stem());
            single || stem.is_some_and(|s| s == mesh.name.as_str())
        });
        let Some((file, cache)) = found.and_then(Option::take) else {
            return Err(Failure::Input(format!(
                "there is no cache for the mesh `{}` of `{}`; give the folder that holds one cache for each mesh",
                mesh.name, character.name
            )));
        };
        if cache.point_count() != mesh.positions.len() {
            return Err(Failure::Input(format!(
                "{} has {} points, the mesh `{}` has {} vertices: it is the cache of another character",
                file.display(),
                cache.point_count(),
                mesh.name,
                mesh.positions.len()
            )));
        }
        out.push(cache);
    }
    Ok(out)
}
