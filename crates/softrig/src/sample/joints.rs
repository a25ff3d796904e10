//! The skeleton of the sample character.

use crate::rig::{Affine, Joint, JointId, Skeleton, Transform};

/// Name, parent and place of every joint on the middle plane and the left side [m]; names ending in `.L` are mirrored to `.R`.
const JOINTS: [(&str, &str, [f64; 3]); 13] = [
    ("hips", "", [0.0, 0.60, -0.01]),
    ("spine", "hips", [0.0, 0.72, -0.02]),
    ("chest", "spine", [0.0, 0.90, -0.02]),
    ("neck", "chest", [0.0, 1.09, -0.01]),
    ("head", "neck", [0.0, 1.18, 0.0]),
    ("shoulder.L", "chest", [0.06, 1.03, -0.02]),
    ("upper_arm.L", "shoulder.L", [0.205, 1.0, -0.02]),
    ("forearm.L", "upper_arm.L", [0.385, 0.815, -0.025]),
    ("hand.L", "forearm.L", [0.545, 0.65, -0.01]),
    ("thigh.L", "hips", [0.125, 0.55, 0.0]),
    ("shin.L", "thigh.L", [0.165, 0.325, 0.008]),
    ("foot.L", "shin.L", [0.19, 0.10, -0.01]),
    ("toes.L", "foot.L", [0.203, 0.04, 0.10]),
];

/// Bone `base` on the left or the right.
pub(super) fn sided(base: &str, left: bool) -> String {
    format!("{base}.{}", if left { 'L' } else { 'R' })
}

/// Rest place of a joint [m].
pub(super) fn place(name: &str) -> [f64; 3] {
    let left = name.strip_suffix(".R").map_or_else(|| name.to_owned(), |base| sided(base, true));
    let (_, _, p) = JOINTS.iter().find(|j| j.0 == left).expect("only names of the table are asked for");
    if name.ends_with(".R") { [-p[0], p[1], p[2]] } else { *p }
}

/// The skeleton: all rest frames are aligned with the world, so that a clip's rotations are about the world's axes.
pub(super) fn skeleton() -> Skeleton {
    let mirror = |name: &str| name.replace(".L", ".R");
    let left = JOINTS.iter().map(|(name, parent, _)| (String::from(*name), String::from(*parent)));
    let right = JOINTS.iter().filter(|j| j.0.ends_with(".L")).map(|(name, parent, _)| (mirror(name), mirror(parent)));
    let named: Vec<(String, String)> = left.chain(right).collect();
    let joints = named
        .iter()
        .map(|(name, parent)| {
            let at = place(name);
            let base = if parent.is_empty() { [0.0; 3] } else { place(parent) };
            let translation = std::array::from_fn(|k| at[k] - base[k]);
            Joint {
                name: name.clone(),
                parent: named.iter().position(|j| j.0 == *parent).map(|i| JointId(i as u32)),
                local: Transform { translation, ..Transform::default() },
                local_matrix: None,
                rest: Affine::from_translation(at),
            }
        })
        .collect();
    Skeleton::new(joints, Affine::IDENTITY).expect("the table is a tree")
}
