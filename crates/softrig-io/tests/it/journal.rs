//! The journal: what was finished stays valid whatever happens after.

use crate::made;
use proptest::prelude::*;
use softrig::material::{Material, MaterialMap};
use softrig::mesh::VolumeMesh;
use softrig_io::journal::{
    Existing, JournalError, JournalFrame, JournalHeader, JournalReader, JournalVolume, JournalWriter, Tail,
    journal_path,
};
use std::fs;
use std::io::Cursor;
use std::path::{Path, PathBuf};

fn read(bytes: &[u8]) -> Result<JournalReader<Cursor<Vec<u8>>>, JournalError> {
    JournalReader::from_source(Cursor::new(bytes.to_vec()), Path::new("test"))
}

fn all_frames(reader: &mut JournalReader<Cursor<Vec<u8>>>) -> Vec<JournalFrame> {
    (0..reader.frame_count())
        .map(|i| {
            let mut frame = JournalFrame::default();
            reader.read_frame(i, &mut frame).unwrap();
            frame
        })
        .collect()
}

/// Bytes of a bake with a checkpoint after every second frame, and where each frame's record ends.
fn bake(frames: usize) -> (Vec<u8>, Vec<u64>) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("j");
    let character = made::one_mesh();
    let mut writer = JournalWriter::create(&path, made::header(&character, frames), Existing::Refuse).unwrap();
    let mut ends = Vec::new();
    run(&mut writer, 0, frames, |path| ends.push(fs::metadata(path).unwrap().len()));
    writer.finish().unwrap();
    (fs::read(&path).unwrap(), ends)
}

fn run(writer: &mut JournalWriter, from: usize, to: usize, mut after_frame: impl FnMut(&Path)) {
    let character = made::one_mesh();
    let path = writer.path().to_owned();
    for i in from..to {
        made::feed(writer, &character, i).unwrap();
        after_frame(&path);
        if i % 2 == 1 {
            writer.checkpoint(format!("state {i}").as_bytes()).unwrap();
        }
    }
}

#[test]
fn frames_come_back_as_they_went_in() {
    let (bytes, _) = bake(4);
    let mut reader = read(&bytes).unwrap();
    assert_eq!((reader.frame_count(), reader.tail()), (4, Tail::Finished));
    assert_eq!(reader.header(), &made::header(&made::one_mesh(), 4));
    let character = made::one_mesh();
    for (i, frame) in all_frames(&mut reader).iter().enumerate() {
        let pose = made::pose(&character, i);
        assert_eq!((frame.index, frame.time), (i, i as f64 / 24.0));
        assert_eq!(frame.pose, pose);
        let skin = character.blend_skin(0, &pose);
        assert_eq!(frame.skin[0], skin.iter().map(|p| p.map(|v| v as f32)).collect::<Vec<_>>());
        assert_eq!(frame.joint_force, [[1.0, 2.0, i as f32]; 3]);
        assert!(frame.nodes.is_empty(), "no volume was asked for");
    }
}

/// A tetrahedron and a hexahedron.
fn volume() -> JournalVolume {
    let mesh = VolumeMesh {
        nodes: (0..5).map(|i| [f64::from(i), 0.5, 1.0 / 3.0]).collect(),
        tets: vec![[0, 1, 2, 3]],
        hexes: vec![[0, 1, 2, 3, 4, 0, 1, 2]],
        region: vec![0, 1],
        region_names: vec!["belly".into(), "rest".into()],
        fill: vec![0.5, 1.0],
        lattice: None,
    };
    let materials =
        MaterialMap { materials: vec![Material::default()], of_cell: vec![0, 0], stiffness_factor: vec![1.0, 7.0] };
    JournalVolume { mesh, materials }
}

#[test]
fn a_volume_mesh_and_its_nodes_are_kept() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("j");
    let character = made::one_mesh();
    let volume = Some(volume());
    let header = JournalHeader { volume, ..made::header(&character, 1) };
    let mut writer = JournalWriter::create(&path, header.clone(), Existing::Refuse).unwrap();
    made::feed(&mut writer, &character, 0).unwrap();
    let mut reader = JournalReader::open(&path).unwrap();
    assert_eq!(reader.header(), &header);
    let mut frame = JournalFrame::default();
    reader.read_frame(0, &mut frame).unwrap();
    assert_eq!(frame.nodes, [[9.0; 3]; 5]);
}

/// Stresses are made of them: what no body takes never comes out as numbers.
#[test]
fn materials_that_no_body_takes_are_refused() {
    let changes: [fn(&mut JournalVolume); 4] = [
        |v| v.materials.materials[0].density = f64::NAN,
        |v| v.materials.materials[0].poisson_ratio = 0.5,
        |v| v.materials.stiffness_factor[1] = f32::INFINITY,
        |v| v.mesh.fill[0] = f32::NAN,
    ];
    for change in changes {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("j");
        let mut volume = volume();
        change(&mut volume);
        let header = JournalHeader { volume: Some(volume), ..made::header(&made::one_mesh(), 1) };
        // the writer reads its own header back
        let e = JournalWriter::create(&path, header, Existing::Refuse).unwrap_err();
        assert!(e.to_string().contains("materials or fills"), "{e}");
    }
}

/// Kill -9 can cut the file at any byte: every frame whose record ended before the cut is there, and nothing else is.
#[test]
fn cut_at_every_byte_it_keeps_what_was_finished() {
    let (bytes, ends) = bake(5);
    let whole = all_frames(&mut read(&bytes).unwrap());
    let mut readable = 0;
    for cut in 0..bytes.len() {
        let finished = ends.iter().filter(|end| **end <= cut as u64).count();
        match read(&bytes[..cut]) {
            Ok(mut reader) => {
                readable += 1;
                assert_ne!(reader.tail(), Tail::Finished);
                assert_eq!(all_frames(&mut reader), whole[..finished], "cut at {cut}");
            }
            Err(JournalError::NotAJournal { .. }) => assert_eq!(finished, 0),
            Err(e) => panic!("cut at {cut}: {e}"),
        }
    }
    assert!(readable > bytes.len() / 2);
}

/// A flipped bit ends the valid part at or before the frame it is in; frames before it are untouched.
#[test]
fn every_flipped_bit_is_seen() {
    let (bytes, ends) = bake(3);
    let whole = all_frames(&mut read(&bytes).unwrap());
    for at in 0..bytes.len() {
        for bit in 0..8 {
            let mut bad = bytes.clone();
            bad[at] ^= 1 << bit;
            match read(&bad) {
                Ok(mut reader) => {
                    assert_ne!(reader.tail(), Tail::Finished, "byte {at}");
                    let untouched = ends.iter().filter(|end| **end <= at as u64).count();
                    assert_eq!(all_frames(&mut reader), whole[..untouched], "byte {at}");
                }
                Err(JournalError::NotAJournal { .. } | JournalError::Version { .. }) => assert!((at as u64) < ends[0]),
                Err(e) => panic!("byte {at}: {e}"),
            }
        }
    }
}

/// Killed at any byte and resumed from its own checkpoint, a bake ends with the same bytes as one never interrupted.
#[test]
fn resumed_after_any_cut_it_ends_with_the_same_bytes() {
    let (bytes, _) = bake(5);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("j");
    let header = made::header(&made::one_mesh(), 5);
    let mut resumed = 0;
    for cut in (0..=bytes.len()).step_by(7).chain([bytes.len()]) {
        fs::write(&path, &bytes[..cut]).unwrap();
        let Ok((mut writer, point)) = JournalWriter::resume(&path, header.clone()) else { continue };
        resumed += 1;
        let from = point.checkpoint.as_ref().map_or(0, |c| {
            assert_eq!(c.state, format!("state {}", c.frames_done - 1).into_bytes());
            c.frames_done
        });
        assert!(from <= point.frames);
        if point.finished {
            assert_eq!(cut, bytes.len());
        } else {
            run(&mut writer, from, 5, |_| {});
            writer.finish().unwrap();
        }
        drop(writer);
        assert_eq!(fs::read(&path).unwrap(), bytes, "cut at {cut}");
    }
    assert!(resumed > 100, "{resumed}");
}

#[test]
fn resuming_with_other_inputs_says_which() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("j");
    let character = made::one_mesh();
    let header = made::header(&character, 3);
    drop(JournalWriter::create(&path, header.clone(), Existing::Refuse).unwrap());
    let before = fs::read(&path).unwrap();
    let e = JournalWriter::resume(&path, JournalHeader { input_hash: 1, ..header.clone() }).unwrap_err();
    assert!(e.to_string().contains("hash of inputs and settings differs"), "{e}");
    let e = JournalWriter::resume(&path, JournalHeader { fps: 30.0, ..header }).unwrap_err();
    assert!(e.to_string().contains("frames per second differs"), "{e}");
    assert_eq!(fs::read(&path).unwrap(), before);
}

#[test]
fn a_frame_computed_differently_after_resuming_is_refused() {
    let (bytes, ends) = bake(5);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("j");
    fs::write(&path, &bytes[..ends[0] as usize]).unwrap();
    let (mut writer, point) = JournalWriter::resume(&path, made::header(&made::one_mesh(), 5)).unwrap();
    assert_eq!((point.frames, point.checkpoint), (1, None));
    let mut other = made::one_mesh();
    other.meshes[0].positions[3][1] += 1e-3;
    assert!(matches!(made::feed(&mut writer, &other, 0), Err(JournalError::Diverged { frame: 0 })));
    made::feed(&mut writer, &made::one_mesh(), 0).unwrap();
}

#[test]
fn what_does_not_fit_is_refused_and_leaves_the_file_alone() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("j");
    let character = made::one_mesh();
    let mut writer = JournalWriter::create(&path, made::header(&character, 3), Existing::Refuse).unwrap();
    let before = fs::read(&path).unwrap();
    assert!(matches!(made::feed(&mut writer, &character, 1), Err(JournalError::Mismatch { .. })), "out of order");
    assert!(matches!(made::feed(&mut writer, &made::character(), 0), Err(JournalError::Mismatch { .. })));
    assert!(matches!(writer.finish(), Err(JournalError::Mismatch { .. })), "frames are missing");
    let mut broken = character.clone();
    broken.meshes[0].positions[0][0] = f64::NAN;
    assert!(matches!(made::feed(&mut writer, &broken, 0), Err(JournalError::NotFinite { frame: 0, .. })));
    assert_eq!(fs::read(&path).unwrap(), before);
    made::feed(&mut writer, &character, 0).unwrap();
}

#[test]
fn one_writer_at_a_time_and_no_silent_replacement() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("j");
    let header = || made::header(&made::one_mesh(), 3);
    let writer = JournalWriter::create(&path, header(), Existing::Refuse).unwrap();
    assert!(matches!(JournalWriter::resume(&path, header()), Err(JournalError::Busy { .. })));
    assert!(matches!(JournalWriter::create(&path, header(), Existing::Replace), Err(JournalError::Busy { .. })));
    drop(writer);
    assert!(matches!(JournalWriter::create(&path, header(), Existing::Refuse), Err(JournalError::Exists { .. })));
    JournalWriter::create(&path, header(), Existing::Replace).unwrap();
}

/// `/dev/full` takes no byte: the writer reports the machine's fault.
#[test]
fn an_unwritable_place_is_the_machines_fault() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("file");
    fs::write(&file, b"x").unwrap();
    let header = made::header(&made::one_mesh(), 3);
    let e = JournalWriter::create(&file.join("j"), header, Existing::Refuse).unwrap_err();
    assert!(e.is_machine_fault(), "{e}");
    assert_eq!(journal_path(Path::new("a/out.pc2")), PathBuf::from("a/out.pc2.softrig-journal"));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    /// Garbage of any kind is refused or read as far as it is valid; nothing panics and nothing is allocated for lengths that
    /// are only claimed.
    #[test]
    fn garbage_never_panics(
        bytes in prop::collection::vec(any::<u8>(), 0..200),
        cut in 0usize..4000,
        keep_front in any::<bool>(),
    ) {
        let (whole, _) = bake(3);
        let mut mixed = if keep_front { whole[..cut.min(whole.len())].to_vec() } else { Vec::new() };
        mixed.extend_from_slice(&bytes);
        if let Ok(mut reader) = read(&mixed) {
            let frames = all_frames(&mut reader);
            prop_assert!(frames.len() <= 3);
            reader.last_checkpoint().unwrap();
        }
    }
}
