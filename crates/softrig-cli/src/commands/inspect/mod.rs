//! `softrig inspect`: what is in a file, what is wrong with it, and what softrig would do about it.

mod other;
mod surface;

use crate::args::InspectArgs;
use crate::failure::{Failure, Outcome};
use crate::load::{self, FileKind};
use crate::scene::{DEFAULT_CELLS, Scene, template};
use crate::ui;
use serde::Serialize;
use softrig::character::{Character, Skin};
use std::fmt::Write;
use surface::Defects;

/// What `--json` prints for a character or surface. Keys are stable.
#[derive(Debug, Serialize)]
struct CharacterInfo<'a> {
    kind: &'static str,
    name: &'a str,
    height_m: f64,
    vertices: usize,
    triangles: usize,
    meshes: Vec<MeshInfo<'a>>,
    joints: usize,
    bones: Vec<&'a str>,
    clips: Vec<ClipInfo<'a>>,
    looks: Vec<&'a str>,
    surface: Defects,
    bake: String,
    notes: &'a [String],
}

#[derive(Debug, Serialize)]
struct MeshInfo<'a> {
    name: &'a str,
    vertices: usize,
    triangles: usize,
    /// `flesh`, `rigid` or `none`.
    skin: &'static str,
    #[serde(skip_serializing_if = "Option::is_none")]
    joint: Option<&'a str>,
    groups: Vec<&'a str>,
}

#[derive(Debug, Serialize)]
struct ClipInfo<'a> {
    name: &'a str,
    seconds: f64,
    tracks: usize,
}

/// Prints what is in the file.
///
/// # Errors
/// [`Failure`] when it cannot be read.
pub fn run(args: &InspectArgs) -> Outcome {
    let other = match load::kind(&args.file) {
        FileKind::Scene | FileKind::Character => return character(args),
        FileKind::Volume => other::volume(&args.file)?,
        FileKind::Motion => other::motion(&args.file)?,
        FileKind::Journal => other::journal(&args.file)?,
        FileKind::PointCache => other::cache(&args.file)?,
    };
    if args.scene {
        return Err(Failure::Usage(format!("{} is no character: --scene needs one", args.file.display())));
    }
    if args.json {
        ui::result(serde_json::to_string_pretty(&other).expect("names and numbers are plain data"));
    } else {
        ui::result(other.text());
    }
    Ok(())
}

fn character(args: &InspectArgs) -> Outcome {
    let mut scene = load::scene(&args.file)?;
    scene.override_import(&args.import);
    let character = load::scene_character(&scene)?;
    if args.scene {
        // a scene lies beside its character
        let name = scene.character.file_name().unwrap_or(scene.character.as_os_str()).into();
        let scene = Scene { character: name, ..scene };
        ui::result(template(&scene, Some(&character)).trim_end());
        return Ok(());
    }
    let info = describe(&character);
    if args.json {
        ui::result(serde_json::to_string_pretty(&info).expect("names and numbers are plain data"));
    } else {
        ui::result(text(&info).trim_end());
    }
    Ok(())
}

fn describe(character: &Character) -> CharacterInfo<'_> {
    let joint_name = |j: softrig::rig::JointId| character.skeleton.joint(j).name.as_str();
    let meshes = character.meshes.iter().map(|m| MeshInfo {
        name: &m.name,
        vertices: m.positions.len(),
        triangles: m.triangles.len(),
        skin: match m.skin {
            Skin::Free => "none",
            Skin::Rigid(_) => "rigid",
            Skin::Weighted(_) => "flesh",
        },
        joint: if let Skin::Rigid(j) = m.skin { Some(joint_name(j)) } else { None },
        groups: m.groups.iter().map(|g| g.0.as_str()).collect(),
    });
    let bones = bones(character);
    CharacterInfo {
        kind: if bones.is_empty() { "surface" } else { "character" },
        name: &character.name,
        height_m: character.height(),
        vertices: character.vertex_count(),
        triangles: character.meshes.iter().map(|m| m.triangles.len()).sum(),
        meshes: meshes.collect(),
        joints: character.skeleton.joint_count(),
        clips: character
            .clips
            .iter()
            .map(|c| ClipInfo { name: &c.name, seconds: c.duration(), tracks: c.tracks.len() })
            .collect(),
        looks: character.looks.iter().map(|l| l.name.as_str()).collect(),
        surface: Defects::of(character),
        bake: plan(character, bones.len()),
        bones,
        notes: &character.notes,
    }
}

/// Names of the joints that skin hangs on, in the file's order.
fn bones(character: &Character) -> Vec<&str> {
    let mut weighted = vec![false; character.skeleton.joint_count()];
    for mesh in &character.meshes {
        if let Skin::Weighted(weights) = &mesh.skin {
            weights.joint.iter().for_each(|j| weighted[j.index()] = true);
        }
    }
    let joints = character.skeleton.joints().iter().zip(&weighted);
    joints.filter(|(_, w)| **w).map(|(j, _)| j.name.as_str()).collect()
}

/// What `softrig bake` would do, in one sentence.
fn plan(character: &Character, bones: usize) -> String {
    if bones == 0 {
        return "nothing: no mesh has skin weights on a skeleton; bind the mesh to an armature and export it as .glb. \
                `softrig mesh` fills it with cells as it is"
            .into();
    }
    let clip = match character.clips.first() {
        Some(clip) => format!("play `{}` ({:.2} s)", clip.name, clip.duration()),
        None => "need a clip (--clip FILE.bvh)".into(),
    };
    let rigid = character.meshes.iter().filter(|m| matches!(m.skin, Skin::Rigid(_))).count();
    let rigid = match rigid {
        0 => String::new(),
        1 => ", carry 1 mesh whole".into(),
        n => format!(", carry {n} meshes whole"),
    };
    format!("fill it with about {DEFAULT_CELLS} cells, hang them on {bones} bones{rigid}, and {clip}")
}

fn counted(count: usize, one: &str, many: &str) -> String {
    format!("{count} {}", if count == 1 { one } else { many })
}

fn text(info: &CharacterInfo<'_>) -> String {
    let mut out = String::new();
    // writing into a string cannot fail
    let _ = writeln!(out, "{} ({}): {:.3} m tall", info.name, info.kind, info.height_m);
    let _ = writeln!(
        out,
        "  {} vertices, {} triangles, {}",
        info.vertices,
        info.triangles,
        counted(info.meshes.len(), "mesh", "meshes")
    );
    for m in &info.meshes {
        let skin = match (m.skin, m.joint) {
            ("rigid", Some(joint)) => format!("carried by `{joint}`"),
            ("flesh", _) => "flesh".into(),
            _ => "no skin weights".into(),
        };
        let _ = writeln!(out, "    {}: {} vertices, {} triangles, {skin}", m.name, m.vertices, m.triangles);
    }
    let _ = writeln!(out, "  {}", info.surface.text());
    let _ = writeln!(out, "  {} joints, {} of them bones", info.joints, info.bones.len());
    let _ = writeln!(out, "  {}", counted(info.clips.len(), "clip", "clips"));
    for (i, c) in info.clips.iter().enumerate() {
        let _ = writeln!(out, "    {i}  {}: {:.2} s, {} tracks", c.name, c.seconds, c.tracks);
    }
    for note in info.notes {
        let _ = writeln!(out, "  note: {note}");
    }
    let _ = writeln!(out, "  bake would {}", info.bake);
    out
}
