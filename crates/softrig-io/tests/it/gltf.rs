//! Characters in glTF.

use crate::gltf_reference::Reference;
use crate::shared::{Data, data};
use softrig::character::{Character, Skin};
use softrig_io::{ImportOptions, gltf};

fn read(data: &Data, name: &str) -> Character {
    gltf::read(&data.file(format!("characters/{name}")), &ImportOptions::default()).unwrap()
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

/// Skinning through rest frames and bone maps is that of the file. The second reading is `gltf_reference.rs`; weights are f32
/// here and f64 there, matrices f32 in the file, hence 1e-6 of the height.
#[test]
fn blend_skinning_equals_a_plain_reading_of_the_file() {
    let Some(data) = data() else { return };
    for (name, _, unit) in CHARACTERS {
        let c = read(&data, name);
        let reference = Reference::open(&data.file(format!("characters/{name}")));
        let mut moments = vec![(None, 0.0)];
        for (k, clip) in c.clips.iter().enumerate() {
            moments.extend([0.0, 0.37, 1.0].map(|s| (Some(k), clip.start + s * clip.duration())));
        }
        let mut worst = 0.0f64;
        for (clip, time) in moments {
            let locals = clip.map_or(c.skeleton.rest_locals(), |k| c.clips[k].sample(&c.skeleton, time));
            let pose = c.skeleton.pose(&locals);
            let expected = reference.skinned(clip, time);
            assert_eq!(expected.len(), c.meshes.len());
            for (m, expected) in expected.iter().enumerate() {
                let got = c.blend_skin(m, &pose);
                assert_eq!(got.len(), expected.len(), "{name}");
                for (a, b) in got.iter().zip(expected) {
                    worst = (0..3).map(|k| (a[k] - unit * b[k]).abs()).fold(worst, f64::max);
                }
            }
        }
        let size = c.height().max(0.1);
        assert!(worst < 1e-6 * size, "{name}: {worst} m of {size}");
    }
}

#[test]
fn separate_files_give_the_same_character_as_one() {
    let Some(data) = data() else { return };
    let mut one = read(&data, "CesiumMan.glb");
    one.name = "CesiumMan".into();
    assert_eq!(one, read(&data, "CesiumMan_separate/CesiumMan.gltf"));
    assert_eq!(one.textures.len(), 1);
}

/// Both robots are one model; 16 bits over the model's 6.6 units, after its bones, leave 1e-4 of the height.
#[test]
fn a_quantized_file_is_the_plain_one_to_its_bits() {
    let Some(data) = data() else { return };
    let (plain, packed) = (read(&data, "RobotExpressive.glb"), read(&data, "RobotExpressive_quantized.glb"));
    let mut compared = 0;
    for mesh in &plain.meshes {
        let Some(other) = packed.meshes.iter().find(|m| m.name == mesh.name) else { continue };
        let (a, b) = (bounds(&mesh.positions), bounds(&other.positions));
        for k in 0..6 {
            assert!((a[k] - b[k]).abs() < 1e-4 * plain.height(), "{}: {a:?} {b:?}", mesh.name);
        }
        compared += 1;
    }
    assert_eq!(compared, 14);
}

fn bounds(points: &[[f64; 3]]) -> [f64; 6] {
    let mut out = [f64::INFINITY; 6];
    for p in points {
        for k in 0..3 {
            out[k] = out[k].min(p[k]);
            out[3 + k] = out[3 + k].min(-p[k]);
        }
    }
    out
}

/// Cut anywhere, a binary file is refused as cut short, a text file as broken JSON.
#[test]
fn characters_cut_anywhere_are_refused() {
    let Some(data) = data() else { return };
    for (name, ..) in CHARACTERS {
        let path = data.file(format!("characters/{name}"));
        crate::bad::cut(&path, |bytes| {
            let error = gltf::read_beside(bytes, &path, &ImportOptions::default()).unwrap_err();
            let message = error.to_string();
            assert!(message.contains("cut short") || message.contains("JSON"), "{message}");
            Err(error)
        });
    }
}
