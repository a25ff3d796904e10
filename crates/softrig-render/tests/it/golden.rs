//! The sample character against a stored picture.

use softrig_render::{Camera, Settings, View, character_scene, render};

/// The picture is the same everywhere up to the last bits of the platform's mathematics: a few pixels at edges may differ.
/// `SOFTRIG_BLESS=1` stores a new one; look at it first.
#[test]
fn the_sample_looks_as_it_did() {
    let character = softrig::sample::character();
    let skin: Vec<_> = character.meshes.iter().map(|m| m.positions.clone()).collect();
    let scene = character_scene(&character, &skin);
    let settings = Settings { width: 180, height: 220, samples: 3, ..Settings::default() };
    let camera = Camera::framing(scene.bounds(), View::ThreeQuarter, &settings);
    let picture = render(&scene, &camera, &settings).unwrap();
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/golden/sample.png");
    if std::env::var_os("SOFTRIG_BLESS").is_some() {
        picture.write_png(path).unwrap();
    }
    let stored = image::open(path).unwrap().to_rgb8();
    assert_eq!(stored.dimensions(), (picture.width, picture.height));
    let far = |p: &[u8; 3], q: &[u8]| (0..3).any(|k| p[k].abs_diff(q[k]) > 2);
    let differ = picture.pixels.iter().zip(stored.as_raw().chunks(3)).filter(|(p, q)| far(p, q)).count();
    assert!(
        differ * 500 < picture.pixels.len(),
        "{differ} of {} pixels differ by more than two levels",
        picture.pixels.len()
    );
}
