//! Volume meshes of all formats, and that what is written reads back the same.

use crate::shared::data;
use softrig::mesh::VolumeMesh;
use softrig_io::volume::{self, DataArray, VolumeFormat, VtuData, write_msh41, write_vtu};
use std::path::Path;

/// Nodes, tetrahedra, hexahedra and regions of the sample files (the table of the data's README).
const COUNTS: [(&str, usize, usize, usize, &[&str]); 20] = [
    ("bar-14114.msh", 3_842, 14_114, 0, &[]),
    ("beam3.veg", 208, 0, 75, &["BODY"]),
    ("beam3_tet.veg", 208, 450, 0, &["BODY"]),
    ("beam_hex_and_tet.mesh", 32, 12, 5, &["2", "1"]),
    ("block_hex.mesh", 525, 0, 320, &[]),
    ("cube_hex8_8.msh", 27, 0, 8, &[]),
    ("cylinder_8x30x6.msh", 1_446, 6_750, 0, &["1"]),
    ("elbow.mesh", 1_823, 8_161, 0, &["6"]),
    ("hexbeam.vtk", 99, 0, 40, &[]),
    ("simpleBridge_hex.veg", 3_923, 0, 1_736, &["EL"]),
    ("sphere.msh", 1_760, 6_851, 0, &[]),
    ("sphere_tet4_593.msh", 183, 593, 0, &["1"]),
    ("stanford/Armadillo_Tetra_4406.vtu", 1_446, 4_406, 0, &[]),
    ("stanford/asianDragon.veg", 959, 2_591, 0, &["BODY"]),
    ("stanford/bunny_igl.mesh", 5_433, 34_055, 0, &[]),
    ("stanford/bunny_v41.msh", 4_670, 19_379, 0, &[]),
    ("stanford/dragon_67k.node", 17_632, 66_696, 0, &[]),
    ("stanford/dragon_67k_v22bin.msh", 17_632, 66_696, 0, &[]),
    ("tire.vtk", 1_430, 4_111, 0, &[]),
    ("turtle/turtle-volumetric-heterogeneous.veg", 347, 1_185, 0, &["softMaterial", "hardMaterial"]),
];

fn read(name: &str) -> Option<VolumeMesh> {
    let path = data()?.file(format!("volumes/{name}"));
    Some(volume::read(&path).unwrap_or_else(|e| panic!("{e}")))
}

fn volume_of(mesh: &VolumeMesh, tet: [u32; 4]) -> f64 {
    let p = tet.map(|n| mesh.nodes[n as usize]);
    let e = |k: usize| [p[k][0] - p[0][0], p[k][1] - p[0][1], p[k][2] - p[0][2]];
    let (a, b, c) = (e(1), e(2), e(3));
    ((a[1] * b[2] - a[2] * b[1]) * c[0] + (a[2] * b[0] - a[0] * b[2]) * c[1] + (a[0] * b[1] - a[1] * b[0]) * c[2]) / 6.0
}

#[test]
fn every_volume_has_the_counts_of_the_table() {
    let Some(folder) = data() else { return };
    for (name, nodes, tets, hexes, regions) in COUNTS {
        let Some(mesh) = read(name) else { return };
        assert_eq!((mesh.nodes.len(), mesh.tets.len(), mesh.hexes.len()), (nodes, tets, hexes), "{name}");
        assert_eq!(mesh.region_names, regions, "{name}");
        assert_eq!(mesh.region.len(), if regions.is_empty() { 0 } else { tets + hexes }, "{name}");
    }
    let mut found = folder.files("volumes", &["node", "msh", "mesh", "veg", "vtk", "vtu"]);
    found.retain(|f| VolumeFormat::of(f).is_some());
    assert_eq!(found.len(), COUNTS.len(), "{found:?}");
}

/// A wrong order of nodes shows in volumes: the sum over cells is the volume of known shapes, and hexahedra are boxes of known size.
#[test]
fn cells_fill_the_shapes_they_should() {
    let Some(bar) = read("bar-14114.msh") else { return };
    let sum = |m: &VolumeMesh| m.tets.iter().map(|t| volume_of(m, *t)).sum::<f64>();
    assert!((sum(&bar) - 5.0).abs() < 1e-9, "10 x 0.5 x 1: {}", sum(&bar));
    assert!((sum(&read("beam3_tet.veg").unwrap()) - 0.12 * 0.04).abs() < 1e-9);
    let ball = sum(&read("sphere.msh").unwrap());
    assert!((0.97..1.0).contains(&(ball / (4.0 / 3.0 * std::f64::consts::PI * 0.125))), "{ball}");
    for (name, total) in [
        ("block_hex.mesh", 40.0),
        ("cube_hex8_8.msh", 1.0),
        ("hexbeam.vtk", 5.0),
        ("beam3.veg", 0.12 * 0.04),
        ("simpleBridge_hex.veg", 1_736.0 * 0.251_086_956_521_739f64.powi(3)),
    ] {
        let mesh = read(name).unwrap();
        // corner 0 and its three neighbours span a sixth of a box, right-handed
        let boxes: f64 = mesh.hexes.iter().map(|h| 6.0 * volume_of(&mesh, [h[0], h[1], h[3], h[4]])).sum();
        assert!((boxes / total - 1.0).abs() < 1e-6, "{name}: {boxes} instead of {total}");
    }
}

/// The two sample files with cells inside out: all twelve tetrahedra of one, one of six of the other.
#[test]
fn inverted_cells_are_turned_over_and_counted() {
    let Some(folder) = data() else { return };
    for (name, flipped, mixed) in
        [("volumes/beam_hex_and_tet.mesh", 12, true), ("bad/6_tetra_bad.msh", 1, true), ("volumes/tire.vtk", 0, false)]
    {
        let (mesh, report) = volume::read_checked(&folder.file(name)).unwrap();
        assert_eq!((report.flipped, report.mixed_orientation), (flipped, mixed), "{name}");
        assert!(mesh.tets.iter().all(|t| volume_of(&mesh, *t) > 0.0), "{name}");
    }
}

#[test]
fn one_mesh_in_two_formats_is_the_same() {
    let (Some(text), Some(binary)) = (read("stanford/dragon_67k.ele"), read("stanford/dragon_67k_v22bin.msh")) else {
        return;
    };
    assert!(text.tets == binary.tets);
    // the text has nine digits
    let apart = text.nodes.iter().flatten().zip(binary.nodes.iter().flatten()).map(|(a, b)| (a - b).abs());
    assert!(apart.fold(0.0, f64::max) < 1e-8);
}

#[test]
fn materials_of_the_turtle_follow_its_included_lists() {
    let Some(mesh) = read("turtle/turtle-volumetric-heterogeneous.veg") else { return };
    let folder = data().unwrap();
    let hard = mesh.region_names.iter().position(|n| n == "hardMaterial").unwrap() as u32;
    let list = std::fs::read_to_string(folder.file("volumes/turtle/shellElementList.txt")).unwrap();
    let shell: Vec<usize> = list.split([',', '\n', '\r']).filter_map(|w| w.trim().parse().ok()).collect();
    assert!(shell.len() > 50);
    for (cell, region) in mesh.region.iter().enumerate() {
        assert_eq!(*region == hard, shell.contains(&(cell + 1)), "element {}", cell + 1);
    }
}

fn cube_and_tet() -> VolumeMesh {
    let mut nodes: Vec<[f64; 3]> =
        [0, 1, 3, 2, 4, 5, 7, 6].map(|i| [(i & 1) as f64, (i >> 1 & 1) as f64, (i >> 2) as f64 / 3.0]).to_vec();
    nodes.push([2.0, 0.0, 1e-17]);
    VolumeMesh {
        nodes,
        tets: vec![[1, 8, 2, 5]],
        hexes: vec![[0, 1, 2, 3, 4, 5, 6, 7]],
        region: vec![1, 0],
        region_names: vec!["soft".into(), "hard \"one\"".into()],
        fill: vec![0.25, 1.0],
        ..VolumeMesh::default()
    }
}

fn none(_: &str) -> Result<Vec<u8>, softrig_io::ImportError> {
    panic!("nothing is included")
}

#[test]
fn what_is_written_reads_back_exactly() {
    let mesh = cube_and_tet();
    let mut msh = Vec::new();
    write_msh41(&mut msh, &mesh).unwrap();
    let back = volume::from_bytes(&msh, Path::new("a.msh"), VolumeFormat::Gmsh, &mut none).unwrap();
    // regions come back in order of first use, names without quotes
    assert_eq!((&back.nodes, &back.tets, &back.hexes), (&mesh.nodes, &mesh.tets, &mesh.hexes));
    assert_eq!((back.region, back.region_names), (vec![0, 1], vec!["hard _one_".to_string(), "soft".into()]));

    let moved: Vec<[f64; 3]> = mesh.nodes.iter().map(|p| p.map(|v| v + 0.1)).collect();
    let stress = [1.5, f64::NAN];
    let data = VtuData {
        positions: Some(&moved),
        cell_data: &[DataArray { name: "stress <von Mises> [Pa]", components: 1, values: &stress }],
        ..VtuData::default()
    };
    let mut vtu = Vec::new();
    write_vtu(&mut vtu, &mesh, &data).unwrap();
    let back = volume::from_bytes(&vtu, Path::new("a.vtu"), VolumeFormat::Vtu, &mut none).unwrap();
    assert_eq!((&back.nodes, &back.tets, &back.hexes), (&moved, &mesh.tets, &mesh.hexes));
    assert!(String::from_utf8_lossy(&vtu).contains("Name=\"fill\""));

    let short =
        VtuData { point_data: &[DataArray { name: "u", components: 3, values: &stress }], ..VtuData::default() };
    let mut nothing = Vec::new();
    assert!(write_vtu(&mut nothing, &mesh, &short).unwrap_err().to_string().contains("`u` has 2 values"));
    assert!(nothing.is_empty());
}

/// Where a file of the sample folders covers a way of writing, no copy of it is needed here: these are the ways none of them uses.
#[test]
fn rare_encodings_read_as_the_common_ones() {
    // Gmsh 4.1 binary, big-endian
    let mut msh = b"$MeshFormat\n4.1 1 8\n".to_vec();
    msh.extend(1i32.to_be_bytes());
    msh.extend(b"\n$EndMeshFormat\n$Nodes\n");
    [1i64, 4, 10, 40].iter().for_each(|v| msh.extend(v.to_be_bytes()));
    [3i32, 1, 0].iter().for_each(|v| msh.extend(v.to_be_bytes()));
    [4i64, 10, 20, 30, 40].iter().for_each(|v| msh.extend(v.to_be_bytes()));
    for p in [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0f64]] {
        p.iter().for_each(|v| msh.extend(v.to_be_bytes()));
    }
    msh.extend(b"\n$EndNodes\n$Elements\n");
    [2i64, 2, 1, 2].iter().for_each(|v| msh.extend(v.to_be_bytes()));
    [2i32, 7, 2].iter().for_each(|v| msh.extend(v.to_be_bytes()));
    [1i64, 1, 10, 20, 30].iter().for_each(|v| msh.extend(v.to_be_bytes()));
    [3i32, 9, 4].iter().for_each(|v| msh.extend(v.to_be_bytes()));
    [1i64, 2, 10, 20, 30, 40].iter().for_each(|v| msh.extend(v.to_be_bytes()));
    msh.extend(b"\n$EndElements\n");
    let mesh = volume::from_bytes(&msh, Path::new("a.msh"), VolumeFormat::Gmsh, &mut none).unwrap();
    assert_eq!((mesh.tets, mesh.region_names), (vec![[0, 1, 2, 3]], vec!["9".to_string()]));

    // VTK 5.1 with separate offsets and a voxel
    let vtk = "# vtk DataFile Version 5.1\nx\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS 8 float\n\
        0 0 0 1 0 0 0 1 0 1 1 0 0 0 1 1 0 1 0 1 1 1 1 1\nMETADATA\nINFORMATION 0\n\nCELLS 2 8\nOFFSETS vtktypeint64\n0 8\n\
        CONNECTIVITY vtktypeint64\n0 1 2 3 4 5 6 7\nCELL_TYPES 1\n11\n";
    let mesh = volume::from_bytes(vtk.as_bytes(), Path::new("a.vtk"), VolumeFormat::Vtk, &mut none).unwrap();
    assert_eq!(mesh.hexes, [[0, 1, 3, 2, 4, 5, 7, 6]]);

    // quadratic cells and prisms would leave holes
    for kind in [11, 6] {
        let text =
            format!("$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Elements\n1\n1 {kind} 2 0 0 1 2 3 4 5 6\n$EndElements\n");
        let e = volume::from_bytes(text.as_bytes(), Path::new("a.msh"), VolumeFormat::Gmsh, &mut none).unwrap_err();
        assert!(e.to_string().contains("export first-order cells"), "{e}");
    }
}

/// The user gave one file: the message names that one, the one that is not there, and what to do.
#[test]
fn a_file_that_is_missing_beside_another_is_named_with_the_one_that_needs_it() {
    let folder = tempfile::tempdir().unwrap();
    for (name, text, missing) in [
        ("a.ele", "1 4 0\n1 1 2 3 4\n", "a.node"),
        ("a.veg", "*VERTICES\n*INCLUDE nodes.txt\n", "nodes.txt"),
        ("a.veg", "*VERTICES\n*INCLUDE .\n", "."),
    ] {
        let path = folder.path().join(name);
        std::fs::write(&path, text).unwrap();
        let e = volume::read(&path).unwrap_err();
        let message = e.to_string();
        assert!(message.contains(name) && message.contains(&format!("`{missing}`")), "{message}");
        assert!(message.contains("one folder") && !e.is_machine_fault(), "{message}");
    }
}

#[test]
fn an_include_outside_of_the_folder_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.veg");
    for name in ["../secret.txt", "/etc/passwd", ""] {
        std::fs::write(&path, format!("*VERTICES\n*INCLUDE {name}\n")).unwrap();
        let e = volume::read(&path).unwrap_err().to_string();
        assert!(e.contains("not below its own folder"), "{e}");
    }
}
