//! The node hierarchy: parents, local transforms, world frames while no clip plays.
//!
//! Every node of the file becomes a joint of the same number, whether a scene shows it or not.

use super::document::{Document, Node};
use super::fault::{Checked, Fault};
use crate::names::Names;
use glam::{DMat3, DQuat, DVec3};
use softrig::rig::{Affine, Joint, JointId, Transform};

/// All nodes of a file.
pub(super) struct Nodes {
    /// Unique name of each.
    pub names: Vec<String>,
    /// Parent of each.
    pub parents: Vec<Option<usize>>,
    /// Parents before their children.
    pub order: Vec<usize>,
    /// Distance of each from its root.
    pub depths: Vec<usize>,
    /// Translation, rotation, scale; of a matrix as near as they come.
    pub transforms: Vec<Transform>,
    /// Set for nodes whose matrix stays one: it has shear.
    pub matrices: Vec<Option<Affine>>,
    /// Node to the world, in file units, while no clip plays.
    pub world: Vec<Affine>,
    /// Whether the scene shows it.
    pub shown: Vec<bool>,
}

impl Nodes {
    /// Reads and checks the hierarchy.
    pub fn read(document: &Document, notes: &mut Vec<String>) -> Checked<Self> {
        let count = document.nodes.len();
        let mut parents = vec![None; count];
        for (i, node) in document.nodes.iter().enumerate() {
            for &child in &node.children {
                let place = format!("/nodes/{i}/children");
                match parents.get_mut(child) {
                    None => {
                        return Err(Fault::malformed(place, format!("it names node {child}, but there are {count}")));
                    }
                    Some(Some(other)) => {
                        return Err(Fault::malformed(
                            place,
                            format!("node {child} is also a child of node {other}; the node hierarchy must be a tree"),
                        ));
                    }
                    Some(parent) => *parent = Some(i),
                }
            }
        }
        let mut order: Vec<usize> = (0..count).filter(|i| parents[*i].is_none()).collect();
        let mut depths = vec![0; count];
        let mut next = 0;
        while next < order.len() {
            let i = order[next];
            for &child in &document.nodes[i].children {
                depths[child] = depths[i] + 1;
                order.push(child);
            }
            next += 1;
        }
        if order.len() < count {
            let mut reached = vec![false; count];
            order.iter().for_each(|i| reached[*i] = true);
            let lost = reached.iter().position(|r| !r).expect("fewer reached than there are");
            return Err(Fault::malformed(
                format!("/nodes/{lost}"),
                "the node is its own ancestor; the node hierarchy must be a tree",
            ));
        }

        let animated = animated_nodes(document);
        let (mut names, mut unique) = (Vec::with_capacity(count), Names::default());
        let (mut transforms, mut matrices, mut skewed) = (Vec::with_capacity(count), Vec::with_capacity(count), 0);
        for (i, node) in document.nodes.iter().enumerate() {
            let wish = node.name.as_deref().map(str::trim).filter(|n| !n.is_empty());
            names.push(unique.unique(&wish.map_or_else(|| format!("node {i}"), str::to_owned)));
            let (transform, matrix) = local(node, i)?;
            transforms.push(transform);
            // a node can only move when its matrix is split up: those of clips must be, others are where nothing is lost
            let lost = |digits: f64| matrix.is_some_and(|m| !close(&m, &transform.to_affine(), digits));
            skewed += usize::from(animated[i] && lost(1e-5));
            matrices.push(matrix.filter(|_| !animated[i] && lost(1e-6)));
        }
        if skewed > 0 {
            notes.push(format!(
                "{skewed} animated nodes have a matrix with shear, which clips cannot keep: dropped the shear"
            ));
        }

        let mut world = vec![Affine::IDENTITY; count];
        for &i in &order {
            let parent = parents[i].map_or(Affine::IDENTITY, |p| world[p]);
            world[i] = parent.after(&matrices[i].unwrap_or_else(|| transforms[i].to_affine()));
            if !world[i].is_finite() {
                return Err(Fault::malformed(format!("/nodes/{i}"), "its transform is not finite"));
            }
        }
        let shown = shown(document, &order, &parents, notes)?;
        Ok(Self { names, parents, order, depths, transforms, matrices, world, shown })
    }

    /// Local map of a node while no clip plays.
    pub fn local(&self, i: usize) -> Affine {
        self.matrices[i].unwrap_or_else(|| self.transforms[i].to_affine())
    }

    /// As joints with the given rest frames.
    pub fn into_joints(self, rest: Vec<Affine>) -> Vec<Joint> {
        let each = self.names.into_iter().zip(self.parents).zip(self.transforms).zip(self.matrices).zip(rest);
        each.map(|((((name, parent), local), local_matrix), rest)| Joint {
            name,
            parent: parent.map(|p| JointId(p as u32)),
            local,
            local_matrix,
            rest,
        })
        .collect()
    }
}

/// Which nodes some clip moves, rotates or scales.
fn animated_nodes(document: &Document) -> Vec<bool> {
    let mut out = vec![false; document.nodes.len()];
    for channel in document.animations.iter().flat_map(|a| &a.channels) {
        if matches!(channel.target.path.as_str(), "translation" | "rotation" | "scale")
            && let Some(moved) = channel.target.node.and_then(|n| out.get_mut(n))
        {
            *moved = true;
        }
    }
    out
}

/// Transform of a node, and its matrix when the file gives one.
fn local(node: &Node, i: usize) -> Checked<(Transform, Option<Affine>)> {
    if let Some(m) = &node.matrix {
        let matrix = Affine::from_columns(m);
        if !matrix.is_finite() {
            return Err(Fault::malformed(format!("/nodes/{i}/matrix"), "its numbers are not finite"));
        }
        return Ok((split(&matrix), Some(matrix)));
    }
    let none = Transform::default();
    let transform = Transform {
        translation: node.translation.unwrap_or(none.translation),
        rotation: node.rotation.unwrap_or(none.rotation),
        scale: node.scale.unwrap_or(none.scale),
    };
    Ok((transform, None))
}

/// Translation, rotation and scale of a matrix, shear dropped.
fn split(m: &Affine) -> Transform {
    let column = |j: usize| DVec3::new(m.linear[0][j], m.linear[1][j], m.linear[2][j]);
    let mut columns = [column(0), column(1), column(2)];
    let mut scale = columns.map(DVec3::length);
    if m.determinant() < 0.0 {
        scale[0] = -scale[0];
    }
    for (c, s) in columns.iter_mut().zip(scale) {
        *c = if s == 0.0 { DVec3::ZERO } else { *c / s };
    }
    // nearest orthonormal frame by Gram and Schmidt; a flat matrix has no rotation to speak of
    let x = columns[0].normalize_or(DVec3::X);
    let y = (columns[1] - x * columns[1].dot(x)).normalize_or(x.any_orthonormal_vector());
    let rotation = DQuat::from_mat3(&DMat3::from_cols(x, y, x.cross(y))).normalize();
    Transform { translation: m.translation, rotation: rotation.to_array(), scale }
}

fn close(a: &Affine, b: &Affine, tolerance: f64) -> bool {
    let size = a.linear.iter().flatten().fold(0.0f64, |s, v| s.max(v.abs()));
    a.linear.iter().flatten().zip(b.linear.iter().flatten()).all(|(a, b)| (a - b).abs() <= tolerance * size)
}

/// Which nodes belong to the scene: the file's default one, else the first, else all.
fn shown(
    document: &Document,
    order: &[usize],
    parents: &[Option<usize>],
    notes: &mut Vec<String>,
) -> Checked<Vec<bool>> {
    let count = document.nodes.len();
    let chosen = document.scene.unwrap_or(0);
    let Some(scene) = document.scenes.get(chosen) else {
        if let Some(scene) = document.scene {
            notes.push(format!("the file's default scene {scene} does not exist; took all nodes"));
        }
        return Ok(vec![true; count]);
    };
    let mut shown = vec![false; count];
    for &root in &scene.nodes {
        match shown.get_mut(root) {
            Some(s) => *s = true,
            None => {
                return Err(Fault::malformed(
                    format!("/scenes/{chosen}/nodes"),
                    format!("it names node {root}, but there are {count}"),
                ));
            }
        }
    }
    for &i in order {
        shown[i] |= parents[i].is_some_and(|p| shown[p]);
    }
    Ok(shown)
}
