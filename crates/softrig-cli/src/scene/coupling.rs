//! Who moves whom: the coupling, single joints, and what happens to the character.

use super::SceneError;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use softrig::character::Character;
use softrig::couple::Binding;
use softrig::rig::{Clip, JointKind, JointSetup, RootKind, automatic};
use softrig::simulation::{self, Action, Key, TwoWay, TwoWayScheme, root_bones};

/// How the skeleton as a whole is held.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum RootName {
    /// Its root moves and turns as the clip says.
    #[default]
    Driven,
    /// Its root is where the clip says, and turns freely.
    Pinned,
    /// Its root falls and flies.
    Free,
}

/// How flesh and skeleton are computed together.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum SchemeName {
    /// In one implicit step: stable for any stiffness and step.
    #[default]
    Monolithic,
    /// One after the other, as in Georgii et al. 2010: slower to follow, for comparison.
    Staggered,
}

/// Which turns a joint allows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum JointName {
    /// As the clip says and not otherwise.
    Fixed,
    /// About one axis.
    Hinge,
    /// Any way, within a cone and a twist.
    Ball,
}

/// Whether flesh moves the skeleton too, and how far the clip leads it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Coupling {
    /// Flesh and gravity move the joints, not only the clip.
    pub two_way: bool,
    /// How both are computed.
    pub scheme: SchemeName,
    /// How the skeleton as a whole is held.
    pub root: RootName,
    /// How much the clip leads every joint [-]: 1 is followed exactly, 0 leaves the joints limp.
    pub drive: f64,
    /// Damping of every joint's motion against the clip's [N m s/rad].
    pub damping: f64,
}

impl Default for Coupling {
    fn default() -> Self {
        // the clip leads, the flesh disturbs: at 0.9 a limb hangs about a degree below its clip
        Self { two_way: false, scheme: SchemeName::Monolithic, root: RootName::Driven, drive: 0.9, damping: 0.0 }
    }
}

/// What one joint can do, instead of what is chosen from its clips and its name.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Joint {
    /// Name of the joint.
    pub joint: String,
    /// Which turns it allows.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub kind: Option<JointName>,
    /// Axis of a hinge, or direction of the bone of a ball, in the joint's own frame at rest.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub axis: Option<[f64; 3]>,
    /// Least and greatest angle of a hinge, from the rest pose [degrees].
    #[serde(skip_serializing_if = "Option::is_none")]
    pub range: Option<[f64; 2]>,
    /// Greatest angle between the bone of a ball and its direction at rest [degrees].
    #[serde(skip_serializing_if = "Option::is_none")]
    pub cone: Option<f64>,
    /// Least and greatest twist of a ball [degrees].
    #[serde(skip_serializing_if = "Option::is_none")]
    pub twist: Option<[f64; 2]>,
    /// How much the clip leads it [-].
    #[serde(skip_serializing_if = "Option::is_none")]
    pub drive: Option<f64>,
    /// Spring toward the clip's angle, on top of the drive [N m/rad].
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stiffness: Option<f64>,
    /// Damping of its motion against the clip's [N m s/rad].
    #[serde(skip_serializing_if = "Option::is_none")]
    pub damping: Option<f64>,
}

/// Something that happens to the character. It has exactly one of `drag`, `pull`, `gravity` and `wind`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Event {
    /// When it begins, counted from the first frame [s].
    pub start: f64,
    /// When it ends [s]. Without it: never.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub end: Option<f64>,
    /// Drags this joint along the `path`, or holds it where it is without one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub drag: Option<String>,
    /// Pulls the flesh under a vertex of this mesh along the `path`, or with the `force`, or holds it where it is.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pull: Option<String>,
    /// The vertex of the mesh, counted from 0.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub vertex: Option<usize>,
    /// Times and places, `[[t, x, y, z], ...]`, straight in between [s, m].
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub path: Vec<[f64; 4]>,
    /// Of the spring that pulls [N/m]. Without it: one that swings the whole body three times a second.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stiffness: Option<f64>,
    /// A set force instead of a spring [N].
    #[serde(skip_serializing_if = "Option::is_none")]
    pub force: Option<[f64; 3]>,
    /// Another gravity [m/s2].
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gravity: Option<[f64; 3]>,
    /// Moving air [m/s].
    #[serde(skip_serializing_if = "Option::is_none")]
    pub wind: Option<[f64; 3]>,
}

/// A coupling ready to be set, and what was chosen for the joints.
#[derive(Clone, Debug, Default)]
pub struct Chosen {
    /// For the simulation.
    pub coupling: simulation::Coupling,
    /// For the simulation.
    pub events: Vec<simulation::Event>,
    /// One line for each kind of choice, in words.
    pub notes: Vec<String>,
}

impl super::Scene {
    /// Joints and events for a character under a clip.
    ///
    /// # Errors
    /// [`SceneError::Conflict`] names what the character does not have.
    pub fn chosen_coupling(&self, character: &Character, binding: &Binding, clip: &Clip) -> Result<Chosen, SceneError> {
        let mut out = Chosen::default();
        for (i, event) in self.event.iter().enumerate() {
            out.events
                .push(event.resolved(character).map_err(|e| SceneError::Conflict(format!("event {}: {e}", i + 1)))?);
        }
        if !self.coupling.two_way {
            return Ok(out);
        }
        let skeleton = &character.skeleton;
        let bones: Vec<_> = binding.bones.iter().map(|b| b.joint).collect();
        let mut clips = character.clips.clone();
        if !clips.contains(clip) {
            clips.push(clip.clone());
        }
        let mut joints = vec![JointSetup::default(); skeleton.joint_count()];
        let (drive, damping) = (self.coupling.drive, self.coupling.damping);
        let mut by_reason: Vec<(&str, Vec<String>)> = Vec::new();
        let roots = root_bones(skeleton, binding);
        for choice in automatic(skeleton, &bones, &clips) {
            joints[choice.joint.index()] = JointSetup { drive, damping, ..choice.setup };
            if roots.contains(&choice.joint) {
                continue;
            }
            let name = skeleton.joint(choice.joint).name.clone();
            match by_reason.iter_mut().find(|r| r.0 == choice.reason) {
                Some((_, names)) => names.push(name),
                None => by_reason.push((choice.reason, vec![name])),
            }
        }
        for (reason, names) in by_reason {
            out.notes.push(format!("joints chosen: {} ({reason})", names.join(", ")));
        }
        for joint in &self.joint {
            let id = skeleton.find(&joint.joint).ok_or_else(|| unknown("joint", &joint.joint, character))?;
            let setup = &mut joints[id.index()];
            joint.apply(setup);
        }
        let scheme = match self.coupling.scheme {
            SchemeName::Monolithic => TwoWayScheme::Monolithic,
            SchemeName::Staggered => TwoWayScheme::Staggered,
        };
        let root = match self.coupling.root {
            RootName::Driven => RootKind::Driven,
            RootName::Pinned => RootKind::Pinned,
            RootName::Free => RootKind::Free,
        };
        out.coupling = simulation::Coupling::TwoWay(TwoWay { scheme, joints, root });
        Ok(out)
    }
}

impl Joint {
    /// Puts what the scene says in place of what was chosen.
    fn apply(&self, setup: &mut JointSetup) {
        let radians = |r: [f64; 2]| r.map(f64::to_radians);
        let half = std::f64::consts::FRAC_PI_2;
        let kind = self.kind.unwrap_or(match setup.kind {
            JointKind::Fixed => JointName::Fixed,
            JointKind::Hinge { .. } => JointName::Hinge,
            JointKind::Ball { .. } => JointName::Ball,
        });
        setup.kind = match (kind, setup.kind) {
            (JointName::Fixed, _) => JointKind::Fixed,
            (JointName::Hinge, JointKind::Hinge { axis, range }) => {
                JointKind::Hinge { axis: self.axis.unwrap_or(axis), range: self.range.map_or(range, radians) }
            }
            (JointName::Hinge, _) => JointKind::Hinge {
                axis: self.axis.unwrap_or([1.0, 0.0, 0.0]),
                range: self.range.map_or([-half, half], radians),
            },
            (JointName::Ball, JointKind::Ball { axis, cone, twist }) => JointKind::Ball {
                axis: self.axis.unwrap_or(axis),
                cone: self.cone.map_or(cone, f64::to_radians),
                twist: self.twist.map_or(twist, radians),
            },
            (JointName::Ball, _) => JointKind::Ball {
                axis: self.axis.unwrap_or([0.0, 1.0, 0.0]),
                cone: self.cone.map_or(half, f64::to_radians),
                twist: self.twist.map_or([-half, half], radians),
            },
        };
        setup.drive = self.drive.unwrap_or(setup.drive);
        setup.stiffness = self.stiffness.unwrap_or(setup.stiffness);
        setup.damping = self.damping.unwrap_or(setup.damping);
    }
}

impl Event {
    /// Exactly one thing, and what goes with it.
    pub(super) fn check(&self, index: usize) -> Result<(), SceneError> {
        let key = format!("event {}", index + 1);
        let conflict = |text: String| Err(SceneError::Conflict(format!("{key} {text}")));
        let things = [self.drag.is_some(), self.pull.is_some(), self.gravity.is_some(), self.wind.is_some()];
        let count = things.iter().filter(|t| **t).count();
        if count != 1 {
            return conflict(format!("must have exactly one of `drag`, `pull`, `gravity` and `wind`, it has {count}"));
        }
        if self.pull.is_some() != self.vertex.is_some() {
            return conflict("needs both `pull`, the mesh, and `vertex`, its number, or neither".into());
        }
        if self.force.is_some() && (self.pull.is_none() || !self.path.is_empty() || self.stiffness.is_some()) {
            return conflict("has a `force`, which goes with `pull` and without `path` and `stiffness`".into());
        }
        if !(self.path.is_empty() || self.drag.is_some() || self.pull.is_some()) {
            return conflict("has a `path`, which goes with `drag` or `pull`".into());
        }
        Ok(())
    }

    fn resolved(&self, character: &Character) -> Result<simulation::Event, SceneError> {
        let path = || self.path.iter().map(|k| Key { time: k[0], position: [k[1], k[2], k[3]] }).collect();
        let action = if let Some(name) = &self.drag {
            let joint = character.skeleton.find(name).ok_or_else(|| unknown("joint", name, character))?;
            Action::DragJoint { joint, path: path(), stiffness: self.stiffness }
        } else if let (Some(name), Some(vertex)) = (&self.pull, self.vertex) {
            let mesh = character.meshes.iter().position(|m| m.name == *name);
            let mesh = mesh.ok_or_else(|| unknown("mesh", name, character))?;
            match self.force {
                Some(force) => Action::Force { mesh, vertex, force },
                None => Action::PullFlesh { mesh, vertex, path: path(), stiffness: self.stiffness },
            }
        } else if let Some(gravity) = self.gravity {
            Action::Gravity(gravity)
        } else {
            Action::Wind(self.wind.unwrap_or_default())
        };
        Ok(simulation::Event { start: self.start, end: self.end.unwrap_or(f64::INFINITY), action })
    }
}

fn unknown(what: &str, name: &str, character: &Character) -> SceneError {
    let known: Vec<&str> = match what {
        "mesh" => character.meshes.iter().map(|m| m.name.as_str()).collect(),
        _ => character.skeleton.joints().iter().map(|j| j.name.as_str()).collect(),
    };
    SceneError::Conflict(format!(
        "the scene names the {what} `{name}`, which the character does not have; it has: {}",
        known.join(", ")
    ))
}
