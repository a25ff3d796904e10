//! GLB with the motion as morph targets: what every glTF viewer and engine plays.
//!
//! glTF has no vertex caches. Each mesh becomes its rest shape plus at most N shapes (the principal components of its motion)
//! whose weights are animated, one linear key per frame; a mesh that only follows one joint becomes a node that moves.
//! Metres, Y up, as glTF demands; the vertex order is the file's own.

use super::colors::Painter;
use super::glb_file::{Attribute, GlbFile, Rank};
use super::normals::SmoothNormals;
use super::output::write_file;
use super::principal::{Components, Goal, components};
use super::rigid::{RigidMotion, rigid_motion};
use super::{ExportError, ExportOptions, ExportReport, MorphFit};
use crate::journal::JournalReader;
use serde_json::{Map, Value, json};
use softrig::character::{Character, CharacterMesh};
use softrig::rig::Transform;
use std::io::{Read, Seek, Write};
use std::path::Path;

/// Share of the character's height to which a mesh must move rigidly to become a moving node.
const RIGID_TOLERANCE: f64 = 1e-4;

pub(super) fn write<S: Read + Seek>(
    journal: &mut JournalReader<S>,
    character: &Character,
    out: &Path,
    options: &ExportOptions,
) -> Result<ExportReport, ExportError> {
    let frames = journal.frame_count();
    let mut report = ExportReport { frames, files: vec![out.to_owned()], ..ExportReport::default() };
    // a flat character has no height to measure by; any length then serves
    let height = match character.height() {
        h if h > 0.0 => h,
        _ => 1.0,
    };
    let goal = Goal { most: options.morphs, tolerance: options.morph_tolerance * height };
    let mut fit = MorphFit { tolerance: options.morph_tolerance, ..MorphFit::default() };
    let mut scene = Scene::new(character, journal.header().fps, frames);
    let painter = options.colors.map(|field| Painter::new(journal, character, field)).transpose()?;
    let peaks = painter.as_ref().map(|p| p.peaks(journal)).transpose()?;
    if let Some(painter) = &painter {
        let name = painter.field.name();
        report.notes.push(format!("glTF has no colours over time: vertices have that of their largest {name}"));
    }
    for (index, mesh) in character.meshes.iter().enumerate() {
        scene.paint = painter.as_ref().zip(peaks.as_ref()).map(|(painter, peaks)| {
            let linear = |v: &f64| painter.color(*v).map(|c| c as f32);
            peaks[index].iter().map(linear).map(|[r, g, b]| [r, g, b, 1.0]).collect()
        });
        if mesh.triangles.is_empty() {
            report.notes.push(format!("mesh `{}` has no triangles and is left out", mesh.name));
            continue;
        }
        let normals = SmoothNormals::new(&mesh.positions, &mesh.triangles);
        if let Some(motion) = rigid_motion(journal, character, index, RIGID_TOLERANCE * height)? {
            scene.rigid(mesh, &motion)?;
        } else {
            let components = components(journal, index, &mesh.positions, &normals, goal)?;
            fit.used = fit.used.max(components.shapes.len());
            fit.error = fit.error.max(components.error / height);
            fit.needed = fit.needed.max(components.needed);
            scene.morphing(mesh, &normals, &components)?;
        }
    }
    report.morphs = Some(fit);
    let bytes = scene.finish()?;
    write_file(out, options.existing, |w| {
        w.write_all(&bytes).map_err(|source| ExportError::Io { file: out.to_owned(), source })
    })?;
    Ok(report)
}

/// The document being put together.
struct Scene<'a> {
    character: &'a Character,
    file: GlbFile,
    nodes: Vec<Value>,
    meshes: Vec<Value>,
    materials: Vec<Value>,
    /// Material of a look, with and without its texture.
    material_of: Vec<[Option<usize>; 2]>,
    /// glTF texture of each picture.
    texture_of: Vec<Option<usize>>,
    channels: Vec<Value>,
    samplers: Vec<Value>,
    /// Accessor of the key times.
    times: Option<usize>,
    fps: f64,
    frames: usize,
    /// Colours in the place of those of the mesh that is written now.
    paint: Option<Vec<[f32; 4]>>,
    /// Material that shows nothing but them.
    plain: Option<usize>,
}

impl<'a> Scene<'a> {
    fn new(character: &'a Character, fps: f64, frames: usize) -> Self {
        Self {
            character,
            file: GlbFile::default(),
            nodes: Vec::new(),
            meshes: Vec::new(),
            materials: Vec::new(),
            material_of: vec![[None; 2]; character.looks.len()],
            texture_of: vec![None; character.textures.len()],
            channels: Vec::new(),
            samplers: Vec::new(),
            times: None,
            fps,
            frames,
            paint: None,
            plain: None,
        }
    }

    /// A mesh on a node that moves.
    fn rigid(&mut self, mesh: &CharacterMesh, motion: &RigidMotion) -> Result<(), ExportError> {
        let normals = SmoothNormals::new(&motion.positions, &mesh.triangles);
        let value = self.mesh(mesh, &motion.positions, &normals, None)?;
        let node = self.node(mesh, value);
        let first = motion.transforms.first().copied().unwrap_or_default();
        self.nodes[node]["translation"] = json!(first.translation.map(|v| v as f32));
        self.nodes[node]["rotation"] = json!(first.rotation.map(|v| v as f32));
        self.nodes[node]["scale"] = json!(first.scale.map(|v| v as f32));
        if motion.transforms.len() < 2 {
            return Ok(());
        }
        let keys = |f: &dyn Fn(&Transform) -> Vec<f64>| -> Vec<f32> {
            motion.transforms.iter().flat_map(|t| f(t).into_iter().map(|v| v as f32)).collect()
        };
        self.channel(node, "translation", &keys(&|t| t.translation.to_vec()), Rank::Vec3);
        self.channel(node, "rotation", &keys(&|t| t.rotation.to_vec()), Rank::Vec4);
        self.channel(node, "scale", &keys(&|t| t.scale.to_vec()), Rank::Vec3);
        Ok(())
    }

    /// A mesh that changes its shape.
    fn morphing(
        &mut self,
        mesh: &CharacterMesh,
        normals: &SmoothNormals,
        components: &Components,
    ) -> Result<(), ExportError> {
        let value = self.mesh(mesh, &mesh.positions, normals, Some(components))?;
        let node = self.node(mesh, value);
        if !components.weights.is_empty() {
            let keys: Vec<f32> = (0..self.frames).flat_map(|t| components.weights.iter().map(move |w| w[t])).collect();
            self.channel(node, "weights", &keys, Rank::Scalar);
        }
        Ok(())
    }

    fn node(&mut self, mesh: &CharacterMesh, value: Value) -> usize {
        self.meshes.push(value);
        self.nodes.push(json!({ "name": mesh.name, "mesh": self.meshes.len() - 1 }));
        self.nodes.len() - 1
    }

    fn channel(&mut self, node: usize, path: &str, keys: &[f32], rank: Rank) {
        let times = match self.times {
            Some(times) => times,
            None => {
                let times: Vec<f32> = (0..self.frames).map(|t| (t as f64 / self.fps) as f32).collect();
                *self.times.insert(self.file.animation_data(&times, Rank::Scalar))
            }
        };
        let output = self.file.animation_data(keys, rank);
        self.samplers.push(json!({ "input": times, "output": output, "interpolation": "LINEAR" }));
        self.channels.push(json!({ "sampler": self.samplers.len() - 1, "target": { "node": node, "path": path } }));
    }

    /// One primitive for each look, all in the same buffers: a primitive sees the stretch of vertices that it uses.
    fn mesh(
        &mut self,
        mesh: &CharacterMesh,
        rest: &[[f64; 3]],
        normals: &SmoothNormals,
        components: Option<&Components>,
    ) -> Result<Value, ExportError> {
        let count = rest.len();
        let positions: Vec<[f32; 3]> = rest.iter().map(|p| p.map(|v| v as f32)).collect();
        let finite = |v: f32| if v.is_finite() { v } else { 0.0 };
        let position = Attribute::new(&mut self.file, positions.as_flattened(), Rank::Vec3)?;
        let normal = Attribute::new(&mut self.file, normals.of(|v| rest[v]).as_flattened(), Rank::Vec3)?;
        let uv = match mesh.texture_coordinates.len() == count {
            true => {
                let uv: Vec<f32> = mesh.texture_coordinates.as_flattened().iter().map(|v| finite(*v)).collect();
                Some(Attribute::new(&mut self.file, &uv, Rank::Vec2)?)
            }
            false => None,
        };
        let colors = self.paint.as_ref().unwrap_or(&mesh.colors);
        let color = match colors.len() == count {
            true => {
                let colors: Vec<f32> = colors.as_flattened().iter().map(|v| finite(*v).clamp(0.0, 1.0)).collect();
                Some(Attribute::new(&mut self.file, &colors, Rank::Vec4)?)
            }
            false => None,
        };
        let mut targets = Vec::new();
        if let Some(components) = components {
            for (shape, normal) in components.shapes.iter().zip(&components.normals) {
                let shape = Attribute::new(&mut self.file, shape.as_flattened(), Rank::Vec3)?;
                targets.push((shape, Attribute::new(&mut self.file, normal.as_flattened(), Rank::Vec3)?));
            }
        }
        let mut primitives = Vec::new();
        for (look, triangles) in by_look(mesh) {
            let indices = triangles.iter().flatten().copied();
            let (lo, hi) = (indices.clone().min().unwrap_or(0), indices.clone().max().unwrap_or(0));
            let range = lo as usize..hi as usize + 1;
            let mut attributes = Map::new();
            attributes.insert("POSITION".into(), json!(position.part(&mut self.file, range.clone(), true)));
            attributes.insert("NORMAL".into(), json!(normal.part(&mut self.file, range.clone(), false)));
            if let Some(uv) = &uv {
                attributes.insert("TEXCOORD_0".into(), json!(uv.part(&mut self.file, range.clone(), false)));
            }
            if let Some(color) = &color {
                attributes.insert("COLOR_0".into(), json!(color.part(&mut self.file, range.clone(), false)));
            }
            let local: Vec<u32> = indices.map(|i| i - lo).collect();
            let mut primitive = json!({ "attributes": attributes, "indices": self.file.indices(&local)?, "mode": 4 });
            let material = match self.paint {
                Some(_) => Some(self.plain()),
                None => look.and_then(|l| self.material(l, uv.is_some())),
            };
            if let Some(material) = material {
                primitive["material"] = json!(material);
            }
            if !targets.is_empty() {
                let part = |(shape, normal): &(Attribute, Attribute)| {
                    json!({
                        "POSITION": shape.part(&mut self.file, range.clone(), true),
                        "NORMAL": normal.part(&mut self.file, range.clone(), false),
                    })
                };
                primitive["targets"] = targets.iter().map(part).collect();
            }
            primitives.push(primitive);
        }
        let mut value = json!({ "name": mesh.name, "primitives": primitives });
        if let Some(components) = components.filter(|c| !c.weights.is_empty()) {
            // a viewer that plays nothing shows the first frame
            value["weights"] = components.weights.iter().map(|w| json!(w[0])).collect();
            value["extras"] =
                json!({ "targetNames": (1..=targets.len()).map(|k| format!("motion {k}")).collect::<Vec<_>>() });
        }
        Ok(value)
    }

    /// The material that shows the colours of vertices as they are.
    fn plain(&mut self) -> usize {
        let surface = json!({ "baseColorFactor": [1.0, 1.0, 1.0, 1.0], "metallicFactor": 0.0, "roughnessFactor": 0.8 });
        let materials = &mut self.materials;
        *self.plain.get_or_insert_with(|| {
            materials.push(json!({ "name": "colors", "pbrMetallicRoughness": surface, "doubleSided": true }));
            materials.len() - 1
        })
    }

    /// The material of a look; textures need texture coordinates.
    fn material(&mut self, look: usize, textured: bool) -> Option<usize> {
        let definition = self.character.looks.get(look)?;
        if let Some(made) = self.material_of[look][usize::from(textured)] {
            return Some(made);
        }
        let color = definition.base_color.map(|v| if v.is_finite() { v.clamp(0.0, 1.0) } else { 1.0 });
        let mut surface = json!({ "baseColorFactor": color, "metallicFactor": 0.0, "roughnessFactor": 0.8 });
        if let Some(texture) = definition.texture.filter(|_| textured).and_then(|t| self.texture(t)) {
            surface["baseColorTexture"] = json!({ "index": texture });
        }
        // open surfaces are usual; seen from behind they should not vanish
        let mut material = json!({ "name": definition.name, "pbrMetallicRoughness": surface, "doubleSided": true });
        if color[3] < 1.0 {
            material["alphaMode"] = json!("BLEND");
        }
        self.materials.push(material);
        self.material_of[look][usize::from(textured)] = Some(self.materials.len() - 1);
        Some(self.materials.len() - 1)
    }

    fn texture(&mut self, index: usize) -> Option<usize> {
        let texture = self.character.textures.get(index)?;
        if self.texture_of[index].is_none() {
            self.texture_of[index] = self.file.picture(&super::output::png(texture)?);
        }
        self.texture_of[index]
    }

    fn finish(self) -> Result<Vec<u8>, ExportError> {
        let mut document = json!({
            "asset": { "version": "2.0", "generator": concat!("softrig ", env!("CARGO_PKG_VERSION")) },
            "scene": 0,
            "scenes": [{ "name": self.character.name, "nodes": (0..self.nodes.len()).collect::<Vec<_>>() }],
        });
        let lists = [("nodes", self.nodes), ("meshes", self.meshes), ("materials", self.materials)];
        // glTF forbids empty lists
        if lists[0].1.is_empty() {
            let instead = String::from("name a character that has a mesh");
            return Err(ExportError::Unsupported { what: "a glTF file without a surface".into(), instead });
        }
        for (name, list) in lists.into_iter().filter(|(_, list)| !list.is_empty()) {
            document[name] = Value::Array(list);
        }
        if !self.channels.is_empty() {
            document["animations"] =
                json!([{ "name": "softrig", "channels": self.channels, "samplers": self.samplers }]);
        }
        self.file.finish(document)
    }
}

/// Triangles grouped by look, in the order of the file.
fn by_look(mesh: &CharacterMesh) -> Vec<(Option<usize>, Vec<[u32; 3]>)> {
    let mut groups: Vec<(Option<usize>, Vec<[u32; 3]>)> = Vec::new();
    for (i, triangle) in mesh.triangles.iter().enumerate() {
        let look = mesh.look.get(i).map(|l| *l as usize);
        match groups.iter_mut().find(|(l, _)| *l == look) {
            Some((_, triangles)) => triangles.push(*triangle),
            None => groups.push((look, vec![*triangle])),
        }
    }
    groups
}
