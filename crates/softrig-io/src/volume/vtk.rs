//! Legacy VTK files, ASCII and binary, of unstructured grids. Data arrays are stepped over.

use super::builder::{Builder, NodeNumbers, Shape, other_cells};
use crate::error::{ImportError, Place};
use crate::text::{Words, shown};
use softrig::mesh::VolumeMesh;
use std::path::Path;

/// A number type of VTK files.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Number {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    I64,
    U64,
    F32,
    F64,
}

impl Number {
    /// By the name of the legacy format.
    fn legacy(word: &str) -> Option<Self> {
        Some(match word.to_ascii_lowercase().as_str() {
            "char" | "signed_char" => Self::I8,
            "unsigned_char" => Self::U8,
            "short" => Self::I16,
            "unsigned_short" => Self::U16,
            // ids are written as 32-bit integers
            "int" | "vtkidtype" => Self::I32,
            "unsigned_int" => Self::U32,
            "long" | "vtktypeint64" => Self::I64,
            "unsigned_long" | "vtktypeuint64" => Self::U64,
            "float" => Self::F32,
            "double" => Self::F64,
            _ => return None,
        })
    }

    pub fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::I64 | Self::U64 | Self::F64 => 8,
        }
    }

    pub fn is_float(self) -> bool {
        matches!(self, Self::F32 | Self::F64)
    }

    /// One number from exactly [`Self::size`] little-endian bytes; integers beyond `i64` become its largest.
    pub fn decode(self, raw: &[u8]) -> Value {
        let mut b = [0; 8];
        b[..raw.len()].copy_from_slice(raw);
        let [b0, b1, b2, b3, ..] = b;
        match self {
            Self::I8 => Value::Int((b0 as i8).into()),
            Self::U8 => Value::Int(b0.into()),
            Self::I16 => Value::Int(i16::from_le_bytes([b0, b1]).into()),
            Self::U16 => Value::Int(u16::from_le_bytes([b0, b1]).into()),
            Self::I32 => Value::Int(i32::from_le_bytes([b0, b1, b2, b3]).into()),
            Self::U32 => Value::Int(u32::from_le_bytes([b0, b1, b2, b3]).into()),
            Self::I64 => Value::Int(i64::from_le_bytes(b)),
            Self::U64 => Value::Int(i64::try_from(u64::from_le_bytes(b)).unwrap_or(i64::MAX)),
            Self::F32 => Value::Float(f32::from_le_bytes([b0, b1, b2, b3]).into()),
            Self::F64 => Value::Float(f64::from_le_bytes(b)),
        }
    }
}

/// A number of either sort.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Value {
    Int(i64),
    Float(f64),
}

impl Value {
    pub fn float(self) -> f64 {
        match self {
            Self::Int(i) => i as f64,
            Self::Float(f) => f,
        }
    }

    /// Fractions are cut off: indices have none.
    pub fn int(self) -> i64 {
        match self {
            Self::Int(i) => i,
            Self::Float(f) => f as i64,
        }
    }
}

/// What a VTK cell type is to us.
fn shape(kind: i64) -> Option<Shape> {
    Some(match kind {
        0..=9 | 21..=23 | 27 | 28 | 30 | 34 | 35 | 36 | 68..=70 => Shape::Flat,
        10 => Shape::Tet4,
        11 | 12 => Shape::Hex8,
        13 => Shape::Other("wedges"),
        14 => Shape::Other("pyramids"),
        24..=26 | 29 | 31..=33 | 37 | 71..=74 => Shape::Other("cells with nodes on their edges"),
        41 | 42 => Shape::Other("polyhedra"),
        _ => return None,
    })
}

/// Adds one cell.
pub(super) fn add_cell(
    out: &mut Builder,
    kind: i64,
    nodes: &[i64],
    file: &Path,
    cell: usize,
) -> Result<(), ImportError> {
    let place = Place::Part(format!("cell {cell} (from 0)"));
    let region = out.region("");
    match (shape(kind), nodes) {
        (Some(Shape::Flat), _) => {}
        (Some(Shape::Tet4), &[a, b, c, d]) => out.tet([a, b, c, d], region),
        // a voxel lists the nodes of a layer row by row
        (Some(Shape::Hex8), &[a, b, c, d, e, f, g, h]) if kind == 11 => out.hex([a, b, d, c, e, f, h, g], region),
        (Some(Shape::Hex8), &[a, b, c, d, e, f, g, h]) => out.hex([a, b, c, d, e, f, g, h], region),
        (Some(Shape::Other(what)), _) => return Err(other_cells(file, place, what)),
        (None, _) => return Err(other_cells(file, place, &format!("cells of type {kind}"))),
        (Some(_), nodes) => {
            let reason = format!("a cell of type {kind} has {} nodes", nodes.len());
            return Err(ImportError::malformed(file, place, reason, crate::text::REMEDY));
        }
    }
    Ok(())
}

struct Reader<'a> {
    words: Words<'a>,
    binary: bool,
}

pub(super) fn parse(bytes: &[u8], file: &Path) -> Result<VolumeMesh, ImportError> {
    let mut words = Words::new(file, bytes);
    if !words.rest_of_line().to_ascii_lowercase().starts_with(b"# vtk datafile") {
        return Err(words.malformed("a legacy VTK file begins with `# vtk DataFile`"));
    }
    words.rest_of_line();
    let binary = match words.word("`ASCII` or `BINARY`")?.to_ascii_uppercase().as_str() {
        "ASCII" => false,
        "BINARY" => true,
        other => return Err(words.malformed(format!("`{}` is neither `ASCII` nor `BINARY`", shown(other.as_bytes())))),
    };
    words.expect("DATASET")?;
    let kind = words.word("the kind of data set")?;
    if !kind.eq_ignore_ascii_case("UNSTRUCTURED_GRID") {
        let remedy = "save it as an unstructured grid (.vtu)";
        return Err(words.unsupported(format!("a `{}` is no volume mesh", shown(kind.as_bytes())), remedy));
    }
    Reader { words, binary }.grid()
}

impl Reader<'_> {
    fn grid(mut self) -> Result<VolumeMesh, ImportError> {
        let file = self.words.file;
        let mut out = Builder::default();
        let (mut offsets, mut connectivity) = (Vec::new(), Vec::new());
        let mut kinds = None;
        while kinds.is_none() {
            let key = self.words.word("`CELL_TYPES`")?.to_ascii_uppercase();
            match key.as_str() {
                "FIELD" => self.field()?,
                "METADATA" => {
                    // up to an empty line
                    self.words.rest_of_line();
                    while !self.words.rest_of_line().is_empty() {}
                }
                "POINTS" => {
                    let n = self.words.count("the number of points", 3)?;
                    let number = self.number()?;
                    let values = self.array(number, n.saturating_mul(3), "points")?;
                    out.nodes = values.chunks_exact(3).map(|p| [p[0], p[1], p[2]].map(Value::float)).collect();
                }
                "CELLS" => {
                    let n = self.words.count("the number of cells", 0)?;
                    let size = self.words.count("the size of the cells", 1)?;
                    // looked at from a copy: binary rows begin right behind the line
                    let modern = self.words.clone().next().is_some_and(|w| w.eq_ignore_ascii_case(b"OFFSETS"));
                    if modern {
                        // version 5: where each cell begins, then all nodes
                        self.words.expect("OFFSETS")?;
                        let number = self.number()?;
                        offsets = self.array(number, n, "offsets")?.into_iter().map(Value::int).collect();
                        self.words.expect("CONNECTIVITY")?;
                        let number = self.number()?;
                        connectivity = self.array(number, size, "connectivity")?.into_iter().map(Value::int).collect();
                    } else {
                        let rows = self.array(Number::I32, size, "cells")?;
                        (offsets, connectivity) = self.split_rows(&rows)?;
                    }
                }
                "CELL_TYPES" => {
                    let n = self.words.count("the number of cells", 1)?;
                    kinds = Some(self.array(Number::I32, n, "cell types")?);
                }
                other => {
                    return Err(self.words.malformed(format!("`{}` does not belong here", shown(other.as_bytes()))));
                }
            }
        }
        let kinds: Vec<i64> = kinds.unwrap_or_default().into_iter().map(Value::int).collect();
        if kinds.len() + 1 != offsets.len().max(1) {
            let reason = format!("there are {} cell types for {} cells", kinds.len(), offsets.len().max(1) - 1);
            return Err(self.words.malformed(reason));
        }
        for (i, kind) in kinds.into_iter().enumerate() {
            let nodes = slice(&connectivity, offsets[i], offsets[i + 1]);
            let nodes = nodes.ok_or_else(|| self.words.malformed(format!("cell {i} lies beyond the connectivity")))?;
            add_cell(&mut out, kind, nodes, file, i)?;
        }
        out.finish(file, &NodeNumbers::From(0))
    }

    fn number(&mut self) -> Result<Number, ImportError> {
        let word = self.words.word("a number type")?;
        Number::legacy(word).ok_or_else(|| {
            self.words.unsupported(
                format!("numbers of type `{}` are not read", shown(word.as_bytes())),
                "save it with doubles and ints",
            )
        })
    }

    /// Binary arrays are big-endian and begin on the next line.
    fn array(&mut self, number: Number, n: usize, what: &str) -> Result<Vec<Value>, ImportError> {
        let each = if self.binary { number.size() } else { 2 };
        let n = self.words.check_count(i64::try_from(n).unwrap_or(i64::MAX), what, each)?;
        let mut out = Vec::with_capacity(n);
        if self.binary {
            self.words.rest_of_line();
            let raw = self.words.raw(n * number.size(), what)?;
            for bytes in raw.chunks_exact(number.size()) {
                let mut little = [0; 8];
                bytes.iter().rev().zip(&mut little).for_each(|(b, l)| *l = *b);
                out.push(number.decode(&little[..number.size()]));
            }
        } else if number.is_float() {
            for _ in 0..n {
                out.push(Value::Float(self.words.number(what)?));
            }
        } else {
            for _ in 0..n {
                out.push(Value::Int(self.words.integer(what)?));
            }
        }
        Ok(out)
    }

    /// Rows of count and nodes as offsets and nodes.
    fn split_rows(&self, rows: &[Value]) -> Result<(Vec<i64>, Vec<i64>), ImportError> {
        let (mut offsets, mut nodes) = (vec![0], Vec::new());
        let mut rest = rows;
        while let Some((count, after)) = rest.split_first() {
            let count = usize::try_from(count.int()).ok().filter(|c| *c <= after.len());
            let count = count.ok_or_else(|| self.words.malformed("a cell has more nodes than the list"))?;
            nodes.extend(after[..count].iter().map(|v| v.int()));
            offsets.push(nodes.len() as i64);
            rest = &after[count..];
        }
        Ok((offsets, nodes))
    }

    /// Arrays that belong to the file as a whole.
    fn field(&mut self) -> Result<(), ImportError> {
        self.words.word("the name of the field")?;
        for _ in 0..self.words.count("the number of arrays", 4)? {
            self.words.word("the name of an array")?;
            let components = self.words.count("the number of components", 0)?;
            let tuples = self.words.count("the number of tuples", 0)?;
            let word = self.words.word("a number type")?;
            if word.eq_ignore_ascii_case("string") {
                return Err(self.words.unsupported("a field of strings is not read", "save it without field data"));
            }
            let Some(number) = Number::legacy(word) else {
                return Err(self.words.malformed(format!("`{}` is no number type", shown(word.as_bytes()))));
            };
            self.array(number, components.saturating_mul(tuples), "a field")?;
        }
        Ok(())
    }
}

/// A part of a list between two offsets of a file.
pub(super) fn slice(list: &[i64], from: i64, to: i64) -> Option<&[i64]> {
    list.get(usize::try_from(from).ok()?..usize::try_from(to).ok()?)
}
