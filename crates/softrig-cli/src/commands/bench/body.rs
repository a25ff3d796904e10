//! The standard bodies: a bar made here, so that the command needs no files, and a cow of tetrahedra that is read.

use crate::failure::Failure;
use softrig::mesh::{CellKind, VolumeMesh};
use std::path::Path;
use std::str::FromStr;

/// A volume mesh and where it is clamped.
pub struct BenchBody {
    /// What it is called on the command line.
    pub name: &'static str,
    /// Its rest shape.
    pub mesh: VolumeMesh,
    /// Which nodes do not move.
    pub fixed: Vec<bool>,
    /// The nodes whose mean displacement tells whether the motion is right: the bar's free end, the cow's head.
    pub tip: Vec<usize>,
}

/// Names of the bodies.
pub const NAMES: [&str; 2] = ["bar", "cow"];

/// The body of that name; files are looked for in `shared/bench`.
///
/// # Errors
/// [`Failure::Usage`] for a name that is no body, [`Failure::Input`] for files that are missing or damaged.
pub fn load(name: &str, shared: &Path) -> Result<BenchBody, Failure> {
    match name {
        "bar" => Ok(bar([32, 8, 16])),
        "cow" => cow(&shared.join("bench")),
        _ => Err(Failure::Usage(format!("there is no benchmark body `{name}`; there are {}", NAMES.join(", ")))),
    }
}

/// A bar 0.4 m long, clamped at x = 0, of cubes cut into six tetrahedra each along the paths from corner to corner.
pub fn bar(cubes: [usize; 3]) -> BenchBody {
    let spacing = 0.4 / cubes[0] as f64;
    let mesh = softrig::mesh::bar(cubes, cubes.map(|n| n as f64 * spacing), CellKind::Tet4);
    let nodes = &mesh.nodes;
    let fixed = nodes.iter().map(|x| x[0] == 0.0).collect();
    let end = nodes[nodes.len() - 1][0];
    let tip = (0..nodes.len()).filter(|i| nodes[*i][0] >= end - 1e-9).collect();
    BenchBody { name: "bar", fixed, tip, mesh }
}

/// The cow of 65 thousand tetrahedra, clamped at its feet.
fn cow(folder: &Path) -> Result<BenchBody, Failure> {
    let base = folder.join("cow_65k");
    let nodes: Vec<[f64; 3]> =
        table::<f64, 4>(&base.with_extension("node"), 1)?.iter().map(|r| [r[1], r[2], r[3]]).collect();
    let ele = base.with_extension("ele");
    let tets: Vec<[u32; 4]> = table::<u32, 5>(&ele, 1)?.iter().map(|r| [r[1], r[2], r[3], r[4]]).collect();
    let fix = base.with_extension("fix");
    let mut fixed = vec![false; nodes.len()];
    for [node] in table::<usize, 1>(&fix, 0)? {
        let slot = fixed.get_mut(node);
        *slot.ok_or_else(|| Failure::Input(format!("{}: there is no node {node}", fix.display())))? = true;
    }
    if tets.as_flattened().iter().any(|n| *n as usize >= nodes.len()) {
        return Err(Failure::Input(format!("{}: a tetrahedron names a node that does not exist", ele.display())));
    }
    let top = nodes.iter().fold(f64::MIN, |m, x| m.max(x[1]));
    let tip = (0..nodes.len()).filter(|i| nodes[*i][1] > top - 0.02).collect();
    Ok(BenchBody { name: "cow", mesh: VolumeMesh { nodes, tets, ..VolumeMesh::default() }, fixed, tip })
}

/// The first `N` numbers of each line after the header.
fn table<T: FromStr + Copy + Default, const N: usize>(path: &Path, header: usize) -> Result<Vec<[T; N]>, Failure> {
    let text = std::fs::read_to_string(path).map_err(|e| Failure::reading(path, &e))?;
    let mut rows = Vec::new();
    for (i, line) in text.lines().enumerate().skip(header) {
        let mut words = line.split_whitespace();
        let mut row = [T::default(); N];
        for value in &mut row {
            let word = words.next().and_then(|w| w.parse().ok());
            *value = word.ok_or_else(|| {
                Failure::Input(format!("{}: line {}: expected {N} numbers; restore the file", path.display(), i + 1))
            })?;
        }
        rows.push(row);
    }
    Ok(rows)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bar_is_the_standard_one() {
        let b = bar([32, 8, 16]);
        assert_eq!((b.mesh.node_count(), b.mesh.tets.len()), (5049, 24_576));
        assert_eq!(b.mesh.tets[..2], [[0, 153, 170, 171], [0, 154, 153, 171]]);
        assert_eq!((b.fixed.iter().filter(|f| **f).count(), b.tip.len()), (153, 153));
        let volume: f64 =
            b.mesh.tets.iter().map(|t| softrig::force::tet_gradients(t.map(|n| b.mesh.nodes[n as usize])).1).sum();
        assert!((volume - 0.008).abs() < 1e-12, "{volume}");
    }

    #[test]
    fn missing_and_damaged_files_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let failure = |f: Result<BenchBody, Failure>| f.err().unwrap().to_string();
        assert!(failure(load("cow", folder.path())).contains("cow_65k.node"));
        std::fs::create_dir(folder.path().join("bench")).unwrap();
        let write = |name: &str, text: &str| std::fs::write(folder.path().join("bench").join(name), text).unwrap();
        write("cow_65k.node", "1 3 0 0\n0 1.0 x 2\n");
        assert!(failure(load("cow", folder.path())).contains("line 2"));
        write("cow_65k.node", "1 3 0 0\n0 1.0 0 2\n");
        write("cow_65k.ele", "1 4 0\n0 0 0 0 7\n");
        write("cow_65k.fix", "0\n");
        assert!(failure(load("cow", folder.path())).contains("does not exist"));
        assert!(failure(load("horse", folder.path())).contains("bar, cow"));
    }
}
