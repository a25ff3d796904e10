//! Bodies as pictures, coloured by a number on every node.

use super::Results;
use crate::commands::render::failure;
use crate::failure::{Failure, Outcome};
use softrig::character::Character;
use softrig::mesh::VolumeMesh;
use softrig_render::{
    Camera, ColorMap, Image, Material, RenderMesh, ScalarField, Scene, Settings, View, legend, mesh_surface, render,
    side_by_side,
};

/// What is drawn, and how its numbers are shown.
pub struct Look<'a> {
    /// What the numbers are.
    pub title: &'a str,
    /// Values at the two ends of the colours.
    pub range: [f32; 2],
    /// Where from.
    pub view: View,
}

/// Width of the strip for a legend [pixels].
const LEGEND: u32 = 150;

/// Draws states of one mesh, each with a number on every node, side by side, and writes them.
pub fn states(
    results: &Results,
    name: &str,
    mesh: &VolumeMesh,
    look: &Look<'_>,
    states: &[(&str, &[[f64; 3]], Option<Vec<f32>>)],
) -> Outcome {
    let path = results.path(name)?;
    let fail = |e| failure(&path, &e);
    let settings = Settings { width: 420, height: 420, ..Settings::default() };
    let mut images: Vec<Image> = Vec::new();
    let mut camera = None;
    for (_, position, values) in states {
        let (mut surface, _) = mesh_surface(mesh, position);
        if let Some(values) = values {
            surface.scalar =
                Some(ScalarField { values: values.clone().into(), range: look.range, map: ColorMap::Amount });
        }
        let scene = Scene { meshes: vec![surface], ..Scene::default() };
        // all from where the first is seen
        let camera = camera.get_or_insert_with(|| Camera::framing(scene.bounds(), look.view, &settings));
        images.push(render(&scene, camera, &settings).map_err(fail)?);
    }
    let mut labels: Vec<&str> = states.iter().map(|s| s.0).collect();
    let coloured = states.iter().any(|s| s.2.is_some());
    if coloured {
        // a strip of background for the legend, which would hide what is behind it
        let strip = Settings { width: LEGEND, ..settings };
        let camera = camera.get_or_insert_with(|| Camera::framing(Scene::default().bounds(), look.view, &strip));
        images.push(render(&Scene::default(), camera, &strip).map_err(fail)?);
        labels.push("");
    }
    let mut image = side_by_side(&images, &labels).map_err(fail)?;
    if coloured {
        legend(&mut image, ColorMap::Amount, look.range, look.title);
    }
    image.write_png(&path).map_err(fail)?;
    crate::ui::note(format_args!("wrote {}", path.display()));
    Ok(())
}

/// Draws states of a character's skin side by side, and writes them.
pub fn skins(
    results: &Results,
    name: &str,
    character: &Character,
    view: View,
    states: &[(&str, &Vec<Vec<[f64; 3]>>)],
) -> Outcome {
    let path = results.path(name)?;
    let fail = |e| failure(&path, &e);
    let settings = Settings { width: 420, height: 420, ..Settings::default() };
    let (mut images, mut camera): (Vec<Image>, _) = (Vec::new(), None);
    for (_, skin) in states {
        let meshes = character.meshes.iter().zip(*skin).map(|(mesh, positions)| RenderMesh {
            positions: positions.as_slice().into(),
            triangles: mesh.triangles.as_slice().into(),
            materials: vec![Material::default()],
            ..RenderMesh::default()
        });
        let scene = Scene { meshes: meshes.collect(), ..Scene::default() };
        // all from where the first is seen
        let camera = camera.get_or_insert_with(|| Camera::framing(scene.bounds(), view, &settings));
        images.push(render(&scene, camera, &settings).map_err(fail)?);
    }
    let labels: Vec<&str> = states.iter().map(|s| s.0).collect();
    let image = side_by_side(&images, &labels).map_err(fail)?;
    image.write_png(&path).map_err(fail)?;
    crate::ui::note(format_args!("wrote {}", path.display()));
    Ok(())
}

/// Numbers of cells as numbers of nodes: the mean of the cells around each.
pub fn on_nodes(mesh: &VolumeMesh, of_cell: &[f64]) -> Vec<f32> {
    let (mut sum, mut count) = (vec![0.0; mesh.node_count()], vec![0.0f64; mesh.node_count()]);
    for (cell, v) in mesh.cells().zip(of_cell) {
        for n in cell {
            sum[*n as usize] += v;
            count[*n as usize] += 1.0;
        }
    }
    sum.iter().zip(&count).map(|(s, c)| (s / c.max(1.0)) as f32).collect()
}

/// A step that failed, by name.
pub fn failed(error: &dyn std::error::Error) -> Failure {
    Failure::Simulation(error.to_string())
}
