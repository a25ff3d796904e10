//! Bytes of the journal: records, the header, frames.

use softrig::material::{Material, MaterialMap};
use softrig::mesh::VolumeMesh;
use std::hash::Hasher;
use twox_hash::XxHash64;

/// First bytes of every journal.
pub(super) const MAGIC: [u8; 8] = *b"softrigJ";
/// Raised whenever the meaning of a byte changes.
pub(super) const VERSION: u32 = 1;
/// Bytes of magic and version.
pub(super) const PREFIX_LENGTH: u64 = 12;
/// Bytes before the payload of a record.
pub(super) const RECORD_HEAD: u64 = 20;

/// What a record is.
pub(super) mod kind {
    pub const HEADER: u32 = 1;
    pub const FRAME: u32 = 2;
    pub const CHECKPOINT: u32 = 3;
    pub const END: u32 = 4;
}

/// What a journal is about: everything but the frames.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct JournalHeader {
    /// Hash of all inputs and settings that decide the result, by the caller's own rule. Resuming compares it.
    pub input_hash: u64,
    /// Where the character came from and how it was read, in the caller's own words, so that a later `convert` finds it again.
    pub origin: String,
    /// Frames per second of the bake.
    pub fps: f64,
    /// Clock of the clip at frame 0 [s].
    pub start_time: f64,
    /// Frames a finished bake will have.
    pub frame_count: u64,
    /// Joints of the skeleton.
    pub joint_count: u32,
    /// The character's meshes.
    pub meshes: Vec<JournalMesh>,
    /// Present when frames hold the nodes of the volume mesh too.
    pub volume: Option<JournalVolume>,
}

/// One mesh of the character a journal is about.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct JournalMesh {
    /// Its name.
    pub name: String,
    /// Its vertices.
    pub vertex_count: u32,
}

/// The volume mesh whose nodes a journal holds, in its rest shape. Its lattice is not kept.
#[derive(Clone, Debug, PartialEq)]
pub struct JournalVolume {
    /// Nodes and cells.
    pub mesh: VolumeMesh,
    /// What the cells are made of, for stresses.
    pub materials: MaterialMap,
}

impl JournalHeader {
    /// Nodes in each frame.
    pub(super) fn node_count(&self) -> usize {
        self.volume.as_ref().map_or(0, |v| v.mesh.nodes.len())
    }

    /// Bytes of a frame's payload; `None` when they cannot be counted.
    pub(super) fn frame_length(&self) -> Option<u64> {
        let vertices: u64 = self.meshes.iter().map(|m| u64::from(m.vertex_count)).sum();
        let vectors = vertices.checked_add(self.node_count() as u64)?.checked_add(u64::from(self.joint_count))?;
        vectors.checked_mul(12)?.checked_add(u64::from(self.joint_count) * 96)?.checked_add(16)
    }

    /// First thing in which `other` differs, by name.
    pub(super) fn difference(&self, other: &Self) -> Option<&'static str> {
        let same = [
            (self.fps.to_bits() == other.fps.to_bits(), "frames per second"),
            (self.start_time.to_bits() == other.start_time.to_bits(), "start time"),
            (self.frame_count == other.frame_count, "number of frames"),
            (self.joint_count == other.joint_count, "number of joints"),
            (self.meshes == other.meshes, "list of meshes"),
            (self.volume.is_some() == other.volume.is_some(), "kind of output"),
            (self.node_count() == other.node_count(), "volume mesh"),
            (self.input_hash == other.input_hash, "hash of inputs and settings"),
        ];
        same.iter().find(|(same, _)| !same).map(|(_, what)| *what)
    }
}

/// A checksum over everything that makes a record.
pub(super) fn record_hasher(kind: u32, length: u64) -> XxHash64 {
    let mut hasher = XxHash64::with_seed(0);
    hasher.write(&kind.to_le_bytes());
    hasher.write(&length.to_le_bytes());
    hasher
}

/// A whole record.
pub(super) fn record(kind: u32, payload: &[u8], out: &mut Vec<u8>) {
    let mut hasher = record_hasher(kind, payload.len() as u64);
    hasher.write(payload);
    out.clear();
    out.reserve(RECORD_HEAD as usize + payload.len());
    out.extend_from_slice(&kind.to_le_bytes());
    out.extend_from_slice(&(payload.len() as u64).to_le_bytes());
    out.extend_from_slice(&hasher.finish().to_le_bytes());
    out.extend_from_slice(payload);
}

/// Reads numbers off the front of bytes; `None` past their end.
pub(super) struct Bytes<'a>(pub &'a [u8]);

impl<'a> Bytes<'a> {
    pub fn take(&mut self, n: usize) -> Option<&'a [u8]> {
        let (front, rest) = self.0.split_at_checked(n)?;
        self.0 = rest;
        Some(front)
    }

    fn array<const N: usize>(&mut self) -> Option<[u8; N]> {
        self.take(N)?.try_into().ok()
    }

    pub fn u32(&mut self) -> Option<u32> {
        self.array().map(u32::from_le_bytes)
    }

    pub fn u64(&mut self) -> Option<u64> {
        self.array().map(u64::from_le_bytes)
    }

    pub fn f32(&mut self) -> Option<f32> {
        self.array().map(f32::from_le_bytes)
    }

    pub fn f64(&mut self) -> Option<f64> {
        self.array().map(f64::from_le_bytes)
    }

    /// A count, then that many things of at least `size` bytes each: never allocates for more than there are bytes.
    fn list<T>(&mut self, size: usize, mut one: impl FnMut(&mut Self) -> Option<T>) -> Option<Vec<T>> {
        let n = self.u32()? as usize;
        if n.checked_mul(size)? > self.0.len() {
            return None;
        }
        (0..n).map(|_| one(self)).collect()
    }

    fn text(&mut self) -> Option<String> {
        let n = self.u32()? as usize;
        String::from_utf8(self.take(n)?.to_vec()).ok()
    }
}

fn put_count(n: usize, out: &mut Vec<u8>) {
    out.extend_from_slice(&u32::try_from(n).unwrap_or(u32::MAX).to_le_bytes());
}

fn put_text(s: &str, out: &mut Vec<u8>) {
    put_count(s.len(), out);
    out.extend_from_slice(s.as_bytes());
}

fn put_f64s(values: impl IntoIterator<Item = f64>, out: &mut Vec<u8>) {
    values.into_iter().for_each(|v| out.extend_from_slice(&v.to_le_bytes()));
}

fn put_u32s(values: impl IntoIterator<Item = u32>, out: &mut Vec<u8>) {
    values.into_iter().for_each(|v| out.extend_from_slice(&v.to_le_bytes()));
}

pub(super) fn encode_header(h: &JournalHeader) -> Vec<u8> {
    let mut out = Vec::new();
    out.extend_from_slice(&h.input_hash.to_le_bytes());
    put_text(&h.origin, &mut out);
    put_f64s([h.fps, h.start_time], &mut out);
    out.extend_from_slice(&h.frame_count.to_le_bytes());
    put_u32s([h.joint_count], &mut out);
    put_count(h.meshes.len(), &mut out);
    for mesh in &h.meshes {
        put_text(&mesh.name, &mut out);
        put_u32s([mesh.vertex_count], &mut out);
    }
    put_u32s([u32::from(h.volume.is_some())], &mut out);
    if let Some(JournalVolume { mesh, materials }) = &h.volume {
        put_count(mesh.nodes.len(), &mut out);
        put_f64s(mesh.nodes.iter().flatten().copied(), &mut out);
        put_count(mesh.tets.len(), &mut out);
        put_u32s(mesh.tets.iter().flatten().copied(), &mut out);
        put_count(mesh.hexes.len(), &mut out);
        put_u32s(mesh.hexes.iter().flatten().copied(), &mut out);
        put_count(mesh.region.len(), &mut out);
        put_u32s(mesh.region.iter().copied(), &mut out);
        put_count(mesh.region_names.len(), &mut out);
        mesh.region_names.iter().for_each(|s| put_text(s, &mut out));
        put_count(mesh.fill.len(), &mut out);
        put_u32s(mesh.fill.iter().map(|f| f.to_bits()), &mut out);
        put_count(materials.materials.len(), &mut out);
        for m in &materials.materials {
            put_f64s([m.young_modulus, m.poisson_ratio, m.density, m.mass_damping, m.stiffness_damping], &mut out);
        }
        put_count(materials.of_cell.len(), &mut out);
        put_u32s(materials.of_cell.iter().copied(), &mut out);
        put_count(materials.stiffness_factor.len(), &mut out);
        put_u32s(materials.stiffness_factor.iter().map(|f| f.to_bits()), &mut out);
    }
    out
}

/// The header, or why its bytes make no sense.
pub(super) fn decode_header(bytes: &[u8]) -> Result<JournalHeader, &'static str> {
    let mut b = Bytes(bytes);
    let header = read_header(&mut b).ok_or("its header is cut short or garbled")?;
    if !b.0.is_empty() {
        return Err("its header has bytes left over");
    }
    if !(header.fps.is_finite() && header.fps > 0.0 && header.start_time.is_finite()) {
        return Err("its frame rate or start time is no usable number");
    }
    if let Some(JournalVolume { mesh, materials }) = &header.volume {
        let nodes = mesh.nodes.len() as u32;
        let in_range = |n: &u32| *n < nodes;
        if !(mesh.tets.iter().flatten().all(in_range) && mesh.hexes.iter().flatten().all(in_range)) {
            return Err("its volume mesh names nodes it does not have");
        }
        if !mesh.nodes.iter().flatten().all(|v| v.is_finite()) {
            return Err("its volume mesh is not finite");
        }
        let fits = |n: usize| n == 0 || n == mesh.cell_count();
        let regions = mesh.region.iter().all(|r| (*r as usize) < mesh.region_names.len());
        let of_cell = materials.of_cell.iter().all(|m| (*m as usize) < materials.materials.len());
        let lengths = [mesh.region.len(), mesh.fill.len(), materials.of_cell.len(), materials.stiffness_factor.len()];
        if !(lengths.into_iter().all(fits) && regions && of_cell) || materials.materials.is_empty() {
            return Err("its regions or materials do not fit its volume mesh");
        }
        // what a body would refuse was never simulated
        let usable = (0..mesh.cell_count()).all(|cell| materials.get(cell).check().is_ok());
        if !(usable && mesh.fill.iter().all(|f| f.is_finite())) {
            return Err("its materials or fills are out of range");
        }
    }
    Ok(header)
}

fn read_header(b: &mut Bytes<'_>) -> Option<JournalHeader> {
    Some(JournalHeader {
        input_hash: b.u64()?,
        origin: b.text()?,
        fps: b.f64()?,
        start_time: b.f64()?,
        frame_count: b.u64()?,
        joint_count: b.u32()?,
        meshes: b.list(8, |b| Some(JournalMesh { name: b.text()?, vertex_count: b.u32()? }))?,
        volume: match b.u32()? {
            0 => None,
            1 => Some(read_volume(b)?),
            _ => return None,
        },
    })
}

fn read_volume(b: &mut Bytes<'_>) -> Option<JournalVolume> {
    fn array<T: Copy + Default, const N: usize>(mut one: impl FnMut() -> Option<T>) -> Option<[T; N]> {
        let mut out = [T::default(); N];
        for v in &mut out {
            *v = one()?;
        }
        Some(out)
    }
    let mesh = VolumeMesh {
        nodes: b.list(24, |b| array(|| b.f64()))?,
        tets: b.list(16, |b| array(|| b.u32()))?,
        hexes: b.list(32, |b| array(|| b.u32()))?,
        region: b.list(4, Bytes::u32)?,
        region_names: b.list(4, Bytes::text)?,
        fill: b.list(4, Bytes::f32)?,
        lattice: None,
    };
    let materials = b.list(40, |b| {
        Some(Material {
            young_modulus: b.f64()?,
            poisson_ratio: b.f64()?,
            density: b.f64()?,
            mass_damping: b.f64()?,
            stiffness_damping: b.f64()?,
        })
    })?;
    let materials =
        MaterialMap { materials, of_cell: b.list(4, Bytes::u32)?, stiffness_factor: b.list(4, Bytes::f32)? };
    Some(JournalVolume { mesh, materials })
}
