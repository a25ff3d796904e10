//! Reading a scene file, and refusing one that makes no sense with the place and what to change.

use super::Scene;
use crate::args::MethodName;
use softrig::material::Material;
use std::io::Read;
use std::path::{Path, PathBuf};

/// Why a scene cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SceneError {
    /// The file cannot be read.
    #[error("cannot read the scene")]
    Read(#[source] std::io::Error),
    /// It is far larger than any scene.
    #[error("is {0} bytes long; a scene file has at most {MOST_BYTES}")]
    TooLarge(u64),
    /// It is not TOML, or has a key that does not exist.
    #[error("line {line}, column {column}: {message}")]
    Syntax {
        /// From 1.
        line: usize,
        /// From 1.
        column: usize,
        /// What is wrong there.
        message: String,
    },
    /// A value makes no sense.
    #[error("`{key}` is {value}; {expected}")]
    Value {
        /// Path of the key.
        key: String,
        /// What it is.
        value: String,
        /// What it must be.
        expected: &'static str,
    },
    /// Keys that exclude or need each other.
    #[error("{0}")]
    Conflict(String),
}

/// A scene written by hand has a few kilobytes.
const MOST_BYTES: u64 = 1 << 20;

/// Reads and checks a scene file; paths in it are resolved against its folder.
///
/// # Errors
/// [`SceneError`] names the line, or the key, and what to change.
pub fn read(path: &Path) -> Result<Scene, SceneError> {
    let file = softrig_io::open_regular(path).map_err(SceneError::Read)?;
    let size = file.metadata().map_err(SceneError::Read)?.len();
    if size > MOST_BYTES {
        return Err(SceneError::TooLarge(size));
    }
    let mut bytes = Vec::new();
    file.take(MOST_BYTES).read_to_end(&mut bytes).map_err(SceneError::Read)?;
    let text = std::str::from_utf8(&bytes).map_err(|e| {
        let (line, column) = place(&String::from_utf8_lossy(&bytes[..e.valid_up_to()]), e.valid_up_to());
        SceneError::Syntax { line, column, message: "is not UTF-8 text".into() }
    })?;
    let mut scene = parse(text)?;
    let folder = path.parent().unwrap_or(Path::new(""));
    let beside = folder.join(&scene.character);
    // the built-in character lies nowhere, nor do objects
    if !scene.has_objects() && (scene.character != Path::new(crate::load::SAMPLE) || beside.exists()) {
        scene.character = beside;
    }
    if let Some(clip) = &mut scene.motion.clip
        && is_bvh(Path::new(clip))
    {
        // the name goes back into a string: a file name that is no text was refused above
        *clip = folder.join(&*clip).to_string_lossy().into_owned();
    }
    Ok(scene)
}

/// Whether a clip's name is that of a motion-capture file.
#[must_use]
pub fn is_bvh(path: &Path) -> bool {
    path.extension().is_some_and(|e| e.eq_ignore_ascii_case("bvh"))
}

/// Parses and checks the text of a scene file; paths stay as written.
///
/// # Errors
/// [`SceneError`] names the line, or the key, and what to change.
pub fn parse(text: &str) -> Result<Scene, SceneError> {
    let scene: Scene = toml::from_str(text).map_err(|e| {
        let (line, column) = place(text, e.span().map_or(0, |s| s.start));
        SceneError::Syntax { line, column, message: e.message().replace('\n', "; ") }
    })?;
    scene.check()?;
    Ok(scene)
}

/// Line and column, from 1, of a byte.
fn place(text: &str, byte: usize) -> (usize, usize) {
    let before: String = text.char_indices().take_while(|(i, _)| *i < byte).map(|(_, c)| c).collect();
    let line = before.matches('\n').count() + 1;
    let column = before.rsplit('\n').next().unwrap_or("").chars().count() + 1;
    (line, column)
}

impl Scene {
    /// Checks what the types cannot say.
    ///
    /// # Errors
    /// The first [`SceneError`] found, in the order of the file.
    pub fn check(&self) -> Result<(), SceneError> {
        self.check_objects()?;
        if self.character == PathBuf::new() && !self.has_objects() {
            return Err(SceneError::Value {
                key: "character".into(),
                value: "empty".into(),
                expected: "it must name a character file, or there must be an [[object]]",
            });
        }
        let positive = |key: &str, v: Option<f64>| within(key, v, f64::MIN_POSITIVE..=1e6, "it must be above 0");
        positive("import.height", self.import.height)?;
        positive("import.unit", self.import.unit)?;
        exclusive("import", ("height", self.import.height.is_some()), ("unit", self.import.unit.is_some()))?;
        let m = &self.motion;
        within("motion.fps", Some(m.fps), 0.1..=10_000.0, "it must be between 0.1 and 10000 frames per second")?;
        within("motion.speed", Some(m.speed), 1e-3..=1e3, "it must be between 0.001 and 1000")?;
        within("motion.preroll", Some(m.preroll), 0.0..=60.0, "it must be between 0 and 60 seconds")?;
        exclusive("body", ("cells", self.body.cells.is_some()), ("spacing", self.body.spacing.is_some()))?;
        let cells = self.body.cells.map(|n| n as f64);
        within("body.cells", cells, 1.0..=1e8, "it must be between 1 and 100000000")?;
        positive("body.spacing", self.body.spacing)?;
        let s = &self.simulation;
        within("simulation.tolerance", Some(s.tolerance), 1e-14..=0.5, "it must be between 1e-14 and 0.5")?;
        within("simulation.step", s.step, 1e-9..=1.0, "it must be between 1e-9 and 1 second")?;
        within("simulation.modes", Some(s.modes as f64), 1.0..=10_000.0, "it must be between 1 and 10000")?;
        for (axis, g) in ["x", "y", "z"].iter().zip(s.gravity) {
            let key = format!("simulation.gravity ({axis})");
            within(&key, Some(g), -1e4..=1e4, "it must be between -10000 and 10000 m/s2")?;
        }
        self.multigrid.check()?;
        let base = self.material.material();
        check_material("material", &base)?;
        if let Some(near) = self.material.near_bones {
            within("material.near_bones.factor", Some(near.factor), 1e-3..=1e6, "it must be between 0.001 and 1e6")?;
            positive("material.near_bones.radius", Some(near.radius))?;
        }
        for (i, region) in self.region.iter().enumerate() {
            region.check(i, base)?;
        }
        for bone in &self.bone {
            let key = format!("bone `{}`", bone.joint);
            positive(&format!("{key}: radius"), bone.radius)?;
            exclusive(&key, ("exclude", bone.exclude), ("whole", bone.whole))?;
            exclusive(&key, ("radius", bone.radius.is_some()), ("exclude or whole", bone.exclude || bone.whole))?;
        }
        within("coupling.drive", Some(self.coupling.drive), 0.0..=1.0, "it must be between 0 and 1")?;
        within("coupling.damping", Some(self.coupling.damping), 0.0..=1e12, "it must be 0 or more")?;
        for joint in &self.joint {
            let key = format!("joint `{}`", joint.joint);
            within(&format!("{key}: drive"), joint.drive, 0.0..=1.0, "it must be between 0 and 1")?;
        }
        if !(self.joint.is_empty() || self.coupling.two_way) {
            let text = "[[joint]] has no meaning while only the clip moves joints; set two_way = true under [coupling]";
            return Err(SceneError::Conflict(text.into()));
        }
        for (i, event) in self.event.iter().enumerate() {
            event.check(i)?;
        }
        if s.method != MethodName::Implicit && (self.coupling.two_way || !self.event.is_empty()) {
            let what = if self.coupling.two_way { "two_way = true under [coupling]" } else { "[[event]]" };
            let text = format!(
                "unsupported: {what} with the method `{}`; only `implicit` computes it: leave one of them out",
                s.method.name()
            );
            return Err(SceneError::Conflict(text));
        }
        Ok(())
    }
}

impl super::Region {
    fn check(&self, index: usize, base: Material) -> Result<(), SceneError> {
        let key = format!("region {}", index + 1);
        let chosen = [&self.look, &self.group, &self.bone].into_iter().flatten().count();
        if chosen != 1 {
            return Err(SceneError::Conflict(format!(
                "{key} must have exactly one of `look`, `group` and `bone`, it has {chosen}"
            )));
        }
        if self.threshold.is_some() && self.group.is_none() {
            return Err(SceneError::Conflict(format!("{key} has a `threshold`, which goes with `group` only")));
        }
        within(&format!("{key}: threshold"), self.threshold, -1e9..=1e9, "it must be a finite number")?;
        within(&format!("{key}: stiffness"), self.stiffness, 1e-6..=1e6, "it must be between 1e-6 and 1e6")?;
        check_material(&key, &self.material(base))
    }
}

fn check_material(key: &str, material: &Material) -> Result<(), SceneError> {
    material.check().map_err(|e| SceneError::Conflict(format!("{key}: {e}")))
}

pub(super) fn within(
    key: &str,
    value: Option<f64>,
    range: std::ops::RangeInclusive<f64>,
    expected: &'static str,
) -> Result<(), SceneError> {
    match value {
        // a NaN is in no range
        Some(v) if !range.contains(&v) => {
            Err(SceneError::Value { key: key.to_owned(), value: v.to_string(), expected })
        }
        _ => Ok(()),
    }
}

fn exclusive(section: &str, a: (&str, bool), b: (&str, bool)) -> Result<(), SceneError> {
    if a.1 && b.1 {
        return Err(SceneError::Conflict(format!("{section} has both `{}` and `{}`; keep one of them", a.0, b.0)));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn message(text: &str) -> String {
        parse(text).unwrap_err().to_string()
    }

    #[test]
    fn a_bare_character_is_a_scene() {
        let scene = parse("character = \"a.glb\"").unwrap();
        assert_eq!(scene, Scene { character: "a.glb".into(), ..Scene::default() });
    }

    #[test]
    fn an_unknown_key_is_named_with_its_line() {
        let m = message("character = \"a.glb\"\n[body]\ncels = 3\n");
        assert!(m.starts_with("line 3, column 1: unknown field `cels`, expected one of `cells`"), "{m}");
    }

    #[test]
    fn what_no_method_can_do_yet_is_unknown() {
        for section in ["collider", "pin", "limits"] {
            assert!(message(&format!("character = \"a\"\n[{section}]\n")).contains("unknown field"));
        }
    }

    #[test]
    fn values_out_of_range_are_named() {
        for (text, key) in [
            ("[motion]\nfps = 0.0", "motion.fps"),
            ("[motion]\nspeed = nan", "motion.speed"),
            ("[motion]\nframes = '5..2'", "holds no frame"),
            ("[body]\ncells = 10\nspacing = 0.1", "both `cells` and `spacing`"),
            ("[material]\npoisson_ratio = 0.6", "poisson_ratio is 0.6"),
            ("[[region]]\npreset = 'fat'", "exactly one of"),
            ("[[region]]\nlook = 'a'\nthreshold = 0.1", "goes with `group`"),
            ("[[bone]]\njoint = 'a'\nexclude = true\nwhole = true", "bone `a` has both"),
            ("[simulation]\ngravity = [0, -inf, 0]", "gravity"),
        ] {
            let m = message(&format!("character = \"a\"\n{text}\n"));
            assert!(m.contains(key), "{text}: {m}");
        }
    }
}
