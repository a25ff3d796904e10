//! Wavefront OBJ.
//!
//! All objects of a file become one mesh, because they share one list of vertices, and that list is the file's order.
//! `o` and `g` become per-vertex groups, `usemtl` the looks. Indices may be negative (relative to the vertices so far)
//! or point forward. A vertex with several texture coordinates keeps the first. Free-form curves and surfaces, lines and points are left out.

use super::{Parsed, srgb_to_linear, triangulate};
use crate::error::{ImportError, Place};
use crate::text::{MAX_COORDINATE, REMEDY, name, parse_integer, parse_number, shown};
use softrig::character::Look;
use std::borrow::Cow;
use std::collections::HashMap;
use std::path::Path;

/// Most numbers spent on groups: groups times vertices.
const MAX_GROUP_ENTRIES: usize = 1 << 24;

/// Base colour of materials no file describes: a light grey.
const PLAIN: [f32; 4] = [0.6, 0.6, 0.6, 1.0];

/// The state of a parse.
#[derive(Default)]
struct Reader {
    out: Parsed,
    /// Texture coordinates by their own index.
    coordinates: Vec<[f32; 2]>,
    colored: bool,
    /// Corners of all polygons, one after the other.
    corners: Vec<Corner>,
    polygons: Vec<Polygon>,
    names: Names,
    look_of_name: HashMap<String, u32>,
    look: Option<u32>,
    skipped: usize,
    other: usize,
}

/// Indices as they will be once all vertices are known, and the line they stand on.
struct Corner {
    vertex: u32,
    coordinate: Option<u32>,
}

struct Polygon {
    first: usize,
    line: usize,
    look: Option<u32>,
    /// Number of the set of groups it is in.
    groups: u32,
}

/// Sets of group names that were in force, by number.
#[derive(Default)]
struct Names {
    group_of_name: HashMap<String, u32>,
    groups: Vec<String>,
    object: Option<u32>,
    current: Vec<u32>,
    /// Every set so far; the last is the one in force.
    sets: Vec<Vec<u32>>,
}

impl Names {
    fn id(&mut self, group: String) -> u32 {
        let next = self.groups.len() as u32;
        *self.group_of_name.entry(group).or_insert_with_key(|key| {
            self.groups.push(key.clone());
            next
        })
    }

    fn changed(&mut self) {
        let set: Vec<u32> = self.object.iter().chain(&self.current).copied().collect();
        self.sets.push(set);
    }
}

pub(super) fn parse(bytes: &[u8], file: &Path) -> Result<Parsed, ImportError> {
    let mut reader = Reader::default();
    reader.names.sets.push(Vec::new());
    let mut lines = Lines { bytes, at: 0, line: 0 };
    while let Some((line, number)) = lines.next() {
        reader.line(&line).map_err(|reason| ImportError::malformed(file, Place::Line(number), reason, REMEDY))?;
        // the line is known to `line` only afterwards
        for polygon in reader.polygons.iter_mut().rev().take_while(|p| p.line == 0) {
            polygon.line = number;
        }
    }
    reader.finish(file)
}

impl Reader {
    fn line(&mut self, line: &[u8]) -> Result<(), String> {
        let mut words = line.split(u8::is_ascii_whitespace).filter(|w| !w.is_empty());
        let Some(key) = words.next() else { return Ok(()) };
        let rest = || line.trim_ascii_start().get(key.len()..).unwrap_or_default();
        match key {
            b"v" => return self.vertex(words),
            b"vt" => {
                let mut read = || words.next().map_or(Some(0.0), parse_number);
                let (Some(u), Some(v)) = (read(), read()) else {
                    return Err("a texture coordinate is no number".into());
                };
                // the origin of OBJ is the lower left
                self.coordinates.push([u as f32, (1.0 - v) as f32]);
            }
            b"f" | b"fo" => return self.face(words),
            b"g" => {
                self.names.current.clear();
                for word in words {
                    let id = self.names.id(name(word));
                    if !self.names.current.contains(&id) && self.names.current.len() < 16 {
                        self.names.current.push(id);
                    }
                }
                self.names.changed();
            }
            b"o" => {
                let object = name(rest());
                self.names.object = (!object.is_empty()).then(|| self.names.id(object));
                self.names.changed();
            }
            b"usemtl" => {
                let material = name(rest());
                let looks = &mut self.out.looks;
                self.look = Some(*self.look_of_name.entry(material).or_insert_with_key(|key| {
                    looks.push(Look { name: key.clone(), base_color: PLAIN, texture: None });
                    (looks.len() - 1) as u32
                }));
            }
            b"mtllib" => self.out.material_files.push(name(rest())),
            b"l" | b"p" | b"curv" | b"curv2" | b"surf" => self.other += 1,
            // normals, smoothing and everything else do not move anything
            _ => {}
        }
        Ok(())
    }

    fn vertex<'a>(&mut self, words: impl Iterator<Item = &'a [u8]>) -> Result<(), String> {
        let (mut v, mut n) = ([0.0; 6], 0);
        for word in words.take(6) {
            v[n] = parse_number(word).ok_or_else(|| format!("`{}` is no number", shown(word)))?;
            n += 1;
        }
        if n < 3 {
            return Err(format!("a vertex has {n} coordinates"));
        }
        if let Some(far) = v[..3].iter().find(|v| v.abs() > MAX_COORDINATE) {
            return Err(format!("{far:e} is no usable coordinate"));
        }
        self.out.positions.push([v[0], v[1], v[2]]);
        // colours behind the position, as scanners write them; white until the first
        self.colored |= n == 6;
        let color = if n == 6 { [v[3], v[4], v[5]].map(|c| srgb_to_linear(c as f32)) } else { [1.0; 3] };
        if self.colored {
            self.out.colors.resize(self.out.positions.len() - 1, [1.0; 4]);
            self.out.colors.push([color[0], color[1], color[2], 1.0]);
        }
        Ok(())
    }

    fn face<'a>(&mut self, words: impl Iterator<Item = &'a [u8]>) -> Result<(), String> {
        let first = self.corners.len();
        for word in words {
            let mut parts = word.split(|b| *b == b'/');
            let vertex = resolve(parts.next().unwrap_or_default(), self.out.positions.len())?;
            let vertex = vertex.ok_or_else(|| format!("corner `{}` names no vertex", shown(word)))?;
            let coordinate = resolve(parts.next().unwrap_or_default(), self.coordinates.len())?;
            self.corners.push(Corner { vertex, coordinate });
        }
        if self.corners.len() - first < 3 {
            self.corners.truncate(first);
            self.skipped += 1;
            return Ok(());
        }
        let groups = (self.names.sets.len() - 1) as u32;
        self.polygons.push(Polygon { first, line: 0, look: self.look, groups });
        Ok(())
    }

    fn finish(mut self, file: &Path) -> Result<Parsed, ImportError> {
        let vertex_count = self.out.positions.len();
        let has_looks = self.polygons.iter().any(|p| p.look.is_some());
        if has_looks && self.polygons.iter().any(|p| p.look.is_none()) {
            self.out.looks.push(Look { name: String::new(), base_color: PLAIN, texture: None });
        }
        let last_look = self.out.looks.len().saturating_sub(1) as u32;
        let with_coordinates = self.corners.iter().any(|c| c.coordinate.is_some());
        let mut coordinate_of_vertex = vec![None; if with_coordinates { vertex_count } else { 0 }];
        let mut corners = Vec::new();
        for (i, polygon) in self.polygons.iter().enumerate() {
            let end = self.polygons.get(i + 1).map_or(self.corners.len(), |p| p.first);
            corners.clear();
            for corner in &self.corners[polygon.first..end] {
                if corner.vertex as usize >= vertex_count {
                    let reason =
                        format!("a face uses vertex {}, but there are {vertex_count}", u64::from(corner.vertex) + 1);
                    return Err(ImportError::malformed(file, Place::Line(polygon.line), reason, REMEDY));
                }
                corners.push(corner.vertex);
                let coordinate = corner.coordinate.and_then(|c| self.coordinates.get(c as usize));
                if let Some(c) = coordinate {
                    coordinate_of_vertex[corner.vertex as usize].get_or_insert(*c);
                }
            }
            triangulate(&corners, &self.out.positions, &mut self.out.triangles);
            if has_looks {
                self.out.look.resize(self.out.triangles.len(), polygon.look.unwrap_or(last_look));
            }
        }
        self.out.texture_coordinates = coordinate_of_vertex.into_iter().map(Option::unwrap_or_default).collect();
        if self.colored {
            self.out.colors.resize(vertex_count, [1.0; 4]);
        }
        self.groups();
        if self.skipped > 0 {
            self.out.notes.push(format!("left out {} faces with fewer than three corners", self.skipped));
        }
        if self.other > 0 {
            self.out.notes.push(format!("left out {} lines, points or free-form pieces", self.other));
        }
        Ok(self.out)
    }

    /// Vertex groups from `o` and `g`.
    fn groups(&mut self) {
        let vertex_count = self.out.positions.len();
        let group_count = self.names.groups.len();
        if group_count.saturating_mul(vertex_count) > MAX_GROUP_ENTRIES {
            self.out
                .notes
                .push(format!("left out the file's {group_count} groups: too many for {vertex_count} vertices"));
            return;
        }
        let mut groups: Vec<_> = self.names.groups.drain(..).map(|g| (g, vec![0.0; vertex_count])).collect();
        for (i, polygon) in self.polygons.iter().enumerate() {
            let end = self.polygons.get(i + 1).map_or(self.corners.len(), |p| p.first);
            for group in &self.names.sets[polygon.groups as usize] {
                for corner in &self.corners[polygon.first..end] {
                    groups[*group as usize].1[corner.vertex as usize] = 1.0;
                }
            }
        }
        groups.retain(|(_, weights)| weights.iter().any(|w| *w > 0.0));
        self.out.groups = groups;
    }
}

/// An index of a face as one from 0; `None` for an empty one. Negative ones count back from what is there so far.
fn resolve(word: &[u8], so_far: usize) -> Result<Option<u32>, String> {
    if word.is_empty() {
        return Ok(None);
    }
    let index = parse_integer(word).ok_or_else(|| format!("`{}` is no index", shown(word)))?;
    let from_zero = if index < 0 { so_far as i64 + index } else { index - 1 };
    match u32::try_from(from_zero) {
        Ok(i) => Ok(Some(i)),
        Err(_) if index == 0 => Err("a face uses index 0; OBJ counts from 1".into()),
        Err(_) => Err(format!("a face uses index {index}, but there are {so_far} so far")),
    }
}

/// Lines with continuations joined and comments cut off, and the number each starts on.
struct Lines<'a> {
    bytes: &'a [u8],
    at: usize,
    line: usize,
}

impl<'a> Lines<'a> {
    fn next(&mut self) -> Option<(Cow<'a, [u8]>, usize)> {
        let first = self.line + 1;
        let mut joined = Cow::Borrowed(self.physical()?);
        // a backslash before the line end goes on in the next line
        while let Some(b'\\') = joined.last() {
            let Some(next) = self.physical() else { break };
            let all = joined.to_mut();
            all.pop();
            all.push(b' ');
            all.extend_from_slice(next);
        }
        if let Some(end) = joined.iter().position(|b| *b == b'#') {
            match &mut joined {
                Cow::Borrowed(line) => *line = &line[..end],
                Cow::Owned(line) => line.truncate(end),
            }
        }
        Some((joined, first))
    }

    fn physical(&mut self) -> Option<&'a [u8]> {
        let rest = self.bytes.get(self.at..).filter(|r| !r.is_empty())?;
        let len = rest.iter().position(|b| *b == b'\n').unwrap_or(rest.len());
        self.at += len + 1;
        self.line += 1;
        Some(rest[..len].trim_ascii_end())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parsed(text: &str) -> Result<Parsed, ImportError> {
        parse(text.as_bytes(), Path::new("t.obj"))
    }

    #[test]
    fn continuations_negative_indices_and_crlf_are_understood() {
        let p = parsed("v 0 0 0\r\nv 1 0 \\\r\n0\r\nv 0 1 0 # tip\r\ng arm\r\nf -3/1/1 \\\r\n -2// -1\r\n").unwrap();
        assert_eq!((p.positions[1], &p.triangles[..]), ([1.0, 0.0, 0.0], &[[0, 1, 2]][..]));
        assert_eq!(p.groups, [("arm".to_string(), vec![1.0; 3])]);
    }

    #[test]
    fn a_bad_index_is_refused_with_its_line() {
        for (text, part) in [
            ("v 0 0 0\nf 1 2 3\n", "line 2: a face uses vertex 2, but there are 1"),
            ("v 0 0 0\nf 0 1 1\n", "line 2: a face uses index 0"),
            ("v 0 0 0\n\nf -2 1 1\n", "line 3: a face uses index -2"),
            ("v 0 0 x\n", "line 1: `x` is no number"),
            ("v 0 0\n", "line 1: a vertex has 2 coordinates"),
            ("v 0 0 inf\n", "line 1: `inf` is no number"),
        ] {
            let e = parsed(text).err().expect(text).to_string();
            assert!(e.contains(part), "{e}");
        }
    }

    #[test]
    fn materials_and_colors_stay_with_their_faces() {
        let p = parsed("v 0 0 0\nv 1 0 0 1 0 0\nv 0 1 0\nf 1 2 3\nusemtl red one\nf 1 3 2\n").unwrap();
        assert_eq!(p.look, [1, 0]);
        assert_eq!(p.looks[0].name, "red one");
        assert_eq!(p.colors, [[1.0; 4], [1.0, 0.0, 0.0, 1.0], [1.0; 4]]);
    }
}
