#![no_main]
use libfuzzer_sys::fuzz_target;
use softrig_io::export::PointCache;
use std::io::Cursor;

fuzz_target!(|data: &[u8]| {
    let Ok(mut cache) = PointCache::from_source(Cursor::new(data), "fuzz".as_ref()) else { return };
    // what is claimed is there
    let bytes = cache.point_count() as u128 * cache.frame_count() as u128 * 12;
    assert!(bytes <= data.len() as u128);
    assert!(cache.fps().is_none_or(|f| f.is_finite() && f > 0.0));
    let mut points = Vec::new();
    for frame in 0..cache.frame_count().min(100) {
        if cache.read_frame(frame, &mut points).is_ok() {
            assert_eq!(points.len(), cache.point_count());
            assert!(points.iter().flatten().all(|v| v.is_finite()));
        }
    }
    assert!(cache.read_frame(cache.frame_count(), &mut points).is_err());
});
