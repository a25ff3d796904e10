//! Medit `.mesh` text files: keyword, count, rows; every row ends in a reference, which becomes the region.

use super::builder::{Builder, NodeNumbers, other_cells};
use crate::error::{ImportError, Place};
use crate::text::{Words, shown};
use softrig::mesh::VolumeMesh;
use std::path::Path;

pub(super) fn parse(bytes: &[u8], file: &Path) -> Result<VolumeMesh, ImportError> {
    let mut words = Words::new(file, bytes).with_comments(b'#');
    let mut out = Builder::default();
    words.expect("MeshVersionFormatted")?;
    words.integer("the version")?;
    while let Some(key) = words.next() {
        match key.to_ascii_lowercase().as_slice() {
            b"dimension" => {
                let dimension = words.integer("the dimension")?;
                if dimension != 3 {
                    let remedy = "give a mesh in three dimensions";
                    return Err(words.unsupported(format!("nodes have {dimension} coordinates"), remedy));
                }
            }
            b"vertices" => {
                for _ in 0..words.count("the number of vertices", 8)? {
                    let p = words.point("a coordinate")?;
                    words.integer("a reference")?;
                    out.nodes.push(p);
                }
            }
            b"tetrahedra" => {
                for _ in 0..words.count("the number of tetrahedra", 10)? {
                    let (nodes, region) = row(&mut words, &mut out)?;
                    out.tet(nodes, region);
                }
            }
            b"hexahedra" | b"hexaedra" => {
                for _ in 0..words.count("the number of hexahedra", 18)? {
                    let (nodes, region) = row(&mut words, &mut out)?;
                    out.hex(nodes, region);
                }
            }
            b"end" => break,
            other => {
                let columns = match other {
                    b"corners"
                    | b"ridges"
                    | b"requiredvertices"
                    | b"requirededges"
                    | b"requiredtriangles"
                    | b"requiredquadrilaterals" => 1,
                    b"normalatvertices" | b"tangentatvertices" => 2,
                    b"edges" | b"normals" | b"tangents" => 3,
                    b"triangles" => 4,
                    b"quadrilaterals" => 5,
                    b"prisms" | b"pyramids" | b"tetrahedrap2" | b"hexahedraq2" => {
                        if words.count("a number of cells", 2)? > 0 {
                            return Err(other_cells(file, Place::Line(words.line()), &shown(key).to_lowercase()));
                        }
                        continue;
                    }
                    _ => return Err(words.malformed(format!("`{}` is no Medit keyword known here", shown(key)))),
                };
                let count = words.count("the number of rows", 2 * columns)?;
                (0..count * columns).try_for_each(|_| words.word("a number").map(|_| ()))?;
            }
        }
    }
    out.finish(file, &NodeNumbers::From(1))
}

fn row<const N: usize>(words: &mut Words<'_>, out: &mut Builder) -> Result<([i64; N], u32), ImportError> {
    let mut nodes = [0; N];
    for n in &mut nodes {
        *n = words.integer("the index of a node")?;
    }
    let reference = words.integer("a reference")?;
    // 0 is what writers put where nothing was said
    let region = if reference == 0 { out.region("") } else { out.region(&reference.to_string()) };
    Ok((nodes, region))
}
