//! Holds the sources to the table of ARCHITECTURE.md: an import goes down, never up, and `unsafe` stays on the lowest floor.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

/// Rooms of the core crate that share a floor but must not see each other: (who, whom).
const STRANGERS: [(&str, &str); 6] = [
    ("rig", "mesh"),
    ("mesh", "rig"),
    ("force", "rig"),
    ("integrate", "rig"),
    ("constraint", "rig"),
    ("material", "rig"),
];

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

/// Floor of every crate, and of every room of the crates that have several floors, from the table.
struct Floors {
    crates: BTreeMap<String, Vec<u32>>,
    rooms: BTreeMap<String, u32>,
}

impl Floors {
    fn read(table: &str) -> Self {
        let (mut crates, mut rooms) = (BTreeMap::<String, Vec<u32>>::new(), BTreeMap::new());
        for line in table.lines() {
            let cells: Vec<_> = line.split('|').map(str::trim).collect();
            let [_, floor, names, what, _] = cells[..] else { continue };
            let Ok(floor) = floor.parse::<u32>() else { continue };
            let name = names.split('`').nth(1).expect("a crate in backticks").replace('-', "_");
            if name == "softrig" {
                // the names before the first explanation
                let list = what.split([':', ';']).next().unwrap_or_default();
                rooms.extend(list.split('`').skip(1).step_by(2).map(|room| (room.to_owned(), floor)));
            }
            crates.entry(name).or_default().push(floor);
        }
        Self { crates, rooms }
    }

    fn lowest(&self, name: &str) -> u32 {
        *self.crates[name].iter().min().unwrap_or_else(|| panic!("{name} is in no row"))
    }
}

/// Source text without comments, strings and character literals.
fn code_of(source: &str) -> String {
    let s: Vec<char> = source.chars().collect();
    let (mut out, mut i) = (String::new(), 0);
    let starts = |i: usize, text: &str| text.chars().enumerate().all(|(k, c)| s.get(i + k) == Some(&c));
    while i < s.len() {
        if starts(i, "//") {
            i += s[i..].iter().position(|c| *c == '\n').unwrap_or(s.len() - i);
        } else if starts(i, "/*") {
            i += 2;
            while i < s.len() && !starts(i, "*/") {
                i += 1;
            }
            i += 2;
        } else if s[i] == 'r' && (starts(i, "r\"") || starts(i, "r#")) && (i == 0 || !s[i - 1].is_alphanumeric()) {
            let hashes = s[i + 1..].iter().take_while(|c| **c == '#').count();
            if s.get(i + 1 + hashes) != Some(&'"') {
                out.push(s[i]);
                i += 1;
                continue;
            }
            let end = format!("\"{}", "#".repeat(hashes));
            i += 2 + hashes;
            while i < s.len() && !starts(i, &end) {
                i += 1;
            }
            i += end.len();
        } else if s[i] == '"' {
            i += 1;
            while i < s.len() && s[i] != '"' {
                i += if s[i] == '\\' { 2 } else { 1 };
            }
            i += 1;
        } else if s[i] == '\'' && s.get(i + 1) == Some(&'\\') {
            i += 3;
            while i < s.len() && s[i] != '\'' {
                i += 1;
            }
            i += 1;
        } else if s[i] == '\'' && s.get(i + 2) == Some(&'\'') {
            i += 3;
        } else {
            out.push(s[i]);
            i += 1;
        }
    }
    out
}

fn words(code: &str) -> impl Iterator<Item = &str> {
    code.split(|c: char| !c.is_alphanumeric() && c != '_').filter(|w| !w.is_empty())
}

/// First names after every `prefix::`, also those of a braced list right behind it.
fn names_after<'a>(code: &'a str, prefix: &str) -> Vec<&'a str> {
    let mut out = Vec::new();
    for (at, found) in code.match_indices(prefix) {
        let before = code[..at].chars().next_back();
        if before.is_some_and(|c| c.is_alphanumeric() || c == '_' || c == ':') {
            continue;
        }
        let rest = code[at + found.len()..].trim_start();
        let Some(list) = rest.strip_prefix('{') else {
            out.extend(words(rest).next());
            continue;
        };
        let mut depth = 0;
        let mut fresh = true;
        for (k, c) in list.char_indices() {
            match c {
                '}' if depth == 0 => break,
                '{' => depth += 1,
                '}' => depth -= 1,
                ',' if depth == 0 => fresh = true,
                c if fresh && (c.is_alphanumeric() || c == '_') => {
                    fresh = false;
                    out.extend(words(&list[k..]).next());
                }
                _ => {}
            }
        }
    }
    out
}

/// What a source file must not do. `inside` is its path from the crate's `src`.
fn faults(floors: &Floors, name: &str, inside: &Path, source: &str) -> Vec<String> {
    let code = code_of(source);
    let mut faults = Vec::new();
    let room = inside.iter().next().and_then(|p| Path::new(p).file_stem()).and_then(|s| s.to_str()).unwrap_or("");
    let floor = match floors.rooms.get(room) {
        Some(floor) if name == "softrig" => *floor,
        _ => floors.lowest(name),
    };
    for other in floors.crates.keys().filter(|other| *other != name) {
        let seen = !names_after(&code, &format!("{other}::")).is_empty();
        if seen && floors.lowest(other) >= floor {
            faults.push(format!("sees the crate {other}, which is not below it"));
        }
    }
    if name == "softrig" {
        // `super` repeated up to the root of the crate is the same as `crate`
        let depth = inside.iter().count() - usize::from(inside.ends_with("mod.rs"));
        let to_root = "super::".repeat(depth.max(1));
        let mut seen = names_after(&code, "crate::");
        if depth > 1 || room == "lib" {
            seen.extend(names_after(&code, &to_root));
        }
        for other in seen {
            let higher = floors.rooms.get(other).is_some_and(|f| *f > floor);
            if room != "lib" && (higher || STRANGERS.contains(&(room, other))) {
                faults.push(format!("room {room} sees room {other}"));
            }
        }
    }
    if name != "softrig_linalg" && words(&code).any(|w| w == "unsafe") {
        faults.push("has unsafe code".into());
    }
    faults
}

fn sources(folder: &Path, out: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).expect("a folder of sources") {
        let path = entry.expect("a source").path();
        if path.is_dir() {
            sources(&path, out);
        } else if path.extension().is_some_and(|e| e == "rs") {
            out.push(path);
        }
    }
}

fn floors() -> Floors {
    Floors::read(&fs::read_to_string(root().join("ARCHITECTURE.md")).expect("the table"))
}

#[test]
fn imports_go_down() {
    let floors = floors();
    let mut all = Vec::new();
    let mut seen = 0;
    for entry in fs::read_dir(root().join("crates")).unwrap() {
        let folder = entry.unwrap().path();
        let name = folder.file_name().unwrap().to_str().unwrap().replace('-', "_");
        assert!(floors.crates.contains_key(&name), "{name} is not in the table of ARCHITECTURE.md");
        let mut files = Vec::new();
        sources(&folder.join("src"), &mut files);
        files.sort();
        for file in files {
            seen += 1;
            let inside = file.strip_prefix(folder.join("src")).unwrap();
            let source = fs::read_to_string(&file).unwrap();
            all.extend(
                faults(&floors, &name, inside, &source).iter().map(|f| format!("{name}/{}: {f}", inside.display())),
            );
        }
    }
    assert!(seen > 40, "only {seen} sources found");
    assert!(all.is_empty(), "{}", all.join("\n"));
}

#[test]
fn every_room_of_the_core_is_in_the_table() {
    let floors = floors();
    let lib = fs::read_to_string(root().join("crates/softrig/src/lib.rs")).unwrap();
    for room in names_after(&code_of(&lib).replace("mod ", "mod::"), "mod::") {
        assert!(floors.rooms.contains_key(room), "room {room} is not in the table of ARCHITECTURE.md");
    }
}

#[test]
fn dependencies_go_down() {
    let floors = floors();
    for name in floors.crates.keys() {
        let file = root().join("crates").join(name.replace('_', "-")).join("Cargo.toml");
        let manifest: toml::Table = fs::read_to_string(&file).unwrap().parse().unwrap();
        for other in manifest["dependencies"].as_table().unwrap().keys().map(|k| k.replace('-', "_")) {
            let below = !floors.crates.contains_key(&other) || floors.lowest(&other) < floors.lowest(name);
            assert!(below, "{name} depends on {other}");
        }
    }
}

/// The checks above would find what they look for.
#[test]
fn what_goes_up_is_found() {
    let floors = floors();
    let of = |name: &str, file: &str, source: &str| faults(&floors, name, Path::new(file), source).len();
    assert_eq!(of("softrig", "mesh/weld.rs", "use crate::rig::Pose;"), 1);
    assert_eq!(of("softrig", "mesh/weld.rs", "use crate::{mesh::A, rig::{Pose, Clip}};"), 1);
    assert_eq!(of("softrig", "mesh/weld.rs", "use super::super::rig::Pose;"), 1);
    assert_eq!(of("softrig", "mesh/voxel/cut.rs", "use super::super::super::couple::Binding;"), 1);
    assert_eq!(of("softrig", "force/hex.rs", "fn f() { crate::character::Character::new(); }"), 1);
    assert_eq!(of("softrig", "couple/mod.rs", "use crate::{mesh, rig}; use softrig_linalg::Scalar;"), 0);
    assert_eq!(of("softrig", "couple/mod.rs", "use softrig_io::import;"), 1);
    assert_eq!(of("softrig_io", "lib.rs", "use softrig_render::picture;"), 1);
    assert_eq!(of("softrig", "integrate/mod.rs", "use softrig_explicit::scheme::Scheme;"), 1);
    assert_eq!(of("softrig_explicit", "stepper.rs", "use softrig::integrate::State;"), 0);
    assert_eq!(of("softrig_explicit", "stepper.rs", "use softrig_io::journal;"), 1);
    assert_eq!(of("softrig_linalg", "lib.rs", "use softrig::mesh; unsafe {}"), 1);
    assert_eq!(of("softrig_cli", "lib.rs", "unsafe {}"), 1);
    let quiet = "// crate::rig unsafe\n/* unsafe */ const A: &str = \"unsafe \\\" crate::rig\"; const B: &str = r#\"unsafe\"#; const C: char = '\"';";
    assert_eq!(of("softrig", "mesh/weld.rs", quiet), 0);
}
