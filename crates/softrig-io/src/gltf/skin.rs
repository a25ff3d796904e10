//! Rest frames of all joints, from the inverse bind matrices.
//!
//! glTF skins a vertex p of a mesh by  x = sum_j w_j W_j B_j p,  W_j the frame of joint j in the world and B_j its inverse
//! bind matrix; the frame of the mesh's own node plays no part. The bind shape is where all W_j B_j are one map G. No file says
//! which, and the node transforms often stand in another pose. Here G is taken from the root-most joint of the skin: where the
//! nodes put that joint, the bind shape stands, upright and of the size that the posed character has (armature nodes of scale
//! 100 are common). G is a similarity, so the bind shape keeps its proportions. Then
//!
//!   rest position of a vertex = G p        rest frame of a joint = G B_j^-1
//!
//! and W_j rest_j^-1 (G p) = W_j B_j p: skinning from the rest shape is that of the file, to rounding.

use super::accessor::{Accessors, Integers};
use super::document::{Document, Skin};
use super::fault::{Checked, Fault};
use super::nodes::Nodes;
use glam::DMat3;
use softrig::rig::Affine;

/// How far the rest frames that two skins give one joint may differ, relative to the mesh, before it is said.
const DISAGREEMENT: f64 = 1e-3;

/// A skin that some shown mesh uses.
pub(super) struct Binding {
    /// Node of each joint.
    pub joints: Vec<usize>,
    /// Mesh space to the rest shape in the world, file units.
    pub place: Affine,
    /// Takes the vertices that have no weight at all.
    pub root: usize,
    /// The node that importers make the armature object, and the skinned meshes its children.
    pub armature: Option<usize>,
}

/// What meshes say about the joints of their skin.
pub(super) struct Usage {
    /// Whether some vertex has weight on each joint of the skin's list.
    pub weighted: Vec<bool>,
    /// Box around all vertices of meshes with this skin, in mesh space.
    pub bounds: [[f64; 3]; 2],
}

impl Usage {
    pub fn new(joint_count: usize) -> Self {
        Self { weighted: vec![false; joint_count], bounds: [[f64::INFINITY; 3], [f64::NEG_INFINITY; 3]] }
    }
}

/// Rest frames of all nodes (file units), and the binding of each used skin.
pub(super) struct Rest {
    pub frames: Vec<Affine>,
    pub bindings: Vec<Option<Binding>>,
}

/// Finds the rest shape. `usage` has an entry for each skin that a shown mesh uses.
pub(super) fn rest(
    document: &Document,
    accessors: &Accessors<'_>,
    nodes: &Nodes,
    usage: &[Option<Usage>],
    notes: &mut Vec<String>,
) -> Checked<Rest> {
    let mut frames: Vec<Option<Affine>> = vec![None; nodes.names.len()];
    let mut bindings = Vec::with_capacity(usage.len());
    for (s, (skin, usage)) in document.skins.iter().zip(usage).enumerate() {
        bindings.push(match usage {
            Some(usage) => Some(bind(accessors, nodes, s, skin, usage, &mut frames, notes)?),
            None => None,
        });
    }
    Ok(Rest { frames: complete(nodes, &bindings, frames), bindings })
}

/// Joint nodes of a skin, checked.
pub(super) fn joints(document: &Document, s: usize) -> Checked<&[usize]> {
    let (joints, count) = (&document.skins[s].joints, document.nodes.len());
    if joints.is_empty() {
        return Err(Fault::malformed(format!("/skins/{s}/joints"), "the skin has no joints"));
    }
    match joints.iter().find(|j| **j >= count) {
        Some(j) => {
            Err(Fault::malformed(format!("/skins/{s}/joints"), format!("it names node {j}, but there are {count}")))
        }
        None => Ok(joints),
    }
}

/// Places one skin, and gives its joints the rest frames that they do not have yet.
fn bind(
    accessors: &Accessors<'_>,
    nodes: &Nodes,
    s: usize,
    skin: &Skin,
    usage: &Usage,
    frames: &mut [Option<Affine>],
    notes: &mut Vec<String>,
) -> Checked<Binding> {
    let joints = skin.joints.clone();
    let inverse_binds = inverse_binds(accessors, s, skin, notes)?;
    let sane = sane(&inverse_binds, usage);
    let lost: Vec<&str> = (0..joints.len()).filter(|k| !sane[*k]).map(|k| nodes.names[joints[k]].as_str()).collect();
    if !lost.is_empty() {
        notes.push(format!(
            "skin {s}: the inverse bind matrix of {} is no usable transform; took the rest frame from the node hierarchy",
            quoted(&lost)
        ));
    }

    // a joint that an earlier skin has placed places this one
    let shared = (0..joints.len()).filter(|k| sane[*k] && frames[joints[*k]].is_some());
    let shared = shared.min_by_key(|k| (!usage.weighted[*k], nodes.depths[joints[*k]]));
    let exact = shared.and_then(|k| {
        let place = frames[joints[k]].expect("asked above").after(&inverse_binds[k]);
        place.inverse().map(|_| place)
    });
    let reference = reference(nodes, &joints, &inverse_binds, &sane, usage);
    let place = match (exact, reference) {
        (Some(place), _) => place,
        (None, Some(k)) => similarity(&nodes.world[joints[k]], &inverse_binds[k]).unwrap_or(Affine::IDENTITY),
        (None, None) => Affine::IDENTITY,
    };

    let mut apart = Vec::new();
    for (k, &j) in joints.iter().enumerate().filter(|(k, _)| sane[*k]) {
        let Some(back) = inverse_binds[k].inverse() else { continue };
        let frame = place.after(&back);
        match &frames[j] {
            None => frames[j] = Some(frame),
            Some(other) if usage.weighted[k] && !same_place(&other.after(&inverse_binds[k]), &place, usage) => {
                apart.push(j)
            }
            Some(_) => {}
        }
    }
    if !apart.is_empty() {
        let names: Vec<&str> = apart.iter().map(|j| nodes.names[*j].as_str()).collect();
        notes.push(format!(
            "skin {s} binds {} elsewhere than an earlier skin does; its mesh will not follow them exactly",
            quoted(&names)
        ));
    }
    let root = skin.skeleton.filter(|j| joints.contains(j));
    let root = root.unwrap_or_else(|| joints[reference.unwrap_or(0)]);
    let armature = armature(nodes, skin);
    Ok(Binding { joints, place, root, armature })
}

/// The deepest common ancestor of all joints and the skeleton node, or its parent when that is a joint itself, as Blender's
/// importer has it.
fn armature(nodes: &Nodes, skin: &Skin) -> Option<usize> {
    let mut below = vec![0usize; nodes.names.len()];
    let skeleton = skin.skeleton.filter(|s| *s < below.len());
    let all = || skin.joints.iter().copied().chain(skeleton);
    all().for_each(|j| below[j] += 1);
    let total = all().count();
    for &i in nodes.order.iter().rev() {
        if below[i] == total {
            // children come first, so this is the deepest one
            return if skin.joints.contains(&i) { nodes.parents[i] } else { Some(i) };
        }
        if let Some(parent) = nodes.parents[i] {
            below[parent] += below[i];
        }
    }
    None
}

fn inverse_binds(accessors: &Accessors<'_>, s: usize, skin: &Skin, notes: &mut Vec<String>) -> Checked<Vec<Affine>> {
    let here = format!("/skins/{s}/inverseBindMatrices");
    let Some(index) = skin.inverse_bind_matrices else {
        notes.push(format!(
            "skin {s} has no inverse bind matrices; took its joints as bound where the mesh's origin is"
        ));
        return Ok(vec![Affine::IDENTITY; skin.joints.len()]);
    };
    let matrices = accessors.reals::<16>(index, &here, Integers::AsMarked)?;
    if matrices.len() < skin.joints.len() {
        let (have, need) = (matrices.len(), skin.joints.len());
        return Err(Fault::malformed(here, format!("{have} inverse bind matrices for {need} joints")));
    }
    Ok(matrices[..skin.joints.len()].iter().map(Affine::from_columns).collect())
}

/// Which inverse bind matrices can be meant: invertible, not flattened by more than 1e4, of a size within 1e3 of the usual
/// one, and putting the joint within 1e4 mesh sizes. Real rigs are far inside, uninitialised memory far outside.
fn sane(inverse_binds: &[Affine], usage: &Usage) -> Vec<bool> {
    let shape = |b: &Affine| -> Option<f64> {
        let columns = (0..3).map(|j| (0..3).map(|i| b.linear[i][j] * b.linear[i][j]).sum::<f64>().sqrt());
        let (lo, hi) = columns.fold((f64::INFINITY, 0.0f64), |(l, h), c| (l.min(c), h.max(c)));
        let whole = b.is_finite() && hi < 1e4 * lo && b.inverse().is_some_and(|i| i.is_finite());
        whole.then(|| b.determinant().abs().cbrt()).filter(|s| *s > 0.0 && s.is_finite())
    };
    let sizes: Vec<Option<f64>> = inverse_binds.iter().map(shape).collect();
    let usual = median(sizes.iter().flatten().copied().collect());
    let [lo, hi] = usage.bounds;
    let extent = (0..3).map(|k| hi[k] - lo[k]).fold(0.0, f64::max);
    let near = |b: &Affine| {
        extent <= 0.0
            || b.inverse()
                .is_some_and(|i| (0..3).all(|k| (i.translation[k] - 0.5 * (lo[k] + hi[k])).abs() < 1e4 * extent))
    };
    let usable = |(b, size): (&Affine, &Option<f64>)| {
        size.zip(usual).is_some_and(|(s, u)| s < 1e3 * u && u < 1e3 * s) && near(b)
    };
    inverse_binds.iter().zip(&sizes).map(usable).collect()
}

/// The joint (place in the skin's list) whose node frame says where the bind shape stands: the root-most one that has the
/// scale of the weighted ones.
fn reference(nodes: &Nodes, joints: &[usize], inverse_binds: &[Affine], sane: &[bool], usage: &Usage) -> Option<usize> {
    let scale = |k: usize| nodes.world[joints[k]].after(&inverse_binds[k]).determinant().cbrt();
    let usable = |k: &usize| {
        let s = scale(*k);
        sane[*k] && s != 0.0 && s.is_finite()
    };
    let candidates: Vec<usize> = (0..joints.len()).filter(usable).collect();
    let weighted: Vec<f64> = candidates.iter().filter(|k| usage.weighted[**k]).map(|k| scale(*k)).collect();
    let usual = median(if weighted.is_empty() { candidates.iter().map(|k| scale(*k)).collect() } else { weighted })?;
    let plain = |k: usize| !usage.weighted[k] && inverse_binds[k] == Affine::IDENTITY;
    let fits = candidates.iter().copied().filter(|k| (scale(*k) / usual - 1.0).abs() < 0.01);
    // an identity on a joint without weight may be a mere filler
    fits.min_by_key(|k| (plain(*k), nodes.depths[joints[*k]]))
}

/// Rotation, uniform scale and translation nearest to `world * inverse_bind`, with the joint's origin kept where it is.
fn similarity(world: &Affine, inverse_bind: &Affine) -> Option<Affine> {
    let map = world.after(inverse_bind);
    let scale = map.determinant().abs().cbrt();
    let rotation = orthogonal(&map)?;
    let linear = rotation.map(|row| row.map(|v| scale * v));
    let origin = inverse_bind.inverse()?.translation;
    let place = Affine { linear, translation: [0.0; 3] };
    let moved = place.point(origin);
    let translation = std::array::from_fn(|k| world.translation[k] - moved[k]);
    Some(Affine { linear, translation }).filter(|p| p.is_finite() && p.inverse().is_some())
}

/// Orthogonal factor of the polar decomposition, a mirror included, by Newton's iteration.
fn orthogonal(map: &Affine) -> Option<[[f64; 3]; 3]> {
    let l = map.linear;
    let scale = map.determinant().abs().cbrt();
    let mut q = DMat3::from_cols_array_2d(&l).transpose() * (1.0 / scale);
    for _ in 0..100 {
        let back = q.inverse().transpose();
        let next = (q + back) * 0.5;
        let change = (next - q).to_cols_array().iter().fold(0.0f64, |m, v| m.max(v.abs()));
        q = next;
        if change < 1e-15 {
            break;
        }
    }
    let rows = q.transpose().to_cols_array_2d();
    rows.iter().flatten().all(|v| v.is_finite()).then_some(rows)
}

/// Whether two maps send the box of the meshes to the same place.
fn same_place(a: &Affine, b: &Affine, usage: &Usage) -> bool {
    let corner = |i: usize| std::array::from_fn(|k| usage.bounds[i >> k & 1][k]);
    let size = |f: &dyn Fn([f64; 3], [f64; 3]) -> f64| {
        (0..8).map(|i| f(a.point(corner(i)), b.point(corner(i)))).fold(0.0f64, f64::max)
    };
    let apart = size(&|p, q| (0..3).map(|k| (p[k] - q[k]).abs()).fold(0.0, f64::max));
    let first = b.point(corner(0));
    let extent = size(&|_, q| (0..3).map(|k| (q[k] - first[k]).abs()).fold(0.0, f64::max));
    // also false for NaN
    apart <= DISAGREEMENT * extent
}

/// Rest frames of all nodes: those of joints as given, others along the hierarchy by the node's own transforms.
fn complete(nodes: &Nodes, bindings: &[Option<Binding>], mut frames: Vec<Option<Affine>>) -> Vec<Affine> {
    let mut below_joint = vec![false; frames.len()];
    for &i in &nodes.order {
        below_joint[i] = nodes.parents[i].is_some_and(|p| below_joint[p] || frames[p].is_some());
    }
    // upwards from the roots of the skins first: the armature stands where its root joint does; then from the shallowest joints
    let roots = bindings.iter().flatten().map(|b| b.root);
    for start in roots.chain(nodes.order.iter().copied()) {
        let mut at = start;
        while let (Some(frame), Some(parent), false) = (frames[at], nodes.parents[at], below_joint[at]) {
            if frames[parent].is_some() {
                break;
            }
            frames[parent] =
                usable_local(nodes, at).inverse().map(|back| frame.after(&back)).or(Some(nodes.world[parent]));
            at = parent;
        }
    }
    for &i in &nodes.order {
        if frames[i].is_none() {
            let parent = nodes.parents[i].map_or(Affine::IDENTITY, |p| frames[p].expect("parents come first"));
            frames[i] = Some(parent.after(&usable_local(nodes, i)));
        }
    }
    frames.into_iter().map(|f| f.expect("set above")).collect()
}

/// Local transform; a scale of zero, by which files hide things, counts as one: a rest frame must have an inverse.
fn usable_local(nodes: &Nodes, i: usize) -> Affine {
    if nodes.matrices[i].is_some() {
        return nodes.local(i);
    }
    let mut transform = nodes.transforms[i];
    transform.scale = transform.scale.map(|s| if s == 0.0 { 1.0 } else { s });
    transform.to_affine()
}

fn median(mut values: Vec<f64>) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied()
}

/// Some names in a row.
pub(super) fn quoted(names: &[&str]) -> String {
    let mut out = names.iter().take(8).map(|n| format!("`{n}`")).collect::<Vec<_>>().join(", ");
    if names.len() > 8 {
        out.push_str(&format!(" and {} more", names.len() - 8));
    }
    out
}
