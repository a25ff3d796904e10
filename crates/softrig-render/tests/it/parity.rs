//! The same picture whatever the machine is doing.

use softrig_render::{Camera, Settings, View, character_scene, render};

#[test]
fn any_number_of_threads_gives_the_same_picture() {
    let character = softrig::sample::character();
    let skin: Vec<_> = character.meshes.iter().map(|m| m.positions.clone()).collect();
    let scene = character_scene(&character, &skin);
    let settings = Settings { width: 150, height: 170, ..Settings::default() };
    let camera = Camera::framing(scene.bounds(), View::ThreeQuarter, &settings);
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| render(&scene, &camera, &settings).unwrap())
    };
    let one = with(1);
    let colours: std::collections::BTreeSet<_> = one.pixels.iter().collect();
    assert!(colours.len() > 500, "something was drawn");
    for threads in [2, 3, 8] {
        assert_eq!(one, with(threads), "{threads} threads");
    }
}
