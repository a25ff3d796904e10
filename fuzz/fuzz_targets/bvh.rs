#![no_main]
use libfuzzer_sys::fuzz_target;
use softrig_io::bvh::{BvhOptions, from_bytes, to_text};

fuzz_target!(|data: &[u8]| {
    if let Ok(bvh) = from_bytes(data, "fuzz".as_ref(), &BvhOptions::default()) {
        let pose = bvh.skeleton.pose(&bvh.clip.sample(&bvh.skeleton, bvh.clip.end));
        assert_eq!(pose.world.len(), bvh.skeleton.joint_count());
        if bvh.frame_count < 50 {
            let _ = to_text(&bvh.skeleton, &bvh.clip, bvh.frame_time);
        }
    }
});
