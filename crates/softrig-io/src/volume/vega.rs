//! VEGA `.veg` text files: vertices, one kind of elements, materials assigned to sets of elements.
//!
//! Lists may stand in further files (`*INCLUDE`), which are looked for below the folder of the first. The region of a cell is the
//! name of its material.

use super::Loader;
use super::builder::{Builder, NodeNumbers, Shape, other_cells};
use crate::error::{ImportError, Place};
use crate::text::{Words, name, parse_integer, shown};
use softrig::mesh::VolumeMesh;
use std::collections::HashMap;
use std::path::Path;

/// Files may include files, but not in circles.
const MAX_DEPTH: usize = 8;
/// Most files one mesh may be made of.
const MAX_FILES: usize = 64;

/// Where in the grammar the next data line stands.
#[derive(Clone, Copy, PartialEq)]
enum Section {
    None,
    VertexHeader,
    Vertices,
    ElementKind,
    ElementHeader,
    Elements,
    Material,
    Set(usize),
    Region,
}

struct Reader<'l, 'a> {
    loader: &'l mut Loader<'a>,
    files: usize,
    section: Section,
    out: Builder,
    /// Label of the first vertex and of the first element: 0 or 1.
    first_vertex: Option<i64>,
    first_element: Option<i64>,
    shape: Shape,
    sets: Vec<Vec<i64>>,
    set_of_name: HashMap<String, usize>,
    /// Set and material, in order; later ones win.
    regions: Vec<(String, String)>,
}

pub(super) fn parse(bytes: &[u8], file: &Path, loader: &mut Loader<'_>) -> Result<VolumeMesh, ImportError> {
    let mut reader = Reader {
        loader,
        files: 0,
        section: Section::None,
        out: Builder::default(),
        first_vertex: None,
        first_element: None,
        shape: Shape::Flat,
        sets: Vec::new(),
        set_of_name: HashMap::new(),
        regions: Vec::new(),
    };
    reader.file(bytes, file, 0)?;
    reader.assign_regions(file)?;
    let first = reader.first_vertex.unwrap_or(1);
    reader.out.finish(file, &NodeNumbers::From(first))
}

impl Reader<'_, '_> {
    fn file(&mut self, bytes: &[u8], file: &Path, depth: usize) -> Result<(), ImportError> {
        self.files += 1;
        let mut words = Words::new(file, bytes).with_comments(b'#').with_separator(b',');
        // line by line: what a line means hangs on the section it is in
        while words.peek().is_some() {
            let at = words.clone();
            let line = words.rest_of_line();
            let line = line.split(|b| *b == b'#').next().unwrap_or_default();
            if line.starts_with(b"*") {
                let key_len = line.iter().position(u8::is_ascii_whitespace).unwrap_or(line.len());
                let (key, rest) = line.split_at(key_len);
                self.keyword(&at, key, name(rest), depth)?;
            } else {
                self.data(&at, line)?;
            }
        }
        Ok(())
    }

    fn keyword(&mut self, at: &Words<'_>, key: &[u8], rest: String, depth: usize) -> Result<(), ImportError> {
        self.section = match key.to_ascii_uppercase().as_slice() {
            b"*VERTICES" => Section::VertexHeader,
            b"*ELEMENTS" => Section::ElementKind,
            b"*MATERIAL" => Section::Material,
            b"*REGION" => Section::Region,
            b"*SET" => {
                let next = self.sets.len();
                let set = *self.set_of_name.entry(rest).or_insert(next);
                if set == next {
                    self.sets.push(Vec::new());
                }
                Section::Set(set)
            }
            b"*INCLUDE" => {
                if depth >= MAX_DEPTH || self.files >= MAX_FILES {
                    return Err(at.malformed(format!(
                        "`{}` is included too deep or after too many other files",
                        shown(rest.as_bytes())
                    )));
                }
                let bytes = (self.loader)(&rest)?;
                return self.file(&bytes, &at.file.with_file_name(rest), depth + 1);
            }
            _ => return Err(at.malformed(format!("`{}` is no VEGA keyword known here", shown(key)))),
        };
        Ok(())
    }

    fn data(&mut self, at: &Words<'_>, line: &[u8]) -> Result<(), ImportError> {
        let mut words = at.clone();
        match self.section {
            Section::None => return Err(at.malformed(format!("`{}` stands before any keyword", shown(line)))),
            Section::VertexHeader => {
                words.count("the number of vertices", 8)?;
                if words.integer("the dimension")? != 3 {
                    return Err(at.malformed("vertices have no three coordinates"));
                }
                self.section = Section::Vertices;
            }
            Section::Vertices => {
                let label = words.integer("the index of a vertex")?;
                let expected = *self.first_vertex.get_or_insert(label) + self.out.nodes.len() as i64;
                if label != expected || !(0..=1).contains(&(label - self.out.nodes.len() as i64)) {
                    return Err(at.malformed(format!("vertex {label} is out of order")));
                }
                self.out.nodes.push(words.point("a coordinate")?);
            }
            Section::ElementKind => {
                self.shape = match name(line).to_ascii_uppercase().as_str() {
                    "TET" | "TETS" => Shape::Tet4,
                    "CUBIC" => Shape::Hex8,
                    _ => {
                        return Err(other_cells(
                            at.file,
                            Place::Line(at.line()),
                            &format!("elements of kind `{}`", shown(line)),
                        ));
                    }
                };
                self.section = Section::ElementHeader;
            }
            Section::ElementHeader => {
                words.count("the number of elements", 10)?;
                self.section = Section::Elements;
            }
            Section::Elements => {
                let label = words.integer("the index of an element")?;
                let count = self.out.tets.len() + self.out.hexes.len();
                let first = *self.first_element.get_or_insert(label);
                if !(0..=1).contains(&first) || label != first + count as i64 {
                    return Err(at.malformed(format!("element {label} is out of order")));
                }
                let mut nodes = [0; 8];
                let used = if self.shape == Shape::Tet4 { 4 } else { 8 };
                for n in &mut nodes[..used] {
                    *n = words.integer("the index of a vertex")?;
                }
                let region = self.out.region("");
                match self.shape {
                    Shape::Tet4 => self.out.tet([nodes[0], nodes[1], nodes[2], nodes[3]], region),
                    _ => self.out.hex(nodes, region),
                }
            }
            // kind and numbers of the material: its name is what is kept
            Section::Material => {}
            Section::Set(set) => {
                for word in line.split(|b| *b == b',' || b.is_ascii_whitespace()).filter(|w| !w.is_empty()) {
                    let Some(label) = parse_integer(word) else {
                        return Err(at.malformed(format!("`{}` is no element number", shown(word))));
                    };
                    self.sets[set].push(label);
                }
            }
            Section::Region => {
                let mut parts = line.splitn(2, |b| *b == b',').map(name);
                match (parts.next(), parts.next()) {
                    (Some(set), Some(material)) if !material.is_empty() => self.regions.push((set, material)),
                    _ => return Err(at.malformed("a region needs a set and a material")),
                }
            }
        }
        Ok(())
    }

    fn assign_regions(&mut self, file: &Path) -> Result<(), ImportError> {
        let count = self.out.tets.len() + self.out.hexes.len();
        let mut region = vec![self.out.region(""); count];
        let first = self.first_element.unwrap_or(1);
        for (set, material) in std::mem::take(&mut self.regions) {
            let number = self.out.region(&material);
            if set == "allElements" {
                region.fill(number);
                continue;
            }
            let wrong = |reason: String| {
                ImportError::malformed(file, Place::Part(format!("set `{set}`")), reason, "correct the file")
            };
            let Some(labels) = self.set_of_name.get(&set).and_then(|s| self.sets.get(*s)) else {
                return Err(wrong("a region names it, but there is no such set".into()));
            };
            for label in labels {
                let cell = usize::try_from(label - first).ok().and_then(|i| region.get_mut(i));
                *cell.ok_or_else(|| wrong(format!("it has element {label}, which does not exist")))? = number;
            }
        }
        // one kind of elements: file order is cell order
        self.out.set_regions(&region);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TET: &str = "*VERTICES\n4 3 0 0\n0 0 0 0\n1 1 0 0\n2 0 1 0\n3 0 0 1\n*ELEMENTS\nTET\n1 4 0\n0 0 1 2 3\n";

    #[test]
    fn includes_end_even_when_they_run_in_circles() {
        let text = format!("{TET}*SET a\n*INCLUDE a.txt\n*MATERIAL m\nENU, 1, 2, 3\n*REGION\na, m\n");
        let m = parse(text.as_bytes(), Path::new("t.veg"), &mut |name| {
            assert_eq!(name, "a.txt");
            Ok(b"0\n".to_vec())
        });
        assert_eq!(m.unwrap().region_names, ["m"]);
        let e = parse(text.as_bytes(), Path::new("t.veg"), &mut |_| Ok(b"*INCLUDE a.txt\n".to_vec()));
        assert!(e.unwrap_err().to_string().contains("too deep"));
    }
}
