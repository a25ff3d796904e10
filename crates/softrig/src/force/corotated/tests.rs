use super::*;
use crate::material::Material;

/// A row of voxels far from the origin: their corners differ by rounding, their stiffness must not be stored again.
#[test]
fn cells_of_a_lattice_share_their_stiffness() {
    let h = 0.0217;
    let mut mesh = VolumeMesh::default();
    for i in 0..=50 {
        let x = 1.3 + f64::from(i) * h;
        for (y, z) in [(0.0, 0.0), (h, 0.0), (h, h), (0.0, h)] {
            mesh.nodes.push([x, 0.7 + y, -0.4 + z]);
        }
    }
    for i in 0..50u32 {
        let (a, b) = (4 * i, 4 * i + 4);
        mesh.hexes.push([a, b, b + 1, a + 1, a + 3, b + 3, b + 2, a + 2]);
    }
    let count = |map: &MaterialMap| {
        let pattern = Arc::new(BlockPattern::from_cells(mesh.node_count(), mesh.cells()));
        Corotated::<f64>::new(&mesh, map, pattern, Rotations::Follow).shape_count()
    };
    let flesh = Material::default();
    assert_eq!(count(&MaterialMap::uniform(flesh)), 1);
    // another modulus is a factor, another Poisson's ratio another stiffness
    let stiff = Material { young_modulus: 1e6, ..flesh };
    let of_cell: Vec<u32> = (0..50).map(|i| i % 2).collect();
    let two =
        |other| MaterialMap { materials: vec![flesh, other], of_cell: of_cell.clone(), stiffness_factor: Vec::new() };
    assert_eq!(count(&two(stiff)), 1);
    assert_eq!(count(&two(Material { poisson_ratio: 0.3, ..flesh })), 2);
}

/// A ball of tetrahedra around node 0, the corners of all of them: a node that is too crowded for a strip.
fn hedgehog(rings: u32) -> VolumeMesh {
    let mut mesh = VolumeMesh { nodes: vec![[0.0; 3]], ..VolumeMesh::default() };
    let sides = 2 * rings;
    for i in 1..rings {
        for j in 0..sides {
            let (t, p) = (f64::from(i) / f64::from(rings), f64::from(j) / f64::from(rings));
            let ((st, ct), (sp, cp)) = ((t * std::f64::consts::PI).sin_cos(), (p * std::f64::consts::PI).sin_cos());
            mesh.nodes.push([st * cp, 1.2 * ct, st * sp]);
        }
    }
    let at = |i: u32, j: u32| 1 + (i - 1) * sides + j % sides;
    for i in 1..rings - 1 {
        for j in 0..sides {
            let [a, b, c, d] = [at(i, j), at(i, j + 1), at(i + 1, j), at(i + 1, j + 1)];
            mesh.tets.extend([[0, a, b, c], [0, b, d, c]]);
        }
    }
    for tet in &mut mesh.tets {
        if tet_gradients(tet.map(|n| mesh.nodes[n as usize])).1 < 0.0 {
            tet.swap(2, 3);
        }
    }
    mesh
}

/// The rows multiply like the increment of the force, which knows of no rows: with one Poisson's ratio, with two, and at a node
/// with many cells or neighbours.
#[test]
fn rows_are_what_increments_add() {
    let flesh = Material::default();
    let (crowded, long) = (hedgehog(32), hedgehog(14));
    assert!(crowded.tets.len() > 2 * 8 * 160, "too few to crowd a strip");
    let bar = crate::mesh::bar([6, 3, 3], [0.6, 0.3, 0.3], crate::mesh::CellKind::Tet4);
    assert!(long.tets.len() < 8 * 160 && long.node_count() > 256, "a row that is long for its cells");
    let cases = [&bar, &crowded, &long].into_iter().flat_map(|mesh| [(mesh, [0.3, 0.3]), (mesh, [0.2, 0.45])]);
    for (mesh, ratios) in cases {
        let map = MaterialMap {
            materials: ratios
                .map(|poisson_ratio| Material { poisson_ratio, young_modulus: 1e4 / (1.0 - poisson_ratio), ..flesh })
                .to_vec(),
            of_cell: (0..mesh.tets.len() as u32).map(|i| i / 3 % 2).collect(),
            stiffness_factor: Vec::new(),
        };
        let pattern = Arc::new(BlockPattern::from_cells(mesh.node_count(), mesh.cells()));
        let mut model = Corotated::<f64>::new(mesh, &map, pattern.clone(), Rotations::Follow);
        assert_eq!(model.ratio.is_some(), ratios[0] == ratios[1]);
        let wave = |i: usize, k: usize, s: f64| 0.03 * (s * (3 * i + k) as f64).sin();
        let moved = |s: f64| -> Vec<[f64; 3]> {
            (0..mesh.node_count()).map(|i| std::array::from_fn(|k| wave(i, k, s))).collect()
        };
        let x: Vec<[f64; 3]> = mesh
            .nodes
            .iter()
            .zip(moved(1.3))
            .map(|(x, d)| std::array::from_fn(|k| 1.1 * x[(k + 1) % 3] + d[k]))
            .collect();
        model.linearise(&x);
        let mut matrix = BlockCsr::zero(pattern.clone());
        model.stiffness(0.0, 0.0, &mut matrix);
        let mut count = 0;
        for part in 0..model.row_parts() {
            model.stiffness_rows_in_single(0.0, 0.0, part, &mut |node, blocks| {
                let exact = &matrix.values[pattern.row(node)];
                let largest = exact.iter().flatten().fold(0.0f64, |m, v| m.max(v.abs()));
                for (single, exact) in blocks.iter().flatten().zip(exact.iter().flatten()) {
                    assert!((f64::from(*single) - exact).abs() < 1e-5 * largest, "row {node}: {single} {exact}");
                }
                count += blocks.len();
            });
        }
        assert_eq!(count, matrix.values.len());
        let (d, mut with, mut without) = (moved(0.7), moved(0.0), moved(0.0));
        model.force(&x, Increment { displacement: Some(&d), ..Increment::none() }, &mut with);
        model.force(&x, Increment::none(), &mut without);
        let largest = without.iter().flatten().fold(0.0f64, |m, f| m.max(f.abs()));
        for i in 0..mesh.node_count() {
            for c in 0..3 {
                let row = |k: usize| {
                    (0..3).map(|j| matrix.values[k][3 * c + j] * d[pattern.column()[k] as usize][j]).sum::<f64>()
                };
                let product: f64 = pattern.row(i).map(row).sum();
                let error = product - (with[i][c] - without[i][c]);
                assert!(error.abs() < 1e-11 * largest, "{ratios:?} node {i}: {product} {error}");
            }
        }
    }
}

/// Cells of both kinds with materials of their own: a bar of tetrahedra, and beside it one of hexahedra.
fn mixed() -> (VolumeMesh, MaterialMap) {
    let mut mesh = crate::mesh::bar([7, 5, 5], [0.7, 0.5, 0.5], crate::mesh::CellKind::Tet4);
    let other = crate::mesh::bar([6, 3, 3], [0.6, 0.3, 0.3], crate::mesh::CellKind::Hex8);
    let first = mesh.node_count() as u32;
    mesh.nodes.extend(other.nodes.iter().enumerate().map(|(i, [x, y, z])| {
        // every third node is moved: cells that are cubes, and others
        [x + 1.0, y + if i % 3 == 0 { 0.01 } else { 0.0 }, *z]
    }));
    mesh.hexes.extend(other.hexes.iter().map(|cell| cell.map(|n| n + first)));
    let flesh = Material::default();
    let cells = (mesh.tets.len() + mesh.hexes.len()) as u32;
    let materials = vec![
        Material { stiffness_damping: 0.02, ..flesh },
        Material { poisson_ratio: 0.2, young_modulus: 3e4, stiffness_damping: 0.01, ..flesh },
        Material { poisson_ratio: 0.3, ..flesh },
    ];
    let map = MaterialMap { materials, of_cell: (0..cells).map(|i| i / 5 % 3).collect(), stiffness_factor: Vec::new() };
    (mesh, map)
}

/// One material for all cells is kept once; that the same moduli written for each cell on its own give the same forces, to the bit, is
/// what keeps both ways of keeping them one law.
#[test]
fn moduli_of_all_are_those_of_each() {
    let (mut mesh, _) = mixed();
    mesh.hexes.clear();
    let pattern = Arc::new(BlockPattern::from_cells(mesh.node_count(), mesh.cells()));
    let flesh = Material { stiffness_damping: 0.02, ..Material::default() };
    let bent = |x: &[f64; 3]| [x[0] + 0.2 * x[1] * x[1], x[1], 1.1 * x[2] - 0.1 * x[0]];
    let position: Vec<[f64; 3]> = mesh.nodes.iter().map(bent).collect();
    let run = |map: &MaterialMap| {
        let mut model = Corotated::<f64>::new(&mesh, map, pattern.clone(), Rotations::Follow);
        model.linearise(&position);
        let (mut force, mut matrix) = (vec![[0.0; 3]; position.len()], BlockCsr::zero(pattern.clone()));
        let increment = Increment { velocity: Some(&position), ..Increment::none() };
        let energy = model.force(&position, increment, &mut force);
        model.stiffness(60.0, 0.01, &mut matrix);
        (energy, force, matrix.values)
    };
    let same = run(&MaterialMap::uniform(flesh));
    // one cell of another material sends all cells the other way, and shows at its own nodes alone
    let cells = mesh.tets.len() as u32;
    let materials = vec![flesh, Material { young_modulus: 2.0 * flesh.young_modulus, ..flesh }];
    let of_cell: Vec<u32> = (0..cells).map(|i| u32::from(i == 0)).collect();
    let each = run(&MaterialMap { materials, of_cell, stiffness_factor: Vec::new() });
    assert!(same.0 > 0.0 && same.0 < each.0);
    let far: Vec<usize> = (0..position.len()).filter(|n| !mesh.tets[0].contains(&(*n as u32))).collect();
    for n in far {
        assert_eq!(same.1[n], each.1[n], "node {n}");
        assert_eq!(same.2[pattern.row(n)], each.2[pattern.row(n)], "node {n}");
    }
}

/// The product without the matrix is that with it, for both kinds of cells and several materials, in a turned and bent shape; and to
/// the bit the same on one thread and on four.
#[test]
fn products_are_those_of_the_matrix() {
    let (mesh, map) = mixed();
    let pattern = Arc::new(BlockPattern::from_cells(mesh.node_count(), mesh.cells()));
    let mut model = Corotated::<f64>::new(&mesh, &map, pattern.clone(), Rotations::Follow);
    let wave = |i: usize, k: usize, s: f64| 0.03 * (s * (3 * i + k) as f64).sin();
    let bent = |(i, x): (usize, &[f64; 3])| std::array::from_fn(|k| 1.1 * x[(k + 1) % 3] + wave(i, k, 1.3));
    let position: Vec<[f64; 3]> = mesh.nodes.iter().enumerate().map(bent).collect();
    model.linearise(&position);
    let x: Vec<[f64; 3]> = (0..mesh.node_count()).map(|i| std::array::from_fn(|k| wave(i, k, 0.7))).collect();
    let mut matrix = BlockCsr::zero(pattern.clone());
    let diagonal = |i: usize| 40.0 * (i as f64).cos();
    for (rate, damping) in [(0.0, 0.0), (60.0, 0.01)] {
        model.stiffness(rate, damping, &mut matrix);
        let mut run = |threads| {
            let mut y = x.clone();
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            assert!(pool.install(|| model.product(rate, damping, &diagonal, &mut y)));
            y
        };
        let y = run(1);
        assert_eq!(y, run(4));
        let largest = y.iter().flatten().fold(0.0f64, |m, f| m.max(f.abs()));
        for i in 0..y.len() {
            for c in 0..3 {
                let of_block = |k: usize| {
                    (0..3).map(|j| matrix.values[k][3 * c + j] * x[pattern.column()[k] as usize][j]).sum::<f64>()
                };
                let expected = pattern.row(i).map(of_block).sum::<f64>() + diagonal(i) * x[i][c];
                assert!((y[i][c] - expected).abs() < 1e-13 * largest, "rate {rate}, node {i}: {} {expected}", y[i][c]);
            }
        }
    }
}

/// One pass over the cells does what two do, to the bit, and on any number of threads, from wherever the rotations were.
#[test]
fn one_pass_is_two() {
    let (mesh, map) = mixed();
    let pattern = Arc::new(BlockPattern::from_cells(mesh.node_count(), mesh.cells()));
    let bent = |s: f64, x: &[f64; 3]| [x[0] + s * x[1] * x[1], x[1] - 0.3 * s * x[2], 1.1 * x[2] - s * x[0]];
    let run = |threads, rotations, once: bool| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let mut model = Corotated::<f64>::new(&mesh, &map, pattern.clone(), rotations);
            let mut force = vec![[0.0; 3]; mesh.node_count()];
            let mut energy = 0.0;
            for s in [0.1, 0.4, 0.9] {
                let x: Vec<[f64; 3]> = mesh.nodes.iter().map(|x| bent(s, x)).collect();
                let increment = Increment { displacement: Some(&x), ..Increment::none() };
                energy = if once {
                    model.linearise_and_force(&x, increment, &mut force)
                } else {
                    model.linearise(&x);
                    model.force(&x, increment, &mut force)
                };
            }
            (force, energy, model.history())
        })
    };
    for rotations in [Rotations::Follow, Rotations::Fixed] {
        let two = run(1, rotations, false);
        assert!(two.1 > 0.0);
        assert_eq!(run(1, rotations, true), two);
        assert_eq!(run(3, rotations, true), two);
    }
}

/// Rows summed up in f32 are as good for flat cells, tiny ones, and needles as for others: those are turned with all digits.
#[test]
fn rows_in_single_precision_know_flat_cells() {
    let flat = |size: f64, height: f64| {
        let corner = [[0.0, 0.0, 0.0], [1.0, 0.1, 0.0], [0.2, 1.0, 0.0], [0.4, 0.3, height], [0.3, 0.4, -1.0]];
        let nodes = corner.iter().map(|x| x.map(|c| 5.0 * size + size * c)).collect();
        VolumeMesh { nodes, tets: vec![[0, 1, 2, 3], [0, 2, 1, 4]], ..VolumeMesh::default() }
    };
    for (size, height) in [(1.0, 0.5), (1.0, 1e-3), (1.0, 1e-6), (1.0, 1e-8), (1e-7, 0.5), (1e5, 1e-4)] {
        let mesh = flat(size, height);
        let pattern = Arc::new(BlockPattern::from_cells(mesh.node_count(), mesh.cells()));
        let map = MaterialMap::uniform(Material::default());
        let mut model = Corotated::<f64>::new(&mesh, &map, pattern.clone(), Rotations::Follow);
        let turned: Vec<[f64; 3]> = mesh.nodes.iter().map(|[x, y, z]| [-y, *x, 1.001 * z]).collect();
        model.linearise(&turned);
        let mut matrix = BlockCsr::zero(pattern.clone());
        model.stiffness(0.0, 0.0, &mut matrix);
        for part in 0..model.row_parts() {
            model.stiffness_rows_in_single(0.0, 0.0, part, &mut |node, blocks| {
                let exact = &matrix.values[pattern.row(node)];
                let largest = exact.iter().flatten().fold(0.0f64, |m, v| m.max(v.abs()));
                for (single, exact) in blocks.iter().flatten().zip(exact.iter().flatten()) {
                    let error = (f64::from(*single) - exact).abs() / largest;
                    assert!(error < 2e-5, "size {size}, height {height}, row {node}: {single} {exact}");
                }
            });
        }
    }
}

/// The rotation at a node is that of its largest cell; linear elasticity has none.
#[test]
fn rotations_at_nodes_are_those_of_their_largest_cells() {
    let (mut mesh, mut map) = mixed();
    mesh.nodes.push([9.0; 3]);
    map.of_cell.resize(mesh.cell_count(), 0);
    let pattern = Arc::new(BlockPattern::from_cells(mesh.node_count(), mesh.cells()));
    let node: Vec<u32> = (0..mesh.node_count() as u32).rev().collect();
    let mut out = vec![[7.0f32; 4]; node.len()];
    let linear = Corotated::<f64>::new(&mesh, &map, pattern.clone(), Rotations::Fixed);
    assert!(!linear.rotations(&node, &mut out) && out.iter().flatten().all(|v| *v == 7.0));
    let mut model = Corotated::<f64>::new(&mesh, &map, pattern, Rotations::Follow);
    // the number of a cell is in its quaternion
    let history: Vec<[f64; 4]> = (0..mesh.cell_count()).map(|i| [i as f64, 0.5, 0.25, 1.0]).collect();
    model.restore(&history);
    assert!(model.rotations(&node, &mut out));
    let volume = |cell: &[u32]| {
        let at = |i: usize| mesh.nodes[cell[i] as usize];
        let parts: &[[usize; 4]] = if cell.len() == 4 {
            &[[0, 1, 2, 3]]
        } else {
            &[[0, 1, 2, 5], [0, 2, 7, 5], [0, 2, 3, 7], [0, 5, 7, 4], [2, 7, 5, 6]]
        };
        parts.iter().map(|tet| tet_gradients(tet.map(at)).1).sum::<f64>()
    };
    let cells: Vec<&[u32]> = mesh.cells().collect();
    for (n, q) in node.iter().zip(&out) {
        let around = cells.iter().filter(|cell| cell.contains(n)).map(|cell| volume(cell));
        let Some(most) = around.reduce(f64::max) else {
            assert_eq!(*q, [0.0; 4], "{n}");
            continue;
        };
        let cell = cells[q[0] as usize];
        assert!(cell.contains(n) && volume(cell) > 0.97 * most && q[1..] == [0.5, 0.25, 1.0], "{n} {q:?}");
    }
}
