//! The motion of a skeleton as an ordinary clip: written into a copy of a glTF character, or as BVH.

use super::ExportError;
use base64::Engine;
use glam::{DMat3, DQuat, DVec3};
use serde_json::{Value, json};
use softrig::rig::{Affine, Clip, Interpolation, JointId, Pose, Property, Skeleton, Track, Transform};

/// A clip with one key per pose, `1 / fps` seconds apart: what the poses are in local terms. Only what the clip needs has a track:
/// rotations of joints that turn, translations and scales that differ from the skeleton's own.
#[must_use]
pub fn clip_of_poses(skeleton: &Skeleton, poses: &[Pose], fps: f64, name: &str) -> Clip {
    let times: Vec<f64> = (0..poses.len()).map(|k| k as f64 / fps).collect();
    let end = times.last().copied().unwrap_or(0.0);
    let mut clip = Clip { name: name.into(), start: 0.0, end, tracks: Vec::new() };
    for (i, joint) in skeleton.joints().iter().enumerate() {
        if joint.local_matrix.is_some() {
            continue;
        }
        let mut locals: Vec<Transform> = Vec::with_capacity(poses.len());
        for pose in poses {
            let parent = joint.parent.map_or(*skeleton.to_world(), |p| *pose.joint(p));
            // a joint under a singular frame cannot be seen
            let local = parent.inverse().map(|back| back.after(&pose.world[i]));
            let mut local = local.map_or(joint.local, |l| transform_of(&l, &joint.local));
            if let Some(before) = locals.last()
                && DQuat::from_array(before.rotation).dot(DQuat::from_array(local.rotation)) < 0.0
            {
                local.rotation = local.rotation.map(|v| -v);
            }
            locals.push(local);
        }
        let size = DVec3::from(joint.local.translation).length().max(1e-3);
        let moves =
            locals.iter().any(|l| DVec3::from(l.translation).distance(joint.local.translation.into()) > 1e-7 * size);
        let turns = locals.iter().any(|l| {
            DQuat::from_array(l.rotation).dot(DQuat::from_array(joint.local.rotation).normalize()).abs() < 1.0 - 1e-14
        });
        let scales = locals.iter().any(|l| (0..3).any(|k| (l.scale[k] - joint.local.scale[k]).abs() > 1e-6));
        let mut track = |property, value: &dyn Fn(&Transform) -> [f64; 4]| {
            let values = locals.iter().map(value).collect();
            let (joint, interpolation) = (JointId(i as u32), Interpolation::Linear);
            clip.tracks.push(Track { joint, property, interpolation, times: times.clone(), values });
        };
        let three = |v: [f64; 3]| [v[0], v[1], v[2], 0.0];
        if moves {
            track(Property::Translation, &|l| three(l.translation));
        }
        if turns {
            track(Property::Rotation, &|l| l.rotation);
        }
        if scales {
            track(Property::Scale, &|l| three(l.scale));
        }
    }
    clip
}

/// Translation, rotation and scale of a map, the scale with the signs of `like`.
fn transform_of(map: &Affine, like: &Transform) -> Transform {
    let m = DMat3::from_cols_array_2d(&map.linear).transpose();
    let columns = [m.x_axis, m.y_axis, m.z_axis];
    let scale: [f64; 3] = std::array::from_fn(|k| columns[k].length().copysign(like.scale[k]));
    let unit = |k: usize| columns[k] / if scale[k] == 0.0 { 1.0 } else { scale[k] };
    let x = unit(0).try_normalize().unwrap_or(DVec3::X);
    let y = (unit(1) - x * x.dot(unit(1))).try_normalize().unwrap_or_else(|| x.any_orthonormal_vector());
    let rotation = DQuat::from_mat3(&DMat3::from_cols(x, y, x.cross(y))).normalize().to_array();
    Transform { translation: map.translation, rotation, scale }
}

/// A copy of a glTF file (`.glb` or `.gltf`) with one more animation. The skeleton must be the one read from that file.
///
/// # Errors
/// [`ExportError::Unsupported`] when the bytes are no glTF file of that skeleton.
pub fn gltf_with_clip(source: &[u8], skeleton: &Skeleton, clip: &Clip) -> Result<Vec<u8>, ExportError> {
    let refuse = |what: &str| ExportError::Unsupported {
        what: format!("the clip into {what}"),
        instead: "name the character's own .glb or .gltf file, or write a .bvh".into(),
    };
    let (text, binary) = if source.starts_with(b"glTF") {
        glb_chunks(source).ok_or_else(|| refuse("a damaged GLB file"))?
    } else {
        (source.strip_prefix(b"\xef\xbb\xbf").unwrap_or(source), None)
    };
    let mut document: Value = serde_json::from_slice(text).map_err(|_| refuse("something that is no glTF file"))?;
    if document["nodes"].as_array().map_or(0, Vec::len) != skeleton.joint_count() {
        return Err(refuse("a glTF file with other nodes"));
    }
    let is_glb = source.starts_with(b"glTF");
    let mut data = binary.map_or_else(Vec::new, <[u8]>::to_vec);
    // a .gltf, or a GLB whose first buffer lies elsewhere, gets a buffer of its own
    let own_buffer = !is_glb || document["buffers"][0].get("uri").is_some() || document["buffers"][0].is_null();
    if own_buffer {
        data.clear();
    }
    let buffer = if own_buffer { document["buffers"].as_array().map_or(0, Vec::len) } else { 0 };
    data.resize(data.len().next_multiple_of(4), 0);
    let mut writer = Appender { document: &mut document, data: &mut data, buffer };
    let times: Vec<f32> = clip.tracks.first().map_or_else(Vec::new, |t| t.times.iter().map(|t| *t as f32).collect());
    let (mut channels, mut samplers) = (Vec::new(), Vec::new());
    if !times.is_empty() {
        let input = writer.accessor(&times, 1, "SCALAR");
        for track in &clip.tracks {
            let rest = &skeleton.joint(track.joint).local;
            split(&mut writer.document["nodes"][track.joint.index()], rest);
            let (path, width, kind) = match track.property {
                Property::Translation => ("translation", 3, "VEC3"),
                Property::Rotation => ("rotation", 4, "VEC4"),
                Property::Scale => ("scale", 3, "VEC3"),
            };
            let numbers: Vec<f32> = track.values.iter().flat_map(|v| v[..width].iter().map(|v| *v as f32)).collect();
            let output = writer.accessor(&numbers, width, kind);
            channels.push(json!({ "sampler": samplers.len(), "target": { "node": track.joint.0, "path": path } }));
            samplers.push(json!({ "input": input, "output": output, "interpolation": "LINEAR" }));
        }
        let animation = json!({ "name": clip.name, "channels": channels, "samplers": samplers });
        list(&mut document, "animations").push(animation);
    }
    if own_buffer && !data.is_empty() {
        let uri =
            format!("data:application/octet-stream;base64,{}", base64::engine::general_purpose::STANDARD.encode(&data));
        list(&mut document, "buffers").push(json!({ "byteLength": data.len(), "uri": uri }));
    } else if !data.is_empty() {
        document["buffers"][0]["byteLength"] = json!(data.len());
    }
    if !is_glb {
        return Ok(document.to_string().into_bytes());
    }
    let mut text = document.to_string().into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    let binary = if own_buffer { binary.map(<[u8]>::to_vec) } else { Some(data) };
    let mut out = Vec::new();
    let total = 12 + 8 + text.len() + binary.as_ref().map_or(0, |b| 8 + b.len().next_multiple_of(4));
    let word = |n: usize| {
        u32::try_from(n).map(u32::to_le_bytes).map_err(|_| ExportError::TooLarge {
            what: format!("a file of {n} bytes"),
            format: "GLB",
            limit: u64::from(u32::MAX),
            instead: "bake fewer frames",
        })
    };
    out.extend_from_slice(b"glTF");
    out.extend_from_slice(&2u32.to_le_bytes());
    out.extend_from_slice(&word(total)?);
    out.extend_from_slice(&word(text.len())?);
    out.extend_from_slice(b"JSON");
    out.extend_from_slice(&text);
    if let Some(mut binary) = binary {
        binary.resize(binary.len().next_multiple_of(4), 0);
        out.extend_from_slice(&word(binary.len())?);
        out.extend_from_slice(b"BIN\0");
        out.extend_from_slice(&binary);
    }
    Ok(out)
}

/// Animated nodes must not have a matrix: it becomes what it was read as.
fn split(node: &mut Value, rest: &Transform) {
    if node.as_object_mut().is_some_and(|node| node.remove("matrix").is_some()) {
        node["translation"] = json!(rest.translation);
        node["rotation"] = json!(rest.rotation);
        node["scale"] = json!(rest.scale);
    }
}

/// A list of the document, made when it is not there.
fn list<'a>(document: &'a mut Value, name: &str) -> &'a mut Vec<Value> {
    if !document[name].is_array() {
        document[name] = json!([]);
    }
    document[name].as_array_mut().expect("it was made one above")
}

/// Appends numbers to a buffer of a document.
struct Appender<'a> {
    document: &'a mut Value,
    data: &'a mut Vec<u8>,
    buffer: usize,
}

impl Appender<'_> {
    fn accessor(&mut self, numbers: &[f32], width: usize, kind: &str) -> usize {
        let start = self.data.len();
        self.data.extend(numbers.iter().flat_map(|v| v.to_le_bytes()));
        let views = list(self.document, "bufferViews");
        views.push(json!({ "buffer": self.buffer, "byteOffset": start, "byteLength": 4 * numbers.len() }));
        let view = views.len() - 1;
        let mut accessor =
            json!({ "bufferView": view, "componentType": 5126, "count": numbers.len() / width, "type": kind });
        if width == 1 {
            let (lo, hi) = numbers.iter().fold((f32::INFINITY, f32::NEG_INFINITY), |(l, h), v| (l.min(*v), h.max(*v)));
            (accessor["min"], accessor["max"]) = (json!([lo]), json!([hi]));
        }
        let accessors = list(self.document, "accessors");
        accessors.push(accessor);
        accessors.len() - 1
    }
}

/// JSON and binary chunk of a GLB; `None` when it is damaged.
fn glb_chunks(bytes: &[u8]) -> Option<(&[u8], Option<&[u8]>)> {
    let word = |at: usize| -> Option<usize> {
        Some(u32::from_le_bytes(bytes.get(at..at.checked_add(4)?)?.try_into().ok()?) as usize)
    };
    let (mut json, mut binary, mut at) = (None, None, 12);
    while at + 8 <= bytes.len() {
        let body = bytes.get(at + 8..(at + 8).checked_add(word(at)?)?)?;
        match &bytes[at + 4..at + 8] {
            b"JSON" if json.is_none() => json = Some(body),
            b"BIN\0" if binary.is_none() => binary = Some(body),
            _ => {}
        }
        at += 8 + body.len();
    }
    Some((json?, binary))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bits(pose: &Pose) -> Vec<f64> {
        pose.world.iter().flat_map(|w| w.linear.into_iter().flatten().chain(w.translation)).collect()
    }

    /// Poses made of a clip, turned into a clip and played again are the same poses.
    #[test]
    fn poses_come_back_from_their_clip() {
        let character = softrig::sample::character();
        let (skeleton, clip) = (&character.skeleton, &character.clips[0]);
        let poses: Vec<Pose> = (0..10).map(|k| skeleton.pose(&clip.sample(skeleton, 0.1 * f64::from(k)))).collect();
        let made = clip_of_poses(skeleton, &poses, 10.0, "made");
        assert!(made.tracks.len() > 5);
        for (k, pose) in poses.iter().enumerate() {
            let again = skeleton.pose(&made.sample(skeleton, 0.1 * k as f64));
            let off = bits(pose).iter().zip(bits(&again)).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            assert!(off < 1e-9, "{k}: {off}");
        }
    }

    /// The copy reads as the character it was, with one more clip that plays the poses; both containers.
    #[test]
    fn a_clip_is_written_into_a_copy() {
        let node = |t: [f64; 3], children: Value| json!({ "translation": t, "children": children });
        // a node that is given as a matrix can move as well, and has none in the copy
        let along_x = [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.5, 0.0, 0.0, 1.0];
        let document = json!({
            "asset": { "version": "2.0" }, "scene": 0, "scenes": [{ "nodes": [0] }],
            "nodes": [node([0.0, 1.0, 0.0], json!([1])), json!({ "matrix": along_x, "name": "b", "mesh": 0 })],
            // one triangle
            "meshes": [{ "primitives": [{ "attributes": { "POSITION": 0 } }] }],
            "accessors": [{ "bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 0] }],
            "bufferViews": [{ "buffer": 0, "byteLength": 36 }],
            "buffers": [{ "byteLength": 36, "uri": "data:application/octet-stream;base64,AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAA" }],
        });
        let text = document.to_string();
        let mut padded = text.clone().into_bytes();
        padded.resize(padded.len().next_multiple_of(4), b' ');
        let mut glb = b"glTF".to_vec();
        for word in [2, (20 + padded.len()) as u32, padded.len() as u32] {
            glb.extend_from_slice(&word.to_le_bytes());
        }
        glb.extend_from_slice(b"JSON");
        glb.extend_from_slice(&padded);
        for source in [text.into_bytes(), glb] {
            let options = crate::ImportOptions { unit: Some(1.0), ..crate::ImportOptions::default() };
            let folder = std::env::temp_dir().join(format!("softrig-skeleton-{}", std::process::id()));
            std::fs::create_dir_all(&folder).unwrap();
            let file = folder.join(if source.starts_with(b"glTF") { "a.glb" } else { "a.gltf" });
            std::fs::write(&file, &source).unwrap();
            let character = crate::gltf::read(&file, &options).unwrap();
            let turn = |a: f64| DQuat::from_rotation_z(a).to_array();
            let poses: Vec<Pose> = (0..4)
                .map(|k| {
                    let mut locals = character.skeleton.rest_locals();
                    locals[1].rotation = turn(0.3 * f64::from(k));
                    character.skeleton.pose(&locals)
                })
                .collect();
            let clip = clip_of_poses(&character.skeleton, &poses, 30.0, "shaken");
            let copy = gltf_with_clip(&source, &character.skeleton, &clip).unwrap();
            assert!(!String::from_utf8_lossy(&copy).contains("matrix"));
            std::fs::write(&file, &copy).unwrap();
            let again = crate::gltf::read(&file, &options).unwrap();
            std::fs::remove_dir_all(&folder).unwrap();
            assert_eq!(again.clips.last().unwrap().name, "shaken");
            let pose = again.skeleton.pose(&again.clips.last().unwrap().sample(&again.skeleton, 0.1));
            let off = bits(&pose).iter().zip(bits(&poses[3])).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            assert!(off < 1e-6, "{off}");
        }
    }
}
