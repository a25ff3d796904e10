//! The standard bodies: a bar made here, so that the command needs no files, and a cow of tetrahedra that is read.

use crate::failure::Failure;
use softrig::mesh::{CellKind, VolumeMesh};
use std::path::Path;

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

/// Names of the bodies, and how many cells each has.
pub const NAMES: [&str; 6] = ["bar", "cow", "bar_s", "bar_m", "bar_l", "dragon"];

/// What is measured when nobody names a body.
pub const DEFAULT: [&str; 2] = ["bar", "cow"];

/// The body of that name; files are looked for in `shared`.
///
/// # Errors
/// [`Failure::Usage`] for a name that is no body, [`Failure::Input`] for files that are missing or damaged.
pub fn load(name: &str, shared: &Path) -> Result<BenchBody, Failure> {
    let bench = match name {
        "bar_s" => bar("bar_s", [16, 4, 8]),
        "bar" => bar("bar", [32, 8, 16]),
        "bar_m" => bar("bar_m", [64, 16, 32]),
        "bar_l" => bar("bar_l", [112, 28, 56]),
        "cow" => cow(&shared.join("bench"))?,
        "dragon" => dragon(&shared.join("data/volumes/stanford/dragon_67k.node"))?,
        _ => {
            let all = NAMES.join(", ");
            return Err(Failure::Usage(format!("there is no benchmark body `{name}`; there are {all}, character_N")));
        }
    };
    Ok(bench.renumbered())
}

impl BenchBody {
    /// With neighbours in space as neighbours in memory: part of setting up, as a bake does not need it for its lattices.
    fn renumbered(self) -> Self {
        let (mesh, old) = softrig::mesh::renumbered(&self.mesh);
        let mut new = vec![0; old.len()];
        old.iter().enumerate().for_each(|(k, n)| new[*n as usize] = k);
        let fixed = old.iter().map(|n| self.fixed[*n as usize]).collect();
        Self { mesh, fixed, tip: self.tip.iter().map(|n| new[*n]).collect(), ..self }
    }
}

/// A bar 0.4 m long, clamped at x = 0, of cubes cut into six tetrahedra each along the paths from corner to corner.
pub fn bar(name: &'static str, cubes: [usize; 3]) -> BenchBody {
    let spacing = 0.4 / cubes[0] as f64;
    let mesh = softrig::mesh::bar(cubes, cubes.map(|n| n as f64 * spacing), CellKind::Tet4);
    let nodes = &mesh.nodes;
    let fixed = nodes.iter().map(|x| x[0] == 0.0).collect();
    let end = nodes[nodes.len() - 1][0];
    let tip = (0..nodes.len()).filter(|i| nodes[*i][0] >= end - 1e-9).collect();
    BenchBody { name, fixed, tip, mesh }
}

/// The cow of 65 thousand tetrahedra, clamped at its feet.
fn cow(folder: &Path) -> Result<BenchBody, Failure> {
    let base = folder.join("cow_65k");
    let mesh = crate::load::volume(&base.with_extension("node"))?;
    let list = base.with_extension("fix");
    let text = std::fs::read_to_string(&list).map_err(|e| Failure::reading(&list, &e))?;
    let mut fixed = vec![false; mesh.node_count()];
    for word in text.split_whitespace() {
        let slot = word.parse().ok().and_then(|n: usize| fixed.get_mut(n));
        *slot.ok_or_else(|| Failure::Input(format!("{}: there is no node {word}", list.display())))? = true;
    }
    let top = mesh.nodes.iter().fold(f64::MIN, |m, x| m.max(x[1]));
    let tip = (0..mesh.node_count()).filter(|i| mesh.nodes[*i][1] > top - 0.02).collect();
    Ok(BenchBody { name: "cow", mesh, fixed, tip })
}

/// The dragon, as high as the cow is long, clamped below a twelfth of its height; the tip is the highest twelfth.
fn dragon(path: &Path) -> Result<BenchBody, Failure> {
    let mut mesh = crate::load::volume(path)?;
    let (low, high) = mesh.bounds().unwrap_or_default();
    let height = high[1] - low[1];
    for x in &mut mesh.nodes {
        *x = std::array::from_fn(|k| 0.6 * (x[k] - low[k]) / height);
    }
    let fixed = mesh.nodes.iter().map(|x| x[1] < 0.05).collect();
    let tip = (0..mesh.node_count()).filter(|i| mesh.nodes[*i][1] > 0.55).collect();
    Ok(BenchBody { name: "dragon", mesh, fixed, tip })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bar_is_the_standard_one() {
        let b = bar("bar", [32, 8, 16]);
        assert_eq!((b.mesh.node_count(), b.mesh.tets.len()), (5049, 24_576));
        assert_eq!(b.mesh.tets[..2], [[0, 153, 170, 171], [0, 154, 153, 171]]);
        let (mut fixed, mut tip) = (0, 0);
        for b in [&b, &bar("bar", [32, 8, 16]).renumbered()] {
            (fixed, tip) = (b.fixed.iter().filter(|f| **f).count(), b.tip.len());
            assert!(b.mesh.nodes.iter().zip(&b.fixed).all(|(x, f)| *f == (x[0] == 0.0)));
            assert!(b.tip.iter().all(|n| b.mesh.nodes[*n][0] > 0.39));
        }
        assert_eq!((fixed, tip), (153, 153));
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
        write("cow_65k.node", "4 3 0 0\n0 0 0 0\n1 1 0 0\n2 0 1 0\n3 0 0 x\n");
        write("cow_65k.ele", "1 4 0\n0 0 1 2 3\n");
        assert!(failure(load("cow", folder.path())).contains("line 5"));
        write("cow_65k.node", "4 3 0 0\n0 0 0 0\n1 1 0 0\n2 0 1 0\n3 0 0 1\n");
        write("cow_65k.fix", "9\n");
        assert!(failure(load("cow", folder.path())).contains("there is no node 9"));
        assert!(failure(load("horse", folder.path())).contains("bar, cow"));
    }
}
