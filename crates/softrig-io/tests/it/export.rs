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
    ExportOptions { existing: Existing::Replace }
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
