//! From a scene to triangles on the screen.
//!
//! Terms: w depth along the view [m]; samples are the finer pixels that a picture is averaged from. Screen coordinates are whole
//! multiples of 1/256 of a sample, so that edge tests are exact and triangles that share an edge leave neither gap nor overlap.

use crate::camera::Camera;
use crate::color::ColorMap;
use crate::error::RenderError;
use crate::scene::{Layer, Material, RenderMesh, Scene, Settings};

/// Fixed-point steps per sample.
pub(crate) const FIXED: f32 = 256.0;

/// Screen coordinates beyond this many steps are not drawn: keeps products of two within 64 bits with room to spare.
const FARTHEST: f32 = 1e9;

/// A corner of triangles, in the world relative to the camera's target.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Vertex {
    pub(crate) position: [f32; 3],
    pub(crate) color: [f32; 4],
    pub(crate) uv: [f32; 2],
    pub(crate) scalar: f32,
}

/// A triangle on the screen, corners in order of positive area.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Triangle {
    pub(crate) x: [i32; 3],
    pub(crate) y: [i32; 3],
    /// 1 / w at the corners.
    pub(crate) nearness: [f32; 3],
    pub(crate) vertex: [u32; 3],
    /// Normals at the corners, towards the viewer's side of the triangle.
    pub(crate) normal: [[f32; 3]; 3],
    pub(crate) surface: u32,
}

/// How triangles look.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Surface {
    pub(crate) material: Material,
    pub(crate) field: Option<([f32; 2], ColorMap)>,
    /// How much of itself a glass surface shows; 1 for others.
    pub(crate) opacity: f32,
}

/// The scene as the rasteriser takes it.
pub(crate) struct Geometry {
    pub(crate) vertices: Vec<Vertex>,
    pub(crate) surfaces: Vec<Surface>,
    /// Solids, glass, x-ray.
    pub(crate) layers: [Vec<Triangle>; 3],
    /// World triangles that throw shadows, as vertex indices.
    pub(crate) casters: Vec<[u32; 3]>,
}

/// The camera in numbers of the picture.
pub(crate) struct Projection {
    target: [f64; 3],
    pub(crate) right: [f32; 3],
    pub(crate) up: [f32; 3],
    pub(crate) back: [f32; 3],
    pub(crate) distance: f32,
    /// Samples per unit of x / w.
    pub(crate) focal: f32,
    /// Middle of the picture in samples.
    pub(crate) middle: [f32; 2],
    near: f32,
}

impl Projection {
    pub(crate) fn new(camera: &Camera, settings: &Settings) -> Result<Self, RenderError> {
        let numbers = [camera.distance, camera.yaw, camera.pitch, camera.field_of_view];
        if !numbers.iter().chain(&camera.target).all(|v| v.is_finite()) {
            return Err(RenderError::Camera("a number is not finite"));
        }
        if !(camera.distance > 0.0 && camera.distance < 1e9) {
            return Err(RenderError::Camera("the distance must be more than 0 and less than 1e9 m"));
        }
        if !(1.0..=150.0).contains(&camera.field_of_view) {
            return Err(RenderError::Camera("the field of view must be 1 to 150 degrees"));
        }
        let [right, up, back] = camera.axes().map(|a| a.map(|v| v as f32));
        let (width, height) = ((settings.width * settings.samples) as f32, (settings.height * settings.samples) as f32);
        Ok(Self {
            target: camera.target,
            right,
            up,
            back,
            distance: camera.distance as f32,
            focal: 0.5 * height / (0.5 * camera.field_of_view.to_radians()).tan() as f32,
            middle: [0.5 * width, 0.5 * height],
            near: 0.02 * camera.distance as f32,
        })
    }

    /// A world point relative to the target; `None` when it is not finite there.
    fn local(&self, p: [f64; 3]) -> Option<[f32; 3]> {
        let q: [f32; 3] = std::array::from_fn(|k| (p[k] - self.target[k]) as f32);
        q.iter().all(|v| v.abs() < 1e12).then_some(q)
    }

    pub(crate) fn depth(&self, p: [f32; 3]) -> f32 {
        self.distance - dot(p, self.back)
    }

    /// Place on the screen in samples, y down.
    fn screen(&self, p: [f32; 3]) -> [f32; 2] {
        let s = self.focal / self.depth(p);
        [self.middle[0] + s * dot(p, self.right), self.middle[1] - s * dot(p, self.up)]
    }

    /// The eye relative to the target.
    pub(crate) fn eye(&self) -> [f32; 3] {
        self.back.map(|v| v * self.distance)
    }

    /// Height `y` of the world relative to the target.
    pub(crate) fn local_height(&self, y: f64) -> f32 {
        (y - self.target[1]) as f32
    }
}

impl Geometry {
    pub(crate) fn new(scene: &Scene<'_>, view: &Projection, samples: f32) -> Result<Self, RenderError> {
        let mut out = Self {
            vertices: Vec::new(),
            surfaces: Vec::new(),
            layers: [Vec::new(), Vec::new(), Vec::new()],
            casters: Vec::new(),
        };
        for (i, mesh) in scene.meshes.iter().enumerate() {
            check(mesh, scene.textures.len()).map_err(|what| RenderError::Mesh { mesh: i, what })?;
            out.add_mesh(mesh, view);
        }
        out.add_marks(scene, view, samples);
        Ok(out)
    }

    fn add_mesh(&mut self, mesh: &RenderMesh<'_>, view: &Projection) {
        let (first_surface, base) = (self.surfaces.len() as u32, self.vertices.len() as u32);
        let opacity = if let Layer::Glass(share) = mesh.layer { share.clamp(0.0, 1.0) } else { 1.0 };
        let field = mesh.scalar.as_ref().map(|s| (s.range, s.map));
        let mut add_surface = |material: Material| self.surfaces.push(Surface { material, field, opacity });
        if mesh.materials.is_empty() {
            add_surface(Material::default());
        }
        for m in &mesh.materials {
            add_surface(Material { texture: m.texture.filter(|_| !mesh.texture_coordinates.is_empty()), ..*m });
        }
        let mut finite = vec![true; mesh.positions.len()];
        for (v, p) in mesh.positions.iter().enumerate() {
            let position = view.local(*p).unwrap_or_else(|| {
                finite[v] = false;
                [0.0; 3]
            });
            self.vertices.push(Vertex {
                position,
                color: mesh.colors.get(v).copied().unwrap_or([1.0; 4]),
                uv: mesh.texture_coordinates.get(v).copied().unwrap_or([0.0; 2]),
                scalar: mesh.scalar.as_ref().and_then(|s| s.values.get(v)).copied().unwrap_or(f32::NAN),
            });
        }
        let by_triangle = mesh
            .scalar
            .as_ref()
            .filter(|s| s.values.len() == mesh.triangles.len() && s.values.len() != mesh.positions.len());
        let kept: Vec<usize> =
            (0..mesh.triangles.len()).filter(|t| mesh.triangles[*t].iter().all(|v| finite[*v as usize])).collect();
        let local: Vec<[f32; 3]> = self.vertices[base as usize..].iter().map(|v| v.position).collect();
        let normals = corner_normals(&local, &mesh.triangles, &kept, mesh.faceted);
        for (t, normal) in kept.into_iter().zip(normals) {
            let mut vertex = mesh.triangles[t].map(|v| v + base);
            if let Some(field) = by_triangle {
                vertex = vertex.map(|v| {
                    self.vertices.push(Vertex { scalar: field.values[t], ..self.vertices[v as usize] });
                    self.vertices.len() as u32 - 1
                });
            }
            if mesh.layer == Layer::Solid && !mesh.shadowless {
                self.casters.push(vertex);
            }
            let surface = first_surface + mesh.material.get(t).copied().unwrap_or(0);
            self.add_triangle(mesh.layer, vertex, normal, surface, view);
        }
    }

    /// Clips a triangle at the near plane and puts it on the screen.
    fn add_triangle(&mut self, layer: Layer, vertex: [u32; 3], normal: [[f32; 3]; 3], surface: u32, view: &Projection) {
        let depth = vertex.map(|v| view.depth(self.vertices[v as usize].position));
        if depth.iter().all(|w| *w >= view.near) {
            return self.push(layer, vertex, normal, surface, view);
        }
        let mut kept: Vec<(u32, [f32; 3])> = Vec::with_capacity(4);
        for c in 0..3 {
            let n = (c + 1) % 3;
            if depth[c] >= view.near {
                kept.push((vertex[c], normal[c]));
            }
            if (depth[c] >= view.near) != (depth[n] >= view.near) {
                let t = (view.near - depth[c]) / (depth[n] - depth[c]);
                let (a, b) = (self.vertices[vertex[c] as usize], self.vertices[vertex[n] as usize]);
                self.vertices.push(Vertex {
                    position: lerp(a.position, b.position, t),
                    color: lerp(a.color, b.color, t),
                    uv: lerp(a.uv, b.uv, t),
                    scalar: a.scalar + t * (b.scalar - a.scalar),
                });
                kept.push((self.vertices.len() as u32 - 1, lerp(normal[c], normal[n], t)));
            }
        }
        for k in 2..kept.len() {
            let corner = [kept[0], kept[k - 1], kept[k]];
            self.push(layer, corner.map(|c| c.0), corner.map(|c| c.1), surface, view);
        }
    }

    fn push(&mut self, layer: Layer, mut vertex: [u32; 3], mut normal: [[f32; 3]; 3], surface: u32, view: &Projection) {
        let positions = vertex.map(|v| self.vertices[v as usize].position);
        let screen = positions.map(|p| view.screen(p).map(|c| (c * FIXED).round()));
        if !screen.iter().flatten().all(|c| c.abs() < FARTHEST) {
            return;
        }
        let mut x = screen.map(|s| s[0] as i32);
        let mut y = screen.map(|s| s[1] as i32);
        let mut nearness = positions.map(|p| 1.0 / view.depth(p));
        let span = |a: [i32; 3], i: usize| i64::from(a[i]) - i64::from(a[0]);
        let area = span(x, 1) * span(y, 2) - span(x, 2) * span(y, 1);
        if area == 0 {
            return;
        }
        // y runs down the screen: fronts have negative area
        if area < 0 {
            x.swap(1, 2);
            y.swap(1, 2);
            nearness.swap(1, 2);
            vertex.swap(1, 2);
            normal.swap(1, 2);
        } else {
            normal = normal.map(|n| n.map(|v| -v));
        }
        let slot = match layer {
            Layer::Solid => 0,
            Layer::Glass(_) => 1,
            Layer::XRay => 2,
        };
        self.layers[slot].push(Triangle { x, y, nearness, vertex, normal, surface });
    }

    /// Lines as narrow strips and points as small balls, both facing the viewer.
    fn add_marks(&mut self, scene: &Scene<'_>, view: &Projection, samples: f32) {
        if scene.lines.is_empty() && scene.points.is_empty() {
            return;
        }
        let mark = |unlit: bool| Material { base_color: [1.0; 4], unlit, gloss: 0.3, ..Material::default() };
        let flat = self.surfaces.len() as u32;
        self.surfaces.push(Surface { material: mark(true), field: None, opacity: 1.0 });
        self.surfaces.push(Surface { material: mark(false), field: None, opacity: 1.0 });
        for line in &scene.lines {
            let (Some(mut a), Some(mut b)) = (view.local(line.ends[0]), view.local(line.ends[1])) else { continue };
            let (wa, wb) = (view.depth(a), view.depth(b));
            if wa < view.near && wb < view.near {
                continue;
            }
            let cut = |from: [f32; 3], to: [f32; 3], wf: f32, wt: f32| lerp(from, to, (view.near - wf) / (wt - wf));
            if wa < view.near {
                a = cut(a, b, wa, wb);
            } else if wb < view.near {
                b = cut(b, a, wb, wa);
            }
            let (sa, sb) = (view.screen(a), view.screen(b));
            let along = [sb[0] - sa[0], sb[1] - sa[1]];
            let length = (along[0] * along[0] + along[1] * along[1]).sqrt();
            if length.is_nan() || length <= 1e-3 {
                continue;
            }
            let corner = |p: [f32; 3], side: f32| {
                let half = side * 0.5 * line.width.clamp(0.0, 1e3) * samples * view.depth(p) / view.focal;
                // across the line on the screen; y runs down there
                let (r, u) = (-along[1] / length * half, -along[0] / length * half);
                // a little nearer than the surface the line lies on
                let lift = 0.003 * view.depth(p);
                std::array::from_fn(|k| p[k] + r * view.right[k] + u * view.up[k] + lift * view.back[k])
            };
            let base =
                self.mark_vertices(&[corner(a, -1.0), corner(a, 1.0), corner(b, 1.0), corner(b, -1.0)], line.color);
            for t in [[0, 1, 2], [0, 2, 3]] {
                self.add_triangle(line.layer, t.map(|v| v + base), [view.back; 3], flat, view);
            }
        }
        // a ball seen from the front: its middle, and a ring where it curves away
        const RING: [[f32; 2]; 8] = [
            [1.0, 0.0],
            [0.707_106_77, 0.707_106_77],
            [0.0, 1.0],
            [-0.707_106_77, 0.707_106_77],
            [-1.0, 0.0],
            [-0.707_106_77, -0.707_106_77],
            [0.0, -1.0],
            [0.707_106_77, -0.707_106_77],
        ];
        for point in &scene.points {
            let Some(p) = view.local(point.position) else { continue };
            let w = view.depth(p);
            if w < view.near {
                continue;
            }
            let radius = point.radius.clamp(0.0, 1e3) * samples * w / view.focal;
            let at = |c: [f32; 2], out: f32| {
                std::array::from_fn(|k| p[k] + radius * (c[0] * view.right[k] + c[1] * view.up[k] + out * view.back[k]))
            };
            let mut corners = vec![at([0.0; 2], 1.0)];
            corners.extend(RING.map(|c| at(c, 0.5)));
            let base = self.mark_vertices(&corners, point.color);
            let tilted = |c: [f32; 2]| {
                std::array::from_fn(|k| 0.8 * (c[0] * view.right[k] + c[1] * view.up[k]) + 0.6 * view.back[k])
            };
            for i in 0..8 {
                let j = (i + 1) % 8;
                let vertex = [base, base + 1 + i as u32, base + 1 + j as u32];
                self.add_triangle(point.layer, vertex, [view.back, tilted(RING[i]), tilted(RING[j])], flat + 1, view);
            }
        }
    }

    fn mark_vertices(&mut self, positions: &[[f32; 3]], color: [f32; 3]) -> u32 {
        let base = self.vertices.len() as u32;
        let color = [color[0], color[1], color[2], 1.0];
        self.vertices.extend(positions.iter().map(|p| Vertex { position: *p, color, uv: [0.0; 2], scalar: f32::NAN }));
        base
    }
}

/// Whether indices and lengths fit.
fn check(mesh: &RenderMesh<'_>, textures: usize) -> Result<(), String> {
    let n = mesh.positions.len();
    if let Some(v) = mesh.triangles.iter().flatten().find(|v| **v as usize >= n) {
        return Err(format!("a triangle uses vertex {v} of {n}"));
    }
    let surfaces = mesh.materials.len().max(1);
    if let Some(m) = mesh.material.iter().find(|m| **m as usize >= surfaces) {
        return Err(format!("a triangle uses material {m} of {surfaces}"));
    }
    if let Some(t) = mesh.materials.iter().filter_map(|m| m.texture).find(|t| *t >= textures) {
        return Err(format!("a material uses texture {t} of {textures}"));
    }
    for (what, len) in [("colours", mesh.colors.len()), ("texture coordinates", mesh.texture_coordinates.len())] {
        if len != 0 && len != n {
            return Err(format!("{len} {what} for {n} vertices"));
        }
    }
    if !mesh.material.is_empty() && mesh.material.len() != mesh.triangles.len() {
        return Err(format!("{} material numbers for {} triangles", mesh.material.len(), mesh.triangles.len()));
    }
    match &mesh.scalar {
        Some(s) if s.values.len() != n && s.values.len() != mesh.triangles.len() => {
            Err(format!("{} values for {n} vertices and {} triangles", s.values.len(), mesh.triangles.len()))
        }
        _ => Ok(()),
    }
}

/// Normals at the corners of the kept triangles. Vertices at the same place count as one, so that seams of texture do not show;
/// where faces meet at more than about 60 degrees the edge stays hard, with a smooth transition so that nothing flickers.
fn corner_normals(p: &[[f32; 3]], triangles: &[[u32; 3]], kept: &[usize], faceted: bool) -> Vec<[[f32; 3]; 3]> {
    let face: Vec<[f32; 3]> = kept
        .iter()
        .map(|t| {
            let [a, b, c] = triangles[*t].map(|v| p[v as usize]);
            unit(cross(sub(b, a), sub(c, a)))
        })
        .collect();
    if faceted {
        return face.into_iter().map(|n| [n; 3]).collect();
    }
    let key = |v: u32| p[v as usize].map(|c| (c + 0.0).to_bits());
    let mut sorted: Vec<u32> = (0..p.len() as u32).collect();
    sorted.sort_unstable_by_key(|v| (key(*v), *v));
    let mut group = vec![0u32; p.len()];
    let mut groups = 0;
    for (i, v) in sorted.iter().enumerate() {
        if i > 0 && key(*v) != key(sorted[i - 1]) {
            groups += 1;
        }
        group[*v as usize] = groups;
    }
    // corners of each group: (kept triangle, weighted normal)
    let mut start = vec![0u32; groups as usize + 2];
    let corners = || kept.iter().enumerate().flat_map(|(k, t)| (0..3).map(move |c| (k, *t, c)));
    for (_, t, c) in corners() {
        start[group[triangles[t][c] as usize] as usize + 1] += 1;
    }
    for g in 1..start.len() {
        start[g] += start[g - 1];
    }
    let mut fill = start.clone();
    let mut fan: Vec<(u32, [f32; 3])> = vec![(0, [0.0; 3]); 3 * kept.len()];
    for (k, t, c) in corners() {
        let [a, b, d] = [0, 1, 2].map(|i| p[triangles[t][(c + i) % 3] as usize]);
        let (u, v) = (sub(b, a), sub(d, a));
        // exact for corners on a sphere [Max1999], and no trigonometry
        let lengths = dot(u, u) * dot(v, v);
        let n = if lengths > 0.0 { cross(u, v).map(|x| x / lengths) } else { [0.0; 3] };
        let slot = &mut fill[group[triangles[t][c] as usize] as usize];
        fan[*slot as usize] = (k as u32, n);
        *slot += 1;
    }
    kept.iter()
        .enumerate()
        .map(|(k, t)| {
            triangles[*t].map(|v| {
                let g = group[v as usize] as usize;
                let mut sum = [0.0; 3];
                for (other, n) in &fan[start[g] as usize..start[g + 1] as usize] {
                    let s = ((dot(face[k], face[*other as usize]) - 0.3) / 0.4).clamp(0.0, 1.0);
                    let share = s * s * (3.0 - 2.0 * s);
                    (0..3).for_each(|i| sum[i] += share * n[i]);
                }
                let n = unit(sum);
                if n == [0.0; 3] { face[k] } else { n }
            })
        })
        .collect()
}

pub(crate) fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

pub(crate) fn sub(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

pub(crate) fn cross(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// Unit vector, or zero where there is no direction.
pub(crate) fn unit(v: [f32; 3]) -> [f32; 3] {
    // scaled first: squares of tiny edges would vanish
    let most = v.iter().fold(0.0f32, |m, c| m.max(c.abs()));
    if !(most > 0.0 && most.is_finite()) {
        return [0.0; 3];
    }
    let s = v.map(|c| c / most);
    let length = dot(s, s).sqrt();
    s.map(|c| c / length)
}

pub(crate) fn lerp<const N: usize>(a: [f32; N], b: [f32; N], t: f32) -> [f32; N] {
    std::array::from_fn(|k| a[k] + t * (b[k] - a[k]))
}
