#![no_main]
use libfuzzer_sys::fuzz_target;
use softrig_io::volume::{VolumeFormat, from_bytes};

fuzz_target!(|data: &[u8]| {
    // nodes, a zero byte, cells
    let split = data.iter().position(|b| *b == 0).unwrap_or(data.len());
    let cells = data.get(split + 1..).unwrap_or_default().to_vec();
    let mut beside = |_: &str| Ok(cells.clone());
    if let Ok(mesh) = from_bytes(&data[..split], "fuzz.node".as_ref(), VolumeFormat::TetgenNodes, &mut beside) {
        assert!(mesh.cells().flatten().all(|n| (*n as usize) < mesh.node_count()));
    }
});
