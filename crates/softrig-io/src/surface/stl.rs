//! Stereolithography files, ASCII and binary.
//!
//! A file is a list of loose triangles. Corners at exactly the same position become one vertex, numbered by first appearance;
//! normals are not read, the order of the corners says the same.

use super::Parsed;
use crate::error::{ImportError, Place};
use crate::text::{MAX_COORDINATE, REMEDY, Words};
use std::collections::HashMap;
use std::path::Path;

/// Bytes before the first triangle of a binary file.
const HEADER: usize = 84;
/// Bytes of a triangle: normal, three corners, two spare bytes.
const TRIANGLE: usize = 50;

/// Welds equal corners.
#[derive(Default)]
struct Weld {
    out: Parsed,
    vertex_at: HashMap<[u64; 3], u32>,
}

impl Weld {
    fn corner(&mut self, p: [f64; 3]) -> u32 {
        // adding zero makes -0 equal to 0
        let key = p.map(|v| (v + 0.0).to_bits());
        let positions = &mut self.out.positions;
        *self.vertex_at.entry(key).or_insert_with(|| {
            positions.push(p);
            (positions.len() - 1) as u32
        })
    }
}

pub(super) fn parse(bytes: &[u8], file: &Path) -> Result<Parsed, ImportError> {
    let count = bytes.get(80..HEADER).map(|n| u32::from_le_bytes(n.try_into().expect("four bytes")));
    let fits = count.is_some_and(|n| HEADER as u64 + TRIANGLE as u64 * u64::from(n) == bytes.len() as u64);
    // many binary files begin with "solid" too: their size or a zero byte gives them away
    let is_text = bytes.trim_ascii_start().get(..5).is_some_and(|s| s.eq_ignore_ascii_case(b"solid"))
        && !bytes[..bytes.len().min(512)].contains(&0);
    if is_text && !fits { ascii(bytes, file) } else { binary(bytes, file, count) }
}

fn binary(bytes: &[u8], file: &Path, count: Option<u32>) -> Result<Parsed, ImportError> {
    let whole = |reason| ImportError::malformed(file, Place::Whole, reason, REMEDY);
    let Some(count) = count else { return Err(whole(format!("{} bytes are too few for an STL file", bytes.len()))) };
    let body = &bytes[HEADER..];
    let room = body.len() / TRIANGLE;
    if count as usize > room {
        return Err(whole(format!("it says {count} triangles but has room for {room}")));
    }
    let mut weld = Weld::default();
    for (i, triangle) in body.chunks_exact(TRIANGLE).take(count as usize).enumerate() {
        let number =
            |k: usize| f64::from(f32::from_le_bytes(triangle[4 * k..4 * k + 4].try_into().expect("four bytes")));
        let mut corners = [0; 3];
        for (c, corner) in corners.iter_mut().enumerate() {
            let p = [number(3 * c + 3), number(3 * c + 4), number(3 * c + 5)];
            if !p.iter().all(|v| v.is_finite()) {
                let place = Place::Byte(HEADER + i * TRIANGLE);
                return Err(ImportError::malformed(file, place, format!("triangle {i} has a corner at {p:?}"), REMEDY));
            }
            *corner = weld.corner(p);
        }
        weld.out.triangles.push(corners);
    }
    Ok(weld.out)
}

fn ascii(bytes: &[u8], file: &Path) -> Result<Parsed, ImportError> {
    let mut words = Words::new(file, bytes);
    let mut weld = Weld::default();
    let mut corners = Vec::with_capacity(3);
    while let Some(word) = words.next() {
        match word.to_ascii_lowercase().as_slice() {
            // a name may hold any word
            b"solid" | b"endsolid" => {
                words.rest_of_line();
            }
            b"vertex" => {
                let p = words.point("coordinate")?;
                debug_assert!(p.iter().all(|v| v.abs() <= MAX_COORDINATE));
                corners.push(weld.corner(p));
            }
            b"endloop" => {
                let [a, b, c] = corners[..] else {
                    return Err(words.malformed(format!("a facet has {} corners", corners.len())));
                };
                weld.out.triangles.push([a, b, c]);
                corners.clear();
            }
            _ => {}
        }
    }
    if !corners.is_empty() {
        return Err(words.malformed("the file ends inside a facet"));
    }
    Ok(weld.out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_corners_become_one_vertex_in_order_of_appearance() {
        let text = "solid vertex 9\n facet normal 0 0 1\n outer loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop endfacet\n\
                    facet normal 0 0 1 outer loop vertex 1 0 0 vertex 1 1 0 vertex -0 1 0 endloop endfacet\nendsolid\n";
        let p = parse(text.as_bytes(), Path::new("t.stl")).unwrap();
        assert_eq!(p.triangles, [[0, 1, 2], [1, 3, 2]]);
    }

    #[test]
    fn a_binary_file_may_begin_like_a_text_one() {
        let mut bytes = b"solid made by a careless program".to_vec();
        bytes.resize(80, b' ');
        bytes.extend(1u32.to_le_bytes());
        for v in [0.0f32, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0] {
            bytes.extend(v.to_le_bytes());
        }
        bytes.extend([0, 0]);
        assert_eq!(parse(&bytes, Path::new("t.stl")).unwrap().triangles, [[0, 1, 2]]);
        bytes.truncate(100);
        assert!(parse(&bytes[..], Path::new("t.stl")).is_err());
    }
}
