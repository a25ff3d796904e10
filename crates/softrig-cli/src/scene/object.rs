//! Bodies without bones, and the constraints between them [Gissler2006].

use super::SceneError;
use super::read::within;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A box of tetrahedra, or a lattice of boxes that are alike. A scene has objects or a character.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Object {
    /// Its name.
    pub name: String,
    /// Edges of the box [m].
    pub size: [f64; 3],
    /// Cubes along the edges, each cut into five tetrahedra.
    pub cells: [usize; 3],
    /// World position of its corner with the least coordinates [m].
    pub position: [f64; 3],
    /// How much higher the end along X lies than the other: ropes and slopes [m].
    pub rise: f64,
    /// How many boxes along X, Y and Z.
    pub copies: [usize; 3],
    /// From one box to the next along X, Y and Z [m].
    pub spacing: [f64; 3],
    /// Linear RGB. Without it: another one for each object.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub color: Option<[f32; 3]>,
}

impl Default for Object {
    fn default() -> Self {
        Self {
            name: String::new(),
            size: [0.1; 3],
            cells: [1; 3],
            position: [0.0; 3],
            rise: 0.0,
            copies: [1; 3],
            spacing: [0.0; 3],
            color: None,
        }
    }
}

/// What a constraint asks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum ConstraintKind {
    /// Nodes stay where they rest, or move along the `path` from there.
    #[default]
    Nail,
    /// Nodes are in one place with nodes of another box.
    Join,
    /// Nodes keep their place on the nearest edge of `to`.
    Line,
    /// Nodes keep their place on the nearest triangle of the surface of `to`.
    Triangle,
    /// Nodes keep their place in the tetrahedron of `to` that they lie in.
    Tetrahedron,
    /// Nodes are on the surface of `to` and slide.
    Surface,
}

/// A constraint on nodes of objects, with its times. A node may be in one at a time only; with the method `implicit` in as many as can be met
/// together.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct SceneConstraint {
    /// What it asks.
    pub kind: ConstraintKind,
    /// The object whose nodes it holds.
    pub object: String,
    /// Which nodes of a box: their places from its corner, before `rise` [m]. Without it: all.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub at: Vec<[f64; 3]>,
    /// Which boxes of the object, from the first number to the one before the second. Without it: all.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub copies: Option<[[usize; 3]; 2]>,
    /// The other object.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub to: Option<String>,
    /// For `join`: the nodes of the other box, one for each of `at` [m].
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub to_at: Vec<[f64; 3]>,
    /// For `join` within one object: which box the other is, counted from the first along X, Y and Z.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub next: Option<[usize; 3]>,
    /// When it is switched on [s].
    pub start: f64,
    /// When it is switched off [s]. Without it: never.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub end: Option<f64>,
    /// Time over which the gap that it finds closes, slowly at both ends: for parts that come from far away [s].
    pub ramp: f64,
    /// For `nail`: times and ways from where the nodes rest, `[[t, x, y, z], ...]`, straight in between [s, m].
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub path: Vec<[f64; 4]>,
}

/// Energies of mass points, instead of those that come close to the material.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SceneEnergies {
    /// Of every edge [J].
    pub distance: f64,
    /// Of every triangle of a surface [J].
    pub area: f64,
    /// Of every tetrahedron [J].
    pub volume: f64,
    /// Damping of all three [s].
    pub damping: f64,
}

/// More would be a typing error.
const MOST_CELLS: f64 = 2e6;

impl super::Scene {
    /// Whether it is a scene of objects.
    #[must_use]
    pub fn has_objects(&self) -> bool {
        !self.object.is_empty()
    }

    pub(super) fn check_objects(&self) -> Result<(), SceneError> {
        if !self.has_objects() {
            if !self.constraint.is_empty() {
                let text = "[[constraint]] holds nodes of objects, and there is no [[object]]";
                return Err(SceneError::Conflict(text.into()));
            }
            return Ok(());
        }
        let refuse = |what: &str| {
            let text = format!("{what} is for characters, and this scene has objects; leave one of them out");
            Err(SceneError::Conflict(text))
        };
        if self.character != std::path::Path::new("") {
            return refuse("`character`");
        }
        let lists = [
            (!self.region.is_empty(), "[[region]]"),
            (!self.bone.is_empty(), "[[bone]]"),
            (!self.rigid.is_empty(), "[[rigid]]"),
            (!self.joint.is_empty(), "[[joint]]"),
            (!self.event.is_empty(), "[[event]]"),
            (self.coupling.two_way, "two_way = true under [coupling]"),
            (self.motion.clip.is_some(), "motion.clip"),
        ];
        if let Some((_, what)) = lists.iter().find(|(there, _)| *there) {
            return refuse(what);
        }
        let mut cells = 0.0;
        for (i, o) in self.object.iter().enumerate() {
            let key = |field: &str| format!("object `{}`: {field}", o.name);
            if o.name.is_empty() || self.object[..i].iter().any(|other| other.name == o.name) {
                return Err(SceneError::Value {
                    key: format!("object {}: name", i + 1),
                    value: format!("`{}`", o.name),
                    expected: "every object needs a name of its own",
                });
            }
            for k in 0..3 {
                within(&key("size"), Some(o.size[k]), 1e-6..=1e6, "edges must be between 1e-6 and 1e6 m")?;
                within(&key("cells"), Some(o.cells[k] as f64), 1.0..=1e6, "there must be at least one cube")?;
                within(&key("copies"), Some(o.copies[k] as f64), 1.0..=1e6, "there must be at least one box")?;
                let range = -1e6..=1e6;
                within(&key("position"), Some(o.position[k]), range.clone(), "it must be between -1e6 and 1e6 m")?;
                within(&key("spacing"), Some(o.spacing[k]), range, "it must be between -1e6 and 1e6 m")?;
            }
            within(&key("rise"), Some(o.rise), -1e6..=1e6, "it must be between -1e6 and 1e6 m")?;
            cells += o.cells.iter().chain(&o.copies).map(|n| *n as f64).product::<f64>();
        }
        within("object: cells of all copies", Some(cells), 1.0..=MOST_CELLS, "there may be 2000000 cubes in all")?;
        for (i, c) in self.constraint.iter().enumerate() {
            let key = |field: &str| format!("constraint {}: {field}", i + 1);
            within(&key("start"), Some(c.start), 0.0..=1e9, "it must be 0 or more")?;
            within(&key("end"), c.end, c.start..=1e12, "it must not be before `start`")?;
            within(&key("ramp"), Some(c.ramp), 0.0..=1e6, "it must be 0 or more")?;
            let numbers = c.path.iter().flatten().chain(c.at.iter().flatten()).chain(c.to_at.iter().flatten());
            for v in numbers {
                within(&key("a number of its places"), Some(*v), -1e9..=1e9, "it must be finite")?;
            }
            if c.path.windows(2).any(|w| w[1][0] < w[0][0]) {
                let text = format!("constraint {}: the times of its `path` must ascend", i + 1);
                return Err(SceneError::Conflict(text));
            }
            c.fits(i)?;
        }
        if let Some(e) = self.energies {
            for (name, v) in [("distance", e.distance), ("area", e.area), ("volume", e.volume), ("damping", e.damping)]
            {
                within(&format!("energies.{name}"), Some(v), 0.0..=1e15, "it must be 0 or more")?;
            }
        }
        within("motion.duration", self.motion.duration, 0.0..=1e6, "it must be 0 or more seconds")
    }
}

impl SceneConstraint {
    /// Keys that belong to other kinds.
    fn fits(&self, i: usize) -> Result<(), SceneError> {
        let join = self.kind == ConstraintKind::Join;
        let nail = self.kind == ConstraintKind::Nail;
        let wrong = if !self.path.is_empty() && !nail {
            "`path` moves nails only"
        } else if join && (self.to.is_some() == self.next.is_some()) {
            "a join needs either `to` or `next`"
        } else if join && (self.at.is_empty() || self.at.len() != self.to_at.len()) {
            "a join needs as many places in `at` as in `to_at`"
        } else if !join && (self.next.is_some() || !self.to_at.is_empty()) {
            "`next` and `to_at` are for joins"
        } else if !join && (nail == self.to.is_some()) {
            "`to` names what nodes are held by: nails have none, all others need it"
        } else {
            return Ok(());
        };
        Err(SceneError::Conflict(format!("constraint {}: {wrong}", i + 1)))
    }
}
