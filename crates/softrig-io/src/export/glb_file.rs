//! Buffers, accessors and the container of a GLB file.

use super::ExportError;
use serde_json::{Value, json};
use std::ops::Range;

/// Numbers per element.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Rank {
    Scalar,
    Vec2,
    Vec3,
    Vec4,
}

impl Rank {
    fn count(self) -> usize {
        match self {
            Self::Scalar => 1,
            Self::Vec2 => 2,
            Self::Vec3 => 3,
            Self::Vec4 => 4,
        }
    }

    fn name(self) -> &'static str {
        match self {
            Self::Scalar => "SCALAR",
            Self::Vec2 => "VEC2",
            Self::Vec3 => "VEC3",
            Self::Vec4 => "VEC4",
        }
    }
}

const FLOAT: u32 = 5126;
const ARRAY_BUFFER: u32 = 34962;
const ELEMENT_ARRAY_BUFFER: u32 = 34963;

/// The binary part of a GLB file and the lists that describe it.
#[derive(Debug, Default)]
pub(super) struct GlbFile {
    bytes: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
    images: Vec<Value>,
    textures: Vec<Value>,
}

/// One per-vertex quantity of a mesh, from which primitives take parts.
#[derive(Debug)]
pub(super) struct Attribute {
    view: usize,
    /// Offset of its numbers in the binary part.
    start: usize,
    rank: Rank,
}

impl Attribute {
    /// Stores the numbers.
    pub fn new(file: &mut GlbFile, numbers: &[f32], rank: Rank) -> Result<Self, ExportError> {
        let start = file.bytes.len();
        let view = file.view(&float_bytes(numbers), Some(ARRAY_BUFFER), Some(4 * rank.count()))?;
        Ok(Self { view, start, rank })
    }

    /// An accessor to some elements. Parts that are asked for again are the same accessor.
    pub fn part(&self, file: &mut GlbFile, range: Range<usize>, with_bounds: bool) -> usize {
        let size = 4 * self.rank.count();
        let offset = range.start * size;
        let mut accessor = json!({
            "bufferView": self.view, "byteOffset": offset, "componentType": FLOAT, "count": range.len(), "type": self.rank.name(),
        });
        if with_bounds {
            let bytes = &file.bytes[self.start + offset..self.start + offset + range.len() * size];
            add_bounds(&mut accessor, bytes, self.rank.count());
        }
        file.accessor(accessor)
    }
}

impl GlbFile {
    /// Keys of an animation.
    pub fn animation_data(&mut self, numbers: &[f32], rank: Rank) -> usize {
        let bytes = float_bytes(numbers);
        // the size of the whole is checked when the file is finished
        let view = self.push_view(&bytes, None, None);
        let mut accessor = json!({
            "bufferView": view, "componentType": FLOAT, "count": numbers.len() / rank.count(), "type": rank.name(),
        });
        if rank == Rank::Scalar {
            add_bounds(&mut accessor, &bytes, 1);
        }
        self.accessor(accessor)
    }

    /// Vertex indices of triangles, in 16 bits when they fit.
    pub fn indices(&mut self, indices: &[u32]) -> Result<usize, ExportError> {
        // 65535 itself is reserved
        let narrow = indices.iter().all(|i| *i < 65535);
        let bytes: Vec<u8> = if narrow {
            indices.iter().flat_map(|i| (*i as u16).to_le_bytes()).collect()
        } else {
            indices.iter().flat_map(|i| i.to_le_bytes()).collect()
        };
        let view = self.view(&bytes, Some(ELEMENT_ARRAY_BUFFER), None)?;
        let kind = if narrow { 5123 } else { 5125 };
        Ok(self
            .accessor(json!({ "bufferView": view, "componentType": kind, "count": indices.len(), "type": "SCALAR" })))
    }

    /// A PNG picture as a texture.
    pub fn picture(&mut self, png: &[u8]) -> Option<usize> {
        let view = self.push_view(png, None, None);
        self.images.push(json!({ "bufferView": view, "mimeType": "image/png" }));
        self.textures.push(json!({ "source": self.images.len() - 1 }));
        Some(self.textures.len() - 1)
    }

    fn accessor(&mut self, accessor: Value) -> usize {
        self.accessors.push(accessor);
        self.accessors.len() - 1
    }

    fn view(&mut self, bytes: &[u8], target: Option<u32>, stride: Option<usize>) -> Result<usize, ExportError> {
        check_size(self.bytes.len() + bytes.len())?;
        Ok(self.push_view(bytes, target, stride))
    }

    fn push_view(&mut self, bytes: &[u8], target: Option<u32>, stride: Option<usize>) -> usize {
        let mut view = json!({ "buffer": 0, "byteOffset": self.bytes.len(), "byteLength": bytes.len() });
        if let Some(target) = target {
            view["target"] = json!(target);
        }
        if let Some(stride) = stride {
            view["byteStride"] = json!(stride);
        }
        self.bytes.extend_from_slice(bytes);
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        self.views.push(view);
        self.views.len() - 1
    }

    /// The whole file.
    pub fn finish(self, mut document: Value) -> Result<Vec<u8>, ExportError> {
        document["buffers"] = json!([{ "byteLength": self.bytes.len() }]);
        let lists = [
            ("bufferViews", self.views),
            ("accessors", self.accessors),
            ("images", self.images),
            ("textures", self.textures),
        ];
        for (name, list) in lists.into_iter().filter(|(_, list)| !list.is_empty()) {
            document[name] = Value::Array(list);
        }
        let mut text = document.to_string().into_bytes();
        text.resize(text.len().next_multiple_of(4), b' ');
        let total = 12 + 8 + text.len() + 8 + self.bytes.len();
        check_size(total)?;
        let mut out = Vec::with_capacity(total);
        out.extend_from_slice(b"glTF");
        for word in [2, total as u32, text.len() as u32] {
            out.extend_from_slice(&word.to_le_bytes());
        }
        out.extend_from_slice(b"JSON");
        out.extend_from_slice(&text);
        out.extend_from_slice(&(self.bytes.len() as u32).to_le_bytes());
        out.extend_from_slice(b"BIN\0");
        out.extend_from_slice(&self.bytes);
        Ok(out)
    }
}

fn float_bytes(numbers: &[f32]) -> Vec<u8> {
    numbers.iter().flat_map(|v| v.to_le_bytes()).collect()
}

/// Smallest and largest of each component, exactly as stored.
fn add_bounds(accessor: &mut Value, bytes: &[u8], components: usize) {
    let (mut lo, mut hi) = (vec![f32::INFINITY; components], vec![f32::NEG_INFINITY; components]);
    for (i, b) in bytes.chunks_exact(4).enumerate() {
        let v = f32::from_le_bytes([b[0], b[1], b[2], b[3]]);
        lo[i % components] = lo[i % components].min(v);
        hi[i % components] = hi[i % components].max(v);
    }
    accessor["min"] = json!(lo);
    accessor["max"] = json!(hi);
}

fn check_size(bytes: usize) -> Result<(), ExportError> {
    if u32::try_from(bytes).is_ok() {
        return Ok(());
    }
    Err(ExportError::TooLarge {
        what: format!("a file of {bytes} bytes"),
        format: "GLB",
        limit: u64::from(u32::MAX),
        instead: "use fewer morph targets, or .pc2 or .usda",
    })
}
