//! A character as a scene.

use crate::scene::{Material, RenderMesh, Scene};
use softrig::character::Character;
use std::borrow::Cow;

/// The character with its own colours and textures, standing on the ground of its rest shape. `skin` is one list of positions per mesh
/// [m], as in [`softrig::frame::Frame::skin`]; a mesh without one is left out.
#[must_use]
pub fn character_scene<'a>(character: &'a Character, skin: &'a [Vec<[f64; 3]>]) -> Scene<'a> {
    let look = |l: &softrig::character::Look| Material {
        base_color: l.base_color,
        texture: l.texture.filter(|t| *t < character.textures.len()),
        ..Material::default()
    };
    let materials: Vec<Material> = character.looks.iter().map(look).collect();
    let meshes = character.meshes.iter().zip(skin).map(|(mesh, positions)| RenderMesh {
        positions: Cow::Borrowed(positions.as_slice()),
        triangles: Cow::Borrowed(mesh.triangles.as_slice()),
        // without looks of its own a mesh is grey, and has no use for their list
        material: Cow::Borrowed(mesh.look.as_slice()),
        materials: if mesh.look.is_empty() { Vec::new() } else { materials.clone() },
        colors: Cow::Borrowed(mesh.colors.as_slice()),
        texture_coordinates: Cow::Borrowed(mesh.texture_coordinates.as_slice()),
        ..RenderMesh::default()
    });
    let lowest = character.meshes.iter().flat_map(|m| &m.positions).map(|p| p[1]).fold(f64::INFINITY, f64::min);
    Scene {
        meshes: meshes.collect(),
        textures: &character.textures,
        ground: Some(lowest).filter(|y| y.is_finite()),
        ..Scene::default()
    }
}
