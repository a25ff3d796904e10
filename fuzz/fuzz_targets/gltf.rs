#![no_main]
use libfuzzer_sys::fuzz_target;
use softrig_io::{ImportOptions, gltf};

fuzz_target!(|data: &[u8]| {
    // a file beside it is the second half of the data
    let mut beside = |_: &str| Ok(data[data.len() / 2..].to_vec());
    let Ok(c) = gltf::read_bytes(data, "fuzz".as_ref(), &mut beside, &ImportOptions::default()) else { return };
    for mesh in &c.meshes {
        let count = mesh.positions.len();
        assert!(mesh.positions.iter().flatten().all(|v| v.is_finite()));
        assert!(mesh.triangles.iter().flatten().all(|v| (*v as usize) < count));
        assert!(mesh.look.is_empty() || mesh.look.len() == mesh.triangles.len());
        assert!(mesh.look.iter().all(|l| (*l as usize) < c.looks.len()));
        assert!([0, count].contains(&mesh.texture_coordinates.len()));
        assert!([0, count].contains(&mesh.colors.len()));
        assert!(mesh.groups.iter().all(|(_, values)| values.len() == count));
        assert!(mesh.object.is_none_or(|o| o.index() < c.skeleton.joint_count()));
    }
    assert!(c.looks.iter().all(|l| l.texture.is_none_or(|t| t < c.textures.len())));
    assert!(c.skeleton.joints().iter().all(|j| j.rest.is_finite()));
    for clip in c.clips.iter().take(3) {
        let pose = c.skeleton.pose(&clip.sample(&c.skeleton, 0.5 * (clip.start + clip.end)));
        for mesh in 0..c.meshes.len().min(3) {
            // panics when a weight names no joint
            assert_eq!(c.blend_skin(mesh, &pose).len(), c.meshes[mesh].positions.len());
        }
    }
});
