//! Voxelisation with a given spacing, or with the spacing that gives a wanted number of cells.

use super::cells::Pieces;
use super::grid::{Crossings, Grid, SUB, crossings};
use super::region::{Inside, Judge, inside, sheets};
use super::tidy::tidy;
use crate::mesh::orient::{Oriented, orient, validate};
use crate::mesh::{MeshError, SurfaceMesh, VolumeMesh};
use glam::DVec3;

/// How fine a lattice is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Resolution {
    /// Number of cells, counted after duplication; met within 10 % from 1000 on.
    Cells(usize),
    /// Edge of a voxel [m].
    Spacing(f64),
}

/// How to build a lattice.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LatticeOptions {
    /// How fine. Default: 8000 cells, at which an arm of a standing character is three to four cells thick.
    pub resolution: Resolution,
    /// Most cells allowed. Default 4 million: about 2 GiB for the mesh and its stiffness.
    pub max_cells: usize,
    /// Most sub-voxels of the bounding box allowed. Default 2^30: under 1 GiB while building.
    pub max_sub_voxels: u64,
}

impl Default for LatticeOptions {
    fn default() -> Self {
        Self { resolution: Resolution::Cells(8000), max_cells: 4_000_000, max_sub_voxels: 1 << 30 }
    }
}

/// What came out of a voxelisation besides the cells.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LatticeReport {
    /// Edge of a voxel [m].
    pub spacing: f64,
    /// Spacings tried.
    pub tries: usize,
    /// Volume inside the skin [m^3].
    pub volume: f64,
    /// Cells that are only there because of skin thinner than a sub-voxel.
    pub sheet_cells: usize,
    /// Cells that share their voxel with another.
    pub split_cells: usize,
    /// Connected components of the lattice.
    pub components: usize,
    /// Crumbs that held no skin vertex and were left out.
    pub dropped: usize,
    /// Loose pieces of a connected skin that were joined to the rest.
    pub joined: usize,
    /// Boundary edges of the surface after welding.
    pub boundary_edges: usize,
}

/// A lattice of hexahedra around any surface: open, crossing itself, in many parts, doubled, badly wound.
///
/// # Errors
/// A surface without triangles, extent or valid coordinates, or a lattice that would be too large.
pub fn voxelize(surface: &SurfaceMesh, options: &LatticeOptions) -> Result<VolumeMesh, MeshError> {
    voxelize_with_report(surface, options).map(|(mesh, _)| mesh)
}

/// [`voxelize`], and what it found on the way.
///
/// # Errors
/// As [`voxelize`].
pub fn voxelize_with_report(
    surface: &SurfaceMesh,
    options: &LatticeOptions,
) -> Result<(VolumeMesh, LatticeReport), MeshError> {
    validate(surface)?;
    let oriented = orient(surface);
    let none = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    let used = oriented.triangles.iter().flatten().map(|v| oriented.positions[*v as usize]);
    let (lo, hi) = used.fold(none, |(lo, hi), p| (lo.min(p), hi.max(p)));
    let size = if lo.x <= hi.x { (hi - lo).length() } else { 0.0 };
    // squares and cubes of sizes must be representable
    if !(1e-90..=1e90).contains(&size) || size <= 1e-12 * lo.abs().max(hi.abs()).max_element() {
        return Err(MeshError::Extent { size });
    }
    let job = Job { judge: Judge::new(&oriented), surface: &oriented, lo, hi, options };
    let (draft, tries) = match options.resolution {
        Resolution::Spacing(h) if h > 0.0 && h.is_finite() => (job.draft(h)?, 1),
        Resolution::Cells(n) if n > 0 => job.search(n)?,
        other => return Err(MeshError::Resolution { what: format!("{other:?}") }),
    };
    Ok(finish(draft, tries, &oriented))
}

/// One surface on its way into a lattice.
struct Job<'a> {
    surface: &'a Oriented,
    judge: Judge,
    lo: DVec3,
    hi: DVec3,
    options: &'a LatticeOptions,
}

/// A lattice before its nodes are made.
struct Draft {
    grid: Grid,
    crossings: Crossings,
    inside: Inside,
    pieces: Pieces,
}

impl Draft {
    fn count(&self) -> usize {
        self.pieces.mask.len()
    }
}

impl Job<'_> {
    /// Smallest spacing whose grid stays within the limit [m].
    fn finest(&self) -> f64 {
        let limit = self.options.max_sub_voxels as f64;
        let subs = |h: f64| (self.hi - self.lo).to_array().iter().map(|s| (s / h + 3.0) * SUB as f64).product::<f64>();
        // bisection in the logarithm: the count falls as the spacing grows
        let size = (self.hi - self.lo).length();
        let (mut fine, mut coarse) = (size * 1e-9, size * 1e3);
        for _ in 0..60 {
            let h = (fine * coarse).sqrt();
            if subs(h) > limit { fine = h } else { coarse = h }
        }
        coarse
    }

    fn draft(&self, spacing: f64) -> Result<Draft, MeshError> {
        let finest = self.finest();
        if spacing < finest {
            let what = format!("more than {} sub-voxels", self.options.max_sub_voxels);
            return Err(MeshError::TooFine { spacing, what, suggestion: finest });
        }
        let grid = Grid::around(self.lo, self.hi, spacing);
        let crossings = crossings(&grid, self.surface);
        let inside = inside(&grid, &crossings, self.surface, &self.judge);
        let sheets = sheets(&grid, self.surface, &inside.mask);
        let pieces = Pieces::new(&grid, &crossings, &inside, &sheets);
        if pieces.mask.len() > self.options.max_cells {
            let count = pieces.mask.len();
            let what = format!("{count} cells, more than {}", self.options.max_cells);
            let suggestion = spacing * (count as f64 / self.options.max_cells as f64).sqrt() * 1.05;
            return Err(MeshError::TooFine { spacing, what, suggestion });
        }
        Ok(Draft { grid, crossings, inside, pieces })
    }

    /// Looks for the spacing that gives `wanted` cells.
    fn search(&self, wanted: usize) -> Result<(Draft, usize), MeshError> {
        /// Close enough to stop: well within the promised 10 %, and less so after a few tries, as counts may jump.
        const GOOD: [f64; 2] = [0.03, 0.08];
        const TRIES: usize = 14;
        if wanted > self.options.max_cells {
            let what = format!("{wanted} cells, more than {}", self.options.max_cells);
            return Err(MeshError::TooFine { spacing: 0.0, what, suggestion: self.finest() });
        }
        let n = wanted as f64;
        // volume of cells, and half a cell more under every piece of skin: n = V/h^3 + A/2h^2; a line of cells where both vanish
        let size = (self.hi - self.lo).length();
        let expected = |h: f64| self.surface.volume / h.powi(3) + 0.5 * self.surface.area / h.powi(2) + size / h;
        let (mut fine, mut coarse) = (size * 1e-9, size * 2.0);
        for _ in 0..80 {
            let h = (fine * coarse).sqrt();
            if expected(h) > n { fine = h } else { coarse = h }
        }
        let mut h = coarse.max(self.finest());
        // known sides of the answer: (spacing, count)
        let (mut more, mut fewer): (Option<(f64, f64)>, Option<(f64, f64)>) = (None, None);
        let mut best: Option<Draft> = None;
        let mut tries = 0;
        let off = |count: usize| (count as f64 / n).ln().abs();
        while tries < TRIES {
            tries += 1;
            let draft = match self.draft(h) {
                Ok(d) => d,
                // far too many: remember the side, go on coarser
                Err(MeshError::TooFine { .. }) if h > self.finest() => {
                    more = Some((h, f64::NAN));
                    h *= 1.5;
                    continue;
                }
                Err(e) => return Err(e),
            };
            let count = draft.count();
            if best.as_ref().is_none_or(|b| off(count) < off(b.count())) {
                best = Some(draft);
            }
            if count as f64 >= n {
                more = Some((h, count as f64));
            } else {
                fewer = Some((h, count as f64));
            }
            if off(count) <= GOOD[usize::from(tries > 3)] {
                break;
            }
            h = match (more, fewer) {
                // between two sides: the power law through them, held off the ends
                (Some((a, ca)), Some((b, cb))) => {
                    let t = if cb > 0.0 && ca > cb { (ca / n).ln() / (ca / cb).ln() } else { 0.5 };
                    let t = if t.is_finite() { t.clamp(0.1, 0.9) } else { 0.5 };
                    if (b / a - 1.0).abs() < 1e-9 {
                        break;
                    }
                    a * (b / a).powf(t)
                }
                // one side only: cells grow with about the power -2.6 of the spacing
                _ if count == 0 => h * 0.5,
                _ => h * (count as f64 / n).powf(1.0 / 2.6).clamp(0.25, 4.0),
            };
            if h < self.finest() {
                let what = format!("a grid of more than {} sub-voxels", self.options.max_sub_voxels);
                return Err(MeshError::TooFine { spacing: h, what, suggestion: self.finest() });
            }
        }
        best.map(|d| (d, tries)).ok_or(MeshError::Extent { size })
    }
}

fn finish(draft: Draft, tries: usize, oriented: &Oriented) -> (VolumeMesh, LatticeReport) {
    let Draft { grid, crossings, inside, pieces } = draft;
    let solid: u64 = inside.mask.iter().map(|m| u64::from(m.count_ones())).sum();
    let sub = grid.spacing / SUB as f64;
    let (mesh, tidied) = tidy(pieces.build(&grid, &crossings, &inside), oriented);
    let (mut sheet_cells, mut split_cells) = (0, 0);
    if let Some(lattice) = &mesh.lattice {
        // the empty layer comes before voxel (0, 0, 0)
        let solid = |v: [i32; 3]| inside.mask[grid.index(v.map(|x| (x + 1) as usize))];
        sheet_cells = lattice.voxel.iter().zip(&lattice.piece).filter(|(v, p)| solid(**v) & **p == 0).count();
        split_cells = lattice.voxel.chunk_by(|a, b| a == b).filter(|c| c.len() > 1).map(<[_]>::len).sum();
    }
    let components = crate::mesh::components(&mesh).count;
    let report = LatticeReport {
        spacing: grid.spacing,
        tries,
        volume: solid as f64 * sub.powi(3),
        sheet_cells,
        split_cells,
        components,
        dropped: tidied.dropped,
        joined: tidied.joined,
        boundary_edges: oriented.boundary.len(),
    };
    (mesh, report)
}
