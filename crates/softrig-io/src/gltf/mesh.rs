//! Vertices, triangles and attributes of a mesh, before it is placed in the world.
//!
//! The vertex order is that of Blender's importer: primitive after primitive, of each the vertices that its triangles use, in
//! the order of its accessor. Where every vertex is used and no two primitives share an accessor, as exporters write it, that
//! is simply the file's order.

use super::accessor::{Accessors, Integers};
use super::container::shown;
use super::document::{Document, Mesh, Node, Primitive};
use super::fault::{Checked, Fault};

/// Sets of four joints a vertex may have.
const MAX_SETS: usize = 64;

/// Custom attributes a mesh may have.
const MAX_GROUPS: usize = 64;

/// A mesh as the file has it.
#[derive(Debug, Default)]
pub(super) struct RawMesh {
    /// In the mesh's own space, file units, morph targets applied.
    pub positions: Vec<[f64; 3]>,
    pub triangles: Vec<[u32; 3]>,
    /// Material of each triangle, `None` for the default one.
    pub materials: Vec<Option<usize>>,
    pub texture_coordinates: Vec<[f32; 2]>,
    pub colors: Vec<[f32; 4]>,
    pub groups: Vec<(String, Vec<f32>)>,
    /// Place in the skin's joint list, and weight, of all influences: as compressed rows over vertices.
    pub influences: Vec<(u32, f32)>,
    pub influence_start: Vec<usize>,
    /// What was assumed, repaired or dropped.
    pub notes: Vec<String>,
}

/// One primitive's vertices, all of its accessor.
struct Vertices {
    positions: Vec<[f64; 3]>,
    texture_coordinates: Vec<[f64; 2]>,
    colors: Vec<[f64; 4]>,
    groups: Vec<(String, Vec<f32>)>,
    sets: Vec<(Vec<[u32; 4]>, Vec<[f64; 4]>)>,
}

/// Reads mesh `index` as shown by `node`; influences only when the node has a skin.
pub(super) fn read(document: &Document, accessors: &Accessors<'_>, index: usize, node: &Node) -> Checked<RawMesh> {
    let mesh = &document.meshes[index];
    let mut out = RawMesh { influence_start: vec![0], ..RawMesh::default() };
    let (mut skipped, mut unused) = (0, 0);
    for (i, primitive) in mesh.primitives.iter().enumerate() {
        let place = format!("/meshes/{index}/primitives/{i}");
        let mode = primitive.mode.unwrap_or(4);
        if mode < 4 || !primitive.attributes.contains_key("POSITION") {
            skipped += 1;
            continue;
        }
        let mut vertices = read_vertices(document, accessors, primitive, node.skin.is_some(), &place)?;
        let count = vertices.positions.len();
        let triangles = read_triangles(accessors, primitive, mode, count, &place, &mut out.notes)?;
        morph(accessors, mesh, node, primitive, &mut vertices.positions, &place)?;
        if let Some(v) = vertices.positions.iter().position(|p| !p.iter().all(|x| x.is_finite())) {
            return Err(Fault::malformed(place, format!("vertex {v} has no finite position"))
                .with_remedy("delete that vertex, or export the mesh again"));
        }
        unused += append(&mut out, &vertices, &triangles, primitive.material);
        // primitives that lack a custom attribute get zeros
        accessors.charge((count * out.groups.len()) as u64, &place)?;
    }
    if skipped > 0 {
        out.notes.push(format!("skipped {skipped} primitives that are points, lines or have no positions"));
    }
    if unused > 0 {
        out.notes.push(format!("left out {unused} vertices that no triangle uses"));
    }
    Ok(out)
}

fn read_vertices(
    document: &Document,
    accessors: &Accessors<'_>,
    primitive: &Primitive,
    skinned: bool,
    place: &str,
) -> Checked<Vertices> {
    let attribute =
        |name: &str| primitive.attributes.get(name).copied().map(|a| (a, format!("{place}/attributes/{name}")));
    let (index, here) = attribute("POSITION").expect("asked by the caller");
    if !accessors.has_data(index, &here)?
        && let Some(extension) = primitive.extensions.keys().next()
    {
        return Err(Fault::unsupported(place, format!("its vertices are packed with {}", shown(extension)), UNPACK));
    }
    let positions = accessors.reals::<3>(index, &here, Integers::AsMarked)?;
    let count = positions.len();
    if u32::try_from(count).is_err() {
        return Err(Fault::too_large(here, format!("{count} vertices"), u64::from(u32::MAX)));
    }
    let same = |n: usize, here: &str| match n == count {
        true => Ok(()),
        false => Err(Fault::malformed(here, format!("it has {n} entries for {count} vertices"))),
    };

    let (set, uv_map) = texture_map(document, primitive);
    let mut texture_coordinates = Vec::new();
    if let Some((index, here)) = attribute(&format!("TEXCOORD_{set}")) {
        texture_coordinates = accessors.reals::<2>(index, &here, Integers::AsMarked)?;
        same(texture_coordinates.len(), &here)?;
        texture_coordinates.iter_mut().for_each(|t| *t = uv_map(*t));
    }
    let mut colors = Vec::new();
    if let Some((index, here)) = attribute("COLOR_0") {
        colors = if accessors.components(index, &here)? == 3 {
            let rgb = accessors.reals::<3>(index, &here, Integers::Normalized)?;
            rgb.into_iter().map(|c| [c[0], c[1], c[2], 1.0]).collect()
        } else {
            accessors.reals::<4>(index, &here, Integers::Normalized)?
        };
        same(colors.len(), &here)?;
    }
    let mut groups = Vec::new();
    for (name, &index) in primitive.attributes.iter().filter(|(name, _)| name.starts_with('_')) {
        let here = format!("{place}/attributes/{}", shown(name));
        if accessors.components(index, &here)? == 1 {
            let values = accessors.reals::<1>(index, &here, Integers::AsMarked)?;
            same(values.len(), &here)?;
            groups.push((
                name[1..].to_owned(),
                values.iter().map(|v| if v[0].is_finite() { v[0] as f32 } else { 0.0 }).collect(),
            ));
        }
    }
    let mut sets = Vec::new();
    while skinned && sets.len() < MAX_SETS {
        let n = sets.len();
        let (Some((joints, here)), Some((weights, there))) =
            (attribute(&format!("JOINTS_{n}")), attribute(&format!("WEIGHTS_{n}")))
        else {
            break;
        };
        let (joints, weights) =
            (accessors.whole::<4>(joints, &here)?, accessors.reals::<4>(weights, &there, Integers::Normalized)?);
        same(joints.len(), &here)?;
        same(weights.len(), &there)?;
        sets.push((joints, weights));
    }
    Ok(Vertices { positions, texture_coordinates, colors, groups, sets })
}

/// What to do about packed meshes.
pub(super) const UNPACK: &str =
    "save it without mesh compression: switch compression off in the exporter, or unpack it with a glTF tool";

/// Number of the texture coordinate set a primitive's material uses, and what KHR_texture_transform makes of a coordinate.
fn texture_map(document: &Document, primitive: &Primitive) -> (usize, impl Fn([f64; 2]) -> [f64; 2]) {
    let material = primitive.material.and_then(|m| document.materials.get(m));
    let info = material.and_then(|m| m.pbr_metallic_roughness.as_ref()?.base_color_texture.as_ref());
    let extension = info.and_then(|i| i.extensions.as_ref()?.get("KHR_texture_transform"));
    let number = |name: &str, k: usize, usual: f64| {
        extension.and_then(|e| e.get(name)?.get(k)?.as_f64()).filter(|v| v.is_finite()).unwrap_or(usual)
    };
    let offset = [number("offset", 0, 0.0), number("offset", 1, 0.0)];
    let scale = [number("scale", 0, 1.0), number("scale", 1, 1.0)];
    let angle = extension.and_then(|e| e.get("rotation")?.as_f64()).filter(|v| v.is_finite()).unwrap_or(0.0);
    let set = extension.and_then(|e| e.get("texCoord")?.as_u64()).map(|s| s as usize);
    let (sin, cos) = angle.sin_cos();
    let map = move |t: [f64; 2]| {
        let (u, v) = (scale[0] * t[0], scale[1] * t[1]);
        [offset[0] + cos * u + sin * v, offset[1] - sin * u + cos * v]
    };
    (set.or(info.map(|i| i.tex_coord)).unwrap_or(0), map)
}

fn read_triangles(
    accessors: &Accessors<'_>,
    primitive: &Primitive,
    mode: u32,
    vertex_count: usize,
    place: &str,
    notes: &mut Vec<String>,
) -> Checked<Vec<[u32; 3]>> {
    let indices: Vec<u32> = match primitive.indices {
        Some(index) => {
            let here = format!("{place}/indices");
            let indices: Vec<u32> = accessors.whole::<1>(index, &here)?.into_iter().map(|[i]| i).collect();
            if let Some(wrong) = indices.iter().find(|i| **i as usize >= vertex_count) {
                return Err(Fault::malformed(here, format!("it names vertex {wrong}, but there are {vertex_count}")));
            }
            indices
        }
        None => (0..vertex_count as u32).collect(),
    };
    let distinct = |t: &[u32; 3]| t[0] != t[1] && t[1] != t[2] && t[2] != t[0];
    Ok(match mode {
        4 => {
            let left = indices.len() % 3;
            if left > 0 {
                notes.push(format!("ignored {left} indices at the end that make no triangle"));
            }
            indices.chunks_exact(3).map(|t| [t[0], t[1], t[2]]).collect()
        }
        // every second triangle of a strip is listed backwards; those with equal corners only join strips
        5 => {
            let strip = indices.windows(3).enumerate();
            strip
                .map(|(i, t)| if i % 2 == 0 { [t[0], t[1], t[2]] } else { [t[1], t[0], t[2]] })
                .filter(distinct)
                .collect()
        }
        6 => {
            let fan = indices.get(1..).unwrap_or_default().windows(2);
            fan.map(|t| [t[0], t[1], indices[0]]).filter(distinct).collect()
        }
        _ => return Err(Fault::malformed(format!("{place}/mode"), format!("primitive mode {mode} does not exist"))),
    })
}

/// Adds the morph targets at their default weights.
fn morph(
    accessors: &Accessors<'_>,
    mesh: &Mesh,
    node: &Node,
    primitive: &Primitive,
    positions: &mut [[f64; 3]],
    place: &str,
) -> Checked<()> {
    let weights = node.weights.as_ref().or(mesh.weights.as_ref());
    for (i, (weight, target)) in weights.into_iter().flatten().zip(&primitive.targets).enumerate() {
        let Some(&index) = target.get("POSITION").filter(|_| *weight != 0.0) else { continue };
        let here = format!("{place}/targets/{i}");
        let moves = accessors.reals::<3>(index, &here, Integers::AsMarked)?;
        if moves.len() != positions.len() {
            let (n, count) = (moves.len(), positions.len());
            return Err(Fault::malformed(here, format!("it has {n} entries for {count} vertices")));
        }
        for (p, d) in positions.iter_mut().zip(moves) {
            (0..3).for_each(|k| p[k] += weight * d[k]);
        }
    }
    Ok(())
}

/// Appends one primitive; returns how many of its vertices no triangle uses.
fn append(out: &mut RawMesh, vertices: &Vertices, triangles: &[[u32; 3]], material: Option<usize>) -> usize {
    let count = vertices.positions.len();
    let mut new = vec![u32::MAX; count];
    triangles.iter().flatten().for_each(|v| new[*v as usize] = 0);
    let kept: Vec<usize> = (0..count).filter(|v| new[*v] == 0).collect();
    let base = out.positions.len();
    for (i, &v) in kept.iter().enumerate() {
        new[v] = (base + i) as u32;
    }
    out.triangles.extend(triangles.iter().map(|t| t.map(|v| new[v as usize])));
    out.materials.resize(out.triangles.len(), material);
    out.positions.extend(kept.iter().map(|v| vertices.positions[*v]));

    // attributes that some primitives have and others lack are filled with what means nothing
    let total = out.positions.len();
    if !vertices.texture_coordinates.is_empty() {
        out.texture_coordinates.resize(base, [0.0; 2]);
        out.texture_coordinates.extend(kept.iter().map(|v| vertices.texture_coordinates[*v].map(|t| finite(t) as f32)));
    } else if !out.texture_coordinates.is_empty() {
        out.texture_coordinates.resize(total, [0.0; 2]);
    }
    if !vertices.colors.is_empty() {
        out.colors.resize(base, [1.0; 4]);
        out.colors.extend(kept.iter().map(|v| vertices.colors[*v].map(|c| finite(c).clamp(0.0, 1.0) as f32)));
    } else if !out.colors.is_empty() {
        out.colors.resize(total, [1.0; 4]);
    }
    for (name, values) in &vertices.groups {
        if out.groups.len() == MAX_GROUPS && out.groups.iter().all(|(n, _)| n != name) {
            out.notes
                .push(format!("left out the custom attribute `{}`: there are more than {MAX_GROUPS}", shown(name)));
            continue;
        }
        let at = out.groups.iter().position(|(n, _)| n == name).unwrap_or_else(|| {
            out.groups.push((name.clone(), Vec::new()));
            out.groups.len() - 1
        });
        let group = &mut out.groups[at].1;
        group.resize(base, 0.0);
        group.extend(kept.iter().map(|v| values[*v]));
    }
    out.groups.iter_mut().for_each(|(_, values)| values.resize(total, 0.0));

    for &v in &kept {
        for (joints, weights) in &vertices.sets {
            for k in 0..4 {
                if weights[v][k] != 0.0 {
                    out.influences.push((joints[v][k], weights[v][k] as f32));
                }
            }
        }
        out.influence_start.push(out.influences.len());
    }
    count - kept.len()
}

fn finite(v: f64) -> f64 {
    if v.is_finite() { v } else { 0.0 }
}

/// Names of a mesh's morph targets, as most tools store them, or made up.
pub(super) fn target_names(mesh: &Mesh) -> Vec<String> {
    let count = mesh.primitives.iter().map(|p: &Primitive| p.targets.len()).max().unwrap_or(0);
    let names = mesh.extras.as_ref().and_then(|e| e.get("targetNames")?.as_array());
    let given = |i: usize| names.and_then(|n| n.get(i)?.as_str()).map(shown);
    (0..count).map(|i| given(i).unwrap_or_else(|| format!("target {i}"))).collect()
}
