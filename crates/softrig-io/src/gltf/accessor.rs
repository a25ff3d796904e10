//! Numbers out of accessors, every one checked against the bytes that are really there.
//!
//! Any component type is taken for any attribute, so KHR_mesh_quantization needs nothing special. How many numbers one file
//! may make is bounded by its size: many accessors on the same bytes, or one without bytes at all, cannot fill the memory.

use super::document::{Accessor, Document};
use super::fault::{Checked, Fault};
use std::borrow::Cow;
use std::cell::Cell;

/// Numbers any file may make, however small it is.
const FREE_NUMBERS: u64 = 4 << 20;

/// Reads accessors.
pub(super) struct Accessors<'a> {
    document: &'a Document,
    buffers: &'a [Cow<'a, [u8]>],
    /// Numbers still allowed.
    left: Cell<u64>,
    limit: u64,
}

/// How integers become real numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Integers {
    /// As the accessor's `normalized` says.
    AsMarked,
    /// Always to [0, 1] or [-1, 1]: the only thing the format allows for this use.
    Normalized,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Component {
    I8,
    U8,
    I16,
    U16,
    U32,
    F32,
}

impl Component {
    fn of(code: u32, place: &str) -> Checked<Self> {
        Ok(match code {
            5120 => Self::I8,
            5121 => Self::U8,
            5122 => Self::I16,
            5123 => Self::U16,
            5125 => Self::U32,
            5126 => Self::F32,
            _ => return Err(Fault::malformed(place, format!("component type {code} does not exist"))),
        })
    }

    fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::U32 | Self::F32 => 4,
        }
    }

    /// Value at the start of `b`, which has at least `size` bytes.
    fn read(self, b: &[u8]) -> f64 {
        match self {
            Self::I8 => f64::from(b[0] as i8),
            Self::U8 => f64::from(b[0]),
            Self::I16 => f64::from(i16::from_le_bytes([b[0], b[1]])),
            Self::U16 => f64::from(u16::from_le_bytes([b[0], b[1]])),
            Self::U32 => f64::from(u32::from_le_bytes([b[0], b[1], b[2], b[3]])),
            Self::F32 => f64::from(f32::from_le_bytes([b[0], b[1], b[2], b[3]])),
        }
    }

    /// Normalised value of an integer, as the format defines it.
    fn normalize(self, v: f64) -> f64 {
        match self {
            Self::I8 => (v / 127.0).max(-1.0),
            Self::U8 => v / 255.0,
            Self::I16 => (v / 32767.0).max(-1.0),
            Self::U16 => v / 65535.0,
            Self::U32 => v / 4_294_967_295.0,
            Self::F32 => v,
        }
    }
}

/// Bytes of equally spaced elements.
struct Elements<'a> {
    bytes: &'a [u8],
    stride: usize,
    size: usize,
}

impl<'a> Elements<'a> {
    fn at(&self, i: usize) -> &'a [u8] {
        &self.bytes[i * self.stride..i * self.stride + self.size]
    }
}

impl<'a> Accessors<'a> {
    pub fn new(document: &'a Document, buffers: &'a [Cow<'a, [u8]>]) -> Self {
        let limit = FREE_NUMBERS + buffers.iter().map(|b| b.len() as u64).sum::<u64>();
        Self { document, buffers, left: Cell::new(limit), limit }
    }

    fn get(&self, index: usize, place: &str) -> Checked<&'a Accessor> {
        self.document.accessors.get(index).ok_or_else(|| {
            let count = self.document.accessors.len();
            Fault::malformed(place, format!("it names accessor {index}, but there are {count}"))
        })
    }

    /// Whether the accessor has bytes of its own: one without stands for zeros, or for data in an extension.
    pub fn has_data(&self, index: usize, place: &str) -> Checked<bool> {
        let accessor = self.get(index, place)?;
        Ok(accessor.buffer_view.is_some() || accessor.sparse.is_some())
    }

    /// Components of an element.
    pub fn components(&self, index: usize, place: &str) -> Checked<usize> {
        let kind = &self.get(index, place)?.kind;
        Ok(match kind.as_str() {
            "SCALAR" => 1,
            "VEC2" => 2,
            "VEC3" => 3,
            "VEC4" | "MAT2" => 4,
            "MAT3" => 9,
            "MAT4" => 16,
            _ => return Err(Fault::malformed(format!("/accessors/{index}/type"), "there is no such type")),
        })
    }

    /// Takes `numbers` from what this file may still make.
    pub fn charge(&self, numbers: u64, place: &str) -> Checked<()> {
        match self.left.get().checked_sub(numbers) {
            Some(left) => {
                self.left.set(left);
                Ok(())
            }
            None => Err(Fault::too_large(
                place,
                "its vertices and keys together are more numbers than the file has room for",
                self.limit,
            )),
        }
    }

    /// All elements as real numbers.
    pub fn reals<const N: usize>(&self, index: usize, place: &str, integers: Integers) -> Checked<Vec<[f64; N]>> {
        let accessor = self.get(index, place)?;
        let component = Component::of(accessor.component_type, &format!("/accessors/{index}/componentType"))?;
        let scaled = accessor.normalized || integers == Integers::Normalized;
        self.decode(index, place, |bytes| {
            std::array::from_fn(|k| {
                let v = component.read(&bytes[k * component.size()..]);
                if scaled { component.normalize(v) } else { v }
            })
        })
    }

    /// All elements as whole numbers; refuses signed and floating component types.
    pub fn whole<const N: usize>(&self, index: usize, place: &str) -> Checked<Vec<[u32; N]>> {
        let accessor = self.get(index, place)?;
        let component = Component::of(accessor.component_type, &format!("/accessors/{index}/componentType"))?;
        if !matches!(component, Component::U8 | Component::U16 | Component::U32) {
            return Err(Fault::malformed(place, format!("accessor {index} must hold unsigned whole numbers")));
        }
        self.decode(index, place, |bytes| {
            // exact: a u32 fits the f64
            std::array::from_fn(|k| component.read(&bytes[k * component.size()..]) as u32)
        })
    }

    /// Elements of `N` components through `read`, which gets the bytes of one.
    fn decode<const N: usize, T: Copy>(
        &self,
        index: usize,
        place: &str,
        read: impl Fn(&[u8]) -> [T; N],
    ) -> Checked<Vec<[T; N]>> {
        let accessor = self.get(index, place)?;
        let here = format!("/accessors/{index}");
        let component = Component::of(accessor.component_type, &here)?;
        let components = self.components(index, place)?;
        if components != N {
            return Err(Fault::malformed(place, format!("accessor {index} has {components} components, not {N}")));
        }
        let size = component.size() * components;
        self.charge((accessor.count as u64).saturating_mul(components as u64), &here)?;
        let mut out: Vec<[T; N]> = match accessor.buffer_view {
            Some(view) => {
                let e = self.elements(view, accessor.byte_offset, accessor.count, size, true, &here)?;
                (0..accessor.count).map(|i| read(e.at(i))).collect()
            }
            None => vec![read(&[0; 64]); accessor.count],
        };
        if let Some(sparse) = &accessor.sparse {
            let here = format!("{here}/sparse");
            if sparse.count > accessor.count {
                return Err(Fault::malformed(here, "it replaces more elements than there are"));
            }
            let kind = Component::of(sparse.indices.component_type, &here)?;
            let (at, data) = (&sparse.indices, &sparse.values);
            let at = self.elements(at.buffer_view, at.byte_offset, sparse.count, kind.size(), false, &here)?;
            let data = self.elements(data.buffer_view, data.byte_offset, sparse.count, size, false, &here)?;
            for i in 0..sparse.count {
                let target = kind.read(at.at(i));
                // NaN and negative numbers fail the comparison, too
                if !(target >= 0.0 && target < accessor.count as f64) {
                    return Err(Fault::malformed(here, format!("it replaces element {target} of {}", accessor.count)));
                }
                out[target as usize] = read(data.at(i));
            }
        }
        Ok(out)
    }

    /// Bytes of a buffer view; used for pictures, too.
    pub fn view(&self, index: usize, place: &str) -> Checked<&'a [u8]> {
        let views = &self.document.buffer_views;
        let view = views.get(index).ok_or_else(|| {
            Fault::malformed(place, format!("it names buffer view {index}, but there are {}", views.len()))
        })?;
        let here = format!("/bufferViews/{index}");
        let buffer = self.buffers.get(view.buffer).ok_or_else(|| {
            Fault::malformed(&here, format!("it names buffer {}, but there are {}", view.buffer, self.buffers.len()))
        })?;
        let range = view.byte_offset.checked_add(view.byte_length).map(|end| view.byte_offset..end);
        range.and_then(|r| buffer.get(r)).ok_or_else(|| {
            let (start, length) = (view.byte_offset, view.byte_length);
            Fault::malformed(here, format!("it takes {length} bytes from {start} of a buffer of {}", buffer.len()))
        })
    }

    fn elements(
        &self,
        view: usize,
        offset: usize,
        count: usize,
        size: usize,
        strided: bool,
        place: &str,
    ) -> Checked<Elements<'a>> {
        let bytes = self.view(view, place)?;
        let stride = self.document.buffer_views[view].byte_stride.filter(|s| strided && *s > 0).unwrap_or(size);
        if stride < size {
            return Err(Fault::malformed(place, format!("elements of {size} bytes lie only {stride} bytes apart")));
        }
        let length = count.checked_sub(1).map_or(Some(0), |last| last.checked_mul(stride)?.checked_add(size));
        let end = length.and_then(|length| offset.checked_add(length));
        match end.and_then(|end| bytes.get(offset..end)) {
            Some(bytes) => Ok(Elements { bytes, stride, size }),
            None => {
                let have = bytes.len();
                Err(Fault::malformed(
                    place,
                    format!("its {count} elements do not fit into the {have} bytes of its view"),
                ))
            }
        }
    }
}
