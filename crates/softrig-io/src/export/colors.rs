//! Stress and strain of the flesh as colours of the skin.

use super::ExportError;
use crate::journal::{JournalFrame, JournalReader, JournalVolume};
use softrig::character::{Character, CharacterMesh};
use softrig::force::polar::eigen_symmetric;
use softrig::force::{CellStress, cell_stress};
use softrig::mesh::Embedding;
use softrig_linalg::Mat3;
use std::io::{Read, Seek};

/// A quantity of the flesh that skin vertices are coloured by.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FleshField {
    /// Von Mises stress [Pa].
    VonMises,
    /// Largest of the principal strains by size [-].
    PrincipalStrain,
}

impl FleshField {
    fn of(self, cell: &CellStress) -> f64 {
        match self {
            Self::VonMises => cell.von_mises,
            Self::PrincipalStrain => principal(cell.strain).into_iter().fold(0.0, |m: f64, p| m.max(p.abs())),
        }
    }

    /// Name of the number in files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::VonMises => "von_mises",
            Self::PrincipalStrain => "principal_strain",
        }
    }
}

/// Principal values of a tensor xx, yy, zz, xy, yz, zx, largest first.
pub(super) fn principal([xx, yy, zz, xy, yz, zx]: [f64; 6]) -> [f64; 3] {
    let (mut values, _) = eigen_symmetric(Mat3([[xx, xy, zx], [xy, yy, yz], [zx, yz, zz]]));
    values.sort_by(|a, b| b.total_cmp(a));
    values
}

/// What colours the vertices of a character, frame by frame.
pub(super) struct Painter {
    pub field: FleshField,
    volume: JournalVolume,
    /// Cell under each vertex of each mesh; empty for meshes that carry no flesh.
    cells: Vec<Vec<u32>>,
    /// Value at the upper end of the colours.
    top: f64,
}

impl Painter {
    /// Looks at all frames first, so that a colour means the same in all of them.
    pub fn new<S: Read + Seek>(
        journal: &mut JournalReader<S>,
        character: &Character,
        field: FleshField,
    ) -> Result<Self, ExportError> {
        let refuse =
            |what: &str, instead: &str| ExportError::Unsupported { what: what.into(), instead: instead.into() };
        let volume = journal.header().volume.clone();
        let volume = volume.ok_or_else(|| {
            refuse(
                "colours from a journal without nodes",
                "bake with the colours chosen, so that the journal keeps the volume mesh",
            )
        })?;
        let flesh = character.meshes.iter().any(CharacterMesh::is_weighted);
        let surface = character.surface(flesh);
        let embedding = Embedding::embed(&volume.mesh, &surface.positions, None)
            .map_err(|e| refuse("colours of a skin that lies in no cell", &e.to_string()))?;
        let mut next = 0;
        let cells = character.meshes.iter().map(|m| {
            if flesh && !m.is_weighted() {
                return Vec::new();
            }
            let range = next..next + m.positions.len();
            next = range.end;
            embedding.cell[range].to_vec()
        });
        let cells = cells.collect();
        let mut out = Self { field, volume, cells, top: 0.0 };
        let mut frame = JournalFrame::default();
        for t in 0..journal.frame_count() {
            journal.read_frame(t, &mut frame)?;
            out.top = out.values(&frame).iter().flatten().fold(out.top, |m, v| m.max(*v));
        }
        Ok(out)
    }

    /// Values of every vertex of every mesh; zero where there is no flesh.
    pub fn values(&self, frame: &JournalFrame) -> Vec<Vec<f64>> {
        let nodes: Vec<[f64; 3]> = frame.nodes.iter().map(|p| p.map(f64::from)).collect();
        let stress = cell_stress(&self.volume.mesh, &self.volume.materials, &nodes);
        let of_cell: Vec<f64> = stress.iter().map(|c| self.field.of(c)).collect();
        let of_mesh = |(cells, skin): (&Vec<u32>, &Vec<[f32; 3]>)| {
            if cells.is_empty() { vec![0.0; skin.len()] } else { cells.iter().map(|c| of_cell[*c as usize]).collect() }
        };
        self.cells.iter().zip(&frame.skin).map(of_mesh).collect()
    }

    /// The largest value of every vertex of every mesh in any frame.
    pub fn peaks<S: Read + Seek>(&self, journal: &mut JournalReader<S>) -> Result<Vec<Vec<f64>>, ExportError> {
        let mut frame = JournalFrame::default();
        let mut peaks: Vec<Vec<f64>> = Vec::new();
        for t in 0..journal.frame_count() {
            journal.read_frame(t, &mut frame)?;
            let values = self.values(&frame);
            if peaks.is_empty() {
                peaks = values;
                continue;
            }
            for (peak, v) in peaks.iter_mut().flatten().zip(values.into_iter().flatten()) {
                *peak = peak.max(v);
            }
        }
        Ok(peaks)
    }

    /// Red, green and blue of a value: from blue over white to red, each from 0 to 1.
    pub fn color(&self, value: f64) -> [f64; 3] {
        let s = if self.top > 0.0 { (value / self.top).clamp(0.0, 1.0) } else { 0.0 };
        let mix = |a: [f64; 3], b: [f64; 3], s: f64| std::array::from_fn(|k| a[k] + s * (b[k] - a[k]));
        const ENDS: [[f64; 3]; 3] = [[0.23, 0.30, 0.75], [0.87, 0.87, 0.87], [0.71, 0.02, 0.15]];
        if s < 0.5 { mix(ENDS[0], ENDS[1], 2.0 * s) } else { mix(ENDS[1], ENDS[2], 2.0 * s - 1.0) }
    }
}
