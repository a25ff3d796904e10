//! A second, plain reading of glTF skinning, straight from the JSON and the formula of the specification, to hold the
//! importer against: x = sum_j w_j W_j B_j p for skinned meshes, x = W p for others. Trusts its input; only for good files.

use base64::Engine;
use serde_json::Value;
use std::path::Path;

type Matrix = [[f64; 4]; 4];

pub struct Reference {
    json: Value,
    buffers: Vec<Vec<u8>>,
}

impl Reference {
    pub fn open(path: &Path) -> Self {
        let bytes = std::fs::read(path).unwrap();
        if &bytes[..4] != b"glTF" {
            let json: Value = serde_json::from_slice(&bytes).unwrap();
            let load = |b: &Value| {
                let uri = b["uri"].as_str().unwrap();
                match uri.split_once("base64,") {
                    Some((_, data)) => base64::engine::general_purpose::STANDARD.decode(data).unwrap(),
                    None => std::fs::read(path.with_file_name(uri)).unwrap(),
                }
            };
            let buffers = json["buffers"].as_array().unwrap().iter().map(load).collect();
            return Self { json, buffers };
        }
        let length = u32::from_le_bytes(bytes[12..16].try_into().unwrap()) as usize;
        let json = serde_json::from_slice(&bytes[20..20 + length]).unwrap();
        Self { json, buffers: vec![bytes[28 + length..].to_vec()] }
    }

    fn numbers(&self, accessor: &Value) -> Vec<Vec<f64>> {
        let a = &self.json["accessors"][accessor.as_u64().unwrap() as usize];
        assert!(a["sparse"].is_null());
        let n = match a["type"].as_str().unwrap() {
            "SCALAR" => 1,
            "VEC2" => 2,
            "VEC3" => 3,
            "VEC4" => 4,
            _ => 16,
        };
        let kind = a["componentType"].as_u64().unwrap();
        let size = [1, 1, 2, 2, 0, 4, 4][kind as usize - 5120];
        let view = &self.json["bufferViews"][a["bufferView"].as_u64().unwrap() as usize];
        let at = |v: &Value| v.as_u64().unwrap_or(0) as usize;
        let stride = view["byteStride"].as_u64().unwrap_or((n * size) as u64) as usize;
        let start = at(&view["byteOffset"]) + at(&a["byteOffset"]);
        let data = &self.buffers[at(&view["buffer"])];
        let scale = |full: f64| if a["normalized"] == true { full } else { 1.0 };
        let number = |i: usize, k: usize| {
            let b = &data[start + i * stride + k * size..];
            match kind {
                5120 => f64::from(b[0] as i8) / scale(127.0),
                5121 => f64::from(b[0]) / scale(255.0),
                5122 => f64::from(i16::from_le_bytes([b[0], b[1]])) / scale(32767.0),
                5123 => f64::from(u16::from_le_bytes([b[0], b[1]])) / scale(65535.0),
                5125 => f64::from(u32::from_le_bytes([b[0], b[1], b[2], b[3]])),
                _ => f64::from(f32::from_le_bytes([b[0], b[1], b[2], b[3]])),
            }
        };
        (0..at(&a["count"])).map(|i| (0..n).map(|k| number(i, k)).collect()).collect()
    }

    /// World matrices of all nodes at a time of a clip; without a clip as the file stores them.
    fn world(&self, clip: Option<usize>, time: f64) -> Vec<Matrix> {
        let mut nodes = self.json["nodes"].as_array().unwrap().clone();
        if let Some(clip) = clip {
            let clip = &self.json["animations"][clip];
            for channel in clip["channels"].as_array().unwrap() {
                let path = channel["target"]["path"].as_str().unwrap();
                if path == "weights" {
                    continue;
                }
                let sampler = &clip["samplers"][channel["sampler"].as_u64().unwrap() as usize];
                let times: Vec<f64> = self.numbers(&sampler["input"]).iter().map(|t| t[0]).collect();
                let values = self.numbers(&sampler["output"]);
                let step = sampler["interpolation"] == "STEP";
                assert!(sampler["interpolation"] != "CUBICSPLINE");
                let v = interpolate(&times, &values, time, path == "rotation", step);
                nodes[channel["target"]["node"].as_u64().unwrap() as usize][path] = serde_json::json!(v);
            }
        }
        let mut parent = vec![None; nodes.len()];
        for (i, node) in nodes.iter().enumerate() {
            for child in node["children"].as_array().into_iter().flatten() {
                parent[child.as_u64().unwrap() as usize] = Some(i);
            }
        }
        let locals: Vec<Matrix> = nodes.iter().map(local).collect();
        let chain = |mut i: usize| {
            let mut m = locals[i];
            while let Some(p) = parent[i] {
                m = multiply(&locals[p], &m);
                i = p;
            }
            m
        };
        (0..nodes.len()).map(chain).collect()
    }

    /// Posed vertices of every mesh node, in file units, in the order of nodes, primitives and accessors.
    pub fn skinned(&self, clip: Option<usize>, time: f64) -> Vec<Vec<[f64; 3]>> {
        let world = self.world(clip, time);
        let mut out = Vec::new();
        for (i, node) in self.json["nodes"].as_array().unwrap().iter().enumerate() {
            let Some(mesh) = node["mesh"].as_u64() else { continue };
            let mut vertices = Vec::new();
            for primitive in self.json["meshes"][mesh as usize]["primitives"].as_array().unwrap() {
                let attributes = &primitive["attributes"];
                let positions = self.numbers(&attributes["POSITION"]);
                let Some(skin) = node["skin"].as_u64() else {
                    vertices.extend(positions.iter().map(|p| apply(&world[i], p)));
                    continue;
                };
                let skin = &self.json["skins"][skin as usize];
                let binds = self.numbers(&skin["inverseBindMatrices"]);
                let joints = skin["joints"].as_array().unwrap();
                let maps: Vec<Matrix> = joints
                    .iter()
                    .zip(&binds)
                    .map(|(j, b)| {
                        let b = std::array::from_fn(|r| std::array::from_fn(|c| b[4 * c + r]));
                        multiply(&world[j.as_u64().unwrap() as usize], &b)
                    })
                    .collect();
                let sets: Vec<_> = (0..)
                    .map_while(|n| {
                        Some((attributes.get(format!("JOINTS_{n}"))?, attributes.get(format!("WEIGHTS_{n}"))?))
                    })
                    .map(|(j, w)| (self.numbers(j), self.numbers(w)))
                    .collect();
                for (v, p) in positions.iter().enumerate() {
                    let (mut x, mut sum) = ([0.0; 3], 0.0);
                    for (joints, weights) in &sets {
                        for (j, w) in joints[v].iter().zip(&weights[v]) {
                            let q = apply(&maps[*j as usize], p);
                            (0..3).for_each(|k| x[k] += w * q[k]);
                            sum += w;
                        }
                    }
                    vertices.push(x.map(|c| c / sum));
                }
            }
            out.push(vertices);
        }
        out
    }
}

fn interpolate(times: &[f64], values: &[Vec<f64>], time: f64, rotation: bool, step: bool) -> Vec<f64> {
    let last = times.len() - 1;
    if time <= times[0] {
        return values[0].clone();
    }
    if time >= times[last] {
        return values[last].clone();
    }
    let i = (0..last).find(|i| time < times[i + 1]).unwrap();
    if step {
        return values[i].clone();
    }
    let s = (time - times[i]) / (times[i + 1] - times[i]);
    let (a, b) = (&values[i], &values[i + 1]);
    if !rotation {
        return a.iter().zip(b).map(|(a, b)| a + s * (b - a)).collect();
    }
    // spherical, along the shorter arc; keys of some files are unit quaternions to three digits only
    let unit = |q: &[f64]| {
        let n = q.iter().map(|x| x * x).sum::<f64>().sqrt();
        q.iter().map(|x| x / n).collect::<Vec<f64>>()
    };
    let (a, b) = (unit(a), unit(b));
    let dot: f64 = a.iter().zip(&b).map(|(a, b)| a * b).sum();
    let angle = dot.abs().min(1.0).acos();
    let (wa, wb) = if angle < 1e-9 {
        (1.0 - s, s)
    } else {
        (((1.0 - s) * angle).sin() / angle.sin(), (s * angle).sin() / angle.sin())
    };
    a.iter().zip(&b).map(|(a, b)| wa * a + wb * b * dot.signum()).collect()
}

fn local(node: &Value) -> Matrix {
    let list = |name: &str, usual: &[f64]| -> Vec<f64> {
        node[name].as_array().map_or_else(|| usual.to_vec(), |v| v.iter().map(|x| x.as_f64().unwrap()).collect())
    };
    if !node["matrix"].is_null() {
        let m = list("matrix", &[]);
        return std::array::from_fn(|r| std::array::from_fn(|c| m[4 * c + r]));
    }
    let (t, q, s) = (list("translation", &[0.0; 3]), list("rotation", &[0.0, 0.0, 0.0, 1.0]), list("scale", &[1.0; 3]));
    let n = q.iter().map(|x| x * x).sum::<f64>().sqrt();
    let (x, y, z, w) = (q[0] / n, q[1] / n, q[2] / n, q[3] / n);
    let r = [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)],
        [2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)],
        [2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)],
    ];
    let row = |i: usize| [r[i][0] * s[0], r[i][1] * s[1], r[i][2] * s[2], t[i]];
    [row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]]
}

fn multiply(a: &Matrix, b: &Matrix) -> Matrix {
    std::array::from_fn(|i| std::array::from_fn(|j| (0..4).map(|k| a[i][k] * b[k][j]).sum()))
}

fn apply(m: &Matrix, p: &[f64]) -> [f64; 3] {
    std::array::from_fn(|i| m[i][0] * p[0] + m[i][1] * p[1] + m[i][2] * p[2] + m[i][3])
}
