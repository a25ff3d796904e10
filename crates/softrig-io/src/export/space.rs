//! From the world back to the local space of a mesh object.

use softrig::character::Character;
use softrig::rig::{Affine, Pose};

/// For each mesh the map from the world [m] to the space its file keeps its vertices in: units, axes and frame of its object.
pub(super) struct LocalSpaces<'a> {
    character: &'a Character,
    /// The last invertible map of each mesh.
    latest: Vec<Affine>,
    /// Frames in which an object was squeezed flat, so that no local space exists.
    pub singular: usize,
}

impl<'a> LocalSpaces<'a> {
    pub fn new(character: &'a Character) -> Self {
        let file = file_space(character);
        let rest = |m: &softrig::character::CharacterMesh| {
            m.object.and_then(|j| character.skeleton.joint(j).rest.inverse()).unwrap_or(file)
        };
        Self { character, latest: character.meshes.iter().map(rest).collect(), singular: 0 }
    }

    /// The map of one mesh in a pose. An object scaled to nothing is invisible whatever its vertices do: it keeps its last map.
    pub fn of(&mut self, mesh: usize, pose: &Pose) -> Affine {
        if let Some(object) = self.character.meshes[mesh].object {
            match pose.joint(object).inverse() {
                Some(map) => self.latest[mesh] = map,
                None => self.singular += 1,
            }
        }
        self.latest[mesh]
    }
}

/// From the world [m] to the units and axes of the file.
pub(super) fn file_space(character: &Character) -> Affine {
    character.skeleton.to_world().inverse().unwrap_or(Affine::IDENTITY)
}

/// Applies a map to points.
pub(super) fn map_points(map: &Affine, points: &[[f32; 3]], out: &mut Vec<[f32; 3]>) {
    out.clear();
    out.extend(points.iter().map(|p| map.point(p.map(f64::from)).map(|v| v as f32)));
}
