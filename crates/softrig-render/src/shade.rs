//! Light: a warm key, a cool fill, a rim from behind, light from sky and floor all round; and the studio behind the figure.

use crate::color::{linear, linear_rgb};
use crate::geometry::{FIXED, Geometry, Projection, Surface, Triangle, Vertex, dot, lerp, sub, unit};
use crate::scene::{Scene, Settings};
use crate::shadow::Shadow;
use softrig::character::Texture;

/// Directions to the lights as (right, up, towards the viewer): they turn with the camera, as if the figure were turned on a stand.
const KEY: [f32; 3] = [-0.48, 0.74, 0.62];
const FILL: [f32; 3] = [0.85, 0.12, 0.50];
const RIM: [f32; 3] = [0.45, 0.60, -0.66];

const KEY_LIGHT: [f32; 3] = [0.80, 0.755, 0.69];
const FILL_LIGHT: [f32; 3] = [0.10, 0.13, 0.17];
const RIM_LIGHT: [f32; 3] = [0.34, 0.36, 0.40];
const SKY_LIGHT: [f32; 3] = [0.36, 0.385, 0.42];
const FLOOR_LIGHT: [f32; 3] = [0.22, 0.195, 0.175];

pub(crate) struct Shader<'a> {
    vertices: &'a [Vertex],
    surfaces: &'a [Surface],
    textures: &'a [Texture],
    view: &'a Projection,
    eye: [f32; 3],
    key: [f32; 3],
    fill: [f32; 3],
    rim: [f32; 3],
    shadow: Option<Shadow>,
    /// Height of the ground relative to the target.
    ground: Option<f32>,
    /// Linear: top, horizon, ground.
    background: [[f32; 3]; 3],
}

impl<'a> Shader<'a> {
    pub(crate) fn new(scene: &Scene<'a>, geometry: &'a Geometry, view: &'a Projection, settings: &Settings) -> Self {
        // lights stay level: they turn with the camera about the vertical only
        let flat = unit([-view.right[2], 0.0, view.right[0]]);
        let turned =
            |l: [f32; 3]| unit([l[0] * view.right[0] + l[2] * flat[0], l[1], l[0] * view.right[2] + l[2] * flat[2]]);
        let ground = scene.ground.filter(|y| y.is_finite()).map(|y| view.local_height(y));
        let key = turned(KEY);
        Self {
            vertices: &geometry.vertices,
            surfaces: &geometry.surfaces,
            textures: scene.textures,
            view,
            eye: view.eye(),
            key,
            fill: turned(FILL),
            rim: turned(RIM),
            shadow: Shadow::new(geometry, key, ground),
            ground,
            background: settings.background.map(linear_rgb),
        }
    }

    /// Colour and opacity of a triangle at a place on the screen [samples]; `None` where it has a hole.
    pub(crate) fn surface(&self, t: &Triangle, x: f32, y: f32) -> Option<([f32; 3], f32)> {
        let b = barycentric(t, x, y);
        let v = t.vertex.map(|v| &self.vertices[v as usize]);
        let mix = |a: [f32; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
        let surface = &self.surfaces[t.surface as usize];
        let material = &surface.material;
        let mut color: [f32; 4] = std::array::from_fn(|k| material.base_color[k] * mix(v.map(|v| v.color[k])));
        if let Some(texture) = material.texture {
            let texel = sample(&self.textures[texture], [mix(v.map(|v| v.uv[0])), mix(v.map(|v| v.uv[1]))]);
            (0..4).for_each(|k| color[k] *= texel[k]);
        }
        if color[3] < 0.5 {
            return None;
        }
        let mut albedo = [color[0], color[1], color[2]];
        if let Some((range, map)) = surface.field {
            albedo = map.at((mix(v.map(|v| v.scalar)) - range[0]) / (range[1] - range[0]));
        }
        if material.unlit {
            return Some((albedo, surface.opacity));
        }
        let normal = unit(std::array::from_fn(|k| mix(t.normal.map(|n| n[k]))));
        let position: [f32; 3] = std::array::from_fn(|k| mix(v.map(|v| v.position[k])));
        Some((self.lit(albedo, material.gloss, position, normal), surface.opacity))
    }

    fn lit(&self, albedo: [f32; 3], gloss: f32, position: [f32; 3], normal: [f32; 3]) -> [f32; 3] {
        let to_eye = unit(sub(self.eye, position));
        let facing = dot(normal, to_eye).clamp(0.0, 1.0);
        let shade = self.shadow.as_ref().map_or(1.0, |s| s.light_at(position, normal));
        // light wraps a little round the edge, as it does on skin
        let wrap = |l: [f32; 3], w: f32| ((dot(normal, l) + w) / (1.0 + w)).max(0.0);
        let key = wrap(self.key, 0.22) * shade;
        let fill = wrap(self.fill, 0.4);
        let sky = 0.5 * normal[1] + 0.5;
        let edge = (1.0 - facing) * (1.0 - facing);
        let rim = edge * (dot(normal, self.rim) + 0.25).max(0.0);
        let half = unit(std::array::from_fn(|k| self.key[k] + to_eye[k]));
        let h2 = dot(normal, half).max(0.0).powi(2);
        let spec = gloss * shade * (0.35 * h2.powi(16) + 0.12 * h2.powi(4)) * key.min(1.0);
        // the floor is darker under the figure
        let low = self.ground.map_or(1.0, |g| 0.72 + 0.28 * ((position[1] - g) * 2.2).clamp(0.0, 1.0));
        std::array::from_fn(|k| {
            let around = FLOOR_LIGHT[k] + sky * (SKY_LIGHT[k] - FLOOR_LIGHT[k]);
            let light = around * low + KEY_LIGHT[k] * key + FILL_LIGHT[k] * fill;
            albedo[k] * light + RIM_LIGHT[k] * rim * (0.35 + 0.65 * albedo[k]) + spec * KEY_LIGHT[k]
        })
    }

    /// What is behind everything, at a place on the screen [samples].
    pub(crate) fn background(&self, x: f32, y: f32) -> [f32; 3] {
        let (view, [top, horizon, floor]) = (self.view, self.background);
        let (r, u) = ((x - view.middle[0]) / view.focal, -(y - view.middle[1]) / view.focal);
        let ray = unit(std::array::from_fn(|k| r * view.right[k] + u * view.up[k] - view.back[k]));
        // soft from horizon to zenith; all of the gradient lies in the narrow angle a portrait sees
        let rise = (ray[1] * 2.6).clamp(0.0, 1.0);
        let wall = lerp(horizon, top, rise * (2.0 - rise));
        let Some(ground) = self.ground.filter(|g| ray[1] < -1e-4 && self.eye[1] > *g) else {
            // without ground the gradient goes on below
            let height = if self.ground.is_some() { 0.0 } else { (0.5 - 1.6 * ray[1]).clamp(0.0, 1.0) };
            return lerp(wall, floor, height * 0.8);
        };
        let t = (ground - self.eye[1]) / ray[1];
        let p: [f32; 3] = std::array::from_fn(|k| self.eye[k] + t * ray[k]);
        // floor and wall run into each other, as in a studio
        let away = ((p[0] * p[0] + p[2] * p[2]).sqrt() / (0.55 * view.distance)).min(1.0);
        let shade = self.shadow.as_ref().map_or(1.0, |s| s.ground_at(p));
        let color = lerp(floor, horizon, away * away * (3.0 - 2.0 * away));
        color.map(|c| c * shade)
    }
}

/// Perspective-correct weights of the corners.
fn barycentric(t: &Triangle, x: f32, y: f32) -> [f32; 3] {
    let px = t.x.map(|v| f64::from(v) / f64::from(FIXED) - f64::from(x));
    let py = t.y.map(|v| f64::from(v) / f64::from(FIXED) - f64::from(y));
    // twice the areas opposite the corners
    let area = [0, 1, 2].map(|c| {
        let (n, l) = ((c + 1) % 3, (c + 2) % 3);
        (px[n] * py[l] - px[l] * py[n]).max(0.0) * f64::from(t.nearness[c])
    });
    let sum = area[0] + area[1] + area[2];
    if sum > 0.0 { area.map(|a| (a / sum) as f32) } else { [1.0 / 3.0; 3] }
}

/// Bilinear, repeating, averaged in linear light.
fn sample(texture: &Texture, uv: [f32; 2]) -> [f32; 4] {
    let (w, h) = (texture.width as usize, texture.height as usize);
    if w == 0 || h == 0 || texture.rgba.len() < w * h || !uv.iter().all(|c| c.is_finite()) {
        return [1.0; 4];
    }
    let place = |c: f32, n: usize| {
        let s = (c - c.floor()) * n as f32 - 0.5;
        let i = s.floor();
        let wrap = |i: f32| (i as i64).rem_euclid(n as i64) as usize;
        (wrap(i), wrap(i + 1.0), s - i)
    };
    let ((x0, x1, fx), (y0, y1, fy)) = (place(uv[0], w), place(uv[1], h));
    let texel = |x: usize, y: usize| {
        let [r, g, b, a] = texture.rgba[y * w + x];
        [linear(r), linear(g), linear(b), f32::from(a) / 255.0]
    };
    lerp(lerp(texel(x0, y0), texel(x1, y0), fx), lerp(texel(x0, y1), texel(x1, y1), fx), fy)
}
