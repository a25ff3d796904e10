//! What there is to draw, as plain data.

use crate::camera::Bounds;
use crate::color::ColorMap;
use softrig::character::Texture;
use std::borrow::Cow;

/// Everything in one picture. Borrows the large parts of a character, so that a scene per frame costs nothing.
#[derive(Clone, Debug, Default)]
pub struct Scene<'a> {
    /// Drawn in order; of equally near surfaces the first wins.
    pub meshes: Vec<RenderMesh<'a>>,
    /// Straight lines of constant width.
    pub lines: Vec<Line>,
    /// Round dots of constant size.
    pub points: Vec<Point>,
    /// Pictures that materials refer to.
    pub textures: &'a [Texture],
    /// Height of the ground [m]; `None`: no ground, no shadow on it.
    pub ground: Option<f64>,
}

/// What hides what.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Layer {
    /// Hides what is behind it.
    #[default]
    Solid,
    /// Lets through what solids are behind it; the number is how much of itself it shows, in 0 to 1. Never hides [`Layer::XRay`].
    Glass(f32),
    /// Seen through everything else.
    XRay,
}

/// One triangle mesh.
#[derive(Clone, Debug, Default)]
pub struct RenderMesh<'a> {
    /// Vertex positions [m]. Triangles at vertices that are not finite are left out.
    pub positions: Cow<'a, [[f64; 3]]>,
    /// Vertices of each triangle; both sides are drawn.
    pub triangles: Cow<'a, [[u32; 3]]>,
    /// Material of each triangle, an index into `materials`; empty: the first one.
    pub material: Cow<'a, [u32]>,
    /// Surfaces; empty: light grey.
    pub materials: Vec<Material>,
    /// Linear RGBA factor of each vertex; empty: white.
    pub colors: Cow<'a, [[f32; 4]]>,
    /// Texture coordinates of each vertex, (0, 0) at the upper left; empty: no texture is used.
    pub texture_coordinates: Cow<'a, [[f32; 2]]>,
    /// Shown instead of the material's colour.
    pub scalar: Option<ScalarField<'a>>,
    /// Every triangle by its own normal instead of a smooth surface.
    pub faceted: bool,
    /// What hides it, and whether it hides others.
    pub layer: Layer,
    /// Whether it throws a shadow; solids do unless this says no.
    pub shadowless: bool,
}

/// Colour of a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Material {
    /// Linear RGBA. Alpha below one half is a hole.
    pub base_color: [f32; 4],
    /// Index into [`Scene::textures`], multiplied by `base_color`.
    pub texture: Option<usize>,
    /// Shows its colour as it is, without light and shadow.
    pub unlit: bool,
    /// Strength of the highlight [-], 0.25 for skin and cloth.
    pub gloss: f32,
}

impl Default for Material {
    fn default() -> Self {
        Self { base_color: [0.55, 0.55, 0.57, 1.0], texture: None, unlit: false, gloss: 0.25 }
    }
}

/// One number per vertex or per triangle, shown by colour.
#[derive(Clone, Debug)]
pub struct ScalarField<'a> {
    /// As many as vertices: smooth. As many as triangles: one colour each. Not finite: grey.
    pub values: Cow<'a, [f32]>,
    /// Values at the two ends of the colours.
    pub range: [f32; 2],
    /// The colours.
    pub map: ColorMap,
}

/// A straight line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Line {
    /// Ends [m].
    pub ends: [[f64; 3]; 2],
    /// Linear RGB.
    pub color: [f32; 3],
    /// Width in pixels.
    pub width: f32,
    /// What hides it.
    pub layer: Layer,
}

/// A dot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// Centre [m].
    pub position: [f64; 3],
    /// Linear RGB.
    pub color: [f32; 3],
    /// Radius in pixels.
    pub radius: f32,
    /// What hides it.
    pub layer: Layer,
}

/// Size and quality of a picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Pixels across.
    pub width: u32,
    /// Pixels down.
    pub height: u32,
    /// Samples per pixel along each axis. 2 smooths edges for animations, 4 for stills.
    pub samples: u32,
    /// Colours of the background, sRGB: at the top, at the horizon, and of the ground.
    pub background: [[u8; 3]; 3],
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            width: 640,
            height: 640,
            samples: 2,
            // a pale blue studio: far from skin tones, so that a figure stands out
            background: [[196, 212, 224], [231, 236, 239], [222, 222, 218]],
        }
    }
}

impl Scene<'_> {
    /// Smallest box around all finite positions of meshes, lines and points.
    #[must_use]
    pub fn bounds(&self) -> Bounds {
        let mut bounds = Bounds::default();
        self.meshes.iter().for_each(|m| bounds.extend(&m.positions));
        self.lines.iter().for_each(|l| bounds.extend(&l.ends));
        self.points.iter().for_each(|p| bounds.extend(&[p.position]));
        bounds
    }
}
