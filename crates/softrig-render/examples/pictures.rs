//! Draws the pictures of the documentation: `cargo run --release -p softrig-render --example pictures -- docs/images`.

use softrig::character::Character;
use softrig::couple::{BindSettings, Binding};
use softrig::material::{Material, MaterialMap};
use softrig::mesh::{LatticeOptions, Resolution, voxelize};
use softrig::rig::Pose;
use softrig::simulation::{Motion, RestMotion, Simulation, SimulationSettings};
use softrig_render::{
    BoneStyle, Camera, Image, Layer, Scene, Settings, View, bones_overlay, character_scene, mesh_overlay, mesh_surface,
    node_points, render, side_by_side,
};
use std::path::Path;

type Outcome<T> = Result<T, Box<dyn std::error::Error>>;

fn main() -> Outcome<()> {
    let folder = std::env::args().nth(1).unwrap_or_else(|| "docs/images".into());
    let character = softrig::sample::character();
    stages(&character)?.write_png(Path::new(&folder).join("stages.png"))?;
    elbows(&character)?.write_png(Path::new(&folder).join("elbow.png"))?;
    Ok(())
}

fn simulation(character: &Character, cells: usize) -> Outcome<Simulation<f64>> {
    let options = LatticeOptions { resolution: Resolution::Cells(cells), ..LatticeOptions::default() };
    let volume = voxelize(&character.surface(true), &options)?;
    let binding = Binding::new(character, &volume, &BindSettings::default())?;
    let materials = MaterialMap::uniform(Material::default());
    Ok(Simulation::new(character, volume, binding, &materials, SimulationSettings::default())?)
}

fn picture(scene: &Scene<'_>, camera: &Camera, settings: &Settings) -> Outcome<Image> {
    Ok(render(scene, camera, settings)?)
}

/// Skin, skeleton, cells, and the nodes that hang on bones.
fn stages(character: &Character) -> Outcome<Image> {
    let sim = simulation(character, 4000)?;
    let pose = RestMotion(&character.skeleton).pose(0.0);
    let skin: Vec<_> = character.meshes.iter().map(|m| m.positions.clone()).collect();
    let bones: Vec<_> = sim.binding.bones.iter().map(|b| b.joint).collect();
    let settings = Settings { width: 300, height: 460, ..Settings::default() };
    let plain = character_scene(character, &skin);
    let camera = Camera::framing(plain.bounds(), View::ThreeQuarter, &settings);

    let mut boned = plain.clone();
    boned.meshes.push(bones_overlay(&character.skeleton, &pose, &bones, BoneStyle::default()));
    let volume = &sim.body.mesh;
    let mut cells = Scene { meshes: vec![mesh_surface(volume, &volume.nodes).0], ..plain.clone() };
    cells.lines = mesh_overlay(volume, &volume.nodes, Layer::Solid);
    let held = (0..volume.node_count()).filter(|n| sim.binding.bound[*n]);
    let held: Vec<_> = held.map(|n| (n as u32, sim.binding.joint(sim.binding.owner[n]))).collect();
    let mut bound = boned.clone();
    bound.points = node_points(&volume.nodes, &held, Layer::XRay);

    let pictures = [&plain, &boned, &cells, &bound].map(|s| picture(s, &camera, &settings));
    let pictures: Vec<Image> = pictures.into_iter().collect::<Outcome<_>>()?;
    Ok(side_by_side(&pictures, &["skin", "bones", "cells", "held nodes"])?)
}

/// Turns the left forearm about an axis over one second.
struct Elbow<'a> {
    character: &'a Character,
    axis: [f64; 3],
    angle: f64,
}

impl Motion for Elbow<'_> {
    fn pose(&self, time: f64) -> Pose {
        let skeleton = &self.character.skeleton;
        let half = 0.5 * self.angle.to_radians() * time.clamp(0.0, 1.0);
        let mut locals = skeleton.rest_locals();
        if let Some(forearm) = skeleton.find("forearm.L") {
            let [x, y, z] = self.axis.map(|a| a * half.sin());
            locals[forearm.index()].rotation = [x, y, z, half.cos()];
        }
        skeleton.pose(&locals)
    }
}

/// An elbow twisted by 170 and flexed by 130 degrees: plain skinning beside flesh.
fn elbows(character: &Character) -> Outcome<Image> {
    let along = {
        let at = |name| character.skeleton.find(name).map(|j| character.skeleton.joint(j).rest.translation);
        let (a, b) = (at("forearm.L").ok_or("no forearm")?, at("hand.L").ok_or("no hand")?);
        let d: [f64; 3] = std::array::from_fn(|k| b[k] - a[k]);
        let length = d.iter().map(|v| v * v).sum::<f64>().sqrt();
        d.map(|v| v / length)
    };
    let settings = Settings { width: 320, height: 320, ..Settings::default() };
    let mut pictures = Vec::new();
    for (axis, angle) in [(along, 170.0), ([0.0, 0.0, 1.0], 130.0)] {
        let motion = Elbow { character, axis, angle };
        let mut sim = simulation(character, 8000)?;
        sim.start(&motion)?;
        for frame in 1..=40 {
            sim.advance(&motion, f64::from(frame) / 30.0)?;
        }
        let blended: Vec<_> = (0..character.meshes.len()).map(|m| character.blend_skin(m, sim.pose())).collect();
        let flesh = sim.frame(40).skin.to_vec();
        for skin in [&blended, &flesh] {
            let scene = character_scene(character, skin);
            let mut camera = Camera::framing(scene.bounds(), View::Front, &settings);
            (camera.target, camera.distance) = ([0.36, 0.83, 0.0], 0.3 * camera.distance);
            pictures.push(picture(&scene, &camera, &settings)?);
        }
    }
    Ok(side_by_side(
        &pictures,
        &["twist 170: skinning", "twist 170: softrig", "flex 130: skinning", "flex 130: softrig"],
    )?)
}
