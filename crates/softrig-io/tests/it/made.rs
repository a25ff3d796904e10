//! Small characters and motions made by the tests themselves.

use softrig::character::{Character, CharacterMesh, Look, Skin, SkinWeights, Texture};
use softrig::frame::{Frame, FrameSink};
use softrig::rig::{Affine, Joint, JointId, Pose, Skeleton, Transform};
use softrig_io::journal::{Existing, JournalHeader, JournalMesh, JournalReader, JournalWriter};
use std::path::Path;

/// A rig in centimetres with Z up, of a node above everything, a bone and a prop; an arm that follows two joints, a prop that
/// follows one, and a stone that follows none.
pub fn character() -> Character {
    // stretched along a turned axis: what hangs on it shears
    character_with_scale([2.0, 3.0, 0.5])
}

/// The same with another scale of the node above everything.
pub fn character_with_scale(scale: [f64; 3]) -> Character {
    // file (x, y, z) in cm, Z up -> world (x, z, -y) in m
    let to_world = Affine { linear: [[0.01, 0.0, 0.0], [0.0, 0.0, 0.01], [0.0, -0.01, 0.0]], translation: [0.0; 3] };
    let joint = |name: &str, parent: Option<u32>, local: Transform| Joint {
        name: name.into(),
        parent: parent.map(JointId),
        local,
        local_matrix: None,
        rest: Affine::IDENTITY,
    };
    let object = Transform { translation: [5.0, -3.0, 2.0], rotation: [0.0, 0.6, 0.0, 0.8], scale };
    let bone = Transform { translation: [0.0, 0.0, 40.0], ..Transform::default() };
    let joints = vec![joint("Armature", None, object), joint("Bone", Some(0), bone), joint("Prop", Some(1), bone)];
    let mut skeleton = Skeleton::new(joints.clone(), to_world).unwrap();
    let rest = skeleton.pose(&skeleton.rest_locals());
    let joints = joints.into_iter().zip(&rest.world).map(|(j, w)| Joint { rest: *w, ..j }).collect();
    skeleton = Skeleton::new(joints, to_world).unwrap();

    let mut weights = SkinWeights::default();
    for v in 0..12 {
        let w = v as f32 / 11.0;
        assert!(weights.push([(JointId(0), 1.0 - w), (JointId(1), w)]));
    }
    let strip = |count: usize, x: f64| -> Vec<[f64; 3]> {
        (0..count)
            .map(|v| [x + 0.1 * (v % 2) as f64, 1.6 * (v / 2) as f64 / (count as f64 / 2.0 - 1.0), 0.02 * v as f64])
            .collect()
    };
    let faces =
        |count: u32| (0..count - 2).map(|t| if t % 2 == 0 { [t, t + 1, t + 2] } else { [t + 1, t, t + 2] }).collect();
    let arm = CharacterMesh {
        name: "Arm".into(),
        positions: strip(12, 0.0),
        triangles: faces(12),
        look: (0..10).map(|t| u32::from(t >= 4)).collect(),
        texture_coordinates: (0..12).map(|v| [(v % 2) as f32, v as f32 / 11.0]).collect(),
        colors: vec![[1.0, 0.5, 0.25, 1.0]; 12],
        skin: Skin::Weighted(weights),
        object: Some(JointId(0)),
        groups: Vec::new(),
    };
    let prop = CharacterMesh {
        name: "Prop/1".into(),
        positions: strip(6, 0.5),
        triangles: faces(6),
        skin: Skin::Rigid(JointId(2)),
        object: Some(JointId(2)),
        ..CharacterMesh::default()
    };
    let stone = CharacterMesh {
        name: "Stone".into(),
        positions: strip(4, 1.0),
        triangles: faces(4),
        ..CharacterMesh::default()
    };
    let texture = Texture { width: 2, height: 1, rgba: vec![[255, 0, 0, 255], [0, 0, 255, 255]] };
    Character {
        name: "made".into(),
        meshes: vec![arm, prop, stone],
        skeleton,
        clips: Vec::new(),
        looks: vec![
            Look { name: "skin".into(), base_color: [0.8, 0.6, 0.5, 1.0], texture: Some(0) },
            Look { name: "cloth".into(), base_color: [0.1, 0.2, 0.8, 1.0], texture: None },
        ],
        textures: vec![texture],
        notes: Vec::new(),
    }
}

/// The same with the arm alone.
pub fn one_mesh() -> Character {
    let mut c = character();
    c.meshes.truncate(1);
    c
}

/// A pose in which everything above the prop moves.
pub fn pose(character: &Character, frame: usize) -> Pose {
    let mut locals = character.skeleton.rest_locals();
    let angle = 0.1 * frame as f64;
    locals[0].translation[0] += 10.0 * frame as f64;
    locals[1].rotation = [0.0, 0.0, (angle / 2.0).sin(), (angle / 2.0).cos()];
    locals[2].rotation = [angle.sin(), 0.0, 0.0, angle.cos()];
    character.skeleton.pose(&locals)
}

pub fn header(character: &Character, frames: usize) -> JournalHeader {
    JournalHeader {
        input_hash: 0x5eed,
        origin: "a test".into(),
        fps: 24.0,
        start_time: 0.5,
        frame_count: frames as u64,
        joint_count: character.skeleton.joint_count() as u32,
        meshes: character
            .meshes
            .iter()
            .map(|m| JournalMesh { name: m.name.clone(), vertex_count: m.positions.len() as u32 })
            .collect(),
        volume: None,
    }
}

/// Hands the linear blend skin of frame `index` to a sink.
pub fn feed<S: FrameSink>(sink: &mut S, character: &Character, index: usize) -> Result<(), S::Error> {
    let pose = pose(character, index);
    let skin: Vec<_> = (0..character.meshes.len()).map(|m| character.blend_skin(m, &pose)).collect();
    let force = vec![[1.0, 2.0, index as f64]; character.skeleton.joint_count()];
    sink.frame(&Frame {
        index,
        time: index as f64 / 24.0,
        skin: &skin,
        pose: &pose,
        nodes: &[[9.0; 3]; 5],
        joint_force: &force,
    })
}

/// A finished journal of the blended skin.
pub fn journal(folder: &Path, character: &Character, frames: usize) -> JournalReader {
    let path = folder.join("made.softrig-journal");
    let mut writer = JournalWriter::create(&path, header(character, frames), Existing::Replace).unwrap();
    (0..frames).for_each(|i| feed(&mut writer, character, i).unwrap());
    writer.finish().unwrap();
    drop(writer);
    JournalReader::open(&path).unwrap()
}
