//! One picture: the character, what lies in it, and what it feels.

use super::frames::{Frames, Shape};
use crate::args::{PictureSize, RenderArgs, Stress};
use crate::commands::bake::Prepared;
use crate::failure::Failure;
use softrig::character::{Character, Skin};
use softrig::force::cell_stress;
use softrig::material::MaterialMap;
use softrig::mesh::{Embedding, VolumeMesh};
use softrig::rig::JointId;
use softrig_render::{
    BoneStyle, Bounds, Camera, ColorMap, Image, Layer, RenderError, ScalarField, Settings, View, bones_overlay,
    character_scene, legend, mesh_overlay, node_points, render,
};
use std::ops::Range;

/// What is drawn besides the skin.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Overlays {
    /// Edges of the cells.
    pub cells: bool,
    /// Bones.
    pub bones: bool,
    /// Nodes that hang on bones.
    pub bound: bool,
    /// Colours of the skin.
    pub map: Option<Stress>,
}

/// Draws frames from one camera, with one scale of colours.
pub struct Painter {
    camera: Camera,
    settings: Settings,
    overlays: Overlays,
    body: Option<Body>,
    /// Value at the upper end of the colours.
    top: f32,
}

/// The volume mesh of the overlays.
struct Body {
    volume: VolumeMesh,
    materials: MaterialMap,
    /// Nodes with the joint they hang on.
    bound: Vec<(u32, JointId)>,
    /// Cell under each vertex of each mesh with flesh.
    cells: Vec<Vec<u32>>,
}

impl Painter {
    /// Looks at all frames of the range first, so that the camera stands still and colours mean the same in all of them.
    ///
    /// # Errors
    /// [`Failure::Input`] when an overlay needs what the source does not have.
    pub fn new(frames: &mut Frames, args: &RenderArgs, range: Range<usize>) -> Result<Self, Failure> {
        let overlays = Overlays { cells: args.cells, bones: args.bones, bound: args.bound, map: args.map };
        Self::looking(frames, overlays, args.view, args.size, range)
    }

    /// As [`Self::new`], from settings.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn looking(
        frames: &mut Frames,
        overlays: Overlays,
        view: View,
        size: PictureSize,
        range: Range<usize>,
    ) -> Result<Self, Failure> {
        let samples = if range.len() > 1 { 2 } else { 4 };
        let settings = Settings { width: size.width, height: size.height, samples, ..Settings::default() };
        let body = Body::of(frames, overlays)?;
        let mut painter = Self { camera: Camera::default(), settings, overlays, body, top: 0.0 };
        let mut bounds = Bounds::default();
        for index in range {
            let shape = frames.shape(index)?;
            shape.skin.iter().for_each(|s| bounds.extend(s));
            for value in painter.values(&frames.character, &shape).iter().flatten() {
                painter.top = painter.top.max(*value);
            }
        }
        painter.camera = Camera::framing(bounds, view, &painter.settings);
        Ok(painter)
    }

    /// Draws one frame.
    ///
    /// # Errors
    /// [`RenderError`] when the picture is too large.
    pub fn paint(&self, frames: &Frames, shape: &Shape) -> Result<Image, RenderError> {
        let character = &frames.character;
        let mut scene = character_scene(character, &shape.skin);
        let range = [0.0, if self.top > 0.0 { self.top } else { 1.0 }];
        for (mesh, values) in scene.meshes.iter_mut().zip(self.values(character, shape)) {
            mesh.scalar = Some(ScalarField { values: values.into(), range, map: MAP });
        }
        if let Some(body) = &self.body {
            let nodes = if shape.nodes.is_empty() { &body.volume.nodes } else { &shape.nodes };
            if self.overlays.cells {
                scene.lines.extend(mesh_overlay(&body.volume, nodes, Layer::Solid));
            }
            if self.overlays.bound {
                scene.points.extend(node_points(nodes, &body.bound, Layer::XRay));
            }
        }
        if self.overlays.bones {
            let bones = bones(character);
            scene.meshes.push(bones_overlay(&character.skeleton, &shape.pose, &bones, BoneStyle::default()));
        }
        let mut image = render(&scene, &self.camera, &self.settings)?;
        if let Some(map) = self.overlays.map {
            let title = match map {
                Stress::Stress => "stress [Pa]",
                Stress::Displacement => "off skinning [m]",
            };
            legend(&mut image, MAP, range, title);
        }
        Ok(image)
    }

    /// Values to colour each vertex by; empty without a map.
    fn values(&self, character: &Character, shape: &Shape) -> Vec<Vec<f32>> {
        let meshes = 0..character.meshes.len();
        match (self.overlays.map, &self.body) {
            (Some(Stress::Displacement), _) => meshes
                .map(|m| {
                    let plain = character.blend_skin(m, &shape.pose);
                    let off = |(a, b): (&[f64; 3], &[f64; 3])| {
                        (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f64>().sqrt() as f32
                    };
                    shape.skin[m].iter().zip(&plain).map(off).collect()
                })
                .collect(),
            (Some(Stress::Stress), Some(body)) if shape.nodes.len() == body.volume.node_count() => {
                let stress = cell_stress(&body.volume, &body.materials, &shape.nodes);
                meshes
                    .map(|m| match body.cells[m].is_empty() {
                        // what is carried whole feels nothing
                        true => vec![0.0; shape.skin[m].len()],
                        false => body.cells[m].iter().map(|c| stress[*c as usize].von_mises as f32).collect(),
                    })
                    .collect()
            }
            _ => Vec::new(),
        }
    }
}

/// Colours of `--map`.
const MAP: ColorMap = ColorMap::Amount;

/// Joints that skin hangs on.
fn bones(character: &Character) -> Vec<JointId> {
    let mut bones: Vec<JointId> = character
        .meshes
        .iter()
        .flat_map(|m| match &m.skin {
            Skin::Weighted(weights) => weights.joint.clone(),
            Skin::Rigid(joint) => vec![*joint],
            Skin::Free => Vec::new(),
        })
        .collect();
    bones.sort_unstable();
    bones.dedup();
    bones
}

impl Body {
    /// The body that the overlays need; `None` when they need none.
    fn of(frames: &Frames, overlays: Overlays) -> Result<Option<Self>, Failure> {
        let stress = overlays.map == Some(Stress::Stress);
        if !(overlays.cells || overlays.bound || stress) {
            return Ok(None);
        }
        let kept = frames.header().and_then(|h| h.volume.as_ref());
        if kept.is_none() && (stress || !frames.is_bind_pose()) {
            return Err(Failure::Input(
                "cells, bound nodes and stress of a moving character come from a bake: bake it to a .softrig-journal and \
                 render that"
                    .into(),
            ));
        }
        let character = &frames.character;
        let (volume, materials, bound) = match kept {
            Some(kept) if !overlays.bound => (kept.mesh.clone(), kept.materials.clone(), Vec::new()),
            _ => {
                // the binding is not kept anywhere: the same scene gives the same one again
                let prepared = Prepared::new(&frames.scene, character.clone())?;
                let bound = prepared.binding.as_ref().map_or_else(Vec::new, |b| {
                    let nodes = (0..b.bound.len()).filter(|n| b.bound[*n]);
                    nodes.map(|n| (n as u32, b.joint(b.owner[n]))).collect()
                });
                (prepared.volume, prepared.materials, bound)
            }
        };
        let cells = if stress { skin_cells(character, &volume)? } else { Vec::new() };
        Ok(Some(Self { volume, materials, bound, cells }))
    }
}

/// Cell under each vertex of each mesh; empty for meshes without flesh.
fn skin_cells(character: &Character, volume: &VolumeMesh) -> Result<Vec<Vec<u32>>, Failure> {
    let flesh = character.surface(true);
    let embedding = Embedding::embed(volume, &flesh.positions, None).map_err(|e| Failure::Input(e.to_string()))?;
    let mut next = 0;
    let cells = character.meshes.iter().map(|m| {
        if !m.is_weighted() {
            return Vec::new();
        }
        let range = next..next + m.positions.len();
        next = range.end;
        embedding.cell[range].to_vec()
    });
    Ok(cells.collect())
}
