//! A scene file to start from: every setting with what it means, those at their default commented out.

use super::Scene;
use crate::docs::resolve;
use schemars::Schema;
use serde_json::Value;
use softrig::character::Character;
use std::fmt::Write;

/// The text of a scene file with the settings of `scene`, every one explained, and the names that `character` offers.
#[must_use]
pub fn template(scene: &Scene, character: Option<&Character>) -> String {
    let schema = schemars::schema_for!(Scene);
    let mut out = String::from(
        "# A softrig scene: bake it with `softrig bake FILE.toml -o OUT`. docs/scene.md explains every key.\n",
    );
    if let Some(character) = character {
        names(&mut out, character);
    }
    let defaults = json(&Scene::default());
    section(&mut out, &schema, schema.as_value(), "", &json(scene), &defaults);
    for (name, text) in lists(&schema) {
        let empty = json(scene).get(&name).is_none();
        if empty {
            let _ = write!(out, "\n{text}");
        } else {
            let rest = Value::Object([(name.clone(), json(scene)[&name].clone())].into_iter().collect());
            let _ = write!(out, "\n{}", toml::to_string(&rest).expect("a scene is plain data"));
        }
    }
    out
}

fn json(scene: &Scene) -> Value {
    serde_json::to_value(scene).expect("a scene is plain data")
}

/// What the scene can refer to.
fn names(out: &mut String, character: &Character) {
    let list = |names: Vec<&str>| if names.is_empty() { "none".to_owned() } else { names.join(", ") };
    let groups = character.meshes.iter().flat_map(|m| &m.groups).map(|g| g.0.as_str());
    let mut groups: Vec<_> = groups.collect();
    groups.sort_unstable();
    groups.dedup();
    for (what, names) in [
        ("clips", character.clips.iter().map(|c| c.name.as_str()).collect()),
        ("meshes", character.meshes.iter().map(|m| m.name.as_str()).collect()),
        ("looks", character.looks.iter().map(|l| l.name.as_str()).collect()),
        ("groups", groups),
        ("joints", character.skeleton.joints().iter().map(|j| j.name.as_str()).collect::<Vec<_>>()),
    ] {
        // a name with a line break would end the comment
        let _ = writeln!(out, "# {what}: {}", list(names).replace(['\n', '\r'], " "));
    }
}

/// One table: plain keys first, then the tables in it.
fn section(out: &mut String, root: &Schema, table: &Value, path: &str, values: &Value, defaults: &Value) {
    let Some(properties) = table["properties"].as_object() else { return };
    for (key, property) in properties {
        if is_table(root, property) || property["items"]["$ref"].is_string() {
            continue;
        }
        comment(out, property);
        let value = values.get(key).filter(|v| !v.is_null());
        let default = defaults.get(key).filter(|v| !v.is_null());
        match value {
            Some(v) if Some(v) != default => _ = writeln!(out, "{key} = {}", toml_value(v)),
            Some(v) => _ = writeln!(out, "# {key} = {}", toml_value(v)),
            None => _ = writeln!(out, "# {key} ="),
        }
    }
    for (key, property) in properties {
        if !is_table(root, property) {
            continue;
        }
        let path = if path.is_empty() { key.clone() } else { format!("{path}.{key}") };
        out.push('\n');
        comment(out, property);
        let _ = writeln!(out, "[{path}]");
        section(out, root, resolve(root, property), &path, &values[key], &defaults[key]);
    }
}

/// Whether a key is written as a table of its own; an optional one is written on one line.
fn is_table(root: &Schema, property: &Value) -> bool {
    resolve(root, property)["type"] == "object" && !property["anyOf"].is_array()
}

fn comment(out: &mut String, property: &Value) {
    for line in property["description"].as_str().unwrap_or("").lines() {
        let _ = writeln!(out, "# {line}");
    }
}

/// The lists of tables, each as a commented example.
fn lists(root: &Schema) -> Vec<(String, String)> {
    let mut out = Vec::new();
    for (key, property) in root.as_value()["properties"].as_object().into_iter().flatten() {
        if property["type"] != "array" {
            continue;
        }
        let mut text = String::new();
        comment(&mut text, property);
        let _ = writeln!(text, "# [[{key}]]");
        let item = resolve(root, &property["items"]);
        for (field, property) in item["properties"].as_object().into_iter().flatten() {
            let _ = writeln!(
                text,
                "# {field} =    # {}",
                property["description"].as_str().unwrap_or("").replace('\n', " ")
            );
        }
        out.push((key.clone(), text));
    }
    out
}

fn toml_value(value: &Value) -> String {
    match value {
        Value::Null => String::new(),
        // TOML's own form: strings with backslashes, arrays, exponents
        other => toml::Value::try_from(other).map_or_else(|_| other.to_string(), |v| v.to_string()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::read::parse;

    #[test]
    fn the_template_of_a_scene_reads_back_as_that_scene() {
        let mut scene = Scene { character: "a b\\c.glb".into(), ..Scene::default() };
        assert_eq!(parse(&template(&scene, None)).unwrap(), scene);
        scene.motion.fps = 24.0;
        scene.motion.sag = false;
        scene.body.cells = Some(500);
        scene.simulation.gravity = [0.0, 1.5, 0.0];
        scene.material.near_bones = Some(super::super::NearBones { factor: 4.0, radius: 0.05 });
        scene.region.push(super::super::Region {
            bone: Some("head".into()),
            stiffness: Some(3.0),
            ..Default::default()
        });
        scene.rigid.push(super::super::Rigid { mesh: "eye".into(), joint: "head".into() });
        let text = template(&scene, None);
        assert_eq!(parse(&text).unwrap(), scene, "{text}");
    }
}
