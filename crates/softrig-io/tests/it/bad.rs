//! Input that is ugly, broken or cut short: every file works or is refused with one clear message.

use crate::shared::data;
use softrig_io::volume::{self, VolumeFormat};
use softrig_io::{ImportError, ImportOptions, import};
use std::path::Path;
use std::time::{Duration, Instant};

/// What becomes of a bad file.
enum Outcome {
    /// Ugly geometry is still geometry.
    Works,
    /// Refused because: a part of the message.
    Refused(&'static str),
}
use Outcome::{Refused, Works};

const SURFACES: [(&str, Outcome); 13] = [
    ("chair_model.obj", Works),
    ("cloth100.obj", Works),
    ("cycloidal.ply", Works),
    ("demosthenes_scan_open.obj", Works),
    ("human_neutral_eyes.obj", Works),
    ("joined_tetrahedra.obj", Works),
    ("multibody.stl", Works),
    ("negative_indices.obj", Works),
    // the face with two corners is left out and said, the triangle stays
    ("notenoughindices.obj", Works),
    ("rabbit.obj", Works),
    ("soup.stl", Works),
    ("teapot.stl", Works),
    ("wallhole.obj", Works),
];

const GLTF: [(&str, Outcome); 7] = [
    ("BoxWithInfinites.glb", Refused("has no finite position")),
    ("IndexOutOfRange.gltf", Refused("but there are")),
    ("RecursiveNodes.gltf", Refused("must be a tree")),
    ("integer-out-of-bounds.gltf", Refused("1e+300")),
    // no node shows the mesh that names what does not exist
    ("invalid-buffer-index.gltf", Refused("no node of its scene shows a mesh")),
    ("invalid-primitive-indices.gltf", Refused("no node of its scene shows a mesh")),
    // one inverse bind matrix is garbage: replaced and said
    ("unassigned-skeleton.gltf", Works),
];

fn check(path: &Path, expected: &Outcome, result: Result<(), ImportError>) {
    match (expected, result) {
        (Works, Ok(())) => {}
        (Works, Err(e)) => panic!("{} should work: {e}", path.display()),
        (Refused(because), Err(e)) => {
            let message = e.to_string();
            assert!(message.contains(because), "{message}");
            assert!(message.contains(&*path.file_name().unwrap().to_string_lossy()), "names no file: {message}");
            assert!(!message.contains('\n'), "not one line: {message}");
        }
        (Refused(because), Ok(())) => panic!("{} should be refused: {because}", path.display()),
    }
}

#[test]
fn every_bad_surface_works_or_is_refused_as_the_table_says() {
    let Some(folder) = data() else { return };
    for (name, expected) in &SURFACES {
        let path = folder.file(format!("bad/{name}"));
        check(&path, expected, import(&path, &ImportOptions::default()).map(|_| ()));
    }
    // no file of the folder is forgotten
    let found = folder.files("bad", &["obj", "ply", "stl"]);
    assert_eq!(found.len(), SURFACES.len(), "{found:?}");
}

const VOLUMES: [(&str, Outcome); 2] = [
    // six tetrahedra, one of them inside out: reading does not judge shapes
    ("6_tetra_bad.msh", Works),
    ("Armadillo_Tetra_4406_broken.vtu", Refused("the piece says 1445 points, but has 4338 coordinates")),
];

#[test]
fn every_bad_volume_works_or_is_refused_as_the_table_says() {
    let Some(folder) = data() else { return };
    for (name, expected) in &VOLUMES {
        let path = folder.file(format!("bad/{name}"));
        check(&path, expected, volume::read(&path).map(|_| ()));
    }
    let found = folder.files("bad", &["node", "ele", "msh", "mesh", "veg", "vtk", "vtu"]);
    assert_eq!(found.len(), VOLUMES.len(), "{found:?}");
}

#[test]
fn volumes_cut_anywhere_end_in_a_value_or_an_error() {
    let Some(folder) = data() else { return };
    for path in folder.files("volumes", &["node", "ele", "msh", "mesh", "veg", "vtk", "vtu"]) {
        // what it includes or belongs to stays whole
        let mut beside = |name: &str| {
            let file = path.with_file_name(name);
            std::fs::read(&file).map_err(|source| ImportError::Io { file, source })
        };
        let format = VolumeFormat::of(&path).unwrap();
        let mut refused = 0;
        cut(&path, |bytes| {
            let result = volume::from_bytes(bytes, &path, format, &mut beside).map(|mesh| {
                assert!(mesh.cells().flatten().all(|n| (*n as usize) < mesh.node_count()));
            });
            refused += usize::from(result.is_err());
            result
        });
        assert!(refused > 0, "{}: nothing was cut", path.display());
    }
}

#[test]
fn every_bad_gltf_works_or_is_refused_as_the_table_says() {
    let Some(folder) = data() else { return };
    for (name, expected) in &GLTF {
        let path = folder.file(format!("bad/gltf/{name}"));
        check(&path, expected, import(&path, &ImportOptions::default()).map(|_| ()));
    }
    let found = folder.files("bad/gltf", &["glb", "gltf"]);
    assert_eq!(found.len(), GLTF.len(), "{found:?}");
}

#[test]
fn what_was_left_out_is_said() {
    let Some(folder) = data() else { return };
    let character = import(&folder.file("bad/notenoughindices.obj"), &ImportOptions::default()).unwrap();
    assert_eq!(character.meshes[0].triangles, [[0, 1, 2]]);
    assert!(
        character.notes.iter().any(|n| n.contains("1 faces with fewer than three corners")),
        "{:?}",
        character.notes
    );
}

/// Runs `read` on 200 evenly spaced prefixes of a file: each ends in a value or in one line that names the file, and none takes
/// more than 2 s.
pub fn cut(path: &Path, mut read: impl FnMut(&[u8]) -> Result<(), ImportError>) {
    let bytes = std::fs::read(path).unwrap();
    let name = path.file_name().unwrap().to_string_lossy();
    for k in 0..200 {
        let start = Instant::now();
        let result = read(&bytes[..bytes.len() * k / 200]);
        assert!(start.elapsed() < Duration::from_secs(2), "{} cut at {k}/200 is slow", path.display());
        if let Err(e) = result {
            let message = e.to_string();
            assert!(message.contains(&*name) && !message.contains('\n'), "{name} cut at {k}/200: {message}");
        }
    }
}

#[test]
fn surfaces_cut_anywhere_end_in_a_value_or_an_error() {
    use softrig_io::surface::{SurfaceFormat, from_bytes};
    let Some(folder) = data() else { return };
    let mut paths = folder.files("surfaces", &["obj"]);
    paths.extend(folder.files("bad", &["obj", "ply", "stl"]));
    paths.extend(["characters/makehuman/base.obj", "volumes/turtle/turtle.obj"].map(|f| folder.file(f)));
    for path in paths {
        let format = match path.extension().unwrap().to_str().unwrap() {
            "obj" => SurfaceFormat::Obj,
            "ply" => SurfaceFormat::Ply,
            _ => SurfaceFormat::Stl,
        };
        cut(&path, |bytes| {
            from_bytes(bytes, &path, format, &ImportOptions::default()).map(|character| {
                let mesh = &character.meshes[0];
                assert!(mesh.triangles.iter().flatten().all(|v| (*v as usize) < mesh.positions.len()));
                assert!(mesh.positions.iter().flatten().all(|v| v.is_finite()));
            })
        });
    }
}
