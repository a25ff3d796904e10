//! Objects of a scene: their mesh, how they look, and the constraints between them.

use crate::failure::Failure;
use crate::scene::{ConstraintKind, Object, Scene, SceneConstraint};
use softrig::character::{Character, CharacterMesh, Look, Skin};
use softrig::mesh::{VolumeMesh, boundary_faces};
use softrig::rig::{Affine, Clip, Skeleton};
use softrig::simulation::Key;
use softrig_explicit::constraint::{Constraint, Surface, SurfaceId};
use softrig_explicit::objects::{Objects, Timed};
use softrig_explicit::sample::five_tets;
use std::collections::BTreeMap;

/// All boxes of a scene in one mesh.
#[derive(Clone, Debug)]
pub struct Layout {
    /// Objects one after the other, their copies along X, Y and Z, the last fastest.
    pub mesh: VolumeMesh,
    /// First node of each object.
    first: Vec<u32>,
}

fn nodes_of_box(o: &Object) -> usize {
    o.cells.iter().map(|n| n + 1).product()
}

fn copies(o: &Object) -> impl Iterator<Item = [usize; 3]> + '_ {
    let [nx, ny, nz] = o.copies;
    (0..nx).flat_map(move |i| (0..ny).flat_map(move |j| (0..nz).map(move |k| [i, j, k])))
}

impl Layout {
    /// The mesh of a scene's objects.
    #[must_use]
    pub fn new(scene: &Scene) -> Self {
        let mut mesh = VolumeMesh::default();
        let mut first = Vec::new();
        for o in &scene.object {
            first.push(mesh.node_count() as u32);
            let one =
                five_tets(o.cells, false, |p| [p[0] * o.size[0], p[1] * o.size[1] + o.rise * p[0], p[2] * o.size[2]]);
            for copy in copies(o) {
                let base = mesh.node_count() as u32;
                let corner: [f64; 3] = std::array::from_fn(|k| o.position[k] + copy[k] as f64 * o.spacing[k]);
                mesh.nodes.extend(one.nodes.iter().map(|p| -> [f64; 3] { std::array::from_fn(|k| corner[k] + p[k]) }));
                mesh.tets.extend(one.tets.iter().map(|t| t.map(|n| n + base)));
            }
        }
        first.push(mesh.node_count() as u32);
        Self { mesh, first }
    }

    fn object(&self, scene: &Scene, name: &str) -> Result<usize, String> {
        let names = || scene.object.iter().map(|o| o.name.as_str()).collect::<Vec<_>>().join(", ");
        let found = scene.object.iter().position(|o| o.name == name);
        found.ok_or_else(|| format!("there is no object `{name}`; the objects are: {}", names()))
    }

    /// First node of one box.
    fn box_of(&self, scene: &Scene, object: usize, copy: [usize; 3]) -> u32 {
        let o = &scene.object[object];
        let index = (copy[0] * o.copies[1] + copy[1]) * o.copies[2] + copy[2];
        self.first[object] + (index * nodes_of_box(o)) as u32
    }

    /// Number within its box of the node at a place.
    fn node_at(o: &Object, at: [f64; 3]) -> Result<u32, String> {
        let mut index = [0; 3];
        for k in 0..3 {
            let steps = at[k] / o.size[k] * o.cells[k] as f64;
            let whole = steps.round();
            if (steps - whole).abs() > 1e-6 || whole < 0.0 || whole > o.cells[k] as f64 {
                let edges = [0, 1, 2].map(|k| o.size[k] / o.cells[k] as f64);
                return Err(format!(
                    "no node of `{}` is at {at:?}; its nodes are {edges:?} m apart, from its corner",
                    o.name
                ));
            }
            index[k] = whole as usize;
        }
        Ok(((index[0] * (o.cells[1] + 1) + index[1]) * (o.cells[2] + 1) + index[2]) as u32)
    }

    /// Triangles around an object.
    fn surface(&self, faces: &[[u32; 3]], object: usize) -> Vec<[u32; 3]> {
        let own = self.first[object]..self.first[object + 1];
        faces.iter().copied().filter(|t| own.contains(&t[0])).collect()
    }
}

/// The character that stands for the objects of a scene: one mesh for each, no joints.
#[must_use]
pub fn character(scene: &Scene) -> Character {
    let layout = Layout::new(scene);
    let faces = boundary_faces(&layout.mesh).triangles;
    let mut meshes = Vec::new();
    let mut looks = Vec::new();
    for (i, o) in scene.object.iter().enumerate() {
        let own = layout.surface(&faces, i);
        let mut number = BTreeMap::new();
        own.iter().flatten().for_each(|n| _ = number.insert(*n, 0u32));
        number.values_mut().enumerate().for_each(|(k, v)| *v = k as u32);
        let [r, g, b] = o.color.unwrap_or(PALETTE[i % PALETTE.len()]);
        looks.push(Look { name: o.name.clone(), base_color: [r, g, b, 1.0], texture: None });
        meshes.push(CharacterMesh {
            name: o.name.clone(),
            positions: number.keys().map(|n| layout.mesh.nodes[*n as usize]).collect(),
            triangles: own.iter().map(|t| t.map(|n| number[&n])).collect(),
            look: vec![i as u32; own.len()],
            skin: Skin::Free,
            ..CharacterMesh::default()
        });
    }
    let skeleton = Skeleton::new(Vec::new(), Affine::IDENTITY).expect("no joints form no cycle");
    Character {
        name: "objects".into(),
        meshes,
        skeleton,
        clips: Vec::new(),
        looks,
        textures: Vec::new(),
        notes: Vec::new(),
    }
}

/// Linear colours that can be told apart.
const PALETTE: [[f32; 3]; 6] = [
    [0.62, 0.21, 0.12],
    [0.10, 0.28, 0.55],
    [0.16, 0.42, 0.16],
    [0.75, 0.50, 0.12],
    [0.36, 0.16, 0.46],
    [0.4, 0.4, 0.4],
];

/// Nodes of the surface vertices of each object, in the order of the meshes of [`character`].
#[must_use]
pub fn surface_nodes(scene: &Scene, layout: &Layout) -> Vec<Vec<u32>> {
    let faces = boundary_faces(&layout.mesh).triangles;
    (0..scene.object.len())
        .map(|i| {
            let mut nodes: Vec<u32> = layout.surface(&faces, i).into_iter().flatten().collect();
            nodes.sort_unstable();
            nodes.dedup();
            nodes
        })
        .collect()
}

/// What stands for the clip of a scene of objects.
#[must_use]
pub fn clip(scene: &Scene) -> Clip {
    let end = scene.motion.duration.unwrap_or(1.0) * scene.motion.speed;
    Clip { name: "objects".into(), start: 0.0, end, tracks: Vec::new() }
}

/// Puts the constraints of a scene on its bodies.
///
/// # Errors
/// [`Failure::Input`] names the constraint and what to change.
pub fn constrain(scene: &Scene, layout: &Layout, objects: &mut Objects) -> Result<(), Failure> {
    let faces = boundary_faces(&layout.mesh).triangles;
    let mut surfaces = BTreeMap::new();
    for (i, c) in scene.constraint.iter().enumerate() {
        let failed = |e: String| Failure::Input(format!("constraint {}: {e}", i + 1));
        let mut build = Builder { scene, layout, faces: &faces, objects, surfaces: &mut surfaces };
        for constraint in build.all(c).map_err(failed)? {
            let timed = Timed {
                constraint,
                start: c.start,
                end: c.end.unwrap_or(f64::INFINITY),
                ramp: c.ramp,
                path: c.path.iter().map(|p| Key { time: p[0], position: [p[1], p[2], p[3]] }).collect(),
            };
            objects.add(timed).map_err(|e| failed(e.to_string()))?;
        }
    }
    Ok(())
}

struct Builder<'a> {
    scene: &'a Scene,
    layout: &'a Layout,
    faces: &'a [[u32; 3]],
    objects: &'a mut Objects,
    surfaces: &'a mut BTreeMap<usize, SurfaceId>,
}

impl Builder<'_> {
    /// The constraints of one entry, a node each.
    fn all(&mut self, c: &SceneConstraint) -> Result<Vec<Constraint>, String> {
        let (scene, layout) = (self.scene, self.layout);
        let object = layout.object(scene, &c.object)?;
        let o = &scene.object[object];
        let to = c.to.as_ref().map(|name| layout.object(scene, name)).transpose()?;
        let within = c.copies.unwrap_or([[0; 3], o.copies]);
        let places: Vec<u32> = if c.at.is_empty() {
            (0..nodes_of_box(o) as u32).collect()
        } else {
            c.at.iter().map(|p| Layout::node_at(o, *p)).collect::<Result<_, _>>()?
        };
        let other = &scene.object[to.unwrap_or(object)];
        let ends: Vec<u32> = c.to_at.iter().map(|p| Layout::node_at(other, *p)).collect::<Result<_, _>>()?;
        let mut out = Vec::new();
        for copy in copies(o).filter(|n| (0..3).all(|k| (within[0][k]..within[1][k]).contains(&n[k]))) {
            let first = layout.box_of(scene, object, copy);
            let target = match (c.next, to) {
                (Some(next), _) => {
                    let there: [usize; 3] = std::array::from_fn(|k| copy[k].saturating_add(next[k]));
                    if (0..3).any(|k| there[k] >= o.copies[k]) {
                        continue;
                    }
                    layout.box_of(scene, object, there)
                }
                (None, Some(to)) => layout.first[to],
                (None, None) => 0,
            };
            for (k, place) in places.iter().enumerate() {
                let node = first + place;
                out.push(match (c.kind, to) {
                    (ConstraintKind::Join, _) => Constraint::PointsToPoint { nodes: vec![node, target + ends[k]] },
                    (kind, Some(to)) => self.carried(kind, node, to)?,
                    (_, None) => Constraint::Nail { node, goal: layout.mesh.nodes[node as usize] },
                });
            }
        }
        if out.is_empty() { Err("it holds no node; look at `copies` and `next`".into()) } else { Ok(out) }
    }

    fn carried(&mut self, kind: ConstraintKind, node: u32, to: usize) -> Result<Constraint, String> {
        let nodes = &self.layout.mesh.nodes;
        let own = self.layout.first[to]..self.layout.first[to + 1];
        let place = nodes[node as usize];
        let at = |n: u32| nodes[n as usize];
        let tets = || self.layout.mesh.tets.iter().filter(|t| own.contains(&t[0]));
        match kind {
            ConstraintKind::Surface => {
                let surface = match self.surfaces.get(&to) {
                    Some(id) => *id,
                    None => {
                        let triangles = self.layout.surface(self.faces, to);
                        let id = self.objects.add_surface(triangles).map_err(|e| e.to_string())?;
                        self.surfaces.insert(to, id);
                        id
                    }
                };
                Ok(Constraint::PointToSurface { node, surface })
            }
            ConstraintKind::Triangle => {
                let triangles = self.layout.surface(self.faces, to);
                let mut surface = Surface::new(triangles, nodes.len()).map_err(|e| e.to_string())?;
                surface.fit(&at);
                let c = surface.closest(place, &at).ok_or("the object has no surface")?;
                Ok(Constraint::PointToTriangle { node, carriers: c.nodes, weights: c.weights })
            }
            ConstraintKind::Line => {
                let mut best = (f64::INFINITY, [0; 2], 0.0);
                for t in tets() {
                    for (i, j) in [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)] {
                        let (a, b) = (glam::DVec3::from(at(t[i])), glam::DVec3::from(at(t[j])));
                        let p = glam::DVec3::from(place);
                        let s = ((p - a).dot(b - a) / a.distance_squared(b)).clamp(0.0, 1.0);
                        let far = p.distance(a.lerp(b, s));
                        if far < best.0 {
                            best = (far, [t[i], t[j]], s);
                        }
                    }
                }
                let (_, carriers, s) = best;
                Ok(Constraint::PointToLine { node, carriers, weights: [1.0 - s, s] })
            }
            _ => {
                for t in tets() {
                    let (g, _) = softrig::force::tet_gradients(t.map(at));
                    let from = at(t[0]);
                    let w = g.map(|g| (0..3).map(|k| g[k] * (place[k] - from[k])).sum::<f64>());
                    let mut weights = [1.0 - w[0] - w[1] - w[2], w[0], w[1], w[2]];
                    if weights.iter().all(|w| *w >= -1e-9) {
                        weights = weights.map(|w| w.max(0.0));
                        let sum: f64 = weights.iter().sum();
                        let weights = weights.map(|w| w / sum);
                        return Ok(Constraint::PointToTetrahedron { node, carriers: *t, weights });
                    }
                }
                let name = &self.scene.object[to].name;
                Err(format!(
                    "the node at {place:?} lies in no tetrahedron of `{name}`; use `triangle`, or move it inside"
                ))
            }
        }
    }
}
