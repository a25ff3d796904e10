//! What is inside a character: cells, bones, bound nodes.

use crate::color::bone_color;
use crate::scene::{Layer, Line, Material, Point, RenderMesh};
use softrig::mesh::VolumeMesh;
use softrig::rig::{JointId, Pose, Skeleton};

/// Faces of a hexahedron seen from outside, counter-clockwise.
const HEX_FACES: [[usize; 4]; 6] = [[0, 3, 2, 1], [4, 5, 6, 7], [0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]];

/// Faces of a tetrahedron seen from outside, counter-clockwise.
const TET_FACES: [[usize; 3]; 4] = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]];

/// A face that only one cell has: its nodes, the last one twice for a triangle, and the cell.
struct OuterFace {
    nodes: [u32; 4],
    cell: u32,
}

fn outer_faces(volume: &VolumeMesh) -> Vec<OuterFace> {
    let mut faces: Vec<([u32; 4], OuterFace)> = Vec::new();
    let mut add = |nodes: [u32; 4], cell: usize| {
        let mut key = nodes;
        key.sort_unstable();
        faces.push((key, OuterFace { nodes, cell: cell as u32 }));
    };
    for (cell, t) in volume.tets.iter().enumerate() {
        TET_FACES.iter().for_each(|f| add([t[f[0]], t[f[1]], t[f[2]], t[f[2]]], cell));
    }
    for (i, h) in volume.hexes.iter().enumerate() {
        HEX_FACES.iter().for_each(|f| add(f.map(|c| h[c]), volume.tets.len() + i));
    }
    // equal triangles have equal keys whichever node is repeated
    for (key, _) in &mut faces {
        let repeated = (0..3).find(|k| key[*k] == key[k + 1]);
        if let Some(k) = repeated {
            *key = match k {
                0 => [key[1], key[2], key[3], u32::MAX],
                1 => [key[0], key[2], key[3], u32::MAX],
                _ => [key[0], key[1], key[3], u32::MAX],
            };
        }
    }
    faces.sort_by_key(|f| (f.0, f.1.cell));
    let mut outer = Vec::new();
    let mut rest = faces.into_iter().peekable();
    while let Some((key, face)) = rest.next() {
        let mut alone = true;
        while rest.next_if(|f| f.0 == key).is_some() {
            alone = false;
        }
        if alone {
            outer.push(face);
        }
    }
    outer.sort_by_key(|f| f.cell);
    outer
}

/// The outside of a volume mesh as facets, for positions of its nodes [m]; and the cell of each triangle, to paint numbers per cell.
/// Empty when `nodes` are not those of the mesh.
#[must_use]
pub fn mesh_surface(volume: &VolumeMesh, nodes: &[[f64; 3]]) -> (RenderMesh<'static>, Vec<u32>) {
    let mut mesh = RenderMesh { faceted: true, materials: vec![Material::default()], ..RenderMesh::default() };
    let mut cells = Vec::new();
    if nodes.len() == volume.node_count() {
        mesh.positions = nodes.to_vec().into();
        let triangles = mesh.triangles.to_mut();
        for face in outer_faces(volume) {
            let [a, b, c, d] = face.nodes;
            triangles.push([a, b, c]);
            cells.push(face.cell);
            if c != d {
                triangles.push([a, c, d]);
                cells.push(face.cell);
            }
        }
    }
    (mesh, cells)
}

/// The edges of the outer faces of a volume mesh, for positions of its nodes [m]. With [`Layer::Solid`] they are hidden by what is in
/// front of them, with [`Layer::XRay`] all are seen. Empty when `nodes` are not those of the mesh.
#[must_use]
pub fn mesh_overlay(volume: &VolumeMesh, nodes: &[[f64; 3]], layer: Layer) -> Vec<Line> {
    if nodes.len() != volume.node_count() {
        return Vec::new();
    }
    let mut edges: Vec<[u32; 2]> = outer_faces(volume)
        .iter()
        .flat_map(|f| (0..4).map(|c| [f.nodes[c], f.nodes[(c + 1) % 4]]))
        .filter(|e| e[0] != e[1])
        .map(|e| [e[0].min(e[1]), e[0].max(e[1])])
        .collect();
    edges.sort_unstable();
    edges.dedup();
    let line = |e: [u32; 2]| Line { ends: e.map(|v| nodes[v as usize]), color: [0.03, 0.05, 0.08], width: 1.0, layer };
    edges.into_iter().map(line).collect()
}

/// Dots at nodes, coloured by the bone each is bound to. `bound` lists nodes with the joint each hangs on.
#[must_use]
pub fn node_points(nodes: &[[f64; 3]], bound: &[(u32, JointId)], layer: Layer) -> Vec<Point> {
    let point = |(node, joint): &(u32, JointId)| {
        let position = *nodes.get(*node as usize)?;
        Some(Point { position, color: bone_color(joint.index()), radius: 2.6, layer })
    };
    bound.iter().filter_map(point).collect()
}

/// Dots at joints: pins, targets, whatever should be marked.
#[must_use]
pub fn joint_points(pose: &Pose, joints: &[JointId], color: [f32; 3], layer: Layer) -> Vec<Point> {
    joints
        .iter()
        .filter_map(|j| pose.world.get(j.index()))
        .map(|frame| Point { position: frame.translation, color, radius: 4.0, layer })
        .collect()
}

/// How bones are drawn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BoneStyle {
    /// What hides them.
    pub layer: Layer,
    /// Linear RGB of all; `None`: each bone in the colour of [`bone_color`].
    pub color: Option<[f32; 3]>,
}

impl Default for BoneStyle {
    /// Ivory, seen through the flesh.
    fn default() -> Self {
        Self { layer: Layer::XRay, color: Some([0.86, 0.80, 0.66]) }
    }
}

/// Bones as octahedral sticks from joint to joint with a ball at every joint. `bones` are the joints to show; a bone reaches to each of
/// its nearest shown descendants, a leaf continues its parent.
#[must_use]
pub fn bones_overlay(skeleton: &Skeleton, pose: &Pose, bones: &[JointId], style: BoneStyle) -> RenderMesh<'static> {
    let mut out = RenderMesh {
        layer: style.layer,
        materials: vec![Material { base_color: [1.0; 4], ..Material::default() }],
        faceted: true,
        shadowless: true,
        ..RenderMesh::default()
    };
    if pose.world.len() != skeleton.joint_count() {
        return out;
    }
    let mut shown = vec![false; skeleton.joint_count()];
    for joint in bones {
        if let Some(s) = shown.get_mut(joint.index()) {
            *s = true;
        }
    }
    let at = |j: usize| pose.world[j].translation;
    // the nearest shown ancestor of each joint
    let above = |j: usize| {
        let mut at = skeleton.joints()[j].parent;
        while let Some(p) = at {
            if shown[p.index()] {
                return Some(p.index());
            }
            at = skeleton.joint(p).parent;
        }
        None
    };
    let mut lengths = vec![0.0f64; shown.len()];
    let mut sticks = Vec::new();
    for j in (0..shown.len()).filter(|j| shown[*j]) {
        if let Some(p) = above(j) {
            let length = distance(at(p), at(j));
            lengths[p] = if lengths[p] > 0.0 { lengths[p].min(length) } else { length };
            sticks.push((p, at(p), at(j)));
        }
    }
    for j in 0..shown.len() {
        // a leaf, as long as half its parent's bone
        if let Some(p) = above(j).filter(|_| shown[j] && lengths[j] == 0.0) {
            let (a, b) = (at(p), at(j));
            let tip = std::array::from_fn(|k| b[k] + 0.5 * (b[k] - a[k]));
            lengths[j] = 0.5 * distance(a, b);
            sticks.push((j, b, tip));
        }
    }
    let color = |j: usize| style.color.unwrap_or_else(|| bone_color(j));
    for (j, a, b) in sticks {
        stick(&mut out, a, b, color(j));
    }
    let typical = {
        let mut sorted: Vec<f64> = lengths.iter().copied().filter(|l| *l > 0.0).collect();
        sorted.sort_by(f64::total_cmp);
        sorted.get(sorted.len() / 2).copied().unwrap_or(0.1)
    };
    for j in (0..shown.len()).filter(|j| shown[*j]) {
        ball(&mut out, at(j), 0.1 * typical, color(j));
    }
    out
}

fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f64>().sqrt()
}

fn push(out: &mut RenderMesh<'_>, positions: &[[f64; 3]], triangles: &[[u32; 3]], color: [f32; 3]) {
    let base = out.positions.len() as u32;
    out.positions.to_mut().extend_from_slice(positions);
    out.triangles.to_mut().extend(triangles.iter().map(|t| t.map(|v| v + base)));
    let color = [color[0], color[1], color[2], 1.0];
    out.colors.to_mut().extend(positions.iter().map(|_| color));
}

/// Faces of an octahedron with the corners: one end, four around, the other end.
const OCTAHEDRON: [[u32; 3]; 8] =
    [[0, 2, 1], [0, 3, 2], [0, 4, 3], [0, 1, 4], [5, 1, 2], [5, 2, 3], [5, 3, 4], [5, 4, 1]];

fn stick(out: &mut RenderMesh<'_>, a: [f64; 3], b: [f64; 3], color: [f32; 3]) {
    let length = distance(a, b);
    if !(length > 1e-9 && length.is_finite()) {
        return;
    }
    let d: [f64; 3] = std::array::from_fn(|k| (b[k] - a[k]) / length);
    // any two directions across
    let least = (0..3).min_by(|i, j| d[*i].abs().total_cmp(&d[*j].abs())).expect("three axes");
    let mut e = [0.0; 3];
    e[least] = 1.0;
    let cross =
        |a: [f64; 3], b: [f64; 3]| [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
    let u = cross(d, e);
    let l = distance(u, [0.0; 3]);
    let u = u.map(|c| c / l);
    let w = cross(d, u);
    let (waist, wide) = (0.16 * length, 0.11 * length);
    let around = |x: f64, y: f64| std::array::from_fn(|k| a[k] + waist * d[k] + wide * (x * u[k] + y * w[k]));
    push(out, &[a, around(1.0, 0.0), around(0.0, 1.0), around(-1.0, 0.0), around(0.0, -1.0), b], &OCTAHEDRON, color);
}

/// An octahedron, divided once and blown up to a ball.
fn ball(out: &mut RenderMesh<'_>, c: [f64; 3], r: f64, color: [f32; 3]) {
    if !c.iter().all(|v| v.is_finite()) {
        return;
    }
    let mut points: Vec<[f64; 3]> =
        vec![[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0]];
    let mut triangles = OCTAHEDRON.to_vec();
    for _ in 0..2 {
        let mut finer = Vec::with_capacity(4 * triangles.len());
        for t in triangles {
            let base = points.len() as u32;
            for k in 0..3 {
                let (a, b) = (points[t[k] as usize], points[t[(k + 1) % 3] as usize]);
                let m: [f64; 3] = std::array::from_fn(|i| a[i] + b[i]);
                let l = distance(m, [0.0; 3]);
                points.push(m.map(|v| v / l));
            }
            finer.extend([
                [t[0], base, base + 2],
                [base, t[1], base + 1],
                [base + 2, base + 1, t[2]],
                [base, base + 1, base + 2],
            ]);
        }
        triangles = finer;
    }
    let placed: Vec<[f64; 3]> = points.iter().map(|p| std::array::from_fn(|k| c[k] + r * p[k])).collect();
    push(out, &placed, &triangles, color);
}

#[cfg(test)]
mod tests {
    use super::*;

    fn two_cubes() -> VolumeMesh {
        let nodes = (0..12).map(|i| [f64::from(i % 3), f64::from(i / 3 % 2), f64::from(i / 6)]).collect();
        let cube = |x: u32| [x, x + 1, x + 4, x + 3, x + 6, x + 7, x + 10, x + 9];
        VolumeMesh { nodes, hexes: vec![cube(0), cube(1)], ..VolumeMesh::default() }
    }

    /// Two cubes in a row: 10 outer faces, 20 edges, and the divergence theorem gives their volume when faces look outwards.
    #[test]
    fn only_outer_faces_are_drawn_and_they_look_outwards() {
        let volume = two_cubes();
        let (mesh, cells) = mesh_surface(&volume, &volume.nodes);
        assert_eq!((mesh.triangles.len(), cells.len()), (20, 20));
        assert_eq!(mesh_overlay(&volume, &volume.nodes, Layer::Solid).len(), 20);
        let six_volumes: f64 = mesh
            .triangles
            .iter()
            .map(|t| {
                let [a, b, c] = t.map(|v| volume.nodes[v as usize]);
                a[0] * (b[1] * c[2] - b[2] * c[1])
                    + a[1] * (b[2] * c[0] - b[0] * c[2])
                    + a[2] * (b[0] * c[1] - b[1] * c[0])
            })
            .sum();
        assert!((six_volumes / 6.0 - 2.0).abs() < 1e-12, "{six_volumes}");
    }

    #[test]
    fn two_tetrahedra_share_a_face() {
        let nodes = vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 1.0, 1.0]];
        let volume = VolumeMesh { nodes, tets: vec![[0, 1, 2, 3], [1, 2, 3, 4]], ..VolumeMesh::default() };
        assert_eq!(mesh_surface(&volume, &volume.nodes).1.len(), 6);
    }
}
