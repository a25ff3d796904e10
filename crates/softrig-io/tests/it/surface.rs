//! OBJ, PLY and STL files as people have them.

use crate::shared::data;
use softrig::character::{Character, Skin};
use softrig_io::{ImportOptions, UpAxis, import};

/// Vertices and triangles as counted by an independent program (the table of the data's README; polygons count as fans).
const COUNTS: [(&str, usize, usize); 12] = [
    ("surfaces/cat.obj", 7_949, 15_894),
    ("surfaces/hand_closed.obj", 7_993, 15_982),
    ("surfaces/spot.obj", 11_533, 23_062),
    ("surfaces/spot_control_mesh.obj", 188, 2 * 160 + 3 * 16 + 4),
    ("surfaces/stanford/armadillo.obj", 14_587, 29_170),
    ("surfaces/stanford/asianDragon.obj", 25_002, 50_000),
    ("surfaces/stanford/bunny.obj", 3_301, 6_598),
    ("volumes/turtle/turtle.obj", 1_961, 2 * 1_770 + 114),
    ("characters/makehuman/base.obj", 19_158, 2 * 18_486),
    ("bad/cloth100.obj", 10_201, 20_000),
    ("bad/cycloidal.ply", 21_384, 43_368),
    ("bad/wallhole.obj", 92, 66),
];

fn read(path: &str) -> Option<Character> {
    let path = data()?.file(path);
    Some(import(&path, &ImportOptions::default()).unwrap_or_else(|e| panic!("{e}")))
}

#[test]
fn every_surface_has_the_counts_of_the_table() {
    for (path, vertices, triangles) in COUNTS {
        let Some(character) = read(path) else { return };
        let mesh = &character.meshes[0];
        assert_eq!((mesh.positions.len(), mesh.triangles.len()), (vertices, triangles), "{path}");
        assert_eq!((&mesh.skin, character.skeleton.joint_count()), (&Skin::Free, 0), "{path}");
        assert!(mesh.look.is_empty() || mesh.look.len() == triangles, "{path}");
        assert!(mesh.texture_coordinates.is_empty() || mesh.texture_coordinates.len() == vertices, "{path}");
        let size = character.surface(false).bounds().unwrap();
        let largest = (0..3).map(|k| size.1[k] - size.0[k]).fold(0.0, f64::max);
        assert!((0.3..=3.5).contains(&largest), "{path}: {largest} m, {:?}", character.notes);
        assert!(!character.notes.is_empty(), "{path}: the guessed unit is not said");
    }
}

/// The caches that come out later are useless if the order of the vertices is not the file's: compared with the `v` lines, read plainly here.
#[test]
fn vertices_keep_the_order_of_the_file() {
    for path in ["characters/makehuman/base.obj", "bad/rabbit.obj", "bad/chair_model.obj", "surfaces/spot.obj"] {
        let Some(folder) = data() else { return };
        let options = ImportOptions { unit: Some(1.0), up: Some(UpAxis::Y), ..ImportOptions::default() };
        let character = import(&folder.file(path), &options).unwrap();
        let text = String::from_utf8_lossy(&std::fs::read(folder.file(path)).unwrap()).into_owned();
        let expected: Vec<Vec<f64>> = text
            .lines()
            .filter_map(|l| l.strip_prefix("v "))
            .map(|l| l.split_whitespace().take(3).map(|w| w.parse().unwrap()).collect())
            .collect();
        let got: Vec<Vec<f64>> = character.meshes[0].positions.iter().map(|p| p.to_vec()).collect();
        assert!(expected.len() > 600 && got == expected, "{path}");
    }
}

#[test]
fn groups_of_the_makehuman_base_mesh_are_kept() {
    let Some(character) = read("characters/makehuman/base.obj") else { return };
    let groups = &character.meshes[0].groups;
    let body = &groups.iter().find(|g| g.0 == "body").unwrap().1;
    assert_eq!(groups.iter().filter(|g| g.0.starts_with("joint-")).count(), 125);
    assert_eq!(groups.iter().filter(|g| g.0.starts_with("helper-")).count(), 13);
    assert!(body.iter().filter(|w| **w > 0.0).count() > 10_000);
    assert!((character.height() - 1.69).abs() < 0.01, "decimetres: {} m, {:?}", character.height(), character.notes);
}

#[test]
fn scanned_colors_of_a_ply_are_read() {
    let Some(character) = read("bad/cycloidal.ply") else { return };
    assert_eq!(character.meshes[0].colors.len(), 21_384);
}

#[test]
fn the_height_the_user_says_is_the_height_that_comes_out() {
    let Some(folder) = data() else { return };
    let options = ImportOptions { height: Some(1.25), ..ImportOptions::default() };
    let character = import(&folder.file("surfaces/spot.obj"), &options).unwrap();
    assert!((character.height() - 1.25).abs() < 1e-12);
}
