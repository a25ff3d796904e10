//! Characters in glTF.

use crate::shared::data;
use softrig::character::{Character, Skin};
use softrig_io::{ImportOptions, gltf};
use std::path::Path;

fn read(data: &Path, name: &str) -> Character {
    gltf::read(&data.join("characters").join(name), &ImportOptions::default()).unwrap()
}

/// What the README of the sample data says, counted by other tools: meshes, rigid ones, vertices, triangles, nodes, weighted
/// joints, clips; and metres per file unit.
#[rustfmt::skip]
const CHARACTERS: [(&str, [usize; 7], f64); 11] = [
    ("CesiumMan.glb",                    [1,  0, 3273, 4672, 22, 19, 1],  1.0),
    ("CesiumMan_separate/CesiumMan.gltf", [1, 0, 3273, 4672, 22, 19, 1],  1.0),
    ("Cow.glb",                          [1,  0, 4970, 2450, 59, 37, 12], 0.1),
    ("Fox.glb",                          [1,  0, 1728,  576, 26, 22, 3],  0.01),
    ("Horse.glb",                        [1,  0, 4400, 2182, 68, 45, 13], 0.1),
    ("Knight.glb",                       [15, 9, 7024, 6952, 57, 20, 76], 1.0),
    ("RiggedSimple.gltf",                [1,  0,  160,  188,  5,  2, 1],  0.1),
    ("RobotExpressive.glb",              [14, 12, 7214, 3237, 74, 24, 14], 0.1),
    ("RobotExpressive_quantized.glb",    [14, 12, 7214, 3237, 59, 24, 11], 0.1),
    ("SimpleSkin.gltf",                  [1,  0,   10,    8,  3,  2, 1],  1.0),
    ("quad_skin_10_influences.glb",      [1,  0,    4,    2, 23, 10, 0],  0.01),
];

fn weighted_joints(c: &Character) -> Vec<bool> {
    let mut out = vec![false; c.skeleton.joint_count()];
    for mesh in &c.meshes {
        if let Skin::Weighted(w) = &mesh.skin {
            w.joint.iter().for_each(|j| out[j.index()] = true);
        }
    }
    out
}

#[test]
fn characters_have_the_counts_and_units_of_the_data_table() {
    let Some(data) = data() else { return };
    for (name, counts, unit) in CHARACTERS {
        let c = read(&data, name);
        let got = [
            c.meshes.len(),
            c.meshes.iter().filter(|m| matches!(m.skin, Skin::Rigid(_))).count(),
            c.vertex_count(),
            c.meshes.iter().map(|m| m.triangles.len()).sum(),
            c.skeleton.joint_count(),
            weighted_joints(&c).iter().filter(|w| **w).count(),
            c.clips.len(),
        ];
        assert_eq!(got, counts, "{name}");
        assert_eq!(c.skeleton.to_world().determinant(), unit * unit * unit, "{name}");
    }
}

/// The rest shape has the scale of the posed one: armature nodes of scale 100 are in both. The clips of these files scale
/// nothing beyond rounding.
#[test]
fn bones_keep_their_volume_in_every_clip() {
    let Some(data) = data() else { return };
    for (name, ..) in CHARACTERS {
        let c = read(&data, name);
        let weighted = weighted_joints(&c);
        for clip in &c.clips {
            for i in 0..=10 {
                let time = clip.start + 0.1 * f64::from(i) * clip.duration();
                let pose = c.skeleton.pose(&clip.sample(&c.skeleton, time));
                for (map, _) in c.bone_maps(&pose).iter().zip(&weighted).filter(|(_, w)| **w) {
                    assert!((map.determinant() - 1.0).abs() < 1e-5, "{name}, {}: {map:?}", clip.name);
                }
            }
        }
    }
}
