//! Meshes that a scene hangs whole on one joint.

use super::{Scene, SceneError};
use softrig::character::{Character, Skin};

impl Scene {
    /// Makes the meshes of [`Scene::rigid`] follow their joint.
    ///
    /// # Errors
    /// [`SceneError::Conflict`] when the character has no such mesh or joint, with the names it has.
    pub fn make_rigid(&self, character: &mut Character) -> Result<(), SceneError> {
        for rigid in &self.rigid {
            let joints = character.skeleton.joints().iter().map(|j| j.name.as_str());
            let joint = character.skeleton.find(&rigid.joint).ok_or_else(|| unknown("joint", &rigid.joint, joints))?;
            let Some(i) = character.meshes.iter().position(|m| m.name == rigid.mesh) else {
                return Err(unknown("mesh", &rigid.mesh, character.meshes.iter().map(|m| m.name.as_str())));
            };
            character.meshes[i].skin = Skin::Rigid(joint);
        }
        Ok(())
    }
}

fn unknown<'a>(what: &str, name: &str, known: impl Iterator<Item = &'a str>) -> SceneError {
    let known: Vec<_> = known.collect();
    let known = if known.is_empty() { "none".into() } else { known.join(", ") };
    SceneError::Conflict(format!(
        "the scene names the {what} `{name}`, which the character does not have; it has: {known}"
    ))
}
