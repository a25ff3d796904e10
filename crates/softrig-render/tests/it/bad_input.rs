//! Nothing that a scene can hold brings the rasteriser down.

use super::{WHITE, camera, draw, sphere, square};
use softrig_render::{Camera, Layer, Line, Point, RenderError, RenderMesh, Scene, Settings, render};

#[test]
fn triangles_at_numbers_that_are_not_finite_are_left_out() {
    let clean = draw(square(), &camera(6.0));
    for bad in [f64::NAN, f64::INFINITY, -1e300] {
        let mut mesh = square();
        mesh.positions.to_mut().push([0.0, bad, 0.0]);
        mesh.texture_coordinates.to_mut().push([f32::NAN; 2]);
        mesh.triangles.to_mut().push([0, 1, 4]);
        assert_eq!(clean, draw(mesh, &camera(6.0)), "{bad}");
    }
    let nowhere = [f64::NAN; 3];
    let scene = Scene {
        lines: vec![Line { ends: [nowhere, [0.0; 3]], color: [0.0; 3], width: f32::NAN, layer: Layer::Solid }],
        points: vec![Point { position: nowhere, color: [0.0; 3], radius: f32::INFINITY, layer: Layer::XRay }],
        ground: Some(f64::NAN),
        ..Scene::default()
    };
    assert!(render(&scene, &camera(6.0), &WHITE).unwrap().pixels.iter().all(|p| *p == [255; 3]));
}

#[test]
fn a_camera_inside_the_surface_sees_it_from_within() {
    let image = draw(RenderMesh { materials: super::unlit([0.0; 3]), ..sphere(2.0) }, &camera(1.0));
    assert!(image.pixels.iter().all(|p| *p == [0; 3]));
}

#[test]
fn impossible_sizes_cameras_and_meshes_are_refused() {
    let scene = Scene { meshes: vec![square()], ..Scene::default() };
    for (width, height, samples) in
        [(0, 10, 1), (10, 0, 1), (100_000, 10, 1), (10, 10, 0), (10, 10, 9), (u32::MAX, u32::MAX, 8)]
    {
        let settings = Settings { width, height, samples, ..WHITE };
        assert!(
            matches!(render(&scene, &camera(6.0), &settings), Err(RenderError::Size { .. })),
            "{width} {height} {samples}"
        );
    }
    for camera in [
        Camera { distance: 0.0, ..camera(1.0) },
        Camera { yaw: f64::NAN, ..camera(1.0) },
        Camera { field_of_view: 180.0, ..camera(1.0) },
    ] {
        assert!(matches!(render(&scene, &camera, &WHITE), Err(RenderError::Camera(_))), "{camera:?}");
    }
    let mut holes: Vec<RenderMesh<'_>> = vec![square(), square(), square(), square()];
    holes[0].triangles.to_mut().push([0, 1, 9]);
    holes[1].material = vec![0, 7].into();
    holes[2].colors = vec![[1.0; 4]; 3].into();
    holes[3].materials[0].texture = Some(0);
    for mesh in holes {
        let scene = Scene { meshes: vec![square(), mesh], ..Scene::default() };
        assert!(matches!(render(&scene, &camera(6.0), &WHITE), Err(RenderError::Mesh { mesh: 1, .. })));
    }
}

#[test]
fn an_empty_scene_is_the_background() {
    assert!(render(&Scene::default(), &camera(6.0), &WHITE).unwrap().pixels.iter().all(|p| *p == [255; 3]));
}
