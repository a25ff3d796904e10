//! The reference pages, generated from the code: `docs/cli.md`, `docs/scene.md`, `docs/scene.schema.json`, `docs/report.md`.
//! A test fails when they are stale; `UPDATE=1 cargo test --release -p softrig-cli docs` writes them.

use crate::args::Cli;
use crate::report::BakeReport;
use crate::scene::Scene;
use clap::CommandFactory;
use schemars::{JsonSchema, Schema, schema_for};
use serde_json::Value;
use std::fmt::Write;

/// Every generated page: its path in the repository, and its text.
#[must_use]
pub fn pages() -> Vec<(&'static str, String)> {
    vec![
        ("docs/cli.md", cli()),
        ("docs/scene.md", scene()),
        ("docs/scene.schema.json", schema::<Scene>()),
        ("docs/report.md", report()),
    ]
}

const GENERATED: &str = "<!-- generated from the code: UPDATE=1 cargo test --release -p softrig-cli docs -->\n";

/// The command line, as `--help` prints it.
fn cli() -> String {
    let mut out = format!("# softrig on the command line\n\n{GENERATED}");
    let mut command = Cli::command().term_width(110);
    command.build();
    help(&mut out, &mut command, "softrig");
    out
}

fn help(out: &mut String, command: &mut clap::Command, path: &str) {
    let text = command.render_long_help().to_string();
    let lines: Vec<_> = text.lines().map(str::trim_end).collect();
    let _ = write!(out, "\n## {path}\n\n```text\n{}\n```\n", lines.join("\n").trim_end());
    for sub in command.get_subcommands_mut().filter(|c| c.get_name() != "help") {
        let path = format!("{path} {}", sub.get_name());
        help(out, sub, &path);
    }
}

/// The keys of a scene file.
fn scene() -> String {
    let schema = schema_for!(Scene);
    let mut out = format!(
        "# Scene file\n\n{GENERATED}\nTOML, written next to the character. `softrig inspect --scene CHARACTER` prints one to start from, with the names the\n\
         character offers; `softrig bake ... --write-scene FILE` writes down the settings of a command line. What the command line\n\
         gives wins over the scene. An editor that knows JSON schemas completes it with `scene.schema.json`.\n"
    );
    let _ = write!(out, "\n{}\n", text(schema.as_value()));
    table(&mut out, &schema, schema.as_value());
    for (key, property) in properties(schema.as_value()) {
        let (title, target) = match &property["items"] {
            Value::Null => (format!("[{key}]"), resolve(&schema, property)),
            items => (format!("[[{key}]]"), resolve(&schema, items)),
        };
        if target["type"] == "object" {
            let _ = write!(out, "\n## `{title}`\n\n{}\n", text(property));
            table(&mut out, &schema, target);
        }
    }
    out
}

/// The keys of a bake's report.
fn report() -> String {
    let schema = schema_for!(BakeReport);
    let mut out = format!(
        "# Report of a bake\n\n{GENERATED}\n`softrig bake --report R.json` writes it, `--json` prints it. Keys are stable: they may be added to, never renamed.\n"
    );
    table(&mut out, &schema, schema.as_value());
    out
}

fn schema<T: JsonSchema>() -> String {
    let text = serde_json::to_string_pretty(&schema_for!(T)).expect("a schema is plain data");
    text + "\n"
}

/// One row for each plain key.
fn table(out: &mut String, root: &Schema, object: &Value) {
    let rows: Vec<_> = properties(object).filter(|(_, p)| !is_section(root, p)).collect();
    if rows.is_empty() {
        return;
    }
    out.push_str("\n| key | default | meaning |\n|---|---|---|\n");
    for (key, property) in rows {
        let mut meaning = text(property).replace('\n', " ");
        let target = resolve(root, property);
        for choice in target["oneOf"].as_array().into_iter().flatten() {
            let _ = write!(meaning, " `{}`: {}", plain(&choice["const"]), text(choice).replace('\n', " "));
        }
        let names: Vec<_> =
            target["enum"].as_array().into_iter().flatten().map(|c| format!("`{}`", plain(c))).collect();
        if !names.is_empty() {
            let _ = write!(meaning, " One of {}.", names.join(", "));
        }
        if target["type"] == "object" {
            for (field, p) in properties(target) {
                let _ = write!(meaning, " `{field}`: {}", text(p));
            }
        }
        let default = match &property["default"] {
            Value::Null => String::new(),
            v => format!("`{v}`"),
        };
        let _ = writeln!(out, "| `{key}` | {default} | {meaning} |");
    }
}

/// Whether a key of a scene has a heading of its own.
fn is_section(root: &Schema, property: &Value) -> bool {
    let list = property["items"]["$ref"].is_string();
    list || property["anyOf"].is_null() && resolve(root, property)["type"] == "object"
}

fn properties(object: &Value) -> impl Iterator<Item = (&String, &Value)> {
    object["properties"].as_object().into_iter().flatten()
}

fn text(schema: &Value) -> String {
    schema["description"].as_str().unwrap_or("").to_owned()
}

fn plain(value: &Value) -> String {
    value.as_str().map_or_else(|| value.to_string(), str::to_owned)
}

/// Follows a reference, also one that is optional.
pub(crate) fn resolve<'a>(root: &'a Schema, property: &'a Value) -> &'a Value {
    let target =
        property["anyOf"].as_array().and_then(|any| any.iter().find(|s| s["type"] != "null")).unwrap_or(property);
    match target["$ref"].as_str().and_then(|r| r.strip_prefix('#')) {
        Some(pointer) => root.as_value().pointer(pointer).unwrap_or(target),
        None => target,
    }
}
