//! Polygon files, ASCII and binary of either byte order.
//!
//! Read are the vertices (`x y z`, colours, texture coordinates) and the faces (`vertex_indices` or `vertex_index`); all other
//! elements and properties are stepped over.

use super::{Parsed, srgb_to_linear, triangulate};
use crate::error::{ImportError, Place};
use crate::text::{REMEDY, Words, shown};
use std::path::Path;

#[derive(Clone, Copy, PartialEq)]
enum Encoding {
    Ascii,
    Little,
    Big,
}

#[derive(Clone, Copy, PartialEq)]
enum Kind {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Kind {
    fn of(word: &str) -> Option<Self> {
        Some(match word {
            "char" | "int8" => Self::I8,
            "uchar" | "uint8" => Self::U8,
            "short" | "int16" => Self::I16,
            "ushort" | "uint16" => Self::U16,
            "int" | "int32" => Self::I32,
            "uint" | "uint32" => Self::U32,
            "float" | "float32" => Self::F32,
            "double" | "float64" => Self::F64,
            _ => return None,
        })
    }

    fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    /// What one is in a colour of this kind.
    fn full(self) -> f64 {
        match self {
            Self::F32 | Self::F64 => 1.0,
            Self::I8 | Self::U8 => 255.0,
            _ => 65535.0,
        }
    }
}

struct Property {
    name: String,
    /// Kind of the count in front, for lists.
    list: Option<Kind>,
    kind: Kind,
}

struct Element {
    name: String,
    count: i64,
    properties: Vec<Property>,
}

pub(super) fn parse(bytes: &[u8], file: &Path) -> Result<Parsed, ImportError> {
    let mut words = Words::new(file, bytes);
    let (encoding, elements) = header(&mut words)?;
    let mut out = Parsed::default();
    // polygons, as corners one after the other and their counts
    let (mut corners, mut sizes) = (Vec::new(), Vec::new());
    let mut has_faces = false;
    for element in &elements {
        if element.properties.is_empty() {
            continue;
        }
        let each = element.properties.iter().map(|p| match encoding {
            Encoding::Ascii => 2,
            _ => p.list.unwrap_or(p.kind).size(),
        });
        let what = format!("the number of `{}` elements", element.name);
        let count = words.check_count(element.count, &what, each.sum())?;
        let mut body = Body { words: &mut words, encoding };
        match element.name.as_str() {
            "vertex" => body.vertices(element, count, &mut out)?,
            "face" => {
                has_faces = true;
                body.faces(element, count, &mut corners, &mut sizes)?;
            }
            _ => (0..count).try_for_each(|_| element.properties.iter().try_for_each(|p| body.skip(p)))?,
        }
    }
    if !has_faces && elements.iter().any(|e| e.name == "tristrips") {
        return Err(ImportError::unsupported(
            file,
            Place::Part("element `tristrips`".into()),
            "triangle strips are not read",
            "export it again with plain faces",
        ));
    }
    let mut polygon = Vec::new();
    let mut rest = &corners[..];
    let mut skipped = 0;
    for (i, size) in sizes.iter().enumerate() {
        let (these, after) = rest.split_at(*size);
        rest = after;
        polygon.clear();
        for &v in these {
            let vertex = u32::try_from(v).ok().filter(|v| (*v as usize) < out.positions.len());
            polygon.push(vertex.ok_or_else(|| {
                let reason = format!("it uses vertex {v}, but there are {}", out.positions.len());
                ImportError::malformed(file, Place::Part(format!("face {i}")), reason, REMEDY)
            })?);
        }
        skipped += usize::from(*size < 3);
        triangulate(&polygon, &out.positions, &mut out.triangles);
    }
    if skipped > 0 {
        out.notes.push(format!("left out {skipped} faces with fewer than three corners"));
    }
    Ok(out)
}

fn header(words: &mut Words<'_>) -> Result<(Encoding, Vec<Element>), ImportError> {
    let mut encoding = None;
    let mut elements: Vec<Element> = Vec::new();
    if words.rest_of_line() != b"ply" {
        return Err(words.malformed("a PLY file begins with `ply`"));
    }
    loop {
        match words.word("`end_header`")? {
            "end_header" => {
                words.rest_of_line();
                break;
            }
            "comment" | "obj_info" => {
                words.rest_of_line();
            }
            "format" => {
                encoding = Some(match words.word("a format")? {
                    "ascii" => Encoding::Ascii,
                    "binary_little_endian" => Encoding::Little,
                    "binary_big_endian" => Encoding::Big,
                    other => return Err(words.malformed(format!("`{}` is no PLY format", shown(other.as_bytes())))),
                });
                words.rest_of_line();
            }
            "element" => {
                let name = words.word("the name of an element")?.to_owned();
                let count = words.integer("the count of an element")?;
                elements.push(Element { name, count, properties: Vec::new() });
            }
            "property" => {
                let mut kind_word = words.word("a type")?;
                let is_list = kind_word == "list";
                let mut list = None;
                let kind = |word: &str, words: &Words<'_>| {
                    Kind::of(word)
                        .ok_or_else(|| words.malformed(format!("`{}` is no PLY type", shown(word.as_bytes()))))
                };
                if is_list {
                    list = Some(kind(words.word("a type")?, words)?);
                    kind_word = words.word("a type")?;
                }
                let kind = kind(kind_word, words)?;
                let name = words.word("the name of a property")?.to_owned();
                let Some(element) = elements.last_mut() else {
                    return Err(words.malformed("a property of no element"));
                };
                element.properties.push(Property { name, list, kind });
            }
            other => return Err(words.malformed(format!("`{}` belongs in no PLY header", shown(other.as_bytes())))),
        }
    }
    let encoding = encoding.ok_or_else(|| words.malformed("the header has no `format` line"))?;
    Ok((encoding, elements))
}

/// The data behind the header.
struct Body<'w, 'a> {
    words: &'w mut Words<'a>,
    encoding: Encoding,
}

impl Body<'_, '_> {
    fn number(&mut self, kind: Kind) -> Result<f64, ImportError> {
        if self.encoding == Encoding::Ascii {
            return self.words.number("a number");
        }
        let mut raw = [0; 8];
        let size = kind.size();
        raw[..size].copy_from_slice(self.words.raw(size, "a number")?);
        if self.encoding == Encoding::Big {
            raw[..size].reverse();
        }
        let [a, b, c, d, ..] = raw;
        Ok(match kind {
            Kind::I8 => f64::from(a as i8),
            Kind::U8 => f64::from(a),
            Kind::I16 => f64::from(i16::from_le_bytes([a, b])),
            Kind::U16 => f64::from(u16::from_le_bytes([a, b])),
            Kind::I32 => f64::from(i32::from_le_bytes([a, b, c, d])),
            Kind::U32 => f64::from(u32::from_le_bytes([a, b, c, d])),
            Kind::F32 => f64::from(f32::from_le_bytes([a, b, c, d])),
            Kind::F64 => f64::from_le_bytes(raw),
        })
    }

    /// Length of a list, held against the bytes that are left.
    fn length(&mut self, kind: Kind, item: Kind) -> Result<usize, ImportError> {
        let n = self.number(kind)?;
        let each = if self.encoding == Encoding::Ascii { 2 } else { item.size() };
        if n.fract() != 0.0 {
            return Err(self.words.malformed(format!("a list has {n} items")));
        }
        self.words.check_count(n as i64, "the length of a list", each)
    }

    fn skip(&mut self, property: &Property) -> Result<(), ImportError> {
        let n = match property.list {
            None => 1,
            Some(kind) => self.length(kind, property.kind)?,
        };
        if self.encoding == Encoding::Ascii {
            // any word will do: nan is fine where it is not used
            return (0..n).try_for_each(|_| self.words.word("a number").map(|_| ()));
        }
        self.words.raw(n * property.kind.size(), "a property").map(|_| ())
    }

    fn vertices(&mut self, element: &Element, count: usize, out: &mut Parsed) -> Result<(), ImportError> {
        // what each property means: 0-2 position, 3-6 colour, 7-8 texture
        let meaning = |p: &Property| match p.name.as_str() {
            _ if p.list.is_some() => None,
            "x" => Some(0),
            "y" => Some(1),
            "z" => Some(2),
            "red" | "r" | "diffuse_red" => Some(3),
            "green" | "g" | "diffuse_green" => Some(4),
            "blue" | "b" | "diffuse_blue" => Some(5),
            "alpha" | "a" => Some(6),
            "s" | "u" | "texture_u" => Some(7),
            "t" | "v" | "texture_v" => Some(8),
            _ => None,
        };
        let meanings: Vec<_> = element.properties.iter().map(meaning).collect();
        let has = |k| meanings.contains(&Some(k));
        if let Some(axis) = (0..3).find(|k| !has(*k)) {
            return Err(self.words.malformed(format!("vertices have no `{}`", ["x", "y", "z"][axis])));
        }
        let (colored, textured) = (has(3) && has(4) && has(5), has(7) && has(8));
        for _ in 0..count {
            let mut v = [0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0, 0.0, 0.0];
            for (property, meaning) in element.properties.iter().zip(&meanings) {
                match meaning {
                    None => self.skip(property)?,
                    Some(k @ 3..=6) => v[*k] = self.number(property.kind)? / property.kind.full(),
                    Some(k) => v[*k] = self.number(property.kind)?,
                }
            }
            out.positions.push(self.words.check_point([v[0], v[1], v[2]], "coordinate")?);
            if colored {
                let linear = |k: usize| srgb_to_linear(v[k] as f32);
                out.colors.push([linear(3), linear(4), linear(5), (v[6] as f32).clamp(0.0, 1.0)]);
            }
            if textured {
                out.texture_coordinates.push([v[7] as f32, (1.0 - v[8]) as f32]);
            }
        }
        Ok(())
    }

    fn faces(
        &mut self,
        element: &Element,
        count: usize,
        corners: &mut Vec<i64>,
        sizes: &mut Vec<usize>,
    ) -> Result<(), ImportError> {
        let is_corners =
            |p: &Property| p.list.is_some() && matches!(p.name.as_str(), "vertex_indices" | "vertex_index");
        if count > 0 && !element.properties.iter().any(is_corners) {
            return Err(self.words.malformed("faces have no `vertex_indices`"));
        }
        for _ in 0..count {
            for property in &element.properties {
                match property.list {
                    Some(kind) if is_corners(property) => {
                        let n = self.length(kind, property.kind)?;
                        for _ in 0..n {
                            corners.push(self.number(property.kind)? as i64);
                        }
                        sizes.push(n);
                    }
                    _ => self.skip(property)?,
                }
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HEADER: &str = "element vertex 4\nproperty float x\nproperty float y\nproperty float z\nproperty uchar red\nproperty uchar green\n\
        property uchar blue\nelement face 1\nproperty uchar flags\nproperty list uchar int vertex_indices\nend_header\n";

    fn encoded(format: &str, put: impl Fn(&mut Vec<u8>, f32), put_int: impl Fn(&mut Vec<u8>, i32)) -> Vec<u8> {
        let mut out = format!("ply\nformat {format} 1.0\n{HEADER}").into_bytes();
        for p in [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]] {
            p.iter().for_each(|v| put(&mut out, *v));
            out.extend([255, 0, 0]);
        }
        out.extend([7, 4]);
        (0..4).for_each(|i| put_int(&mut out, i));
        out
    }

    #[test]
    fn all_three_encodings_give_the_same_surface() {
        let little =
            encoded("binary_little_endian", |o, v| o.extend(v.to_le_bytes()), |o, v| o.extend(v.to_le_bytes()));
        let big = encoded("binary_big_endian", |o, v| o.extend(v.to_be_bytes()), |o, v| o.extend(v.to_be_bytes()));
        let ascii = format!(
            "ply\r\nformat ascii 1.0\ncomment hi\n{HEADER}0 0 0 255 0 0\n1 0 0 255 0 0\n1 1 0 255 0 0\n0 1 0 255 0 0\n7 4 0 1 2 3\n"
        );
        for bytes in [little, big, ascii.into_bytes()] {
            let p = parse(&bytes, Path::new("t.ply")).unwrap();
            assert_eq!(p.triangles, [[0, 1, 2], [0, 2, 3]]);
            assert_eq!(p.positions[2], [1.0, 1.0, 0.0]);
            assert_eq!(p.colors[3], [1.0, 0.0, 0.0, 1.0]);
            for cut in 0..bytes.len() - 2 {
                assert!(parse(&bytes[..cut], Path::new("t.ply")).is_err(), "{cut}");
            }
        }
    }

    #[test]
    fn a_header_that_claims_the_world_is_refused() {
        for claim in ["element vertex 4000000000", "element vertex -1", "element vertex 99999999999999999999999"] {
            let text = format!(
                "ply\nformat ascii 1.0\n{claim}\nproperty float x\nproperty float y\nproperty float z\nend_header\n0 0 0\n"
            );
            assert!(parse(text.as_bytes(), Path::new("t.ply")).is_err(), "{claim}");
        }
    }
}
