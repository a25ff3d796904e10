//! Which triangle is seen where, and the picture put together.
//!
//! Each horizontal band of the picture is drawn by itself: first the nearest triangle of every sample, then, pixel by pixel, one
//! shading per triangle seen in it at the middle of the samples it covers. Nothing in a band depends on any other, so the picture is
//! the same for any number of threads.

use crate::camera::Camera;
use crate::color::srgb;
use crate::error::RenderError;
use crate::geometry::{FIXED, Geometry, Projection, Triangle};
use crate::image::Image;
use crate::scene::{Scene, Settings};
use crate::shade::Shader;
use rayon::prelude::*;

/// Pixels a side at most: 64 million pixels are 200 MB.
const LARGEST: u32 = 8192;

/// Rows of pixels per band: a band's samples fit the cache.
const BAND: u32 = 16;

/// No triangle.
const NONE: u32 = u32::MAX;

/// Draws a scene.
///
/// # Errors
/// [`RenderError::Size`] for impossible settings, [`RenderError::Camera`] and [`RenderError::Mesh`] for impossible input.
pub fn render(scene: &Scene<'_>, camera: &Camera, settings: &Settings) -> Result<Image, RenderError> {
    let (width, height, samples) = (settings.width, settings.height, settings.samples);
    if !((1..=LARGEST).contains(&width) && (1..=LARGEST).contains(&height) && (1..=8).contains(&samples)) {
        return Err(RenderError::Size { width, height, samples, limit: LARGEST });
    }
    let view = Projection::new(camera, settings)?;
    let geometry = Geometry::new(scene, &view, samples as f32)?;
    let shader = Shader::new(scene, &geometry, &view, settings);
    let rows = (BAND * samples) as i32;
    let bands = height.div_ceil(BAND) as usize;
    let bins: Vec<Vec<Vec<u32>>> = geometry.layers.iter().map(|layer| bin(layer, bands, rows)).collect();
    let mut pixels = vec![[0u8; 3]; width as usize * height as usize];
    pixels.par_chunks_mut((width * BAND) as usize).enumerate().for_each(|(b, out)| {
        let mut band = Band { top: b as i32 * rows, rows, width: (width * samples) as i32, layers: Vec::new() };
        for (layer, bins) in geometry.layers.iter().zip(&bins) {
            band.draw(layer, &bins[b]);
        }
        band.resolve(&geometry, &shader, samples as i32, width as usize, out);
    });
    Ok(Image { width, height, pixels })
}

/// Triangles that reach into each band, in order.
fn bin(triangles: &[Triangle], bands: usize, rows: i32) -> Vec<Vec<u32>> {
    let mut bins = vec![Vec::new(); bands];
    for (i, t) in triangles.iter().enumerate() {
        let step = FIXED as i32 * rows;
        let first = t.y.iter().min().expect("three corners").div_euclid(step).max(0);
        let last = t.y.iter().max().expect("three corners").div_euclid(step).min(bands as i32 - 1);
        for b in first..=last {
            bins[b as usize].push(i as u32);
        }
    }
    bins
}

/// Nearest triangle of each sample of a band, for one layer.
#[derive(Default)]
struct Visible {
    id: Vec<u32>,
    nearness: Vec<f32>,
}

struct Band {
    /// First row of samples.
    top: i32,
    rows: i32,
    width: i32,
    /// Empty where nothing of the layer is in the band.
    layers: Vec<Visible>,
}

impl Band {
    fn draw(&mut self, triangles: &[Triangle], bin: &[u32]) {
        let mut seen = Visible::default();
        if !bin.is_empty() {
            let count = (self.rows * self.width) as usize;
            seen = Visible { id: vec![NONE; count], nearness: vec![0.0; count] };
            for i in bin {
                self.cover(&triangles[*i as usize], *i, &mut seen);
            }
        }
        self.layers.push(seen);
    }

    /// Marks the samples whose middle the triangle covers and where it is the nearest so far.
    fn cover(&self, t: &Triangle, id: u32, seen: &mut Visible) {
        let one = FIXED as i64;
        let low = |c: [i32; 3]| i64::from(*c.iter().min().expect("three corners"));
        let high = |c: [i32; 3]| i64::from(*c.iter().max().expect("three corners"));
        // samples whose middles are within the box
        let first = |v: i64| (v - one / 2 + one - 1).div_euclid(one);
        let last = |v: i64| (v - one / 2).div_euclid(one);
        let (x0, x1) = (first(low(t.x)).max(0), last(high(t.x)).min(i64::from(self.width) - 1));
        let top = i64::from(self.top);
        let (y0, y1) = (first(low(t.y)).max(top), last(high(t.y)).min(top + i64::from(self.rows) - 1));
        if x0 > x1 || y0 > y1 {
            return;
        }
        // edge c runs from corner c to the next; positive inside
        let x = t.x.map(i64::from);
        let y = t.y.map(i64::from);
        let edge = [0, 1, 2].map(|c| {
            let n = (c + 1) % 3;
            let (dx, dy) = (x[n] - x[c], y[n] - y[c]);
            // a sample exactly on an edge belongs to the triangle on the lower right of it
            let owns = dy < 0 || (dy == 0 && dx > 0);
            let (px, py) = (x0 * one + one / 2, y0 * one + one / 2);
            (dx, dy, dx * (py - y[c]) - dy * (px - x[c]) - i64::from(!owns))
        });
        let plane = Plane::new(t);
        let (least, most) =
            (t.nearness.iter().copied().fold(f32::MAX, f32::min), t.nearness.iter().copied().fold(0.0, f32::max));
        let mut row = edge.map(|e| e.2);
        for py in y0..=y1 {
            let mut e = row;
            let offset = ((py - top) * i64::from(self.width)) as usize;
            let start = plane.row(py as f32 + 0.5);
            for px in x0..=x1 {
                if (e[0] | e[1] | e[2]) >= 0 {
                    let nearness = (start + plane.dx * (px as f32 + 0.5)).clamp(least, most);
                    let at = offset + px as usize;
                    if nearness > seen.nearness[at] {
                        seen.nearness[at] = nearness;
                        seen.id[at] = id;
                    }
                }
                (0..3).for_each(|c| e[c] -= edge[c].1 * one);
            }
            (0..3).for_each(|c| row[c] += edge[c].0 * one);
        }
    }

    /// Averages samples into pixels.
    fn resolve(&self, geometry: &Geometry, shader: &Shader<'_>, samples: i32, width: usize, out: &mut [[u8; 3]]) {
        let per_pixel = (samples * samples) as usize;
        let mut light = vec![[0f32; 3]; per_pixel];
        for (i, pixel) in out.iter_mut().enumerate() {
            let (left, above) = ((i % width) as i32 * samples, (i / width) as i32 * samples);
            let sample = |s: usize| (left + s as i32 % samples, above + s as i32 / samples);
            let at = |s: usize| {
                let (x, y) = sample(s);
                (y * self.width + x) as usize
            };
            let full = self.layers[0].id.get(at(0)..).is_some_and(|_| {
                !self.layers[0].id.is_empty() && (0..per_pixel).all(|s| self.layers[0].id[at(s)] != NONE)
            });
            let half = 0.5 * samples as f32;
            let back =
                if full { [0.0; 3] } else { shader.background(left as f32 + half, (self.top + above) as f32 + half) };
            light.fill(back);
            for (slot, seen) in self.layers.iter().enumerate() {
                if seen.id.is_empty() {
                    continue;
                }
                let hidden = |s: usize| {
                    slot == 1 && self.layers[0].nearness.get(at(s)).is_some_and(|solid| *solid > seen.nearness[at(s)])
                };
                for s in 0..per_pixel {
                    let id = seen.id[at(s)];
                    // each triangle once, at its first sample
                    if id == NONE || (0..s).any(|r| seen.id[at(r)] == id) {
                        continue;
                    }
                    let (mut x, mut y, mut count) = (0.0, 0.0, 0.0);
                    for r in s..per_pixel {
                        if seen.id[at(r)] == id {
                            let (sx, sy) = sample(r);
                            x += sx as f32 + 0.5;
                            y += (sy + self.top) as f32 + 0.5;
                            count += 1.0;
                        }
                    }
                    let triangle = &geometry.layers[slot][id as usize];
                    let Some((color, opacity)) = shader.surface(triangle, x / count, y / count) else { continue };
                    for r in s..per_pixel {
                        if seen.id[at(r)] == id && !hidden(r) {
                            (0..3).for_each(|k| light[r][k] += opacity * (color[k] - light[r][k]));
                        }
                    }
                }
            }
            let mut sum = [0f32; 3];
            for l in &light {
                // each sample is held to what the screen can show, or a highlight would make edges jagged
                (0..3).for_each(|k| sum[k] += l[k].clamp(0.0, 1.0));
            }
            *pixel = srgb(sum.map(|v| v / per_pixel as f32));
        }
    }
}

/// 1 / w over the screen: linear, because the projection is.
struct Plane {
    dx: f32,
    dy: f32,
    origin: f32,
}

impl Plane {
    fn new(t: &Triangle) -> Self {
        let x = t.x.map(|v| f64::from(v) / f64::from(FIXED));
        let y = t.y.map(|v| f64::from(v) / f64::from(FIXED));
        let n = t.nearness.map(f64::from);
        let (ux, uy, vx, vy) = (x[1] - x[0], y[1] - y[0], x[2] - x[0], y[2] - y[0]);
        let area = ux * vy - vx * uy;
        let dx = ((n[1] - n[0]) * vy - (n[2] - n[0]) * uy) / area;
        let dy = ((n[2] - n[0]) * ux - (n[1] - n[0]) * vx) / area;
        Self { dx: dx as f32, dy: dy as f32, origin: (n[0] - dx * x[0] - dy * y[0]) as f32 }
    }

    fn row(&self, y: f32) -> f32 {
        self.origin + self.dy * y
    }
}
