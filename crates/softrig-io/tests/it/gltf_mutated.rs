//! Good glTF files with a few random changes: each ends in a sound character or an error.
//!
//! Changes are made where they reach deep: to values of the JSON (indices, sizes, names) and to bytes of the buffers. The fuzz
//! target `gltf` goes on from here with coverage.

use base64::Engine;
use serde_json::{Value, json};
use softrig::character::Character;
use softrig_io::{ImportOptions, gltf};
use std::path::Path;
use std::time::{Duration, Instant};

struct Random(u64);

impl Random {
    /// Below `n`, by xorshift.
    fn below(&mut self, n: usize) -> usize {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 >> 11) as usize % n.max(1)
    }
}

/// Changes one value somewhere below `value`.
fn change(value: &mut Value, random: &mut Random) {
    let inside = match value {
        Value::Array(a) => a.len(),
        Value::Object(o) => o.len(),
        _ => 0,
    };
    if inside > 0 && random.below(12) > 0 {
        let at = random.below(inside);
        return match value {
            Value::Array(a) => change(&mut a[at], random),
            Value::Object(o) => change(o.values_mut().nth(at).unwrap(), random),
            _ => unreachable!(),
        };
    }
    match value {
        Value::Array(a) if !a.is_empty() && random.below(3) > 0 => {
            let (from, to) = (random.below(a.len()), random.below(a.len()));
            match random.below(3) {
                0 => a.swap(from, to),
                1 => a.push(a[from].clone()),
                _ => drop(a.remove(from)),
            }
        }
        Value::Object(o) if !o.is_empty() && random.below(3) > 0 => {
            let key = o.keys().nth(random.below(o.len())).unwrap().clone();
            o.remove(&key);
        }
        Value::Number(n) => {
            let n = n.as_f64().unwrap();
            *value = [
                json!(n + 1.0),
                json!((n as i64) + 1),
                json!((n as i64) - 1),
                json!(random.below(8)),
                json!(0),
                json!(-n),
                json!(n * 1e5),
                json!(1e308),
                json!(5120 + random.below(8)),
                json!(u32::MAX),
                json!(u64::MAX),
            ][random.below(11)]
            .clone();
        }
        Value::String(s) if s.len() < 100 => {
            let words =
                ["SCALAR", "VEC2", "VEC3", "VEC4", "MAT4", "scale", "rotation", "STEP", "CUBICSPLINE", "", "POSITION"];
            *value = json!(words[random.below(words.len())]);
        }
        _ => *value = [Value::Null, json!(1), json!([]), json!({}), json!(true), json!("")][random.below(6)].clone(),
    }
}

/// JSON with every buffer as a data URI.
fn open(path: &Path) -> Value {
    let bytes = std::fs::read(path).unwrap();
    let mut json: Value;
    if bytes.starts_with(b"glTF") {
        let length = u32::from_le_bytes(bytes[12..16].try_into().unwrap()) as usize;
        json = serde_json::from_slice(&bytes[20..20 + length]).unwrap();
        embed(&mut json["buffers"][0], &bytes[28 + length..]);
    } else {
        json = serde_json::from_slice(&bytes).unwrap();
    }
    json
}

fn embed(buffer: &mut Value, bytes: &[u8]) {
    let data = base64::engine::general_purpose::STANDARD.encode(bytes);
    buffer["uri"] = json!(format!("data:;base64,{data}"));
}

fn check(c: &Character) {
    for (m, mesh) in c.meshes.iter().enumerate() {
        let count = mesh.positions.len();
        assert!(mesh.positions.iter().flatten().all(|v| v.is_finite()));
        assert!(mesh.triangles.iter().flatten().all(|v| (*v as usize) < count));
        assert!(mesh.look.iter().all(|l| (*l as usize) < c.looks.len()));
        assert!(mesh.groups.iter().all(|(_, values)| values.len() == count));
        for clip in c.clips.iter().take(2) {
            let pose = c.skeleton.pose(&clip.sample(&c.skeleton, 0.5 * (clip.start + clip.end)));
            assert_eq!(c.blend_skin(m, &pose).len(), count);
        }
    }
    assert!(c.skeleton.joints().iter().all(|j| j.rest.is_finite()));
}

/// `SOFTRIG_MUTATIONS` sets how many files are made (default 3000, a second or two).
#[test]
fn changed_files_end_in_a_sound_character_or_an_error() {
    let Some(data) = crate::shared::data() else { return };
    let wanted = std::env::var("SOFTRIG_MUTATIONS").ok().and_then(|n| n.parse().ok()).unwrap_or(3000);
    let good =
        ["characters/SimpleSkin.gltf", "characters/quad_skin_10_influences.glb", "bad/gltf/unassigned-skeleton.gltf"];
    let good = good.map(|name| open(&data.file(name)));
    let (mut random, mut sound) = (Random(0x9e37_79b9_7f4a_7c15), 0);
    for i in 0..wanted {
        let mut file = good[i % good.len()].clone();
        for _ in 0..random.below(3) {
            change(&mut file, &mut random);
        }
        let buffers = file["buffers"].as_array().map_or(0, Vec::len);
        if buffers > 0 && random.below(2) == 0 {
            let buffer = &mut file["buffers"][random.below(buffers)];
            let old = buffer["uri"].as_str().and_then(|u| u.split_once("base64,")).map(|(_, data)| data.to_owned());
            let bytes = old.and_then(|d| base64::engine::general_purpose::STANDARD.decode(d).ok());
            if let Some(mut bytes) = bytes.filter(|b| !b.is_empty()) {
                for _ in 0..=random.below(4) {
                    let at = random.below(bytes.len());
                    bytes[at] = [0, 1, 0x7f, 0x80, 0xff, random.below(256) as u8][random.below(6)];
                }
                embed(buffer, &bytes);
            }
        }
        let text = serde_json::to_vec(&file).unwrap();
        let read = || {
            let mut none = |_: &str| Err("there is none".into());
            let start = Instant::now();
            let result = gltf::read_bytes(&text, Path::new("changed.gltf"), &mut none, &ImportOptions::default());
            (result, start.elapsed())
        };
        let (result, mut took) = read();
        // a busy machine may take the processor away once, not every time
        for _ in 0..5 {
            if took > Duration::from_secs(2) {
                took = took.min(read().1);
            }
        }
        assert!(took < Duration::from_secs(2), "slow: {}", String::from_utf8_lossy(&text));
        match result {
            Ok(c) => {
                check(&c);
                sound += 1;
            }
            Err(e) => assert!(!e.to_string().contains('\n'), "{e}"),
        }
    }
    // both ends are reached, or nothing was tried
    assert!(sound > wanted / 10 && sound < wanted, "{sound} of {wanted}");
    if wanted > 3000 {
        use std::io::Write;
        let _ = writeln!(std::io::stderr(), "{sound} of {wanted} changed files were sound");
    }
}
