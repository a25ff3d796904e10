//! What the number of threads must never change.

use crate::system::random_system;
use softrig_linalg::solver::{Direct, Pcg};
use softrig_linalg::{LinearSolver, Scalar};

fn on_threads<T: Send>(threads: usize, f: impl FnOnce() -> T + Send) -> T {
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(f)
}

fn same_bits<R: Scalar>(solver: fn() -> Box<dyn LinearSolver<R>>, tolerance: f64) {
    // twelve chunks of rows, the last one short
    let s = random_system::<R>(3000, 9000, 100.0, 0.05, 1);
    let run = || {
        let mut solver = solver();
        solver.prepare(&s.matrix.pattern, &s.constraints).unwrap();
        let mut x = vec![[R::zero(); 3]; 3000];
        let report = solver.solve(&s.matrix, &s.rhs, &mut x, tolerance).unwrap();
        (x.as_flattened().iter().map(|v| v.bits()).collect::<Vec<_>>(), report.iterations, report.residual.to_bits())
    };
    let one = on_threads(1, run);
    assert!(one.0.iter().any(|b| *b != 0));
    for threads in [2, 4] {
        assert!(one == on_threads(threads, run), "{} on {threads} threads", R::NAME);
    }
}

#[test]
fn solutions_are_bitwise_equal_on_one_two_and_four_threads() {
    same_bits::<f64>(|| Box::new(Pcg::new()), 1e-8);
    same_bits::<f32>(|| Box::new(Pcg::new()), 1e-4);
    same_bits::<f64>(|| Box::new(Direct::new()), 1e-8);
}
