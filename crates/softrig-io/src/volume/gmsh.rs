//! Gmsh files of version 1, 2.x and 4.1, ASCII and binary.
//!
//! The region of a cell is the physical group it is in (by name where it has one), else its geometric volume.

use super::builder::{Builder, Labels, NodeNumbers, Shape, other_cells};
use crate::error::{ImportError, Place};
use crate::text::{Words, name, shown};
use softrig::mesh::VolumeMesh;
use std::collections::HashMap;
use std::path::Path;

#[derive(Clone, Copy, PartialEq)]
enum Encoding {
    Ascii,
    Little,
    Big,
}

struct Reader<'a> {
    words: Words<'a>,
    encoding: Encoding,
    out: Builder,
    labels: Labels,
    /// Names of physical groups of volumes.
    physical_names: HashMap<i64, String>,
    /// First physical group of each volume.
    physical_of_volume: HashMap<i64, i64>,
}

pub(super) fn parse(bytes: &[u8], file: &Path) -> Result<VolumeMesh, ImportError> {
    let mut reader = Reader {
        words: Words::new(file, bytes),
        encoding: Encoding::Ascii,
        out: Builder::default(),
        labels: Labels::default(),
        physical_names: HashMap::new(),
        physical_of_volume: HashMap::new(),
    };
    let mut version = 1.0;
    while let Some(section) = reader.words.next() {
        // version 1 has no header but sections of its own names
        match (section, version) {
            (b"$MeshFormat", _) => version = reader.format()?,
            (b"$NOD", _) => reader.nodes_2("$ENDNOD")?,
            (b"$ELM", _) => reader.cells_1()?,
            (b"$PhysicalNames", _) => reader.physical_names()?,
            (b"$Nodes", v) if v < 4.0 => reader.nodes_2("$EndNodes")?,
            (b"$Elements", v) if v < 4.0 => reader.cells_2()?,
            (b"$Entities", _) => reader.entities_4()?,
            (b"$Nodes", _) => reader.nodes_4()?,
            (b"$Elements", _) => reader.cells_4()?,
            _ if section.starts_with(b"$") => {
                let end = [b"$End", &section[1..]].concat();
                reader.words.skip_past(&end)?;
            }
            _ => return Err(reader.words.malformed(format!("`{}` stands outside of any section", shown(section)))),
        }
    }
    reader.out.finish(file, &NodeNumbers::Labels(reader.labels))
}

/// Nodes of an element type and what it is to us.
fn element(kind: i64) -> Option<(usize, Shape)> {
    let quadratic = "cells with nodes on their edges";
    Some(match kind {
        15 => (1, Shape::Flat),
        1 => (2, Shape::Flat),
        2 | 8 => (3, Shape::Flat),
        3 | 26 => (4, Shape::Flat),
        27 => (5, Shape::Flat),
        9 | 28 => (6, Shape::Flat),
        16 => (8, Shape::Flat),
        10 | 20 => (9, Shape::Flat),
        21 => (10, Shape::Flat),
        22 => (12, Shape::Flat),
        23 | 24 => (15, Shape::Flat),
        25 => (21, Shape::Flat),
        4 => (4, Shape::Tet4),
        5 => (8, Shape::Hex8),
        6 => (6, Shape::Other("prisms")),
        7 => (5, Shape::Other("pyramids")),
        11 | 12 | 13 | 14 | 17 | 18 | 19 | 29 | 30 | 31 | 92 | 93 => (0, Shape::Other(quadratic)),
        _ => return None,
    })
}

impl Reader<'_> {
    fn format(&mut self) -> Result<f64, ImportError> {
        let version = self.words.number("the version")?;
        let binary = self.words.integer("the file type")?;
        let size = self.words.integer("the size of a number")?;
        let known = version == 1.0 || (2.0..3.0).contains(&version) || version == 4.1;
        if !known {
            let remedy = "save it as version 4.1 or 2.2 (Gmsh: -format msh41)";
            return Err(self.words.unsupported(format!("Gmsh format {version} is not read"), remedy));
        }
        if binary == 1 {
            if size != 8 {
                return Err(self.words.malformed(format!("numbers of {size} bytes")));
            }
            self.words.rest_of_line();
            self.encoding = match self.words.raw(4, "the byte order")? {
                [1, 0, 0, 0] => Encoding::Little,
                [0, 0, 0, 1] => Encoding::Big,
                _ => return Err(self.words.malformed("the byte order is neither little nor big")),
            };
        }
        self.words.expect("$EndMeshFormat")?;
        Ok(version)
    }

    fn raw<const N: usize>(&mut self, what: &str) -> Result<[u8; N], ImportError> {
        let mut raw = [0; N];
        raw.copy_from_slice(self.words.raw(N, what)?);
        if self.encoding == Encoding::Big {
            raw.reverse();
        }
        Ok(raw)
    }

    fn int(&mut self, what: &str) -> Result<i64, ImportError> {
        if self.encoding == Encoding::Ascii {
            self.words.integer(what)
        } else {
            Ok(i32::from_le_bytes(self.raw(what)?).into())
        }
    }

    fn long(&mut self, what: &str) -> Result<i64, ImportError> {
        if self.encoding == Encoding::Ascii {
            self.words.integer(what)
        } else {
            Ok(i64::from_le_bytes(self.raw(what)?))
        }
    }

    fn double(&mut self, what: &str) -> Result<f64, ImportError> {
        if self.encoding == Encoding::Ascii { self.words.number(what) } else { Ok(f64::from_le_bytes(self.raw(what)?)) }
    }

    fn point(&mut self) -> Result<[f64; 3], ImportError> {
        Ok([self.double("a coordinate")?, self.double("a coordinate")?, self.double("a coordinate")?])
    }

    /// A count of things of at least so many bytes as text or as binary.
    fn room(&self, n: i64, what: &str, text: usize, binary: usize) -> Result<usize, ImportError> {
        self.words.check_count(n, what, if self.encoding == Encoding::Ascii { text } else { binary })
    }

    fn node(&mut self, label: i64, position: [f64; 3]) -> Result<(), ImportError> {
        if !self.labels.push(label) {
            return Err(self.words.malformed(format!("node {label} is there twice")));
        }
        self.out.nodes.push(position);
        Ok(())
    }

    /// After a count that is text even in binary files: binary data begins on the next line.
    fn skip_to_data(&mut self) {
        if self.encoding != Encoding::Ascii {
            self.words.rest_of_line();
        }
    }

    fn nodes_2(&mut self, end: &str) -> Result<(), ImportError> {
        let n = self.words.integer("the number of nodes")?;
        self.skip_to_data();
        for _ in 0..self.room(n, "the number of nodes", 8, 28)? {
            let label = self.int("the label of a node")?;
            let position = self.point()?;
            self.node(label, position)?;
        }
        self.words.expect(end)
    }

    fn cells_1(&mut self) -> Result<(), ImportError> {
        for _ in 0..self.words.count("the number of elements", 12)? {
            self.words.integer("the label of an element")?;
            let kind = self.words.integer("the type of an element")?;
            let physical = self.words.integer("a region")?;
            let geometric = self.words.integer("a region")?;
            let nodes = self.words.count("the number of nodes", 2)?;
            self.cell(kind, physical, geometric, Some(nodes), false)?;
        }
        self.words.expect("$ENDELM")
    }

    fn cells_2(&mut self) -> Result<(), ImportError> {
        let n = self.words.integer("the number of elements")?;
        self.skip_to_data();
        let count = self.room(n, "the number of elements", 6, 8)?;
        let mut done = 0;
        while done < count {
            // binary: blocks of one type; text: every line is its own block
            let binary = self.encoding != Encoding::Ascii;
            if !binary {
                self.words.integer("the label of an element")?;
            }
            let kind = self.int("the type of an element")?;
            let block = if binary { self.int("the size of a block")? } else { 1 };
            let tag_count = self.int("the number of tags")?;
            let tag_count = self.room(tag_count, "the number of tags", 2, 4)?;
            let block = self.room(block, "the size of a block", 2, 8)?;
            if block == 0 || block > count - done {
                return Err(self
                    .words
                    .malformed(format!("a block of {block} elements where {} are left", count - done)));
            }
            for _ in 0..block {
                if binary {
                    self.int("the label of an element")?;
                }
                let mut tags = [0; 2];
                for i in 0..tag_count {
                    let tag = self.int("a tag")?;
                    if let Some(t) = tags.get_mut(i) {
                        *t = tag;
                    }
                }
                self.cell(kind, tags[0], tags[1], None, false)?;
            }
            done += block;
        }
        self.words.expect("$EndElements")
    }

    /// The nodes of one element, kept when it is a cell.
    fn cell(
        &mut self,
        kind: i64,
        physical: i64,
        geometric: i64,
        listed: Option<usize>,
        long: bool,
    ) -> Result<(), ImportError> {
        let place = Place::Line(self.words.line());
        let Some((count, shape)) = element(kind) else {
            return Err(other_cells(self.words.file, place, &format!("elements of type {kind}")));
        };
        if let Shape::Other(what) = shape {
            return Err(other_cells(self.words.file, place, what));
        }
        if listed.is_some_and(|n| n != count) {
            return Err(self.words.malformed(format!("an element of type {kind} has {count} nodes")));
        }
        let mut nodes = [0; 8];
        for i in 0..count {
            let node = if long { self.long("a node")? } else { self.int("a node")? };
            if let Some(n) = nodes.get_mut(i) {
                *n = node;
            }
        }
        if shape == Shape::Flat {
            return Ok(());
        }
        let region = match (self.physical_names.get(&physical), physical, geometric) {
            (Some(name), ..) => name.clone(),
            (None, 0, 0) => String::new(),
            (None, 0, volume) => volume.to_string(),
            (None, group, _) => group.to_string(),
        };
        let region = self.out.region(&region);
        match shape {
            Shape::Tet4 => self.out.tet([nodes[0], nodes[1], nodes[2], nodes[3]], region),
            _ => self.out.hex(nodes, region),
        }
        Ok(())
    }

    /// Text in every file: dimension, number, "name".
    fn physical_names(&mut self) -> Result<(), ImportError> {
        for _ in 0..self.words.count("the number of names", 6)? {
            let dimension = self.words.integer("a dimension")?;
            let number = self.words.integer("the number of a group")?;
            let text = name(self.words.rest_of_line());
            if dimension == 3 {
                self.physical_names.insert(number, text.trim_matches('"').to_owned());
            }
        }
        self.words.expect("$EndPhysicalNames")
    }

    fn entities_4(&mut self) -> Result<(), ImportError> {
        self.skip_to_data();
        let mut counts = [0; 4];
        for c in &mut counts {
            *c = self.long("a number of entities")?;
        }
        for (dimension, count) in counts.into_iter().enumerate() {
            for _ in 0..self.room(count, "the number of entities", 8, 32)? {
                let tag = self.int("the tag of an entity")?;
                for _ in 0..if dimension == 0 { 3 } else { 6 } {
                    self.double("a bound")?;
                }
                let groups = self.long("the number of groups")?;
                for i in 0..self.room(groups, "the number of groups", 2, 4)? {
                    let group = self.int("a group")?;
                    if dimension == 3 && i == 0 {
                        self.physical_of_volume.insert(tag, group.abs());
                    }
                }
                if dimension > 0 {
                    let borders = self.long("the number of borders")?;
                    for _ in 0..self.room(borders, "the number of borders", 2, 4)? {
                        self.int("a border")?;
                    }
                }
            }
        }
        self.words.expect("$EndEntities")
    }

    fn nodes_4(&mut self) -> Result<(), ImportError> {
        self.skip_to_data();
        let blocks = self.long("the number of blocks")?;
        for what in ["the number of nodes", "the smallest label", "the largest label"] {
            self.long(what)?;
        }
        let mut labels = Vec::new();
        for _ in 0..self.room(blocks, "the number of blocks", 8, 20)? {
            let dimension = self.int("a dimension")?;
            self.int("the tag of an entity")?;
            let parametric = self.int("0 or 1")?;
            let count = self.long("the number of nodes")?;
            let count = self.room(count, "the number of nodes", 8, 32)?;
            labels.clear();
            for _ in 0..count {
                labels.push(self.long("the label of a node")?);
            }
            for &label in &labels {
                let position = self.point()?;
                for _ in 0..if parametric == 0 { 0 } else { dimension.clamp(0, 3) } {
                    self.double("a parameter")?;
                }
                self.node(label, position)?;
            }
        }
        self.words.expect("$EndNodes")
    }

    fn cells_4(&mut self) -> Result<(), ImportError> {
        self.skip_to_data();
        let blocks = self.long("the number of blocks")?;
        for what in ["the number of elements", "the smallest label", "the largest label"] {
            self.long(what)?;
        }
        for _ in 0..self.room(blocks, "the number of blocks", 8, 20)? {
            self.int("a dimension")?;
            let volume = self.int("the tag of an entity")?;
            let kind = self.int("the type of the elements")?;
            let count = self.long("the number of elements")?;
            let physical = self.physical_of_volume.get(&volume).copied().unwrap_or(0);
            for _ in 0..self.room(count, "the number of elements", 4, 16)? {
                self.long("the label of an element")?;
                self.cell(kind, physical, volume, None, true)?;
            }
        }
        self.words.expect("$EndElements")
    }
}
