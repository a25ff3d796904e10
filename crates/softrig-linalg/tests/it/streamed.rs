//! Systems that are never stored: rows in any order and parts, products from elsewhere.

use crate::system::{System, random_system};
use softrig_linalg::solver::{Interpolation, Multigrid, Pcg};
use softrig_linalg::{BlockCsr, BlockPattern, LinearSolver, LinearSystem, Rows, Scalar, SolveError};
use std::sync::Arc;

/// Hands out every third row in each of three parts, but not `left_out`; the last part also repeats the first one.
struct Streamed<'a, R> {
    matrix: &'a BlockCsr<R>,
    /// Products, where it has any, are made by the mask of free nodes.
    free: Option<Vec<bool>>,
    left_out: usize,
    products: usize,
    guess: Option<Vec<[R; 3]>>,
}

impl<R: Scalar> Rows<R> for Streamed<'_, R> {
    fn pattern(&self) -> &Arc<BlockPattern> {
        &self.matrix.pattern
    }

    fn part_count(&self) -> usize {
        4
    }

    fn for_rows(&self, part: usize, take: &mut dyn FnMut(usize, &[[R; 9]])) {
        let pattern = &self.matrix.pattern;
        for row in (0..pattern.row_count()).rev().filter(|row| row % 3 == part % 3 && *row != self.left_out) {
            take(row, &self.matrix.values[pattern.row(row)]);
        }
    }
}

impl<R: Scalar> LinearSystem<R> for Streamed<'_, R> {
    fn assembled(&mut self) -> &BlockCsr<R> {
        panic!("nobody needs all entries at once");
    }

    fn rows(&mut self) -> &dyn Rows<R> {
        self
    }

    fn guess(&self) -> Option<&[[R; 3]]> {
        self.guess.as_deref()
    }

    fn product(&mut self, y: &mut [[R; 3]]) -> bool {
        let Some(free) = &self.free else { return false };
        self.products += 1;
        let x = y.to_vec();
        for (i, y) in y.iter_mut().enumerate() {
            *y = [R::zero(); 3];
            for k in self.matrix.pattern.row(i) {
                let j = self.matrix.pattern.column()[k] as usize;
                // entries of constrained nodes are NaN, and their x is zero
                assert!(free[j] || x[j] == [R::zero(); 3]);
                for c in (0..9).filter(|_| free[i] && free[j]) {
                    y[c / 3] += self.matrix.values[k][c] * x[j][c % 3];
                }
            }
        }
        true
    }
}

fn solvers<R: Scalar>(nodes: usize) -> [Box<dyn LinearSolver<R>>; 2] {
    let p = Interpolation {
        coarse_count: nodes.div_ceil(5),
        start: (0..=nodes as u32).collect(),
        column: (0..nodes as u32).map(|i| i / 5).collect(),
        weight: vec![1.0; nodes],
    };
    [Box::new(Pcg::<R>::new()), Box::new(Multigrid::<R>::new(vec![p]))]
}

fn as_good_as_stored<R: Scalar>(tolerance: f64) -> usize {
    let s: System<R> = random_system(400, 900, 10.0, 0.15, 11);
    let free: Vec<bool> = s.constraints.mask().iter().map(|held| !held).collect();
    let mut products = 0;
    for (mut stored, mut streamed) in solvers::<R>(400).into_iter().zip(solvers::<R>(400)) {
        let mut x = [vec![[R::zero(); 3]; 400], vec![[R::zero(); 3]; 400]];
        stored.prepare(&s.matrix.pattern, &s.constraints).unwrap();
        let first = stored.solve(&s.matrix, &s.rhs, &mut x[0], tolerance).unwrap();
        streamed.prepare(&s.matrix.pattern, &s.constraints).unwrap();
        let mut system =
            Streamed { matrix: &s.matrix, free: Some(free.clone()), left_out: usize::MAX, products: 0, guess: None };
        let second = streamed.solve_system(&mut system, &s.rhs, &mut x[1], tolerance).unwrap();
        assert_eq!(x[0], x[1], "{} {tolerance:e}", streamed.name());
        assert!((first.residual - second.residual).abs() < 1e-13, "{first:?} {second:?}");
        assert!((second.residual - s.residual(&x[1])).abs() < 1e-12, "{second:?}");
        products += system.products;
    }
    products
}

/// The same bits, and a true residual, whether it comes from the solver's own matrix or from products.
#[test]
fn a_system_that_is_never_stored_is_solved_like_one_that_is() {
    assert_eq!(as_good_as_stored::<f32>(1e-4), 0, "the solver's own matrix has the numbers");
    assert_eq!(as_good_as_stored::<f64>(1e-9), 0, "so it has here");
    assert!(as_good_as_stored::<f64>(1e-3) > 0, "an iteration in f32 has rounded them");
}

#[test]
fn a_row_that_never_comes_is_an_error() {
    let s: System<f64> = random_system(400, 900, 10.0, 0.15, 12);
    let missing = (0..400).find(|i| !s.constraints.is_constrained(*i)).unwrap();
    for mut solver in solvers::<f64>(400) {
        solver.prepare(&s.matrix.pattern, &s.constraints).unwrap();
        let mut x = vec![[7.0; 3]; 400];
        let mut system = Streamed { matrix: &s.matrix, free: None, left_out: missing, products: 0, guess: None };
        let result = solver.solve_system(&mut system, &s.rhs, &mut x, 1e-3);
        assert_eq!(result, Err(SolveError::NotPrepared), "{}", solver.name());
        assert!(x.iter().all(|x| *x == [7.0; 3]));
    }
}

/// A guess that is twice the solution is the solution; one near it saves iterations; one that says nothing, or is not a number where it
/// counts, does no harm; and what it holds at constrained nodes does not matter. The residual stays that of the whole system.
fn starts_from_guesses<R: Scalar>() {
    let s: System<R> = random_system(400, 900, 10.0, 0.15, 13);
    let free: Vec<bool> = s.constraints.mask().iter().map(|held| !held).collect();
    for mut solver in solvers::<R>(400) {
        solver.prepare(&s.matrix.pattern, &s.constraints).unwrap();
        let mut exact = vec![[R::zero(); 3]; 400];
        solver.solve(&s.matrix, &s.rhs, &mut exact, 1e-5).unwrap();
        let mut from = |factor: f64, wrong: f64, unknown: f64| {
            let of = |i: usize, c: usize| {
                let wave = (1.7 * (3 * i + c) as f64).sin() * unknown;
                if free[i] { factor * exact[i][c].to_f64() * (1.0 + wave) + 1e-3 * wave } else { wrong }
            };
            let guess = (0..400).map(|i| std::array::from_fn(|c| R::from_f64(of(i, c)))).collect();
            let free = Some(free.clone());
            let mut system =
                Streamed { matrix: &s.matrix, free, left_out: usize::MAX, products: 0, guess: Some(guess) };
            let mut x = vec![[R::zero(); 3]; 400];
            solver.forget();
            let report = solver.solve_system(&mut system, &s.rhs, &mut x, 1e-4).unwrap();
            assert!((report.residual - s.residual(&x)).abs() < 1e-12 && report.converged, "{report:?}");
            assert!(report.start <= 1.0 + 1e-6 && report.start > 0.0, "{report:?}");
            report
        };
        let nothing = from(0.0, 0.0, 0.0);
        assert_eq!(nothing.start, 1.0);
        let whole = from(2.0, 1e30, 0.0);
        assert!(whole.iterations == 0 && whole.start < 1e-4, "{whole:?}");
        let near = from(-0.3, 0.0, 0.05);
        assert!(near.start < 0.5 && near.iterations < nothing.iterations, "{near:?} {nothing:?}");
        let none = from(f64::NAN, 0.0, 0.0);
        assert_eq!((none.start, none.iterations), (1.0, nothing.iterations));
        let huge = from(1e35, 0.0, 0.0);
        assert!(huge.iterations <= nothing.iterations, "{huge:?}");
        let guess = Some(vec![[R::one(); 3]; 3]);
        let mut system =
            Streamed { matrix: &s.matrix, free: Some(free.clone()), left_out: usize::MAX, products: 0, guess };
        let mut x = vec![[R::zero(); 3]; 400];
        let short = solver.solve_system(&mut system, &s.rhs, &mut x, 1e-4).unwrap();
        assert_eq!(short.start, 1.0, "a guess of three nodes is none");
    }
}

#[test]
fn iterations_start_from_the_best_multiple_of_a_guess() {
    starts_from_guesses::<f32>();
    starts_from_guesses::<f64>();
}
