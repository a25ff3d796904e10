//! The sample character: a chubby biped made by code, so that everything can be tried without a file.
//!
//! An implicit surface ([`shape`]) is polygonised ([`polygon`]), cut along the edges of its clothes ([`cut`]), coloured
//! ([`paint`]) and hung on a skeleton ([`joints`]) with smooth weights ([`weights`]); the clips are computed, not drawn ([`clips`]).

mod clips;
mod cut;
mod joints;
mod paint;
mod pieces;
mod polygon;
mod shape;
mod weights;

use crate::character::{Character, CharacterMesh, Skin};

/// The sample character: about 1.6 m tall, 21 joints, one closed skin of 5 to 10 thousand vertices (the features of the face are small
/// closed surfaces of their own in it), facing +Z in an A-pose, with the clips `walk`, `jump` and `turn`. The same on every call.
#[must_use]
pub fn character() -> Character {
    let skeleton = joints::skeleton();
    let mut skin = polygon::polygonise(polygon::SPACING);
    let mut look = cut::cut(&mut skin);
    let mut colors = paint::colors(&skin, &look);
    let mut rows = weights::weights(&skin, &skeleton);
    pieces::append(&mut skin, &mut look, &mut colors, &mut rows, &skeleton);
    let mesh = CharacterMesh {
        name: "body".into(),
        positions: skin.positions,
        triangles: skin.triangles,
        look,
        colors,
        skin: Skin::Weighted(rows),
        ..CharacterMesh::default()
    };
    let clips = clips::all(&skeleton);
    Character {
        name: "sample".into(),
        meshes: vec![mesh],
        skeleton,
        clips,
        looks: paint::looks(),
        textures: Vec::new(),
        notes: Vec::new(),
    }
}

#[cfg(test)]
mod tests;
