//! VTK XML files of unstructured grids: inline text, inline base64, appended raw or base64 data, any byte order, several pieces.
//! Compressed files are refused.

use super::builder::{Builder, NodeNumbers};
use super::vtk::{Number, Value, add_cell, slice};
use crate::error::{ImportError, Place};
use crate::text::{REMEDY, parse_integer, parse_number, shown};
use softrig::mesh::VolumeMesh;
use std::cell::Cell;
use std::path::Path;

/// A start or end tag.
struct Tag<'a> {
    /// With a leading `/` for end tags.
    name: &'a [u8],
    attributes: &'a [u8],
    /// First byte behind it.
    end: usize,
}

/// One `DataArray`.
struct Array<'a> {
    tag_at: usize,
    attributes: &'a [u8],
    /// What stands between its tags.
    inline: &'a [u8],
}

#[derive(Default)]
struct Piece<'a> {
    point_count: usize,
    cell_count: usize,
    points: Option<Array<'a>>,
    /// `connectivity`, `offsets`, `types`.
    cells: [Option<Array<'a>>; 3],
}

struct Reader<'a> {
    file: &'a Path,
    bytes: &'a [u8],
    big: bool,
    long_headers: bool,
    /// Data behind the underscore of `AppendedData`, and whether it is base64.
    appended: Option<(&'a [u8], bool)>,
    /// Numbers that may still be decoded: arrays may point at the same bytes again and again.
    budget: Cell<usize>,
}

pub(super) fn parse(bytes: &[u8], file: &Path) -> Result<VolumeMesh, ImportError> {
    let mut reader =
        Reader { file, bytes, big: false, long_headers: false, appended: None, budget: Cell::new(bytes.len()) };
    let pieces = reader.structure()?;
    let mut out = Builder::default();
    let mut cell = 0;
    for piece in &pieces {
        reader.piece(piece, &mut out, &mut cell)?;
    }
    out.finish(file, &NodeNumbers::From(0))
}

impl<'a> Reader<'a> {
    fn wrong(&self, at: usize, reason: impl Into<String>) -> ImportError {
        let line = 1 + self.bytes[..at.min(self.bytes.len())].iter().filter(|b| **b == b'\n').count();
        ImportError::malformed(self.file, Place::Line(line), reason, REMEDY)
    }

    /// The next tag at or behind `at`; comments and declarations are stepped over.
    fn tag(&self, mut at: usize) -> Result<Option<(usize, Tag<'a>)>, ImportError> {
        loop {
            let Some(open) = find(self.bytes, at, b"<") else { return Ok(None) };
            let rest = &self.bytes[open..];
            let (skip, closer): (bool, &[u8]) = if rest.starts_with(b"<!--") {
                (true, b"-->")
            } else if rest.starts_with(b"<?") {
                (true, b"?>")
            } else {
                (rest.starts_with(b"<!"), b">")
            };
            let close = if skip { find(self.bytes, open, closer) } else { end_of_tag(self.bytes, open) };
            let Some(close) = close else { return Err(self.wrong(open, "a tag has no end")) };
            let end = close + closer.len();
            if skip {
                at = end;
                continue;
            }
            let inside = self.bytes[open + 1..close].trim_ascii();
            let len = inside.iter().position(|b| b.is_ascii_whitespace()).unwrap_or(inside.len());
            let name = inside[..len].strip_suffix(b"/").unwrap_or(&inside[..len]);
            return Ok(Some((open, Tag { name, attributes: &inside[len..], end })));
        }
    }

    fn structure(&mut self) -> Result<Vec<Piece<'a>>, ImportError> {
        let mut pieces: Vec<Piece<'a>> = Vec::new();
        let (mut at, mut section, mut is_vtk, mut closed) = (0, &b""[..], false, false);
        while let Some((open, tag)) = self.tag(at)? {
            at = tag.end;
            match tag.name {
                b"VTKFile" => {
                    is_vtk = true;
                    self.file_attributes(open, &tag)?;
                }
                b"Piece" => {
                    let count = |key: &str| {
                        let text = attribute(tag.attributes, key).unwrap_or(b"0");
                        let count = parse_integer(text).and_then(|n| usize::try_from(n).ok());
                        count.ok_or_else(|| self.wrong(open, format!("`{key}` is `{}`", shown(text))))
                    };
                    let (point_count, cell_count) = (count("NumberOfPoints")?, count("NumberOfCells")?);
                    pieces.push(Piece { point_count, cell_count, ..Piece::default() });
                }
                b"Points" | b"Cells" | b"PointData" | b"CellData" | b"FieldData" => section = tag.name,
                b"/Points" | b"/Cells" | b"/PointData" | b"/CellData" | b"/FieldData" => section = b"",
                b"DataArray" => {
                    let is_empty = self.bytes[..tag.end].ends_with(b"/>");
                    let end =
                        if is_empty { tag.end } else { find(self.bytes, tag.end, b"<").unwrap_or(self.bytes.len()) };
                    if !is_empty
                        && !self.bytes[end..].starts_with(b"</DataArray")
                        && !self.bytes[end..].starts_with(b"<InformationKey")
                    {
                        return Err(self.wrong(open, "a `DataArray` has no end"));
                    }
                    let array = Array { tag_at: open, attributes: tag.attributes, inline: &self.bytes[tag.end..end] };
                    let Some(piece) = pieces.last_mut() else { continue };
                    match (section, attribute(tag.attributes, "Name")) {
                        (b"Points", _) => piece.points = Some(array),
                        (b"Cells", Some(b"connectivity")) => piece.cells[0] = Some(array),
                        (b"Cells", Some(b"offsets")) => piece.cells[1] = Some(array),
                        (b"Cells", Some(b"types")) => piece.cells[2] = Some(array),
                        _ => {}
                    }
                }
                b"AppendedData" => {
                    let raw = attribute(tag.attributes, "encoding") == Some(b"raw");
                    let Some(start) = find(self.bytes, tag.end, b"_") else {
                        return Err(self.wrong(open, "appended data has no `_` in front"));
                    };
                    self.appended = Some((&self.bytes[start + 1..], !raw));
                    // raw data may hold any byte; nothing of use follows
                    closed = true;
                    break;
                }
                b"/VTKFile" => closed = true,
                _ => {}
            }
        }
        if !is_vtk || pieces.is_empty() {
            return Err(self.wrong(0, "it has no `VTKFile` with a `Piece`"));
        }
        if !closed {
            return Err(self.wrong(self.bytes.len(), "the file ends early"));
        }
        Ok(pieces)
    }

    fn file_attributes(&mut self, open: usize, tag: &Tag<'_>) -> Result<(), ImportError> {
        let unsupported =
            |reason: String, remedy: &str| Err(ImportError::unsupported(self.file, Place::Line(1), reason, remedy));
        let kind = attribute(tag.attributes, "type").unwrap_or(b"");
        if kind != b"UnstructuredGrid" {
            return unsupported(
                format!("a `{}` is no volume mesh", shown(kind)),
                "save it as an unstructured grid (.vtu)",
            );
        }
        if attribute(tag.attributes, "compressor").is_some_and(|c| !c.is_empty()) {
            return unsupported("its data is compressed".into(), "save it without compression (compressor: none)");
        }
        self.big = attribute(tag.attributes, "byte_order") == Some(b"BigEndian");
        self.long_headers = match attribute(tag.attributes, "header_type") {
            None | Some(b"UInt32") => false,
            Some(b"UInt64") => true,
            Some(other) => return Err(self.wrong(open, format!("`header_type` is `{}`", shown(other)))),
        };
        Ok(())
    }

    fn piece(&self, piece: &Piece<'_>, out: &mut Builder, cell: &mut usize) -> Result<(), ImportError> {
        if piece.point_count == 0 && piece.cell_count == 0 {
            return Ok(());
        }
        let base = out.nodes.len() as i64;
        let points = self.values(piece.points.as_ref(), "Points")?;
        if Some(points.len()) != piece.point_count.checked_mul(3) {
            let at = piece.points.as_ref().map_or(0, |a| a.tag_at);
            let reason = format!("the piece says {} points, but has {} coordinates", piece.point_count, points.len());
            return Err(self.wrong(at, reason));
        }
        out.nodes.extend(points.chunks_exact(3).map(|p| [p[0], p[1], p[2]].map(Value::float)));
        let [connectivity, offsets, types] = &piece.cells;
        let ints = |array: &Option<Array<'_>>, what| -> Result<Vec<i64>, ImportError> {
            Ok(self.values(array.as_ref(), what)?.into_iter().map(Value::int).collect())
        };
        let (connectivity, offsets, types) =
            (ints(connectivity, "connectivity")?, ints(offsets, "offsets")?, ints(types, "types")?);
        if offsets.len() != piece.cell_count || types.len() != piece.cell_count {
            let at = piece.cells[1].as_ref().map_or(0, |a| a.tag_at);
            let reason = format!(
                "the piece says {} cells, but has {} offsets and {} types",
                piece.cell_count,
                offsets.len(),
                types.len()
            );
            return Err(self.wrong(at, reason));
        }
        let mut from = 0;
        let mut nodes = Vec::new();
        for (to, kind) in offsets.into_iter().zip(types) {
            let Some(part) = slice(&connectivity, from, to) else {
                return Err(ImportError::malformed(
                    self.file,
                    Place::Part(format!("cell {cell} (from 0)")),
                    "its nodes lie beyond the connectivity",
                    REMEDY,
                ));
            };
            nodes.clear();
            nodes.extend(part.iter().map(|n| n.saturating_add(base)));
            add_cell(out, kind, &nodes, self.file, *cell)?;
            *cell += 1;
            from = to;
        }
        Ok(())
    }

    /// All numbers of an array.
    fn values(&self, array: Option<&Array<'_>>, what: &str) -> Result<Vec<Value>, ImportError> {
        let Some(array) = array else { return Err(self.wrong(0, format!("a piece has no `{what}`"))) };
        let kind = attribute(array.attributes, "type").unwrap_or(b"");
        let Some(number) = xml_type(kind) else {
            return Err(self.wrong(array.tag_at, format!("`{}` is no number type", shown(kind))));
        };
        match attribute(array.attributes, "format").unwrap_or(b"ascii") {
            b"ascii" => {
                let words = array.inline.split(u8::is_ascii_whitespace).filter(|w| !w.is_empty());
                let value = |w: &[u8]| match number.is_float() {
                    true => parse_number(w).map(Value::Float),
                    false => parse_integer(w).map(Value::Int),
                };
                words
                    .map(|w| {
                        value(w)
                            .ok_or_else(|| self.wrong(array.tag_at, format!("`{}` is no number of `{what}`", shown(w))))
                    })
                    .collect()
            }
            b"binary" => self.block(array, number, &base64(array.inline, usize::MAX)),
            b"appended" => {
                let Some((data, is_base64)) = self.appended else {
                    return Err(self.wrong(array.tag_at, "there is no appended data"));
                };
                let offset = attribute(array.attributes, "offset").and_then(parse_integer);
                let data = offset.and_then(|o| data.get(usize::try_from(o).ok()?..));
                let Some(data) = data else { return Err(self.wrong(array.tag_at, "its offset lies beyond the file")) };
                if !is_base64 {
                    return self.block(array, number, data);
                }
                // as much as the header says
                let header = base64(data, self.header_size());
                let wanted = self.header(&header).unwrap_or(0).saturating_add(self.header_size());
                self.block(array, number, &base64(data, wanted))
            }
            other => Err(self.wrong(array.tag_at, format!("`{}` is no data format", shown(other)))),
        }
    }

    fn header_size(&self) -> usize {
        if self.long_headers { 8 } else { 4 }
    }

    /// Number of bytes behind a header.
    fn header(&self, data: &[u8]) -> Option<usize> {
        let mut raw = [0; 8];
        let header = raw.get_mut(..self.header_size())?;
        header.copy_from_slice(data.get(..self.header_size())?);
        if self.big {
            header.reverse();
        }
        usize::try_from(u64::from_le_bytes(raw)).ok()
    }

    /// A header with the number of bytes, then the bytes.
    fn block(&self, array: &Array<'_>, number: Number, data: &[u8]) -> Result<Vec<Value>, ImportError> {
        let body = self.header(data).and_then(|n| data[self.header_size()..].get(..n));
        let Some(body) = body else { return Err(self.wrong(array.tag_at, "its data is shorter than it says")) };
        if body.len() % number.size() != 0 {
            return Err(self.wrong(array.tag_at, format!("its data has {} bytes", body.len())));
        }
        // every number has at least a byte of its own in a file that shares nothing
        let Some(left) = self.budget.get().checked_sub(body.len() / number.size()) else {
            return Err(self.wrong(array.tag_at, "its arrays together are larger than the file"));
        };
        self.budget.set(left);
        let decode = |raw: &[u8]| {
            let mut little = [0; 8];
            let little = &mut little[..raw.len()];
            little.copy_from_slice(raw);
            if self.big {
                little.reverse();
            }
            number.decode(little)
        };
        Ok(body.chunks_exact(number.size()).map(decode).collect())
    }
}

fn xml_type(word: &[u8]) -> Option<Number> {
    Some(match word {
        b"Int8" => Number::I8,
        b"UInt8" => Number::U8,
        b"Int16" => Number::I16,
        b"UInt16" => Number::U16,
        b"Int32" => Number::I32,
        b"UInt32" => Number::U32,
        b"Int64" => Number::I64,
        b"UInt64" => Number::U64,
        b"Float32" => Number::F32,
        b"Float64" => Number::F64,
        _ => return None,
    })
}

fn find(bytes: &[u8], from: usize, what: &[u8]) -> Option<usize> {
    let rest = bytes.get(from..)?;
    rest.windows(what.len()).position(|w| w == what).map(|i| from + i)
}

/// The `>` of a tag; attributes may hold some of their own.
fn end_of_tag(bytes: &[u8], open: usize) -> Option<usize> {
    let mut quote = None;
    bytes[open..]
        .iter()
        .position(|b| {
            match quote {
                Some(q) if *b == q => quote = None,
                None if matches!(b, b'"' | b'\'') => quote = Some(*b),
                _ => {}
            }
            quote.is_none() && *b == b'>'
        })
        .map(|i| open + i)
}

/// Value of an attribute, without its quotes.
fn attribute<'a>(mut attributes: &'a [u8], key: &str) -> Option<&'a [u8]> {
    loop {
        let equals = attributes.iter().position(|b| *b == b'=')?;
        let (name, rest) = (attributes[..equals].trim_ascii(), attributes[equals + 1..].trim_ascii_start());
        let quote = *rest.first().filter(|q| matches!(q, b'"' | b'\''))?;
        let end = 1 + rest[1..].iter().position(|b| *b == quote)?;
        if name == key.as_bytes() {
            return Some(&rest[1..end]);
        }
        attributes = &rest[end + 1..];
    }
}

/// Bytes of base64 text, up to a number of them. Padding may stand in the middle, between a header and its data; the text ends at the first
/// character that is none of it.
fn base64(text: &[u8], most: usize) -> Vec<u8> {
    let mut out = Vec::with_capacity((text.len() / 4).saturating_mul(3).min(most.saturating_add(3)));
    let (mut group, mut digits, mut padding) = (0u32, 0, 0);
    for b in text.iter().filter(|b| !b.is_ascii_whitespace()) {
        let digit = match b {
            b'A'..=b'Z' => b - b'A',
            b'a'..=b'z' => b - b'a' + 26,
            b'0'..=b'9' => b - b'0' + 52,
            b'+' => 62,
            b'/' => 63,
            b'=' => {
                padding += 1;
                0
            }
            _ => break,
        };
        group = group << 6 | u32::from(digit);
        digits += 1;
        if digits == 4 {
            let bytes = group.to_be_bytes();
            out.extend_from_slice(&bytes[1..4 - padding.min(2)]);
            (group, digits, padding) = (0, 0, 0);
            if out.len() >= most {
                out.truncate(most);
                return out;
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base64_goes_on_behind_padding() {
        assert_eq!(base64(b"BAAA AA==AQIDBA==", 99), [4, 0, 0, 0, 1, 2, 3, 4]);
        assert_eq!(base64(b"AQIDBA==</x", 3), [1, 2, 3]);
    }

    #[test]
    fn attributes_are_found_by_name() {
        let a = b" type=\"Int32\" Name = 'off sets' format=\"ascii\"";
        assert_eq!(attribute(a, "Name"), Some(&b"off sets"[..]));
        assert_eq!(attribute(a, "format"), Some(&b"ascii"[..]));
        assert_eq!(attribute(a, "offset"), None);
    }
}
