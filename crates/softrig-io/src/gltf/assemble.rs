//! The parts of a file put together: meshes placed in the rest shape, everything in metres and Y up.

use super::accessor::Accessors;
use super::container::{self, Loader, shown};
use super::document::Document;
use super::fault::{Checked, Fault};
use super::mesh::{self, RawMesh};
use super::nodes::Nodes;
use super::skin::{self, Binding, Rest, Usage};
use super::{animation, material};
use crate::import::ImportOptions;
use crate::names::{Names, file_name};
use crate::units::{Units, UpAxis, box_size};
use softrig::character::{Character, CharacterMesh, Skin, SkinWeights};
use softrig::rig::{Affine, JointId, Skeleton};

/// Extensions a file may require: what they add is read, or changes only looks.
const KNOWN: [&str; 3] = ["KHR_mesh_quantization", "KHR_texture_transform", "KHR_animation_pointer"];
const KNOWN_FAMILIES: [&str; 8] =
    ["KHR_materials_", "KHR_texture_", "EXT_texture_", "MSFT_texture_", "KHR_lights_", "EXT_lights_", "KHR_xmp", "VRM"];

/// Weight sums off one by more are worth a note: four rounded bytes stay below.
const SUM_TOLERANCE: f64 = 0.01;

/// Reads everything.
pub(super) fn character(
    bytes: &[u8],
    name: String,
    loader: &mut Loader<'_>,
    options: &ImportOptions,
) -> Checked<Character> {
    let mut notes = Vec::new();
    let (document, binary) = container::parse(bytes, &mut notes)?;
    check_extensions(&document, &mut notes)?;
    let nodes = Nodes::read(&document, &mut notes)?;
    let shown_meshes = shown_meshes(&document, &nodes, &mut notes)?;
    let buffers = container::buffers(&document, binary, loader)?;
    let accessors = Accessors::new(&document, &buffers);

    let mut raw = Vec::with_capacity(shown_meshes.len());
    for &node in &shown_meshes {
        let mesh = document.nodes[node].mesh.expect("only nodes with a mesh are listed");
        raw.push(mesh::read(&document, &accessors, mesh, &document.nodes[node])?);
    }
    let usage = usage(&document, &shown_meshes, &raw)?;
    let clips = animation::clips(&document, &accessors, &mut notes)?;
    let rest = skin::rest(&document, &accessors, &nodes, &usage, &mut notes)?;
    let (mut looks, textures) = material::looks(&document, &accessors, loader, &mut notes);

    let rigged = rest.bindings.iter().any(Option::is_some) || clips.iter().any(|c| !c.tracks.is_empty());
    let (mut meshes, mut names) = (Vec::with_capacity(raw.len()), Names::default());
    for (raw, &node) in raw.into_iter().zip(&shown_meshes) {
        let name = names.unique(&mesh_name(&document, node));
        notes.extend(raw.notes.iter().map(|n| format!("mesh `{name}`: {n}")));
        if raw.triangles.is_empty() {
            notes.push(format!("mesh `{name}` has no triangles; left out"));
            continue;
        }
        meshes.push(place(&document, &rest, raw, node, rigged, name, &mut notes));
    }
    if meshes.is_empty() {
        let what = if document.meshes.is_empty() {
            "the file has no meshes"
        } else {
            "no node of its scene shows a mesh with triangles"
        };
        return Err(Fault::malformed("", what).with_remedy("export the character with its mesh"));
    }
    drop_unused_default(&mut looks, &mut meshes);

    let size = box_size(meshes.iter().flat_map(|m| m.positions.iter().copied()));
    let mut units = Units::choose(size, UpAxis::Y, options);
    notes.append(&mut units.notes);
    let skeleton = Skeleton::new(nodes.into_joints(rest.frames), Affine::IDENTITY)
        .map_err(|e| Fault::malformed("/nodes", e.to_string()))?;
    let mut character = Character { name, meshes, skeleton, clips, looks, textures, notes };
    let to_world = units.to_world();
    character.map_rest(&to_world);
    character.skeleton.set_to_world(to_world);
    let finite = character.meshes.iter().flat_map(|m| &m.positions).flatten().all(|v| v.is_finite());
    if !finite || !character.skeleton.joints().iter().all(|j| j.rest.is_finite()) {
        return Err(Fault::malformed("", "its vertices or joints lie too far out to be numbers"));
    }
    Ok(character)
}

fn check_extensions(document: &Document, notes: &mut Vec<String>) -> Checked<()> {
    for (i, name) in document.extensions_required.iter().enumerate() {
        let known = KNOWN.contains(&name.as_str()) || KNOWN_FAMILIES.iter().any(|f| name.starts_with(f));
        if known {
            continue;
        }
        let packed = name.contains("draco") || name.contains("meshopt");
        let remedy = if packed { mesh::UNPACK.into() } else { format!("export it again without {}", shown(name)) };
        return Err(Fault::unsupported(
            format!("/extensionsRequired/{i}"),
            format!("it needs the extension {}, which softrig does not have", shown(name)),
            remedy,
        ));
    }
    if document.extensions_used.iter().any(|e| e == "EXT_mesh_gpu_instancing") {
        notes.push("instances made by EXT_mesh_gpu_instancing are not shown".into());
    }
    Ok(())
}

/// Nodes of the scene that show a mesh, in the file's order; indices checked.
fn shown_meshes(document: &Document, nodes: &Nodes, notes: &mut Vec<String>) -> Checked<Vec<usize>> {
    let (mut out, mut hidden) = (Vec::new(), 0);
    for (i, node) in document.nodes.iter().enumerate() {
        let Some(mesh) = node.mesh else { continue };
        if mesh >= document.meshes.len() {
            let have = document.meshes.len();
            return Err(Fault::malformed(
                format!("/nodes/{i}/mesh"),
                format!("it names mesh {mesh}, but there are {have}"),
            ));
        }
        if let Some(skin) = node.skin.filter(|s| *s >= document.skins.len()) {
            let have = document.skins.len();
            return Err(Fault::malformed(
                format!("/nodes/{i}/skin"),
                format!("it names skin {skin}, but there are {have}"),
            ));
        }
        if nodes.shown[i] {
            out.push(i);
        } else {
            hidden += 1;
        }
    }
    if hidden > 0 {
        notes.push(format!("left out {hidden} meshes that the file's scene does not show"));
    }
    Ok(out)
}

/// What the shown meshes say about the joints of each skin; refuses joints out of range.
fn usage(document: &Document, shown_meshes: &[usize], raw: &[RawMesh]) -> Checked<Vec<Option<Usage>>> {
    let mut usage: Vec<Option<Usage>> = document.skins.iter().map(|_| None).collect();
    for (&node, raw) in shown_meshes.iter().zip(raw) {
        let Some(s) = document.nodes[node].skin else { continue };
        let joint_count = skin::joints(document, s)?.len();
        let u = usage[s].get_or_insert_with(|| Usage::new(joint_count));
        for &(joint, weight) in &raw.influences {
            match u.weighted.get_mut(joint as usize) {
                Some(weighted) => *weighted |= weight > 0.0,
                None => {
                    return Err(Fault::malformed(
                        format!("/nodes/{node}/mesh"),
                        format!("a vertex hangs on joint {joint} of a skin with {joint_count} joints"),
                    ));
                }
            }
        }
        for p in &raw.positions {
            for k in 0..3 {
                u.bounds[0][k] = u.bounds[0][k].min(p[k]);
                u.bounds[1][k] = u.bounds[1][k].max(p[k]);
            }
        }
    }
    Ok(usage)
}

/// Name for a mesh node's cache: of the node, else of the mesh.
fn mesh_name(document: &Document, node: usize) -> String {
    let mesh = document.nodes[node].mesh.expect("only nodes with a mesh are named");
    let given = document.nodes[node].name.as_deref().filter(|n| !n.trim().is_empty());
    let given = given.or(document.meshes[mesh].name.as_deref());
    file_name(given.unwrap_or_default(), &format!("mesh {mesh}"))
}

/// One mesh node in the rest shape (file units).
fn place(
    document: &Document,
    rest: &Rest,
    raw: RawMesh,
    node: usize,
    rigged: bool,
    name: String,
    notes: &mut Vec<String>,
) -> CharacterMesh {
    let binding = document.nodes[node].skin.and_then(|s| rest.bindings[s].as_ref());
    let (map, object, skin) = match binding {
        Some(binding) => {
            let weights = weights(&raw, binding, &name, notes);
            (binding.place, binding.armature.map(|a| JointId(a as u32)), Skin::Weighted(weights))
        }
        None => {
            let joint = JointId(node as u32);
            (rest.frames[node], Some(joint), if rigged { Skin::Rigid(joint) } else { Skin::Free })
        }
    };
    let positions = raw.positions.iter().map(|p| map.point(*p)).collect();
    let mut triangles = raw.triangles;
    if map.determinant() < 0.0 {
        // a mirror turns triangles inside out
        triangles.iter_mut().for_each(|t| t.swap(1, 2));
    }
    let default = document.materials.len();
    let look = raw.materials.iter().map(|m| m.filter(|m| *m < default).unwrap_or(default) as u32).collect();
    CharacterMesh {
        name,
        positions,
        triangles,
        look,
        texture_coordinates: raw.texture_coordinates,
        colors: raw.colors,
        skin,
        object,
        groups: raw.groups,
    }
}

/// Normalised weights of all vertices.
fn weights(raw: &RawMesh, binding: &Binding, name: &str, notes: &mut Vec<String>) -> SkinWeights {
    let mut out = SkinWeights::default();
    let (mut off, mut none) = (0, 0);
    for range in raw.influence_start.windows(2) {
        let influences = &raw.influences[range[0]..range[1]];
        let usable = || influences.iter().filter(|(_, w)| *w > 0.0 && w.is_finite());
        // in f64: garbage weights may overflow an f32 sum
        let sum: f64 = usable().map(|(_, w)| f64::from(*w)).sum();
        let normalized =
            usable().map(|(j, w)| (JointId(binding.joints[*j as usize] as u32), (f64::from(*w) / sum) as f32));
        off += usize::from(sum > 0.0 && (sum - 1.0).abs() > SUM_TOLERANCE);
        if sum > 0.0 {
            out.push(normalized);
        } else {
            none += 1;
            out.push([(JointId(binding.root as u32), 1.0)]);
        }
    }
    if off > 0 {
        notes.push(format!("mesh `{name}`: the weights of {off} vertices did not sum to 1; scaled them"));
    }
    if none > 0 {
        notes.push(format!("mesh `{name}`: {none} vertices have no weight; hung them on the root joint"));
    }
    out
}

/// Takes the default look away where no triangle uses it; a character without materials has no looks.
fn drop_unused_default(looks: &mut Vec<softrig::character::Look>, meshes: &mut [CharacterMesh]) {
    let default = looks.len() - 1;
    if default == 0 {
        looks.clear();
        meshes.iter_mut().for_each(|m| m.look.clear());
    } else if !meshes.iter().flat_map(|m| &m.look).any(|l| *l as usize == default) {
        looks.pop();
    }
}
