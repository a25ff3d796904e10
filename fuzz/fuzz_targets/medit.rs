#![no_main]
use libfuzzer_sys::fuzz_target;
use softrig_io::volume::{VolumeFormat, from_bytes};

fuzz_target!(|data: &[u8]| {
    // an included file is the second half of the data
    let mut beside = |_: &str| Ok(data[data.len() / 2..].to_vec());
    if let Ok(mesh) = from_bytes(data, "fuzz".as_ref(), VolumeFormat::Medit, &mut beside) {
        assert!(mesh.cells().flatten().all(|n| (*n as usize) < mesh.node_count()));
        assert!(mesh.region.is_empty() || mesh.region.len() == mesh.cell_count());
        assert!(mesh.region.iter().all(|r| (*r as usize) < mesh.region_names.len()));
    }
});
