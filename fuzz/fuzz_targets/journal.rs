#![no_main]
use libfuzzer_sys::fuzz_target;
use softrig_io::journal::{JournalFrame, JournalReader};
use std::hash::Hasher;
use std::io::Cursor;
use twox_hash::XxHash64;

fuzz_target!(|data: &[u8]| {
    read(data);
    // checksums would stop every change at the door: the same bytes with the right ones go deeper
    read(&sealed(data));
});

fn read(data: &[u8]) {
    let Ok(mut journal) = JournalReader::from_source(Cursor::new(data), "fuzz".as_ref()) else { return };
    let header = journal.header().clone();
    if let Some(volume) = &header.volume {
        let mesh = &volume.mesh;
        assert!(mesh.cells().flatten().all(|n| (*n as usize) < mesh.node_count()));
        assert!((0..mesh.cell_count()).all(|c| volume.materials.get(c).young_modulus.is_finite()));
    }
    let mut frame = JournalFrame::default();
    for index in 0..journal.frame_count() {
        if journal.read_frame(index, &mut frame).is_err() {
            continue;
        }
        let sizes = header.meshes.iter().map(|m| m.vertex_count as usize);
        assert!(frame.skin.iter().map(Vec::len).eq(sizes));
        assert!(frame.skin.iter().flatten().chain(&frame.nodes).flatten().all(|v| v.is_finite()));
        assert_eq!(frame.pose.world.len(), header.joint_count as usize);
        assert_eq!(frame.joint_force.len(), header.joint_count as usize);
        assert_eq!(frame.nodes.len(), header.volume.as_ref().map_or(0, |v| v.mesh.node_count()));
    }
    let checkpoint = journal.last_checkpoint().expect("bytes in memory can be read");
    assert!(checkpoint.is_none_or(|c| c.frames_done <= journal.frame_count()));
}

/// The same bytes as a journal whose records reach no farther than the file and have the checksums they must have.
fn sealed(data: &[u8]) -> Vec<u8> {
    let mut out = data.to_vec();
    let (prefix, head) = (12, 20);
    if out.len() < prefix {
        return out;
    }
    out[..8].copy_from_slice(b"softrigJ");
    out[8..12].copy_from_slice(&1u32.to_le_bytes());
    let mut at = prefix;
    while at + head <= out.len() {
        let payload = at + head;
        let mut length = [0; 8];
        length.copy_from_slice(&out[at + 4..at + 12]);
        let length = u64::from_le_bytes(length).min((out.len() - payload) as u64);
        let end = payload + length as usize;
        out[at + 4..at + 12].copy_from_slice(&length.to_le_bytes());
        // as the format says: kind, length, payload
        let mut hasher = XxHash64::with_seed(0);
        hasher.write(&out[at..at + 12]);
        hasher.write(&out[payload..end]);
        out[at + 12..payload].copy_from_slice(&hasher.finish().to_le_bytes());
        at = end;
    }
    out
}
