//! Pictures against closed forms, across threads, on bad input, and on disk.

mod bad_input;
mod files;
mod geometry;
mod golden;
mod parity;

use softrig_render::{Camera, Image, Material, RenderMesh, Scene, Settings, render};

/// White all round, so that whatever is drawn stands out.
const WHITE: Settings = Settings { width: 200, height: 160, samples: 4, background: [[255; 3]; 3] };

fn unlit(color: [f32; 3]) -> Vec<Material> {
    vec![Material { base_color: [color[0], color[1], color[2], 1.0], unlit: true, ..Material::default() }]
}

/// A sphere around the origin, fine enough that its outline is a circle to a thousandth.
fn sphere(radius: f64) -> RenderMesh<'static> {
    const N: u32 = 96;
    let mut mesh = RenderMesh::default();
    for i in 0..=N {
        let (sl, cl) = (std::f64::consts::PI * f64::from(i) / f64::from(N)).sin_cos();
        for j in 0..N {
            let (s, c) = (std::f64::consts::TAU * f64::from(j) / f64::from(N)).sin_cos();
            mesh.positions.to_mut().push([radius * sl * s, radius * cl, radius * sl * c]);
        }
    }
    for i in 0..N {
        for j in 0..N {
            let at = |i: u32, j: u32| i * N + j % N;
            let (a, b, c, d) = (at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1));
            mesh.triangles.to_mut().extend([[a, b, c], [a, c, d]]);
        }
    }
    mesh
}

/// A square in the plane z = 0, two units wide, texture upright as seen from +Z.
fn square() -> RenderMesh<'static> {
    RenderMesh {
        positions: vec![[-1.0, 1.0, 0.0], [-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0]].into(),
        triangles: vec![[0, 1, 2], [0, 2, 3]].into(),
        texture_coordinates: vec![[0.0, 0.0], [0.0, 1.0], [1.0, 1.0], [1.0, 0.0]].into(),
        materials: unlit([1.0; 3]),
        ..RenderMesh::default()
    }
}

fn camera(distance: f64) -> Camera {
    Camera { target: [0.0; 3], distance, yaw: 0.0, pitch: 0.0, field_of_view: 30.0 }
}

fn draw(mesh: RenderMesh<'_>, camera: &Camera) -> Image {
    render(&Scene { meshes: vec![mesh], ..Scene::default() }, camera, &WHITE).expect("the scene is sound")
}
