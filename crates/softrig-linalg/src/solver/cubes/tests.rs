//! Products of cubes against the stiffness of a quadrature, and the laws of all kernels.

use super::*;
use crate::cubes::tests::by_quadrature;
use crate::{BlockPattern, DofConstraints, Instructions, run_wide_with};

const EDGE: f64 = 0.02;

/// A block of `n` cubes each way, turned at random, on a body some of whose nodes are held.
fn system(n: usize) -> (CubeMatrix<f64>, FreePattern) {
    let m = n + 1;
    let id = |x: usize, y: usize, z: usize| (x + m * (y + m * z)) as u32;
    let mut nodes = Vec::new();
    for (x, y, z) in (0..n * n * n).map(|k| (k % n, k / n % n, k / n / n)) {
        let square = |z: usize| [id(x, y, z), id(x + 1, y, z), id(x + 1, y + 1, z), id(x, y + 1, z)];
        let ([a, b, c, d], [e, f, g, h]) = (square(z), square(z + 1));
        nodes.push([a, b, c, d, e, f, g, h]);
    }
    let pattern = Arc::new(CubePattern { nodes, node_count: m * m * m, edge: EDGE });
    let mut matrix = CubeMatrix::zero(pattern.clone());
    let mut seed = 1u32;
    let mut random = || {
        seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        f64::from(seed >> 8) / f64::from(1 << 24) - 0.5
    };
    for (rotation, lame) in matrix.rotation.iter_mut().zip(&mut matrix.lame) {
        let axis = [random(), random(), random()];
        let length = axis.iter().map(|a| a * a).sum::<f64>().sqrt();
        let [x, y, z] = axis.map(|a| a / length);
        let (s, c) = (3.0 * random()).sin_cos();
        let t = 1.0 - c;
        *rotation = [
            [t * x * x + c, t * x * y + s * z, t * x * z - s * y, 7.0],
            [t * x * y - s * z, t * y * y + c, t * y * z + s * x, 7.0],
            [t * x * z + s * y, t * y * z - s * x, t * z * z + c, 7.0],
        ];
        *lame = [1e4 + 5e3 * random(), 1e4 + 5e3 * random()];
    }
    matrix.diagonal.iter_mut().for_each(|d| *d = 100.0 + random());
    let blocks = BlockPattern::from_cells(m * m * m, pattern.nodes.iter().map(|c| &c[..]));
    let mask = (0..m * m * m).map(|i| i % 7 == 3 || i < m).collect();
    (matrix, FreePattern::new(&blocks, &DofConstraints::from_mask(mask)))
}

/// A x cube by cube with the stiffness of a quadrature.
fn slow_product(matrix: &CubeMatrix<f64>, x: &[[f64; 3]]) -> Vec<[f64; 3]> {
    let mut y: Vec<[f64; 3]> = x.iter().zip(&matrix.diagonal).map(|(x, d)| x.map(|x| d * x)).collect();
    for ((nodes, rotation), lame) in matrix.pattern.nodes.iter().zip(&matrix.rotation).zip(&matrix.lame) {
        let k = by_quadrature(EDGE, lame[0], lame[1]);
        for a in 0..8 {
            let mut g = [0.0; 3];
            for b in 0..8 {
                let x = x[nodes[b] as usize];
                let u: [f64; 3] = std::array::from_fn(|j| (0..3).map(|i| rotation[j][i] * x[i]).sum());
                (0..3).for_each(|i| g[i] += (0..3).map(|j| k[a][b][i][j] * u[j]).sum::<f64>());
            }
            (0..3).for_each(|i| y[nodes[a] as usize][i] += (0..3).map(|j| rotation[j][i] * g[j]).sum::<f64>());
        }
    }
    y
}

fn vector<A: Scalar>(rows: usize) -> Vec<[A; 4]> {
    let at = |i: usize, c: usize| A::from_f64(((7 * i + 3 * c) as f64).sin());
    let mut x: Vec<[A; 4]> = (0..rows).map(|i| [at(i, 0), at(i, 1), at(i, 2), A::zero()]).collect();
    x.push([A::zero(); 4]);
    x
}

fn check_product<A: Scalar>(bound: f64) {
    // several chunks
    let (matrix, free) = system(9);
    let rows = free.row_count();
    let mut cubes = FreeCubes::<A>::new(&matrix.pattern, &free);
    cubes.load(&matrix, &free);
    let x = vector::<A>(rows);
    let mut y = vec![[A::zero(); 4]; rows];
    cubes.product(&x, &mut y);
    let mut whole = vec![[0.0; 3]; matrix.pattern.node_count];
    for (x, node) in x.iter().zip(&free.node) {
        whole[*node as usize] = [x[0], x[1], x[2]].map(Scalar::to_f64);
    }
    let exact = slow_product(&matrix, &whole);
    let largest = exact.as_flattened().iter().fold(0.0f64, |m, v| m.max(v.abs()));
    for (y, node) in y.iter().zip(&free.node) {
        for c in 0..3 {
            let error = (y[c].to_f64() - exact[*node as usize][c]).abs();
            assert!(error < bound * largest, "node {node}: {} {}", y[c], exact[*node as usize][c]);
        }
    }
    // xᵀ A x by chunks
    let mut r = y.clone();
    let mut partial = vec![[0.0; 2]; rows.div_ceil(ROWS)];
    cubes.product_dot(&x, &mut r, &mut partial);
    let dot: f64 =
        (0..rows).flat_map(|i| (0..3).map(move |c| (i, c))).map(|(i, c)| x[i][c].to_f64() * y[i][c].to_f64()).sum();
    assert!((partial.iter().map(|p| p[0]).sum::<f64>() - dot).abs() < 1e-6 * dot.abs());
}

#[test]
fn products_are_those_of_the_assembled_cubes() {
    check_product::<f64>(1e-13);
    check_product::<f32>(1e-5);
}

/// The inverted blocks, against products with unit vectors.
#[test]
fn inverted_blocks_are_those_of_the_diagonal() {
    let (matrix, free) = system(3);
    let rows = free.row_count();
    let mut cubes = FreeCubes::<f64>::new(&matrix.pattern, &free);
    cubes.load(&matrix, &free);
    let mut inverse = vec![Inverse::default(); rows];
    cubes.invert_diagonal(&mut inverse);
    for row in 0..rows {
        let mut block = [[0.0; 3]; 3];
        for c in 0..3 {
            let mut x = vec![[0.0; 4]; rows + 1];
            x[row][c] = 1.0;
            let mut y = vec![[0.0; 4]; rows];
            cubes.product(&x, &mut y);
            (0..3).for_each(|i| block[i][c] = y[row][i]);
        }
        for i in 0..3 {
            for j in 0..3 {
                let unit: f64 = (0..3).map(|k| inverse[row][i][k] * block[k][j]).sum();
                assert!((unit - f64::from(u8::from(i == j))).abs() < 1e-12, "row {row}: {i} {j} {unit}");
            }
        }
    }
}

fn check_sets<A: Scalar>() {
    // several chunks
    let (matrix, free) = system(9);
    let rows = free.row_count();
    let x = vector::<A>(rows);
    let results = Instructions::ALL.map(|set| {
        let mut cubes = FreeCubes::<A>::new(&matrix.pattern, &free);
        cubes.load(&matrix, &free);
        let FreeCubes { blocks, scatter, force, .. } = &mut cubes;
        scatter.for_chunks(force, |c, local, force| {
            let blocks = par::chunk(blocks, c, TASK);
            run_wide_with::<A, _>(set, Forces { blocks, x: &x, local, force });
        });
        cubes.force.as_flattened().iter().map(|f| f.bits()).collect::<Vec<_>>()
    });
    assert_eq!(results[0], results[1]);
    assert_eq!(results[0], results[2]);
}

#[test]
fn every_instruction_set_gives_the_same_bits() {
    check_sets::<f32>();
    check_sets::<f64>();
}
