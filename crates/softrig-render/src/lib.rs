//! Headless, deterministic pictures of characters: a software rasteriser, overlays, legends, PNG and GIF.
//!
//! ```
//! use softrig_render::{Camera, Settings, View, character_scene, render};
//! let character = softrig::sample::character();
//! let skin: Vec<_> = character.meshes.iter().map(|m| m.positions.clone()).collect();
//! let scene = character_scene(&character, &skin);
//! let settings = Settings { width: 96, height: 96, ..Settings::default() };
//! let camera = Camera::framing(scene.bounds(), View::ThreeQuarter, &settings);
//! let image = render(&scene, &camera, &settings)?;
//! assert_eq!(image.pixels.len(), 96 * 96);
//! # Ok::<(), softrig_render::RenderError>(())
//! ```
//!
//! The picture is a function of its inputs alone: no GPU, no clock, and the same bits for any number of threads.

mod camera;
mod character;
mod color;
mod compose;
mod error;
mod font;
mod geometry;
mod gif;
mod image;
mod overlay;
mod palette;
mod raster;
mod scene;
mod shade;
mod shadow;

pub use camera::{Bounds, Camera, View};
pub use character::character_scene;
pub use color::{ColorMap, bone_color};
pub use compose::{Align, caption, legend, side_by_side};
pub use error::RenderError;
pub use gif::GifWriter;
pub use image::{Image, PngSeries};
pub use overlay::{BoneStyle, bones_overlay, joint_points, mesh_overlay, mesh_surface, node_points};
pub use raster::render;
pub use scene::{Layer, Line, Material, Point, RenderMesh, ScalarField, Scene, Settings};
