#![no_main]
use libfuzzer_sys::fuzz_target;
use softrig_io::ImportOptions;
use softrig_io::surface::{SurfaceFormat, from_bytes};

fuzz_target!(|data: &[u8]| {
    if let Ok(character) = from_bytes(data, "fuzz".as_ref(), SurfaceFormat::Ply, &ImportOptions::default()) {
        let mesh = &character.meshes[0];
        assert!(mesh.triangles.iter().flatten().all(|v| (*v as usize) < mesh.positions.len()));
        assert!(mesh.positions.iter().flatten().all(|v| v.is_finite()));
    }
});
