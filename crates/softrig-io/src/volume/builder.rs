//! What all volume readers fill: nodes by label, cells by kind, regions by name.

use crate::error::{ImportError, Place};
use crate::text::{MAX_COORDINATE, REMEDY};
use softrig::mesh::VolumeMesh;
use std::collections::HashMap;
use std::path::Path;

/// Labels of nodes as a file counts them.
#[derive(Default)]
pub(super) struct Labels {
    first: i64,
    count: u32,
    /// Only filled once labels are not consecutive.
    scattered: HashMap<i64, u32>,
}

impl Labels {
    /// Takes the label of the next node; `false` when it was there before.
    pub fn push(&mut self, label: i64) -> bool {
        if self.count == 0 {
            self.first = label;
        }
        let consecutive = self.scattered.is_empty() && label.wrapping_sub(self.first) == i64::from(self.count);
        if !consecutive {
            if self.scattered.is_empty() {
                self.scattered = (0..self.count).map(|i| (self.first + i64::from(i), i)).collect();
            }
            if self.scattered.insert(label, self.count).is_some() {
                return false;
            }
        }
        self.count += 1;
        true
    }

    /// Index of the node with a label.
    pub fn find(&self, label: i64) -> Option<u32> {
        if self.scattered.is_empty() {
            let i = label.checked_sub(self.first)?;
            return u32::try_from(i).ok().filter(|i| *i < self.count);
        }
        self.scattered.get(&label).copied()
    }
}

/// A cell of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Shape {
    /// Points, lines, triangles, quads: not part of the volume.
    Flat,
    Tet4,
    Hex8,
    /// A volume cell that softrig does not compute with.
    Other(&'static str),
}

/// Cells hold node indices (not labels) that are checked at the end, when all nodes are known.
#[derive(Default)]
pub(super) struct Builder {
    pub nodes: Vec<[f64; 3]>,
    pub tets: Vec<[i64; 4]>,
    pub hexes: Vec<[i64; 8]>,
    tet_regions: Vec<u32>,
    hex_regions: Vec<u32>,
    region_of_name: HashMap<String, u32>,
    region_names: Vec<String>,
}

impl Builder {
    /// Number of a region; the empty name stands for no region.
    pub fn region(&mut self, name: &str) -> u32 {
        if let Some(region) = self.region_of_name.get(name) {
            return *region;
        }
        let region = self.region_names.len() as u32;
        self.region_of_name.insert(name.to_owned(), region);
        self.region_names.push(name.to_owned());
        region
    }

    pub fn tet(&mut self, nodes: [i64; 4], region: u32) {
        self.tets.push(nodes);
        self.tet_regions.push(region);
    }

    pub fn hex(&mut self, nodes: [i64; 8], region: u32) {
        self.hexes.push(nodes);
        self.hex_regions.push(region);
    }

    /// Replaces the regions of all cells, tetrahedra first.
    pub fn set_regions(&mut self, regions: &[u32]) {
        let (tets, hexes) = regions.split_at(self.tets.len());
        self.tet_regions = tets.to_vec();
        self.hex_regions = hexes.to_vec();
    }

    /// The mesh. Nodes of cells are indices counted from `base`, or labels when the file has them.
    pub fn finish(self, file: &Path, labels: &NodeNumbers) -> Result<VolumeMesh, ImportError> {
        if self.tets.is_empty() && self.hexes.is_empty() {
            let reason = format!("it has {} nodes but no tetrahedron or hexahedron", self.nodes.len());
            let remedy = "give a volume mesh, or make one from a surface with `softrig mesh`";
            return Err(ImportError::malformed(file, Place::Whole, reason, remedy));
        }
        if let Some(i) = self.nodes.iter().position(|p| p.iter().any(|v| v.is_nan() || v.abs() > MAX_COORDINATE)) {
            let reason = format!("{:?} is no usable position", self.nodes[i]);
            return Err(ImportError::malformed(file, Place::Part(format!("node {i} (from 0)")), reason, REMEDY));
        }
        let count = self.nodes.len();
        let resolve = |kind: &str, cell: usize, number: i64| {
            let index = match labels {
                NodeNumbers::From(base) => {
                    number.checked_sub(*base).and_then(|i| u32::try_from(i).ok()).filter(|i| (*i as usize) < count)
                }
                NodeNumbers::Labels(labels) => labels.find(number),
            };
            index.ok_or_else(|| {
                let reason = format!("it uses node {number}, which is not among the {count} nodes of the file");
                ImportError::malformed(file, Place::Part(format!("{kind} {cell} (from 0)")), reason, REMEDY)
            })
        };
        let mut mesh = VolumeMesh { nodes: self.nodes, ..VolumeMesh::default() };
        for (i, tet) in self.tets.iter().enumerate() {
            let mut out = [0; 4];
            for (to, from) in out.iter_mut().zip(tet) {
                *to = resolve("tetrahedron", i, *from)?;
            }
            mesh.tets.push(out);
        }
        for (i, hex) in self.hexes.iter().enumerate() {
            let mut out = [0; 8];
            for (to, from) in out.iter_mut().zip(hex) {
                *to = resolve("hexahedron", i, *from)?;
            }
            mesh.hexes.push(out);
        }
        let mut region = self.tet_regions;
        region.extend(self.hex_regions);
        // names in order of first use; surface groups and unused materials have no cells
        let mut new = vec![None; self.region_names.len()];
        for r in &mut region {
            let names = &mut mesh.region_names;
            *r = *new[*r as usize].get_or_insert_with(|| {
                names.push(self.region_names[*r as usize].clone());
                names.len() as u32 - 1
            });
        }
        if mesh.region_names.iter().all(String::is_empty) {
            mesh.region_names.clear();
        } else {
            mesh.region = region;
        }
        Ok(mesh)
    }
}

/// How cells name nodes.
pub(super) enum NodeNumbers {
    /// By position in the list of nodes, counted from this.
    From(i64),
    /// By label.
    Labels(Labels),
}

/// A cell of another kind: refused with the same words in all formats.
pub(super) fn other_cells(file: &Path, place: Place, what: &str) -> ImportError {
    ImportError::unsupported(
        file,
        place,
        format!("it has {what}"),
        "softrig computes with four-node tetrahedra and eight-node hexahedra; export first-order cells of these kinds",
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn labels_may_be_consecutive_from_anywhere_or_scattered() {
        let mut l = Labels::default();
        assert!([7, 8, 9].into_iter().all(|n| l.push(n)));
        assert_eq!((l.find(9), l.find(6), l.find(10)), (Some(2), None, None));
        assert!(l.push(2) && l.push(40) && !l.push(8));
        assert_eq!((l.find(7), l.find(2), l.find(40), l.find(3)), (Some(0), Some(3), Some(4), None));
    }
}
