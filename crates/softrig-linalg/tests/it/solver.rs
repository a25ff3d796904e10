//! Pcg and Direct against dense algebra, and what they do with systems that have no answer.

use crate::system::{System, difference, random_system};
use proptest::prelude::*;
use softrig_linalg::solver::{Direct, Pcg};
use softrig_linalg::{BlockCsr, BlockPattern, DofConstraints, LinearSolver, Scalar, SolveError, SolveReport};
use std::sync::Arc;

fn solvers<R: Scalar>() -> [Box<dyn LinearSolver<R>>; 2] {
    [Box::new(Pcg::<R>::new()), Box::new(Direct::<R>::new())]
}

/// Prepares and solves; checks what every solve promises.
fn solve<R: Scalar>(
    solver: &mut dyn LinearSolver<R>,
    s: &System<R>,
    tolerance: f64,
) -> Result<(Vec<[R; 3]>, SolveReport), SolveError> {
    solver.prepare(&s.matrix.pattern, &s.constraints)?;
    let seven = R::from_f64(7.0);
    let mut x = vec![[seven; 3]; s.rhs.len()];
    match solver.solve(&s.matrix, &s.rhs, &mut x, tolerance) {
        Ok(report) => {
            assert!(report.converged && report.residual <= tolerance, "{report:?}");
            assert_eq!(report.solver, solver.name());
            for (i, x) in x.iter().enumerate() {
                assert!(!s.constraints.is_constrained(i) || *x == [R::zero(); 3], "constrained node {i} moved: {x:?}");
            }
            // the same sum in another order: equal to rounding of the products
            let independent = s.residual(&x);
            assert!((report.residual - independent).abs() <= 1e-12 * (1.0 + independent), "{report:?} {independent}");
            Ok((x, report))
        }
        Err(e) => {
            assert!(x.iter().all(|x| *x == [seven; 3]), "an error changed the solution");
            Err(e)
        }
    }
}

fn agrees_with_dense<R: Scalar>(system: &System<R>, tolerance: f64, bound: f64) {
    let exact = system.dense_solution();
    for mut solver in solvers::<R>() {
        let (x, _) = solve(&mut *solver, system, tolerance).unwrap();
        let d = difference(&x, &exact);
        assert!(d < bound, "{} {}: {d:e}", solver.name(), R::NAME);
    }
}

/// Condition numbers are below 1e4 here: a residual of 1e-10 leaves errors below 1e-6.
#[test]
fn both_solvers_agree_with_a_dense_solve() {
    for seed in 1..6 {
        agrees_with_dense(&random_system::<f64>(90, 160, 10.0, 0.2, seed), 1e-10, 1e-6);
        agrees_with_dense(&random_system::<f32>(90, 160, 10.0, 0.2, seed), 1e-5, 1e-2);
    }
}

/// Cells 1000 times stiffer than their neighbours.
#[test]
fn stiffness_contrast_of_a_thousand_is_solved() {
    for seed in 1..4 {
        agrees_with_dense(&random_system::<f64>(120, 300, 1000.0, 0.1, seed), 1e-11, 1e-5);
        agrees_with_dense(&random_system::<f32>(120, 300, 1000.0, 0.1, seed), 1e-4, 0.5);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]
    #[test]
    fn any_pattern_and_any_constraints_are_solved(
        nodes in 1usize..60, cells in 0usize..80, fixed in 0.0f64..1.2, seed in 1u64..1_000_000
    ) {
        agrees_with_dense(&random_system::<f64>(nodes, cells, 10.0, fixed, seed), 1e-11, 1e-6);
    }
}

/// A solver is prepared once and used for many matrices: nothing of the last solve is left behind.
#[test]
fn solving_again_gives_the_same_bits() {
    let (a, b) = (random_system::<f64>(400, 900, 10.0, 0.1, 3), random_system::<f64>(400, 900, 10.0, 0.1, 3));
    for mut solver in solvers::<f64>() {
        let (first, report) = solve(&mut *solver, &a, 1e-8).unwrap();
        let mut other = a.rhs.clone();
        other.reverse();
        other.iter_mut().enumerate().for_each(|(i, b)| {
            if b[0].is_nan() || a.constraints.is_constrained(i) {
                *b = [1.0, 0.0, -2.0];
            }
        });
        let mut x = vec![[0.0; 3]; 400];
        solver.solve(&a.matrix, &other, &mut x, 1e-4).unwrap();
        let again = solver.solve(&b.matrix, &b.rhs, &mut x, 1e-8).unwrap();
        assert_eq!(report, again);
        assert_eq!(first, x);
    }
}

#[test]
fn zero_right_hand_side_gives_zero_without_iterating() {
    let mut s = random_system::<f64>(30, 50, 10.0, 0.2, 5);
    s.rhs.fill([0.0; 3]);
    for mut solver in solvers::<f64>() {
        let (x, report) = solve(&mut *solver, &s, 1e-6).unwrap();
        assert_eq!((report.iterations, report.residual), (0, 0.0));
        assert!(x.iter().all(|x| *x == [0.0; 3]));
    }
}

#[test]
fn everything_constrained_gives_zero() {
    let mut s = random_system::<f64>(30, 50, 10.0, 0.0, 5);
    s.constraints = DofConstraints::from_mask(vec![true; 30]);
    for mut solver in solvers::<f64>() {
        let (x, report) = solve(&mut *solver, &s, 1e-6).unwrap();
        assert_eq!(report.iterations, 0);
        assert!(x.iter().all(|x| *x == [0.0; 3]));
    }
}

#[test]
fn a_single_node_is_divided_by_its_block() {
    let pattern = Arc::new(BlockPattern::from_cells(1, std::iter::empty()));
    let matrix = BlockCsr { pattern, values: vec![[2.0, 0.0, 0.0, 0.0, 4.0, 0.0, 0.0, 0.0, 8.0]] };
    let s = System { matrix, rhs: vec![[2.0, 2.0, 2.0]], constraints: DofConstraints::none(1) };
    for mut solver in solvers::<f64>() {
        let (x, _) = solve(&mut *solver, &s, 1e-12).unwrap();
        assert!(difference(&x, &[[1.0, 0.5, 0.25]]) < 4.0 * f64::EPSILON, "{x:?}");
    }
}

/// No cell, no mass: the row is treated as one of the identity instead of dividing by zero.
#[test]
fn a_node_without_entries_does_not_spoil_the_others() {
    let mut s = random_system::<f64>(40, 60, 10.0, 0.1, 11);
    let lonely = (0..40).find(|i| !s.constraints.is_constrained(*i)).unwrap();
    for i in 0..40 {
        for k in s.matrix.pattern.row(i) {
            if (i == lonely || s.matrix.pattern.column()[k] as usize == lonely) && !s.matrix.values[k][0].is_nan() {
                s.matrix.values[k] = [0.0; 9];
            }
        }
    }
    s.rhs[lonely] = [0.0; 3];
    let mut without = System { matrix: s.matrix.clone(), rhs: s.rhs.clone(), constraints: s.constraints.clone() };
    let mut mask = s.constraints.mask().to_vec();
    mask[lonely] = true;
    without.constraints = DofConstraints::from_mask(mask);
    let exact = without.dense_solution();
    for mut solver in solvers::<f64>() {
        let (x, _) = solve(&mut *solver, &s, 1e-10).unwrap();
        assert!(difference(&x, &exact) < 1e-6);
        assert_eq!(x[lonely], [0.0; 3]);
    }
}

#[test]
fn values_that_are_not_finite_are_named() {
    for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        let mut s = random_system::<f64>(700, 1200, 10.0, 0.1, 9);
        let free: Vec<usize> = (0..700).filter(|i| !s.constraints.is_constrained(*i)).collect();
        let node = free[free.len() / 2];
        let entry = s.matrix.pattern.diagonal()[node] as usize;
        let good = (s.rhs[node][1], s.matrix.values[entry][4]);
        s.rhs[node][1] = bad;
        for mut solver in solvers::<f64>() {
            assert_eq!(solve(&mut *solver, &s, 1e-6).unwrap_err(), SolveError::NotFinite { node });
        }
        s.rhs[node][1] = good.0;
        s.matrix.values[entry][4] = bad;
        for mut solver in solvers::<f64>() {
            assert_eq!(solve(&mut *solver, &s, 1e-6).unwrap_err(), SolveError::NotFinite { node });
        }
    }
}

#[test]
fn an_indefinite_matrix_is_refused() {
    let mut s = random_system::<f64>(50, 90, 10.0, 0.0, 4);
    // indefinite although its diagonal blocks are fine
    let k = s.matrix.pattern.find(0, s.matrix.pattern.column()[s.matrix.pattern.row(0)][1] as usize).unwrap();
    let other = s.matrix.pattern.column()[k] as usize;
    let mirrored = s.matrix.pattern.find(other, 0).unwrap();
    s.matrix.values[k] = [1e4, 0.0, 0.0, 0.0, 1e4, 0.0, 0.0, 0.0, 1e4];
    s.matrix.values[mirrored] = s.matrix.values[k];
    for mut solver in solvers::<f64>() {
        let e = solve(&mut *solver, &s, 1e-6).unwrap_err();
        assert!(matches!(e, SolveError::NotPositiveDefinite { .. }), "{e:?}");
    }
    let d = s.matrix.pattern.diagonal()[7] as usize;
    s.matrix.values[d][4] = -1.0;
    for mut solver in solvers::<f64>() {
        let e = solve(&mut *solver, &s, 1e-6).unwrap_err();
        assert!(matches!(e, SolveError::NotPositiveDefinite { .. }), "{e:?}");
    }
}

#[test]
fn the_iteration_limit_is_an_error_with_the_true_residual() {
    let s = random_system::<f64>(300, 900, 100.0, 0.1, 2);
    let mut pcg = Pcg::new();
    pcg.iteration_limit = 3;
    let e = solve(&mut pcg, &s, 1e-10).unwrap_err();
    assert!(matches!(e, SolveError::NotConverged { iterations: 3, residual, .. } if residual > 1e-10), "{e:?}");
}

/// Asked for more than f32 can hold, solvers say so instead of running for ever or claiming it.
#[test]
fn an_impossible_tolerance_is_an_error() {
    let s = random_system::<f32>(300, 900, 100.0, 0.1, 2);
    for mut solver in solvers::<f32>() {
        let e = solve(&mut *solver, &s, 1e-12).unwrap_err();
        assert!(
            matches!(e, SolveError::NotConverged { residual, iterations, .. } if residual < 1e-3 && iterations < 10_000),
            "{e:?}"
        );
    }
}

/// f32 data: the residual is recomputed in f64, and restarts go on where the f32 recursion has drifted.
#[test]
fn single_precision_reaches_what_its_recursive_residual_claims() {
    let s = random_system::<f32>(500, 1500, 100.0, 0.1, 8);
    let (_, report) = solve(&mut Pcg::new(), &s, 2e-6).unwrap();
    assert!(report.iterations > 10);
}

#[test]
fn tiny_and_huge_right_hand_sides_are_solved_alike() {
    for factor in [1e-250, 1e-30, 1e30, 1e250] {
        let mut s = random_system::<f64>(60, 100, 10.0, 0.1, 6);
        let exact: Vec<[f64; 3]> = s.dense_solution().iter().map(|x| x.map(|x| x * factor)).collect();
        s.rhs.iter_mut().for_each(|b| *b = b.map(|b| b * factor));
        for mut solver in solvers::<f64>() {
            solver.prepare(&s.matrix.pattern, &s.constraints).unwrap();
            let mut x = vec![[0.0; 3]; 60];
            solver.solve(&s.matrix, &s.rhs, &mut x, 1e-10).unwrap();
            assert!(difference(&x, &exact) < 1e-6, "{} {factor:e}", solver.name());
        }
    }
}

#[test]
fn a_system_that_was_not_prepared_is_refused() {
    let (a, b) = (random_system::<f64>(20, 30, 10.0, 0.1, 6), random_system::<f64>(21, 30, 10.0, 0.1, 6));
    for mut solver in solvers::<f64>() {
        let mut x = vec![[0.0; 3]; 20];
        assert_eq!(solver.solve(&a.matrix, &a.rhs, &mut x, 1e-6), Err(SolveError::NotPrepared));
        solver.prepare(&b.matrix.pattern, &b.constraints).unwrap();
        assert_eq!(solver.solve(&a.matrix, &a.rhs, &mut x, 1e-6), Err(SolveError::NotPrepared));
        solver.prepare(&a.matrix.pattern, &a.constraints).unwrap();
        assert_eq!(solver.solve(&a.matrix, &a.rhs, &mut x[..19], 1e-6), Err(SolveError::NotPrepared));
        assert!(solver.solve(&a.matrix, &a.rhs, &mut x, 1e-6).is_ok());
    }
}
