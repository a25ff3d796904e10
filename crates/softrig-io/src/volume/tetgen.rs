//! TetGen: nodes in one file, tetrahedra in another. Both may count from 0 or from 1; the first node tells.

use super::builder::{Builder, Labels, NodeNumbers, other_cells};
use crate::error::{ImportError, Place};
use crate::text::{Words, shown};
use softrig::mesh::VolumeMesh;
use std::path::Path;

pub(super) fn parse(nodes: &[u8], node_file: &Path, cells: &[u8], cell_file: &Path) -> Result<VolumeMesh, ImportError> {
    let mut out = Builder::default();
    let mut labels = Labels::default();
    let mut words = Words::new(node_file, nodes).with_comments(b'#');
    // an index and three coordinates with a space behind each
    let count = words.count("the number of nodes", 8)?;
    let dimension = words.integer("the dimension")?;
    if dimension != 3 {
        return Err(words.unsupported(format!("nodes have {dimension} coordinates"), "give a mesh in three dimensions"));
    }
    let attributes = words.count("the number of attributes", 0)?;
    let markers = words.count("the number of markers", 0)?;
    for _ in 0..count {
        let label = words.integer("the index of a node")?;
        if !labels.push(label) {
            return Err(words.malformed(format!("node {label} is there twice")));
        }
        out.nodes.push(words.point("a coordinate")?);
        skip(&mut words, attributes.saturating_add(markers))?;
    }

    let mut words = Words::new(cell_file, cells).with_comments(b'#');
    let count = words.count("the number of tetrahedra", 10)?;
    let corners = words.integer("the number of nodes of each tetrahedron")?;
    if corners != 4 {
        let what = format!("tetrahedra with {corners} nodes");
        return Err(other_cells(cell_file, Place::Line(words.line()), &what));
    }
    let attributes = words.count("the number of attributes", 0)?;
    for _ in 0..count {
        words.integer("the index of a tetrahedron")?;
        let mut nodes = [0; 4];
        for n in &mut nodes {
            *n = words.integer("the index of a node")?;
        }
        // the first attribute is the region
        let region = if attributes > 0 { words.word("an attribute")? } else { "" };
        let region = out.region(&shown(region.as_bytes()));
        skip(&mut words, attributes.saturating_sub(1))?;
        out.tet(nodes, region);
    }
    out.finish(cell_file, &NodeNumbers::Labels(labels))
}

fn skip(words: &mut Words<'_>, count: usize) -> Result<(), ImportError> {
    (0..count).try_for_each(|_| words.word("an attribute").map(|_| ()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_bases_attributes_markers_and_comments_are_understood() {
        for base in [0, 1] {
            let node = format!(
                "# made\n4 3 1 1\n{} 0 0 0 9 1\n{} 1 0 0 9 1 # x\n{} 0 1 0 9 1\n{} 0 0 1 9 1\n",
                base,
                base + 1,
                base + 2,
                base + 3
            );
            let ele = format!("1 4 1\n{base} {} {} {} {} 12\n", base, base + 1, base + 2, base + 3);
            let m = parse(node.as_bytes(), Path::new("a.node"), ele.as_bytes(), Path::new("a.ele")).unwrap();
            assert_eq!((m.tets[0], &m.region_names[..]), ([0, 1, 2, 3], &["12".to_string()][..]));
        }
    }
}
