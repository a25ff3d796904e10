//! Volume meshes as VTU and Gmsh 4.1.

use softrig::mesh::VolumeMesh;
use std::io::{Error, ErrorKind, Result, Write};

/// Named numbers on nodes or cells.
#[derive(Clone, Copy, Debug)]
pub struct DataArray<'a> {
    /// What a viewer lists it under; with its unit, as in `von Mises stress [Pa]`.
    pub name: &'a str,
    /// Numbers per node or cell: 1, 3 for vectors, 9 for matrices.
    pub components: usize,
    /// One after the other; cells tetrahedra first.
    pub values: &'a [f64],
}

/// What goes into a VTU file besides the mesh.
#[derive(Clone, Copy, Debug, Default)]
pub struct VtuData<'a> {
    /// Positions of the nodes [m]; default: those of the mesh, its rest shape.
    pub positions: Option<&'a [[f64; 3]]>,
    /// Numbers on the nodes.
    pub point_data: &'a [DataArray<'a>],
    /// Numbers on the cells.
    pub cell_data: &'a [DataArray<'a>],
}

/// Writes a VTK XML unstructured grid: 64-bit numbers, little-endian, appended raw. Regions become a cell array `region`, the part of each
/// cell inside the skin one named `fill`.
///
/// # Errors
/// What `out` reports; [`ErrorKind::InvalidInput`], before the first byte, when an array has another length than the mesh.
pub fn write_vtu(out: &mut dyn Write, mesh: &VolumeMesh, data: &VtuData<'_>) -> Result<()> {
    let positions = data.positions.unwrap_or(&mesh.nodes);
    let (nodes, cells) = (mesh.node_count(), mesh.cell_count());
    check("positions", positions.len(), nodes)?;
    for (arrays, count) in [(data.point_data, nodes), (data.cell_data, cells)] {
        for array in arrays {
            check(array.name, array.values.len(), count * array.components)?;
        }
    }

    let mut appended = Appended::default();
    let mut xml = String::from(
        "<?xml version=\"1.0\"?>\n<VTKFile type=\"UnstructuredGrid\" version=\"1.0\" byte_order=\"LittleEndian\" header_type=\"UInt64\">\n<UnstructuredGrid>\n",
    );
    xml += &format!("<Piece NumberOfPoints=\"{nodes}\" NumberOfCells=\"{cells}\">\n<PointData>\n");
    for array in data.point_data {
        xml += &appended.floats(array.name, array.components, array.values.iter().copied());
    }
    xml += "</PointData>\n<CellData>\n";
    if mesh.region.len() == cells {
        xml += &appended.ints("region", mesh.region.iter().map(|r| i64::from(*r)));
    }
    if mesh.fill.len() == cells {
        xml += &appended.floats("fill", 1, mesh.fill.iter().map(|f| f64::from(*f)));
    }
    for array in data.cell_data {
        xml += &appended.floats(array.name, array.components, array.values.iter().copied());
    }
    xml += "</CellData>\n<Points>\n";
    xml += &appended.floats("Points", 3, positions.iter().flatten().copied());
    xml += "</Points>\n<Cells>\n";
    xml += &appended.ints("connectivity", mesh.cells().flatten().map(|n| i64::from(*n)));
    let ends = mesh.cells().scan(0, |end, cell| {
        *end += cell.len() as i64;
        Some(*end)
    });
    xml += &appended.ints("offsets", ends);
    xml += &appended.bytes("types", mesh.cells().map(|cell| if cell.len() == 4 { 10 } else { 12 }));
    xml += "</Cells>\n</Piece>\n</UnstructuredGrid>\n<AppendedData encoding=\"raw\">\n_";
    out.write_all(xml.as_bytes())?;
    out.write_all(&appended.data)?;
    out.write_all(b"\n</AppendedData>\n</VTKFile>\n")
}

fn check(name: &str, found: usize, wanted: usize) -> Result<()> {
    if found == wanted {
        return Ok(());
    }
    Err(Error::new(ErrorKind::InvalidInput, format!("`{name}` has {found} values where the mesh needs {wanted}")))
}

/// The block of raw data, and the tags that point into it.
#[derive(Default)]
struct Appended {
    data: Vec<u8>,
}

impl Appended {
    fn push(&mut self, kind: &str, name: &str, components: usize, bytes: impl FnOnce(&mut Vec<u8>)) -> String {
        let offset = self.data.len();
        self.data.extend([0; 8]);
        bytes(&mut self.data);
        let size = (self.data.len() - offset - 8) as u64;
        self.data[offset..offset + 8].copy_from_slice(&size.to_le_bytes());
        let name = name.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;");
        format!(
            "<DataArray type=\"{kind}\" Name=\"{name}\" NumberOfComponents=\"{components}\" format=\"appended\" offset=\"{offset}\"/>\n"
        )
    }

    fn floats(&mut self, name: &str, components: usize, values: impl Iterator<Item = f64>) -> String {
        self.push("Float64", name, components, |out| values.for_each(|v| out.extend(v.to_le_bytes())))
    }

    fn ints(&mut self, name: &str, values: impl Iterator<Item = i64>) -> String {
        self.push("Int64", name, 1, |out| values.for_each(|v| out.extend(v.to_le_bytes())))
    }

    fn bytes(&mut self, name: &str, values: impl Iterator<Item = u8>) -> String {
        self.push("UInt8", name, 1, |out| out.extend(values))
    }
}

/// Writes Gmsh 4.1 text; numbers are exact. Every region is a volume of its own and a physical group of the same name.
///
/// # Errors
/// What `out` reports.
pub fn write_msh41(out: &mut dyn Write, mesh: &VolumeMesh) -> Result<()> {
    let regions = mesh.region_names.len().max(1);
    let region = |cell: usize| mesh.region.get(cell).map_or(0, |r| *r as usize);
    let (lo, hi) = mesh.bounds().unwrap_or_default();
    writeln!(out, "$MeshFormat\n4.1 0 8\n$EndMeshFormat")?;
    if !mesh.region_names.is_empty() {
        writeln!(out, "$PhysicalNames\n{}", mesh.region_names.len())?;
        for (i, name) in mesh.region_names.iter().enumerate() {
            writeln!(out, "3 {} \"{}\"", i + 1, name.replace(['"', '\n', '\r'], "_"))?;
        }
        writeln!(out, "$EndPhysicalNames")?;
    }
    writeln!(out, "$Entities\n0 0 0 {regions}")?;
    for i in 1..=regions {
        let group = if mesh.region_names.is_empty() { "0".into() } else { format!("1 {i}") };
        writeln!(out, "{i} {} {} {} {} {} {} {group} 0", lo[0], lo[1], lo[2], hi[0], hi[1], hi[2])?;
    }
    let n = mesh.node_count();
    writeln!(out, "$EndEntities\n$Nodes\n1 {n} 1 {n}\n3 1 0 {n}")?;
    for label in 1..=n {
        writeln!(out, "{label}")?;
    }
    for p in &mesh.nodes {
        writeln!(out, "{} {} {}", p[0], p[1], p[2])?;
    }
    writeln!(out, "$EndNodes\n$Elements")?;
    // a block per region and kind, cells of each in order
    let mut blocks: Vec<((usize, usize), Vec<usize>)> = Vec::new();
    let mut at = std::collections::BTreeMap::new();
    for (cell, nodes) in mesh.cells().enumerate() {
        let key = (region(cell), nodes.len());
        let block = *at.entry(key).or_insert_with(|| {
            blocks.push((key, Vec::new()));
            blocks.len() - 1
        });
        blocks[block].1.push(cell);
    }
    writeln!(out, "{} {} 1 {}", blocks.len(), mesh.cell_count(), mesh.cell_count())?;
    for ((region, corners), cells) in blocks {
        let kind = if corners == 4 { 4 } else { 5 };
        writeln!(out, "3 {} {kind} {}", region + 1, cells.len())?;
        for cell in cells {
            write!(out, "{}", cell + 1)?;
            for node in mesh.cell(cell) {
                write!(out, " {}", node + 1)?;
            }
            writeln!(out)?;
        }
    }
    writeln!(out, "$EndElements")
}
