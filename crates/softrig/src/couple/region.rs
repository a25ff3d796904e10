//! Materials by region: by the file's own material, by a vertex group, by bone, and stiffer near bones.

use super::binding::Binding;
use super::surface::{CellSample, WeightedSurface};
use crate::character::Character;
use crate::material::{Material, MaterialError, MaterialMap};
use crate::mesh::{MeshError, VolumeMesh};

/// Which part of a character a region covers.
#[derive(Clone, Debug, PartialEq)]
pub enum Selector {
    /// Cells under triangles of this look (glTF material).
    Look(String),
    /// Cells under skin where the per-vertex group or attribute is at least the threshold [-].
    Group(String, f32),
    /// Cells owned by this joint's bone.
    Bone(String),
}

/// A material for a part of the character. Later regions win over earlier ones.
#[derive(Clone, Debug, PartialEq)]
pub struct Region {
    /// Where.
    pub selector: Selector,
    /// What it is made of.
    pub material: Material,
}

/// Stiffer flesh near bones: the factor falls linearly from `factor` at the bone to 1 at `radius`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NearBone {
    /// On Young's modulus, at the bone [-].
    pub factor: f64,
    /// Distance at which it has faded [m].
    pub radius: f64,
}

/// Why regions cannot be laid out.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum RegionError {
    /// A region names something the character does not have.
    #[error("no {kind} called `{name}` in the character; it has: {known}")]
    Unknown {
        /// `material`, `vertex group` or `bone`.
        kind: &'static str,
        /// Name in the region.
        name: String,
        /// Names there are.
        known: String,
    },
    /// A region's material is out of range.
    #[error("region {index}: {source}")]
    Material {
        /// Which region, from 0.
        index: usize,
        /// What is wrong with it.
        source: MaterialError,
    },
    /// A near-bone factor or radius that is not positive.
    #[error("near_bone: factor must be in 0.01..=1000 and radius positive, they are {factor} and {radius} m")]
    NearBone {
        /// As given.
        factor: f64,
        /// As given [m].
        radius: f64,
    },
    /// The volume mesh cannot carry the skin.
    #[error(transparent)]
    Mesh(#[from] MeshError),
}

/// The material of every cell.
///
/// # Errors
/// [`RegionError`] names the region that cannot be laid out.
pub fn material_map(
    character: &Character,
    mesh: &VolumeMesh,
    binding: &Binding,
    base: Material,
    regions: &[Region],
    near_bone: Option<NearBone>,
) -> Result<MaterialMap, RegionError> {
    let mut map = MaterialMap::uniform(base);
    if let Some(near) = near_bone {
        let good = (0.01..=1000.0).contains(&near.factor) && near.radius > 0.0 && near.radius.is_finite();
        if !good {
            return Err(RegionError::NearBone { factor: near.factor, radius: near.radius });
        }
        map.stiffness_factor = mesh.cells().map(|cell| near_bone_factor(mesh, binding, cell, near)).collect();
    }
    if regions.is_empty() {
        return Ok(map);
    }
    map.of_cell = vec![0; mesh.cell_count()];
    let Some(surface) = WeightedSurface::new(character) else { return Ok(map) };
    let spacing = mesh.lattice.as_ref().map_or(0.05 * character.height(), |l| l.spacing);
    let samples = surface.samples(&binding.bones, spacing, mesh)?;
    for (index, region) in regions.iter().enumerate() {
        region.material.check().map_err(|source| RegionError::Material { index, source })?;
        map.materials.push(region.material);
        let id = map.materials.len() as u32 - 1;
        for cell in cells_of(&region.selector, character, mesh, binding, &samples)? {
            map.of_cell[cell] = id;
        }
    }
    Ok(map)
}

#[allow(clippy::cast_possible_truncation, reason = "a factor needs no more than f32")]
fn near_bone_factor(mesh: &VolumeMesh, binding: &Binding, cell: &[u32], near: NearBone) -> f32 {
    let mut centre = [0.0; 3];
    for &n in cell {
        (0..3).for_each(|k| centre[k] += mesh.nodes[n as usize][k] / cell.len() as f64);
    }
    let bone = &binding.bones[binding.owner[cell[0] as usize] as usize];
    let closeness = (1.0 - bone.nearest(centre).distance / near.radius).clamp(0.0, 1.0);
    (1.0 + (near.factor - 1.0) * closeness) as f32
}

fn cells_of(
    selector: &Selector,
    character: &Character,
    mesh: &VolumeMesh,
    binding: &Binding,
    samples: &[CellSample],
) -> Result<Vec<usize>, RegionError> {
    match selector {
        Selector::Bone(name) => {
            let joint_name = |b: usize| character.skeleton.joint(binding.bones[b].joint).name.as_str();
            let Some(bone) = (0..binding.bones.len()).find(|b| joint_name(*b) == name) else {
                return Err(unknown("bone", name, (0..binding.bones.len()).map(joint_name)));
            };
            // a cell belongs to the bone that owns most of its nodes
            Ok((0..mesh.cell_count())
                .filter(|c| {
                    let cell = mesh.cell(*c);
                    2 * cell.iter().filter(|n| binding.owner[**n as usize] as usize == bone).count() > cell.len()
                })
                .collect())
        }
        Selector::Look(name) => {
            let Some(look) = character.looks.iter().position(|l| l.name == *name) else {
                return Err(unknown("material", name, character.looks.iter().map(|l| l.name.as_str())));
            };
            Ok(grow_inward(mesh, samples, |s| {
                let mesh = &character.meshes[s.triangle.0 as usize];
                mesh.look.get(s.triangle.1 as usize) == Some(&(look as u32))
            }))
        }
        Selector::Group(name, threshold) => {
            let has = |m: &crate::character::CharacterMesh| m.groups.iter().any(|g| g.0 == *name);
            if !character.meshes.iter().any(has) {
                let known = character.meshes.iter().flat_map(|m| m.groups.iter().map(|g| g.0.as_str()));
                return Err(unknown("vertex group", name, known));
            }
            Ok(grow_inward(mesh, samples, |s| {
                let mesh = &character.meshes[s.triangle.0 as usize];
                let Some((_, values)) = mesh.groups.iter().find(|g| g.0 == *name) else { return false };
                let corners = mesh.triangles[s.triangle.1 as usize];
                corners.iter().map(|v| values.get(*v as usize).copied().unwrap_or(0.0)).sum::<f32>() / 3.0 >= *threshold
            }))
        }
    }
}

fn unknown<'a>(kind: &'static str, name: &str, known: impl Iterator<Item = &'a str>) -> RegionError {
    let mut known: Vec<&str> = known.collect();
    known.dedup();
    let known = if known.is_empty() { "none".to_owned() } else { known.join(", ") };
    RegionError::Unknown { kind, name: name.to_owned(), known }
}

/// Cells under the chosen samples, and the cells inside nearer to those than to any other skin: layer by layer from the skin,
/// a cell joins the side that reached it first with more of its nodes.
fn grow_inward(mesh: &VolumeMesh, samples: &[CellSample], chosen: impl Fn(&CellSample) -> bool) -> Vec<usize> {
    // chosen minus other samples in each cell
    let mut vote = vec![0.0; mesh.cell_count()];
    let mut seen = vec![false; mesh.cell_count()];
    for s in samples {
        vote[s.cell as usize] += if chosen(s) { 1.0 } else { -1.0 };
        seen[s.cell as usize] = true;
    }
    let mut node_vote = vec![0i32; mesh.node_count()];
    let mut frontier: Vec<usize> = (0..mesh.cell_count()).filter(|c| seen[*c]).collect();
    while !frontier.is_empty() {
        for &c in &frontier {
            let sign = if vote[c] > 0.0 { 1 } else { -1 };
            mesh.cell(c).iter().for_each(|n| node_vote[*n as usize] += sign);
        }
        frontier = (0..mesh.cell_count())
            .filter(|c| !seen[*c] && mesh.cell(*c).iter().any(|n| node_vote[*n as usize] != 0))
            .collect();
        for &c in &frontier {
            vote[c] = mesh.cell(c).iter().map(|n| f64::from(node_vote[*n as usize].signum())).sum();
            seen[c] = true;
        }
    }
    (0..mesh.cell_count()).filter(|c| vote[*c] > 0.0).collect()
}
