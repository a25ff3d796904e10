//! Where a surface crosses the lattice of sub-voxel centres.

use crate::mesh::orient::Oriented;
use glam::DVec3;

/// Sub-voxels along a voxel's edge.
pub(super) const SUB: usize = 4;
/// Mark of a block that the surface does not cross.
pub(super) const NONE: u32 = u32::MAX;
/// Sub-voxels that have a neighbour in the same voxel in direction +x, +y, +z; bit `x + 4 y + 16 z`.
pub(super) const HAS_NEXT: [u64; 3] = [0x7777_7777_7777_7777, 0x0fff_0fff_0fff_0fff, 0x0000_ffff_ffff_ffff];
/// Bits between neighbours in each direction.
pub(super) const STEP: [u32; 3] = [1, 4, 16];
/// Tiny, different shifts of the lattice in sub-voxels, so that faces along its planes fall clearly on one side.
const NUDGE: DVec3 = DVec3::new(1.3e-5, 1.7e-5, 2.1e-5);
/// How much later an exit counts than an entry [sub-voxels]: faces closer than this touch.
const TOUCH: f64 = 1e-4;

/// Voxels over the bounding box, with one empty layer around them.
#[derive(Clone, Debug)]
pub(super) struct Grid {
    /// Corner of the first voxel of the empty layer [m].
    pub origin: DVec3,
    /// Edge of a voxel [m].
    pub spacing: f64,
    /// Voxels along each axis, the empty layer included.
    pub size: [usize; 3],
}

impl Grid {
    /// Centres the lattice on a box.
    pub fn around(lo: DVec3, hi: DVec3, spacing: f64) -> Self {
        // a box that is a whole number of voxels long gets no more for rounding
        let size = (hi - lo).to_array().map(|s| ((s / spacing - 1e-6).ceil().max(1.0)) as usize + 2);
        let half = DVec3::new(size[0] as f64, size[1] as f64, size[2] as f64) * (spacing * 0.5);
        Self { origin: (lo + hi) * 0.5 - half, spacing, size }
    }

    pub fn voxel_count(&self) -> usize {
        self.size.iter().product()
    }

    pub fn index(&self, voxel: [usize; 3]) -> usize {
        voxel[0] + self.size[0] * (voxel[1] + self.size[1] * voxel[2])
    }

    pub fn voxel(&self, index: usize) -> [usize; 3] {
        let (plane, z) = (index % (self.size[0] * self.size[1]), index / (self.size[0] * self.size[1]));
        [plane % self.size[0], plane / self.size[0], z]
    }

    /// Distance in `index` between neighbours in each direction.
    pub fn stride(&self) -> [usize; 3] {
        [1, self.size[0], self.size[0] * self.size[1]]
    }

    /// Voxel and bit of a sub-voxel.
    pub fn sub(&self, s: [usize; 3]) -> (usize, u32) {
        (self.index(s.map(|x| x / SUB)), (s[0] % SUB + SUB * (s[1] % SUB) + SUB * SUB * (s[2] % SUB)) as u32)
    }

    /// The sub-voxel that holds a point, held to the lattice.
    pub fn sub_of(&self, p: DVec3) -> [usize; 3] {
        let q = (p - self.origin) * (SUB as f64 / self.spacing) + NUDGE;
        let n = self.size;
        std::array::from_fn(|k| (q[k].max(0.0) as usize).min(n[k] * SUB - 1))
    }

    /// Centre of a sub-voxel of a voxel [m].
    pub fn centre(&self, voxel: usize, bit: u32) -> DVec3 {
        let v = self.voxel(voxel);
        let part = [bit % 4, bit / 4 % 4, bit / 16];
        let q: [f64; 3] = std::array::from_fn(|k| (v[k] * SUB) as f64 + f64::from(part[k]) + 0.5);
        self.origin + (DVec3::from(q) - NUDGE) * (self.spacing / SUB as f64)
    }
}

/// What the surface does in one voxel. Bit i of a mask speaks of the link from sub-voxel i to its next in that direction,
/// which may lie in the next voxel.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Walls {
    /// Crossed at least once.
    pub crossed: [u64; 3],
    /// Crossed out and in again: what is at the two ends does not touch there.
    pub gap: [u64; 3],
}

/// Walls of all voxels that have any.
pub(super) struct Crossings {
    /// Index into `walls` for each voxel, or [`NONE`].
    pub slot: Vec<u32>,
    pub walls: Vec<Walls>,
}

impl Crossings {
    pub fn walls(&self, voxel: usize) -> Walls {
        match self.slot[voxel] {
            NONE => Walls::default(),
            s => self.walls[s as usize],
        }
    }
}

/// One crossing of a line of sub-voxel centres.
#[derive(Clone, Copy)]
struct Event {
    line: u32,
    /// Where along the line, sub-voxel centres at whole numbers.
    at: f64,
    /// +1: into the inside, -1: out of it.
    sign: i8,
}

/// Finds all links that the surface crosses.
pub(super) fn crossings(grid: &Grid, surface: &Oriented) -> Crossings {
    let scale = SUB as f64 / grid.spacing;
    let points: Vec<DVec3> =
        surface.positions.iter().map(|p| (*p - grid.origin) * scale + NUDGE - DVec3::splat(0.5)).collect();
    let scan = |axis: usize| line_walls(grid, axis, &events(grid, axis, &points, &surface.triangles));
    let (x, (y, z)) = rayon::join(|| scan(0), || rayon::join(|| scan(1), || scan(2)));
    let mut out = Crossings { slot: vec![NONE; grid.voxel_count()], walls: Vec::new() };
    for (axis, list) in [x, y, z].into_iter().enumerate() {
        for (voxel, bit, gap) in list {
            let slot = &mut out.slot[voxel as usize];
            if *slot == NONE {
                *slot = out.walls.len() as u32;
                out.walls.push(Walls::default());
            }
            let walls = &mut out.walls[*slot as usize];
            walls.crossed[axis] |= 1 << bit;
            walls.gap[axis] |= u64::from(gap) << bit;
        }
    }
    out
}

/// Crossings of the lines along one axis, sorted by line and then along it.
fn events(grid: &Grid, axis: usize, points: &[DVec3], triangles: &[[u32; 3]]) -> Vec<Event> {
    let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
    let lines = [(grid.size[u] * SUB) as f64, (grid.size[v] * SUB) as f64];
    let mut out = Vec::new();
    for t in triangles {
        let p = t.map(|i| points[i as usize]);
        // triangle seen along the axis
        let q = p.map(|p| [p[u], p[v]]);
        let area = (q[1][0] - q[0][0]) * (q[2][1] - q[0][1]) - (q[1][1] - q[0][1]) * (q[2][0] - q[0][0]);
        if area == 0.0 {
            continue;
        }
        let range = |k: usize| {
            let lo = q[0][k].min(q[1][k]).min(q[2][k]);
            let hi = q[0][k].max(q[1][k]).max(q[2][k]);
            ((lo - 1e-9).ceil().max(0.0), (hi + 1e-9).floor().min(lines[k] - 1.0))
        };
        let ((u0, u1), (v0, v1)) = (range(0), range(1));
        let longest = (0..3).map(|k| (q[k][0] - q[(k + 1) % 3][0]).abs() + (q[k][1] - q[(k + 1) % 3][1]).abs());
        // lines through an edge hit both its triangles: a crossing found twice is harmless, a missed one is a leak
        let slack = 1e-9 * longest.fold(1.0, f64::max);
        let side = if area > 0.0 { 1.0 } else { -1.0 };
        let (plo, phi) = (p[0][axis].min(p[1][axis]).min(p[2][axis]), p[0][axis].max(p[1][axis]).max(p[2][axis]));
        let mut b = v0;
        while b <= v1 {
            let mut a = u0;
            while a <= u1 {
                let edge = |k: usize| {
                    let (s, e) = (q[k], q[(k + 1) % 3]);
                    (e[0] - s[0]) * (b - s[1]) - (e[1] - s[1]) * (a - s[0])
                };
                let w = [edge(1), edge(2), edge(0)];
                if w.iter().all(|w| w * side >= -slack) {
                    let at = (w[0] * p[0][axis] + w[1] * p[1][axis] + w[2] * p[2][axis]) / area;
                    out.push(Event {
                        line: (b * lines[0] + a) as u32,
                        at: at.clamp(plo, phi),
                        // the outward normal points against the line where the line enters
                        sign: if area > 0.0 { -1 } else { 1 },
                    });
                }
                a += 1.0;
            }
            b += 1.0;
        }
    }
    let key = |e: &Event| e.at + if e.sign < 0 { TOUCH } else { 0.0 };
    out.sort_unstable_by(|a, b| a.line.cmp(&b.line).then(key(a).total_cmp(&key(b))).then(a.sign.cmp(&b.sign)));
    out
}

/// Voxel, bit and whether there is a gap, for each crossed link.
fn line_walls(grid: &Grid, axis: usize, events: &[Event]) -> Vec<(u32, u8, bool)> {
    let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
    let width = (grid.size[u] * SUB) as u32;
    let mut out = Vec::new();
    for link in events.chunk_by(|a, b| a.line == b.line && a.at.floor() == b.at.floor()) {
        let mut s = [0; 3];
        s[u] = (link[0].line % width) as usize;
        s[v] = (link[0].line / width) as usize;
        s[axis] = (link[0].at.floor().max(0.0) as usize).min(grid.size[axis] * SUB - 1);
        let (mut level, mut lowest) = (0, 0);
        for e in link {
            level += i32::from(e.sign);
            lowest = lowest.min(level);
        }
        let (voxel, bit) = grid.sub(s);
        // a single way out of the inside into the inside is a sheet within the material, not a gap
        out.push((voxel as u32, bit as u8, lowest < 0 && level >= 0));
    }
    out
}
