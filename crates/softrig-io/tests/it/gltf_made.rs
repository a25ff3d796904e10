//! glTF files written here, each with one thing that goes wrong in practice.

use base64::Engine;
use serde_json::{Value, json};
use softrig::character::{Character, Skin};
use softrig::rig::{JointId, Property};
use softrig_io::{ImportError, ImportOptions, gltf};
use std::path::Path;

/// Collects accessors into one embedded buffer.
#[derive(Default)]
struct Maker {
    bytes: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
}

impl Maker {
    fn add(&mut self, bytes: &[u8], component: u32, kind: &str, count: usize) -> usize {
        self.views.push(json!({"buffer": 0, "byteOffset": self.bytes.len(), "byteLength": bytes.len()}));
        self.bytes.extend(bytes);
        let view = self.views.len() - 1;
        self.accessors.push(json!({"bufferView": view, "componentType": component, "type": kind, "count": count}));
        self.accessors.len() - 1
    }

    fn floats(&mut self, values: &[f32], kind: &str) -> usize {
        let n = [("SCALAR", 1), ("VEC2", 2), ("VEC3", 3), ("VEC4", 4), ("MAT4", 16)];
        let n = n.iter().find(|(k, _)| *k == kind).unwrap().1;
        let bytes: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        self.add(&bytes, 5126, kind, values.len() / n)
    }

    fn bytes(&mut self, values: &[u8], kind: &str, count: usize) -> usize {
        self.add(values, 5121, kind, count)
    }

    /// The file, with the parts that the maker knows filled in.
    fn file(&self, mut rest: Value) -> Value {
        let data = base64::engine::general_purpose::STANDARD.encode(&self.bytes);
        rest["asset"] = json!({"version": "2.0"});
        rest["buffers"] =
            json!([{"byteLength": self.bytes.len(), "uri": format!("data:application/octet-stream;base64,{data}")}]);
        rest["bufferViews"] = json!(self.views);
        rest["accessors"] = json!(self.accessors);
        rest
    }
}

const SQUARE: [f32; 12] = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 1.0, 0.0];

fn read(file: &Value) -> Result<Character, ImportError> {
    let options = ImportOptions { unit: Some(1.0), ..ImportOptions::default() };
    let mut none = |name: &str| Err(format!("there is no {name}"));
    gltf::read_bytes(&serde_json::to_vec(file).unwrap(), Path::new("made.gltf"), &mut none, &options)
}

fn refused(file: &Value, because: &str) {
    let e = read(file).unwrap_err().to_string();
    assert!(e.contains(because) && e.starts_with("made.gltf"), "{e}");
}

/// A square of one node, with the primitive changed by `with`.
fn square(with: impl FnOnce(&mut Maker, &mut Value)) -> Value {
    let mut maker = Maker::default();
    let positions = maker.floats(&SQUARE, "VEC3");
    let mut primitive = json!({"attributes": {"POSITION": positions}});
    with(&mut maker, &mut primitive);
    maker.file(json!({"nodes": [{"mesh": 0}], "meshes": [{"primitives": [primitive]}]}))
}

#[test]
fn strips_and_fans_become_triangles_of_one_orientation() {
    let strip = square(|m, p| {
        p["mode"] = json!(5);
        p["indices"] = json!(m.bytes(&[0, 1, 3, 2], "SCALAR", 4));
    });
    assert_eq!(read(&strip).unwrap().meshes[0].triangles, [[0, 1, 3], [3, 1, 2]]);
    let fan = square(|_, p| p["mode"] = json!(6));
    assert_eq!(read(&fan).unwrap().meshes[0].triangles, [[1, 2, 0], [2, 3, 0]]);
}

#[test]
fn points_and_lines_are_no_surface() {
    refused(&square(|_, p| p["mode"] = json!(1)), "no node of its scene shows a mesh with triangles");
    refused(&square(|_, p| p["mode"] = json!(7)), "mode 7");
}

#[test]
fn vertices_without_a_triangle_are_left_out_as_other_importers_do() {
    let c = read(&square(|m, p| p["indices"] = json!(m.bytes(&[1, 2, 3, 9], "SCALAR", 3)))).unwrap();
    assert_eq!((c.meshes[0].positions.len(), c.meshes[0].triangles[0]), (3, [0, 1, 2]));
    assert!(c.notes.iter().any(|n| n.contains("left out 1 vertices")), "{:?}", c.notes);
}

#[test]
fn sparse_accessors_replace_elements() {
    let file = |target: u8| {
        let mut m = Maker::default();
        let positions = m.floats(&SQUARE, "VEC3");
        let (at, to) = (m.bytes(&[target], "SCALAR", 1), m.floats(&[0.5, 0.5, 7.0], "VEC3"));
        m.accessors[positions]["sparse"] = json!({"count": 1,
            "indices": {"bufferView": at, "componentType": 5121}, "values": {"bufferView": to}});
        let indices = m.bytes(&[0, 1, 2, 0, 2, 3], "SCALAR", 6);
        let primitive = json!({"attributes": {"POSITION": positions}, "indices": indices});
        m.file(json!({"nodes": [{"mesh": 0}], "meshes": [{"primitives": [primitive]}]}))
    };
    let got = read(&file(2)).unwrap().meshes[0].positions.clone();
    assert_eq!(got, [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.5, 0.5, 7.0], [0.0, 1.0, 0.0]]);
    refused(&file(4), "replaces element 4 of 4");
}

#[test]
fn an_accessor_cannot_claim_more_than_there_is() {
    let mut huge = square(|_, _| {});
    huge["accessors"][0]["count"] = json!(5);
    refused(&huge, "do not fit");
    huge["accessors"][0]["count"] = json!(u64::MAX / 12);
    refused(&huge, "at most");
    // zeros need no bytes, but memory
    huge["accessors"][0] = json!({"componentType": 5126, "type": "VEC3", "count": 2_000_000_000});
    refused(&huge, "at most");
}

/// A small mesh shown by very many nodes must not fill the memory.
#[test]
fn many_instances_of_a_mesh_are_bounded() {
    let mut m = Maker::default();
    let positions = m.floats(&SQUARE.repeat(2500), "VEC3");
    let nodes: Vec<Value> = (0..1000).map(|_| json!({"mesh": 0})).collect();
    let file = m.file(json!({"nodes": nodes, "meshes": [{"primitives": [{"attributes": {"POSITION": positions}}]}]}));
    refused(&file, "at most");
}

#[test]
fn files_outside_the_folder_are_not_read() {
    for uri in
        ["../a.bin", "/etc/a.bin", "%2e%2e/a.bin", "b/../../a.bin", "C:/a.bin", "file:///a.bin", "..%5ca.bin", "%ff"]
    {
        let mut file = square(|_, _| {});
        file["buffers"][0]["uri"] = json!(uri);
        refused(&file, "/buffers/0");
        assert!(!read(&file).unwrap_err().to_string().contains("there is no"), "{uri} was asked for");
    }
    let mut file = square(|_, _| {});
    file["buffers"][0]["uri"] = json!("my%20data/a.bin");
    refused(&file, "there is no my data/a.bin");
}

#[test]
fn a_node_has_one_parent() {
    let mut file = square(|_, _| {});
    file["nodes"] = json!([{"mesh": 0}, {"children": [0]}, {"children": [0]}]);
    refused(&file, "also a child");
}

#[test]
fn packed_meshes_are_refused_with_what_to_do() {
    let mut file = square(|_, _| {});
    file["extensionsRequired"] = json!(["KHR_draco_mesh_compression"]);
    refused(&file, "without mesh compression");
    file["extensionsRequired"] = json!(["ACME_teapots"]);
    refused(&file, "export it again without ACME_teapots");
    file["extensionsRequired"] = json!(["KHR_materials_unlit"]);
    assert!(read(&file).is_ok());
}

/// Two joints; the skin of the square has them both, the node transforms stand elsewhere than the bind pose.
fn skinned(weights: [f32; 16], joints: [u8; 16], with: impl FnOnce(&mut Value)) -> Value {
    let mut m = Maker::default();
    let positions = m.floats(&SQUARE, "VEC3");
    let (joints, weights) = (m.bytes(&joints, "VEC4", 4), m.floats(&weights, "VEC4"));
    let indices = m.bytes(&[0, 1, 2, 0, 2, 3], "SCALAR", 6);
    let bind = |y: f32| [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, y, 0.0, 1.0];
    let binds = m.floats(&[bind(0.0), bind(-1.0)].concat(), "MAT4");
    let primitive = json!({"indices": indices,
        "attributes": {"POSITION": positions, "JOINTS_0": joints, "WEIGHTS_0": weights}});
    let mut rest = json!({
        "nodes": [
            {"mesh": 0, "skin": 0, "translation": [9, 9, 9]},
            {"name": "hip", "children": [2], "scale": [2, 2, 2]},
            {"name": "knee", "translation": [5, 1, 0], "children": [3]},
            {"name": "shoe", "translation": [0, 1, 0]}],
        "skins": [{"joints": [1, 2], "inverseBindMatrices": binds}],
        "meshes": [{"primitives": [primitive]}]
    });
    with(&mut rest);
    m.file(rest)
}

const ALL_ON_FIRST: [f32; 16] = [1., 0., 0., 0., 1., 0., 0., 0., 1., 0., 0., 0., 1., 0., 0., 0.];

/// The rest shape is the bind shape at the scale of the nodes; joints and what hangs on them follow it.
#[test]
fn rest_frames_come_from_inverse_bind_matrices_and_node_scales() {
    let c = read(&skinned(ALL_ON_FIRST, [0; 16], |_| {})).unwrap();
    assert_eq!(c.meshes[0].positions[2], [2.0, 2.0, 0.0]);
    let origin = |i: u32| c.skeleton.joint(JointId(i)).rest.translation;
    // the knee is bound at (0, 1, 0), whatever its node says; the shoe is one (times two) above it
    assert_eq!((origin(2), origin(3)), ([0.0, 2.0, 0.0], [0.0, 4.0, 0.0]));
    assert_eq!(c.meshes[0].object, None);
}

#[test]
fn weights_are_normalized_and_vertices_without_any_hang_on_the_root() {
    let mut weights = ALL_ON_FIRST;
    weights[0] = 0.0;
    (weights[4], weights[5]) = (1.5, 0.5);
    (weights[8], weights[9]) = (3e38, 3e38);
    let mut joints = [0; 16];
    (joints[5], joints[9]) = (1, 1);
    // a joint out of range without weight is common, and harmless
    joints[15] = 77;
    let c = read(&skinned(weights, joints, |_| {})).unwrap();
    let Skin::Weighted(w) = &c.meshes[0].skin else { panic!("not skinned") };
    let of = |v: usize| w.of(v).map(|(j, w)| (j.0, w)).collect::<Vec<_>>();
    assert_eq!((of(0), of(1), of(2)), (vec![(1, 1.0)], vec![(1, 0.75), (2, 0.25)], vec![(1, 0.5), (2, 0.5)]));
    assert!(c.notes.iter().any(|n| n.contains("1 vertices have no weight")), "{:?}", c.notes);
    joints[5] = 2;
    refused(&skinned(weights, joints, |_| {}), "joint 2 of a skin with 2 joints");
}

/// Armatures mirrored by a negative scale pose mirrored: so does the rest shape, with its triangles turned.
#[test]
fn a_mirrored_armature_keeps_positive_bone_maps() {
    let c = read(&skinned(ALL_ON_FIRST, [0; 16], |f| f["nodes"][1]["scale"] = json!([-2, 2, 2]))).unwrap();
    let pose = c.skeleton.pose(&c.skeleton.rest_locals());
    assert!((c.bone_maps(&pose)[1].determinant() - 1.0).abs() < 1e-12);
    assert_eq!((c.meshes[0].positions[1], c.meshes[0].triangles[0]), ([-2.0, 0.0, 0.0], [0, 2, 1]));
}

#[test]
fn broken_skins_are_refused_or_repaired() {
    refused(&skinned(ALL_ON_FIRST, [0; 16], |f| f["skins"][0]["joints"] = json!([])), "no joints");
    refused(&skinned(ALL_ON_FIRST, [0; 16], |f| f["skins"][0]["joints"] = json!([1, 9])), "names node 9");
    refused(&skinned(ALL_ON_FIRST, [0; 16], |f| f["skins"][0]["joints"] = json!([1, 2, 3])), "for 3 joints");
    refused(&skinned(ALL_ON_FIRST, [0; 16], |f| f["nodes"][0]["skin"] = json!(4)), "names skin 4");
    let none = skinned(ALL_ON_FIRST, [0; 16], |f| f["skins"][0]["inverseBindMatrices"] = Value::Null);
    assert!(read(&none).unwrap().notes.iter().any(|n| n.contains("no inverse bind matrices")));
}

/// A clip may move a node that the file gives as a matrix; keys out of order are sorted; equal names told apart.
#[test]
fn clips_move_matrix_nodes_and_are_sorted() {
    let mut m = Maker::default();
    let positions = m.floats(&SQUARE, "VEC3");
    let (times, values) = (m.floats(&[1.0, 0.0], "SCALAR"), m.floats(&[5.0, 0.0, 0.0, 3.0, 0.0, 0.0], "VEC3"));
    let clip = json!({"name": "go", "samplers": [{"input": times, "output": values}],
        "channels": [{"sampler": 0, "target": {"node": 0, "path": "translation"}},
                     {"sampler": 0, "target": {"node": 0, "path": "pointer"}}]});
    let file = m.file(json!({
        "nodes": [{"mesh": 0, "matrix": [0, 2, 0, 0, -2, 0, 0, 0, 0, 0, 2, 0, 7, 8, 9, 1]}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": positions}, "mode": 6}]}],
        "animations": [clip.clone(), clip]
    }));
    let c = read(&file).unwrap();
    assert_eq!([&c.clips[0].name, &c.clips[1].name], ["go", "go_2"]);
    assert_eq!((c.clips[0].start, c.clips[0].end, c.clips[0].tracks[0].property), (0.0, 1.0, Property::Translation));
    assert!(c.notes.iter().any(|n| n.contains("pointer of clip go")), "{:?}", c.notes);
    assert_eq!(c.meshes[0].skin, Skin::Rigid(JointId(0)));
    // quarter turn about Z and scale 2 from the matrix, translation from the clip
    let pose = c.skeleton.pose(&c.clips[0].sample(&c.skeleton, 0.0));
    let p = c.blend_skin(0, &pose)[1];
    assert!((0..3).all(|k| (p[k] - [3.0, 2.0, 0.0][k]).abs() < 1e-12), "{p:?}");
}

#[test]
fn a_file_without_skin_and_clip_is_a_bare_surface() {
    let c = read(&square(|_, p| p["mode"] = json!(6))).unwrap();
    assert_eq!((&c.meshes[0].skin, c.meshes[0].object), (&Skin::Free, Some(JointId(0))));
}
