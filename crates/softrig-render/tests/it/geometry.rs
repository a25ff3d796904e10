//! Where things land in the picture, against closed forms.

use super::{WHITE, camera, draw, sphere, square, unlit};
use softrig::character::Texture;
use softrig_render::{Layer, Line, Material, Point, RenderMesh, Scene, render};

/// A sphere of radius R at distance d is seen as a circle of radius f R / sqrt(d² - R²).
#[test]
fn a_sphere_covers_the_area_of_its_outline() {
    let image = draw(RenderMesh { materials: unlit([0.0; 3]), ..sphere(0.8) }, &camera(5.0));
    let focal = 80.0 / 15f64.to_radians().tan();
    let radius = focal * 0.8 / (25.0f64 - 0.64).sqrt();
    // linear light of a pixel is its uncovered part
    let light = |level: u8| {
        let c = f64::from(level) / 255.0;
        if c <= 0.04045 { c / 12.92 } else { ((c + 0.055) / 1.055).powf(2.4) }
    };
    let area: f64 = image.pixels.iter().map(|p| 1.0 - light(p[0])).sum();
    let expected = std::f64::consts::PI * radius * radius;
    assert!((area / expected - 1.0).abs() < 0.004, "{area} against {expected}");
}

/// Neighbouring triangles leave no gap: every pixel inside the outline is black. And none is drawn twice: glass of one half
/// over white is the same grey everywhere.
#[test]
fn triangles_share_edges_without_gap_or_overlap() {
    let focal = 80.0 / 15f64.to_radians().tan();
    let radius = focal * 0.8 / (25.0f64 - 0.64).sqrt();
    for (layer, level) in [(Layer::Solid, 0u8), (Layer::Glass(0.5), 188)] {
        let image = draw(RenderMesh { materials: unlit([0.0; 3]), layer, ..sphere(0.8) }, &camera(5.0));
        let mut inside = 0;
        for y in 0..160u32 {
            for x in 0..200u32 {
                let (dx, dy) = (f64::from(x) + 0.5 - 100.0, f64::from(y) + 0.5 - 80.0);
                if dx.hypot(dy) < radius - 1.5 {
                    assert!(
                        image.pixel(x, y)[0].abs_diff(level) <= 1,
                        "{layer:?} at {x}, {y}: {:?}",
                        image.pixel(x, y)
                    );
                    inside += 1;
                }
            }
        }
        assert!(inside > 5000);
    }
}

/// The key light comes from the upper left: that side of a grey ball is the bright one, and the ball has no sharp steps.
#[test]
fn light_falls_from_the_upper_left() {
    let image = draw(RenderMesh { materials: vec![Material::default()], ..sphere(0.8) }, &camera(5.0));
    let at = |x, y| image.pixel(x, y)[1];
    assert!(at(80, 60) > at(100, 80) && at(100, 80) > at(122, 102), "{} {} {}", at(80, 60), at(100, 80), at(122, 102));
    for x in 65..135 {
        assert!(at(x, 80).abs_diff(at(x + 1, 80)) < 12, "step at {x}");
    }
}

/// Upper left red, upper right green, lower left blue, lower right yellow: as stored, row by row from the top.
#[test]
fn texture_stands_upright() {
    let (r, g, b, y) = ([255, 0, 0, 255], [0, 255, 0, 255], [0, 0, 255, 255], [255, 255, 0, 255]);
    let textures = [Texture { width: 2, height: 2, rgba: vec![r, g, b, y] }];
    let mesh = RenderMesh { materials: vec![Material { texture: Some(0), ..unlit([1.0; 3])[0] }], ..square() };
    let scene = Scene { meshes: vec![mesh], textures: &textures, ..Scene::default() };
    let image = render(&scene, &camera(6.0), &WHITE).unwrap();
    // the middles of the four texels, where nothing is mixed in
    for (x, y, c) in [(75, 55, r), (125, 55, g), (75, 105, b), (125, 105, y)] {
        let p = image.pixel(x, y);
        assert!((0..3).all(|k| p[k].abs_diff(c[k]) <= 40), "{x} {y}: {p:?} for {c:?}");
    }
}

/// The middle of a square that leans away is in the middle of the picture; without perspective correction its texture would say
/// that the middle is elsewhere.
#[test]
fn texture_follows_perspective() {
    let (black, white) = ([0, 0, 0, 255], [255; 4]);
    // sharp enough that bilinear mixing is within a pixel
    let row: Vec<[u8; 4]> = (0..256).map(|i| if i < 128 { black } else { white }).collect();
    let textures = [Texture { width: 256, height: 1, rgba: row }];
    let mesh = RenderMesh { materials: vec![Material { texture: Some(0), ..unlit([1.0; 3])[0] }], ..square() };
    let scene = Scene { meshes: vec![mesh], textures: &textures, ..Scene::default() };
    let image = render(&scene, &softrig_render::Camera { yaw: 65.0, ..camera(4.0) }, &WHITE).unwrap();
    let change = (0..199).find(|x| image.pixel(*x, 80)[0] < 128 && image.pixel(x + 1, 80)[0] >= 128).unwrap();
    assert!((98..=101).contains(&change), "{change}");
}

#[test]
fn the_nearer_surface_hides_the_other() {
    let far = RenderMesh { materials: unlit([1.0, 0.0, 0.0]), ..square() };
    let mut near = RenderMesh { materials: unlit([0.0, 1.0, 0.0]), ..square() };
    near.positions.to_mut().iter_mut().for_each(|p| p[2] += 0.01);
    for meshes in [vec![far.clone(), near.clone()], vec![near.clone(), far.clone()]] {
        let image = render(&Scene { meshes, ..Scene::default() }, &camera(6.0), &WHITE).unwrap();
        assert_eq!(image.pixel(100, 80), [0, 255, 0]);
    }
    // unless the far one is seen through everything
    let meshes = vec![near, RenderMesh { layer: Layer::XRay, ..far }];
    assert_eq!(
        render(&Scene { meshes, ..Scene::default() }, &camera(6.0), &WHITE).unwrap().pixel(100, 80),
        [255, 0, 0]
    );
}

/// Widths of lines and radii of points are pixels, whatever the distance.
#[test]
fn marks_keep_their_size() {
    for distance in [3.0, 30.0] {
        let lines = vec![Line {
            ends: [[0.0, -20.0, 0.0], [0.0, 20.0, 0.0]],
            color: [0.0; 3],
            width: 6.0,
            layer: Layer::Solid,
        }];
        let image = render(&Scene { lines, ..Scene::default() }, &camera(distance), &WHITE).unwrap();
        assert_eq!((0..200).filter(|x| image.pixel(*x, 80)[0] < 128).count(), 6, "line from {distance} m");
        let points = vec![Point { position: [0.0; 3], color: [0.0, 0.0, 0.02], radius: 10.0, layer: Layer::XRay }];
        let image = render(&Scene { points, ..Scene::default() }, &camera(distance), &WHITE).unwrap();
        let dark = (0..200).filter(|x| image.pixel(*x, 80)[0] < 128).count();
        assert!((18..=20).contains(&dark), "{dark} pixels of a point from {distance} m");
    }
}
