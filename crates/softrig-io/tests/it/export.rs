//! Exports: read back by independent routes, and harmless when they fail.

use crate::made;
use softrig::character::Character;
use softrig_io::export::{ExportError, ExportOptions, Format, PointCache, write};
use softrig_io::journal::Existing;
use std::fs;
use std::path::Path;

fn options() -> ExportOptions {
    ExportOptions::default()
}

fn replace() -> ExportOptions {
    ExportOptions { existing: Existing::Replace, ..options() }
}

/// Points of each frame by plain arithmetic on the bytes, for either byte order.
fn points_of(bytes: &[u8], start: usize, points: usize, frame: usize, big: bool) -> Vec<[f32; 3]> {
    let number = |i: usize| {
        let at = start + 4 * i;
        let b = [bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]];
        if big { f32::from_be_bytes(b) } else { f32::from_le_bytes(b) }
    };
    (0..points).map(|p| std::array::from_fn(|k| number(3 * (frame * points + p) + k))).collect()
}

/// Placing cached points with the object's frame gives the skin in the world: the definition of the local space.
fn assert_is_skin(character: &Character, mesh: usize, frame: usize, points: &[[f32; 3]]) {
    let pose = made::pose(character, frame);
    let object = character.meshes[mesh].object.map_or(*character.skeleton.to_world(), |j| *pose.joint(j));
    let skin = character.blend_skin(mesh, &pose);
    assert_eq!(points.len(), skin.len());
    for (p, expected) in points.iter().zip(&skin) {
        let got = object.point(p.map(f64::from));
        // two roundings to f32 of numbers up to 2 m
        assert!((0..3).all(|k| (got[k] - expected[k]).abs() < 1e-6), "{got:?} {expected:?}");
    }
}

#[test]
fn pc2_is_the_documented_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let character = made::one_mesh();
    let mut journal = made::journal(folder.path(), &character, 4);
    let out = folder.path().join("out.pc2");
    let report = write(&mut journal, &character, Format::from_path(&out).unwrap(), &out, &options()).unwrap();
    assert_eq!((report.frames, report.files), (4, vec![out.clone()]));
    let bytes = fs::read(&out).unwrap();
    assert_eq!(&bytes[..12], b"POINTCACHE2\0");
    let word = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap());
    assert_eq!([word(12), word(16), word(20), word(24), word(28)], [1, 12, 0, 1f32.to_bits(), 4]);
    assert_eq!(bytes.len(), 32 + 4 * 12 * 12);
    for frame in 0..4 {
        assert_is_skin(&character, 0, frame, &points_of(&bytes, 32, 12, frame, false));
    }
}

#[test]
fn several_meshes_make_a_folder_of_mdd_files() {
    let folder = tempfile::tempdir().unwrap();
    let character = made::character();
    let mut journal = made::journal(folder.path(), &character, 3);
    let out = folder.path().join("out.mdd");
    let report = write(&mut journal, &character, Format::Mdd, &out, &options()).unwrap();
    let names = ["Arm.mdd", "Prop_1.mdd", "Stone.mdd"];
    assert_eq!(report.files, names.map(|n| out.join(n)));
    for (mesh, file) in report.files.iter().enumerate() {
        let bytes = fs::read(file).unwrap();
        let points = character.meshes[mesh].positions.len();
        let word = |at: usize| u32::from_be_bytes(bytes[at..at + 4].try_into().unwrap());
        assert_eq!([word(0), word(4)], [3, points as u32]);
        let times: Vec<f32> = (0..3).map(|k| f32::from_bits(word(8 + 4 * k))).collect();
        assert_eq!(times, [0.0, 1.0 / 24.0, 2.0 / 24.0]);
        assert_eq!(bytes.len(), 8 + 12 + 3 * points * 12);
        for frame in 0..3 {
            assert_is_skin(&character, mesh, frame, &points_of(&bytes, 20, points, frame, true));
        }
    }
    // rigid parts stand still in the space of the node that carries them
    let mut prop = PointCache::open(&out.join("Prop_1.mdd")).unwrap();
    let (mut first, mut last) = (Vec::new(), Vec::new());
    prop.read_frame(0, &mut first).unwrap();
    prop.read_frame(2, &mut last).unwrap();
    let most = first.iter().flatten().fold(0f32, |m, v| m.max(v.abs()));
    assert!(most > 1.0, "in centimetres");
    for (a, b) in first.iter().flatten().zip(last.iter().flatten()) {
        assert!((a - b).abs() < 1e-5 * most);
    }
}

#[test]
fn caches_read_back_and_refuse_every_cut() {
    let folder = tempfile::tempdir().unwrap();
    let character = made::one_mesh();
    let mut journal = made::journal(folder.path(), &character, 3);
    for (name, fps) in [("a.pc2", None), ("a.mdd", Some(24.0))] {
        let out = folder.path().join(name);
        write(&mut journal, &character, Format::from_path(&out).unwrap(), &out, &options()).unwrap();
        let mut cache = PointCache::open(&out).unwrap();
        assert_eq!((cache.point_count(), cache.frame_count()), (12, 3));
        assert_eq!(cache.fps().map(|f| (f * 1e3f64).round() / 1e3), fps);
        let mut points = Vec::new();
        for frame in 0..3 {
            cache.read_frame(frame, &mut points).unwrap();
            assert_is_skin(&character, 0, frame, &points);
        }
        assert!(cache.read_frame(3, &mut points).is_err());
        let bytes = fs::read(&out).unwrap();
        for cut in 0..bytes.len() {
            let source = std::io::Cursor::new(&bytes[..cut]);
            assert!(PointCache::from_source(source, Path::new("cut")).is_err(), "{name} cut at {cut}");
        }
    }
    // counts that only claim to be large allocate nothing
    let mut huge = b"POINTCACHE2\0\x01\0\0\0\xff\xff\xff\x7f".to_vec();
    huge.extend_from_slice(&[0, 0, 0, 0, 0, 0, 128, 63, 255, 255, 255, 127]);
    assert!(PointCache::from_source(std::io::Cursor::new(huge), Path::new("huge")).is_err());
}

/// A torn journal exports the frames it has.
#[test]
fn a_killed_bake_can_be_exported() {
    let folder = tempfile::tempdir().unwrap();
    let character = made::one_mesh();
    let path = made::journal(folder.path(), &character, 4).path().to_owned();
    let bytes = fs::read(&path).unwrap();
    fs::write(&path, &bytes[..bytes.len() * 3 / 4]).unwrap();
    let mut torn = softrig_io::journal::JournalReader::open(&path).unwrap();
    let out = folder.path().join("out.pc2");
    let report = write(&mut torn, &character, Format::Pc2, &out, &options()).unwrap();
    assert!((1..4).contains(&report.frames));
    assert_eq!(PointCache::open(&out).unwrap().frame_count(), report.frames);
}

#[test]
fn what_is_there_stays_unless_it_is_to_be_replaced() {
    let folder = tempfile::tempdir().unwrap();
    let (one, many) = (made::one_mesh(), made::character());
    let mut journal = made::journal(folder.path(), &one, 2);
    let out = folder.path().join("out.pc2");
    fs::write(&out, b"precious").unwrap();
    assert!(matches!(write(&mut journal, &one, Format::Pc2, &out, &options()), Err(ExportError::Exists { .. })));
    // another character is noticed before anything is touched
    assert!(matches!(
        write(&mut journal, &many, Format::Pc2, &out, &replace()),
        Err(ExportError::OtherCharacter { .. })
    ));
    assert_eq!(fs::read(&out).unwrap(), b"precious");
    write(&mut journal, &one, Format::Pc2, &out, &replace()).unwrap();
    assert_eq!(PointCache::open(&out).unwrap().frame_count(), 2);

    // a folder is replaced only when softrig wrote everything in it
    let mut journal = made::journal(folder.path(), &many, 2);
    let out = folder.path().join("all.pc2");
    fs::create_dir(&out).unwrap();
    fs::write(out.join("old.pc2"), b"old").unwrap();
    fs::write(out.join("thesis.doc"), b"precious").unwrap();
    let e = write(&mut journal, &many, Format::Pc2, &out, &replace()).unwrap_err();
    assert!(matches!(&e, ExportError::ForeignFolder { file, .. } if file == "thesis.doc"), "{e}");
    fs::remove_file(out.join("thesis.doc")).unwrap();
    write(&mut journal, &many, Format::Pc2, &out, &replace()).unwrap();
    assert!(!out.join("old.pc2").exists() && out.join("Arm.pc2").exists());
    // nothing temporary is left behind
    let left: Vec<_> = fs::read_dir(folder.path()).unwrap().map(|e| e.unwrap().file_name()).collect();
    assert!(left.iter().all(|n| !n.to_string_lossy().starts_with(".softrig-")), "{left:?}");
}

#[test]
fn an_unwritable_place_is_the_machines_fault() {
    let folder = tempfile::tempdir().unwrap();
    for character in [made::one_mesh(), made::character()] {
        let mut journal = made::journal(folder.path(), &character, 2);
        let file = folder.path().join("file");
        fs::write(&file, b"x").unwrap();
        let e = write(&mut journal, &character, Format::Pc2, &file.join("out.pc2"), &replace()).unwrap_err();
        assert!(e.is_machine_fault(), "{e}");
        assert_eq!(fs::read(&file).unwrap(), b"x");
    }
}

#[test]
fn unknown_endings_name_an_alternative() {
    for name in ["a.usdc", "a.abc", "a.fbx", "a.bvh.txt"] {
        let e = Format::from_path(Path::new(name)).unwrap_err();
        assert!(e.to_string().contains("use "), "{e}");
    }
}

/// A GLB file taken apart by hand.
struct Glb {
    json: serde_json::Value,
    bytes: Vec<u8>,
}

impl Glb {
    fn open(path: &Path) -> Self {
        let file = fs::read(path).unwrap();
        let word = |at: usize| u32::from_le_bytes(file[at..at + 4].try_into().unwrap()) as usize;
        assert_eq!((&file[..4], word(4), word(8)), (&b"glTF"[..], 2, file.len()));
        let length = word(12);
        let json = serde_json::from_slice(&file[20..20 + length]).unwrap();
        assert_eq!(word(20 + length), file.len() - 28 - length);
        Self { json, bytes: file[28 + length..].to_vec() }
    }

    /// All numbers of an accessor, which are floats.
    fn floats(&self, accessor: &serde_json::Value) -> Vec<f64> {
        let a = &self.json["accessors"][accessor.as_u64().unwrap() as usize];
        assert_eq!(a["componentType"], 5126);
        let view = &self.json["bufferViews"][a["bufferView"].as_u64().unwrap() as usize];
        let offset = |v: &serde_json::Value| v["byteOffset"].as_u64().unwrap_or(0) as usize;
        let rank = ["SCALAR", "VEC2", "VEC3", "VEC4"].iter().position(|t| a["type"] == **t).unwrap() + 1;
        let start = offset(view) + offset(a);
        let count = rank * a["count"].as_u64().unwrap() as usize;
        (0..count)
            .map(|i| f64::from(f32::from_le_bytes(self.bytes[start + 4 * i..start + 4 * i + 4].try_into().unwrap())))
            .collect()
    }

    fn vectors(&self, accessor: &serde_json::Value) -> Vec<[f64; 3]> {
        self.floats(accessor).chunks_exact(3).map(|v| [v[0], v[1], v[2]]).collect()
    }

    /// Keys of a node's animation, one row for each frame.
    fn keys(&self, node: usize, path: &str, frames: usize) -> Option<Vec<Vec<f64>>> {
        let animation = &self.json["animations"][0];
        let channel = animation["channels"]
            .as_array()?
            .iter()
            .find(|c| c["target"]["node"] == node && c["target"]["path"] == path)?;
        let sampler = &animation["samplers"][channel["sampler"].as_u64().unwrap() as usize];
        assert_eq!(self.floats(&sampler["input"]).len(), frames);
        let numbers = self.floats(&sampler["output"]);
        Some(numbers.chunks_exact(numbers.len() / frames).map(<[f64]>::to_vec).collect())
    }
}

/// Largest distance of what a glTF viewer would show from the blended skin, over all meshes and frames [m].
fn glb_error(glb: &Glb, character: &Character, skin: impl Fn(usize, usize) -> Vec<[f64; 3]>, frames: usize) -> f64 {
    let mut worst = 0.0f64;
    for (node, mesh) in character.meshes.iter().enumerate() {
        let entry = &glb.json["nodes"][node];
        assert_eq!(entry["name"], mesh.name.as_str());
        let weights = glb.keys(node, "weights", frames);
        let still = |path: &str| {
            vec![entry[path].as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect::<Vec<_>>(); frames]
        };
        let moves = |path: &str| glb.keys(node, path, frames).unwrap_or_else(|| still(path));
        let mut lowest = Vec::new();
        for look in 0..2u32 {
            let triangles = mesh.triangles.iter().zip(mesh.look.iter().copied().chain(std::iter::repeat(0)));
            lowest.extend(triangles.filter(|(_, l)| *l == look).flat_map(|(t, _)| *t).min());
        }
        let primitives = glb.json["meshes"][entry["mesh"].as_u64().unwrap() as usize]["primitives"].as_array().unwrap();
        assert_eq!(primitives.len(), lowest.len());
        for (primitive, first) in primitives.iter().zip(lowest) {
            let base = glb.vectors(&primitive["attributes"]["POSITION"]);
            let empty = Vec::new();
            let targets: Vec<_> =
                primitive["targets"].as_array().unwrap_or(&empty).iter().map(|t| glb.vectors(&t["POSITION"])).collect();
            for frame in 0..frames {
                let expected = skin(node, frame);
                for (v, p) in base.iter().enumerate() {
                    let shown = match &weights {
                        Some(w) => {
                            assert!(w[frame].iter().all(|w| (0.0..=1.0).contains(w)), "engines clamp weights");
                            let offset =
                                |k: usize| -> f64 { w[frame].iter().zip(&targets).map(|(w, t)| w * t[v][k]).sum() };
                            [p[0] + offset(0), p[1] + offset(1), p[2] + offset(2)]
                        }
                        None => {
                            let (t, r, s) =
                                (&moves("translation")[frame], &moves("rotation")[frame], &moves("scale")[frame]);
                            let transform = softrig::rig::Transform {
                                translation: [t[0], t[1], t[2]],
                                rotation: [r[0], r[1], r[2], r[3]],
                                scale: [s[0], s[1], s[2]],
                            };
                            transform.to_affine().point(*p)
                        }
                    };
                    let q = expected[first as usize + v];
                    worst = worst.max((0..3).map(|k| (shown[k] - q[k]).powi(2)).sum::<f64>().sqrt());
                }
            }
        }
    }
    worst
}

/// What a viewer computes from the file is the skin, to the error that the report claims. A part that hangs on one joint is a
/// node that turns, unless its joint shears, which no glTF node can.
#[test]
fn glb_shows_the_motion() {
    let folder = tempfile::tempdir().unwrap();
    for (scale, turns) in [([2.0; 3], true), ([2.0, 3.0, 0.5], false)] {
        let character = made::character_with_scale(scale);
        let mut journal = made::journal(folder.path(), &character, 9);
        let out = folder.path().join("out.glb");
        let report = write(&mut journal, &character, Format::Glb, &out, &replace()).unwrap();
        let glb = Glb::open(&out);
        let skin = |mesh: usize, frame: usize| character.blend_skin(mesh, &made::pose(&character, frame));
        let fit = report.morphs.unwrap();
        let error = glb_error(&glb, &character, skin, 9) / character.height();
        // rigid parts are right to 1e-4 of the height, the rest is rounding of f32 sums
        assert!(error <= fit.error.max(1e-4) + 1e-6, "{error} {fit:?}");
        assert!(fit.error <= fit.tolerance && fit.needed <= fit.used && fit.used <= 9, "{fit:?}");
        assert!(glb.keys(0, "weights", 9).is_some(), "the arm bends");
        assert_eq!(glb.keys(1, "rotation", 9).is_some(), turns);
        assert!(glb.keys(2, "weights", 9).is_none() && glb.keys(2, "rotation", 9).is_none(), "the stone stands still");
        let arm = &glb.json["meshes"][0]["primitives"];
        assert!(arm[0]["attributes"]["TEXCOORD_0"].is_u64() && arm[0]["attributes"]["COLOR_0"].is_u64());
        assert_eq!(glb.json["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"]["index"], 0);
        assert_eq!(glb.json["images"][0]["mimeType"], "image/png");
    }
}

/// A motion of mean and three independent shapes needs four morph targets: that many show it, fewer do not, and the report of
/// the shorter one names the number that does.
#[test]
fn morphs_that_do_not_suffice_say_how_many_do() {
    let folder = tempfile::tempdir().unwrap();
    let mut character = made::one_mesh();
    character.meshes[0].look.clear();
    let frames = 30;
    let skin = |frame: usize| -> Vec<[f64; 3]> {
        let shape =
            |k: usize, v: usize| [((k + 1) * v) as f64 % 0.7, ((k + 2) * v * v) as f64 % 0.3, 0.1 * (k * v) as f64];
        let weight = |k: usize| 0.3 * ((k + 1) as f64 * 0.2 * frame as f64).sin();
        let rest = character.meshes[0].positions.iter().enumerate();
        rest.map(|(v, p)| std::array::from_fn(|c| p[c] + 0.5 + (0..3).map(|k| weight(k) * shape(k, v)[c]).sum::<f64>()))
            .collect()
    };
    let path = folder.path().join("j");
    let header = made::header(&character, frames);
    let mut writer = softrig_io::journal::JournalWriter::create(&path, header, Existing::Refuse).unwrap();
    let pose = made::pose(&character, 0);
    for index in 0..frames {
        let skin = [skin(index)];
        let force = [[0.0; 3]; 3];
        let frame =
            softrig::frame::Frame { index, time: 0.0, skin: &skin, pose: &pose, nodes: &[], joint_force: &force };
        softrig::frame::FrameSink::frame(&mut writer, &frame).unwrap();
    }
    let mut journal = softrig_io::journal::JournalReader::open(&path).unwrap();
    let out = folder.path().join("out.glb");
    let mut fit = |morphs: usize| {
        let options = ExportOptions { morphs, ..replace() };
        let fit = write(&mut journal, &character, Format::Glb, &out, &options).unwrap().morphs.unwrap();
        let error = glb_error(&Glb::open(&out), &character, |_, frame| skin(frame), frames) / character.height();
        assert!((error - fit.error).abs() < 1e-5, "claimed {} but {error}", fit.error);
        fit
    };
    let short = fit(2);
    assert!(short.error > short.tolerance && short.used == 2 && short.needed == 4, "{short:?}");
    let enough = fit(short.needed);
    assert!(enough.error < 1e-6 && enough.used == 4, "{enough:?}");
    assert_eq!(fit(64).used, 4);
}

#[test]
fn usda_holds_points_and_extent_over_time() {
    let folder = tempfile::tempdir().unwrap();
    let character = made::character();
    let mut journal = made::journal(folder.path(), &character, 3);
    let out = folder.path().join("out.usda");
    write(&mut journal, &character, Format::Usda, &out, &options()).unwrap();
    let text = fs::read_to_string(&out).unwrap();
    for line in
        ["upAxis = \"Y\"", "metersPerUnit = 1", "endTimeCode = 2", "timeCodesPerSecond = 24", "def Mesh \"Prop_1\""]
    {
        assert!(text.contains(line), "{line}");
    }
    let mut samples = text.lines().filter_map(|l| l.trim().strip_prefix("2: ["));
    for mesh in 0..3 {
        let numbers: Vec<f64> =
            samples.next().unwrap().split(|c: char| "(), ]".contains(c)).filter_map(|n| n.parse().ok()).collect();
        let skin = character.blend_skin(mesh, &made::pose(&character, 2));
        assert_eq!(numbers.len(), 3 * skin.len());
        assert!(numbers.iter().zip(skin.as_flattened()).all(|(a, b)| (a - b).abs() < 1e-6));
        let extent: Vec<f64> =
            samples.next().unwrap().split(|c: char| "(), ]".contains(c)).filter_map(|n| n.parse().ok()).collect();
        let y = skin.iter().map(|p| p[1]);
        assert!((extent[1] - y.clone().fold(f64::INFINITY, f64::min)).abs() < 1e-6);
        assert!((extent[4] - y.fold(f64::NEG_INFINITY, f64::max)).abs() < 1e-6);
    }
}

/// OBJ and PLY series stand in the units and axes of the file: centimetres and Z up here.
#[test]
fn series_hold_every_vertex_of_every_frame() {
    let folder = tempfile::tempdir().unwrap();
    let character = made::character();
    let mut journal = made::journal(folder.path(), &character, 3);
    let to_file = character.skeleton.to_world().inverse().unwrap();
    let expected: Vec<[f64; 3]> =
        (0..3).flat_map(|m| character.blend_skin(m, &made::pose(&character, 2))).map(|p| to_file.point(p)).collect();
    let close = |points: &[f64]| {
        assert_eq!(points.len(), 3 * expected.len());
        // f32 of up to 300 cm
        assert!(points.iter().zip(expected.as_flattened()).all(|(a, b)| (a - b).abs() < 1e-4));
    };

    let out = folder.path().join("frames");
    let format = Format::from_path(&out).unwrap();
    let report = write(&mut journal, &character, format, &out, &options()).unwrap();
    assert_eq!(report.files.len(), 3);
    let text = fs::read_to_string(out.join("frame_0002.obj")).unwrap();
    let points: Vec<f64> = text
        .lines()
        .filter_map(|l| l.strip_prefix("v "))
        .flat_map(|l| l.split(' '))
        .map(|n| n.parse().unwrap())
        .collect();
    close(&points);
    assert_eq!(text.lines().filter(|l| l.starts_with("f ")).count(), 10 + 4 + 2);
    assert!(text.contains("usemtl look_1") && text.contains("f 13 14 15"), "later meshes count on");
    assert!(fs::read_to_string(out.join("materials.mtl")).unwrap().contains("map_Kd texture_0.png"));
    assert_eq!(&fs::read(out.join("texture_0.png")).unwrap()[1..4], b"PNG");

    let out = folder.path().join("ply");
    write(&mut journal, &character, Format::PlySeries, &out, &options()).unwrap();
    let bytes = fs::read(out.join("frame_0002.ply")).unwrap();
    let head = b"end_header\n";
    let start = bytes.windows(head.len()).position(|w| w == head).unwrap() + head.len();
    let floats = bytes[start..start + 12 * expected.len()].chunks_exact(4);
    close(&floats.map(|b| f64::from(f32::from_le_bytes(b.try_into().unwrap()))).collect::<Vec<_>>());
    assert_eq!(bytes.len(), start + 12 * expected.len() + 13 * (10 + 4 + 2));
}

/// A cube stretched by a tenth along x, exported with its stress and read back as a mesh.
#[test]
fn vtu_series_hold_the_deformed_cells() {
    use softrig_io::journal::{JournalHeader, JournalReader, JournalVolume, JournalWriter};
    let folder = tempfile::tempdir().unwrap();
    let character = made::one_mesh();
    let corner = |i: usize| [((i % 4 == 1) || (i % 4 == 2)) as u8, (i % 4 >= 2) as u8, (i >= 4) as u8].map(f64::from);
    let mesh = softrig::mesh::VolumeMesh {
        nodes: (0..8).map(corner).collect(),
        hexes: vec![[0, 1, 2, 3, 4, 5, 6, 7]],
        ..softrig::mesh::VolumeMesh::default()
    };
    let materials = softrig::material::MaterialMap::uniform(softrig::material::Material::default());
    let stretched: Vec<[f64; 3]> = mesh.nodes.iter().map(|p| [1.1 * p[0], p[1], p[2]]).collect();
    let volume = Some(JournalVolume { mesh, materials });
    let path = folder.path().join("j");
    let header = JournalHeader { volume, ..made::header(&character, 1) };
    let mut writer = JournalWriter::create(&path, header, Existing::Refuse).unwrap();
    let pose = made::pose(&character, 0);
    let skin = [character.blend_skin(0, &pose)];
    let frame = softrig::frame::Frame {
        index: 0,
        time: 0.0,
        skin: &skin,
        pose: &pose,
        nodes: &stretched,
        joint_force: &[[0.0; 3]; 3],
    };
    softrig::frame::FrameSink::frame(&mut writer, &frame).unwrap();
    let mut journal = JournalReader::open(&path).unwrap();
    let out = folder.path().join("out.vtu");
    let report = write(&mut journal, &character, Format::from_path(&out).unwrap(), &out, &options()).unwrap();
    let file = folder.path().join("out_vtu/frame_0000.vtu");
    assert_eq!(report.files, [folder.path().join("out.pvd"), file.clone()]);
    assert!(
        fs::read_to_string(&report.files[0])
            .unwrap()
            .contains("timestep=\"0\" part=\"0\" file=\"out_vtu/frame_0000.vtu\"")
    );
    let bytes = fs::read(&file).unwrap();
    // (lambda + 2 mu) e along x, and its difference from the lateral lambda e
    let m = softrig::material::Material::default();
    let holds = |v: f64| {
        let near = |b: &[u8]| (f64::from_le_bytes(b.try_into().unwrap()) / v - 1.0).abs() < 1e-5;
        bytes.windows(8).any(near)
    };
    assert!(holds(0.1 * (m.lambda() + 2.0 * m.shear_modulus())) && holds(0.1 * 2.0 * m.shear_modulus()));
    assert!(holds(f64::from(1.1f32)), "positions and volume ratio");
    // without nodes in the journal there is nothing to write
    let mut plain = made::journal(folder.path(), &character, 1);
    assert!(matches!(
        write(&mut plain, &character, Format::Vtu, &out, &replace()),
        Err(ExportError::Unsupported { .. })
    ));
}
