//! Schemes against closed forms: order of accuracy, and steps that are too long.

use softrig::integrate::State;
use softrig_explicit::scheme::Scheme;
use softrig_explicit::stepper::{ForceLaw, Stepper, StepperError, TooLong};

const STIFFNESS: [f64; 3] = [30.0, 11.0, 4.0];
const DAMPING: f64 = 0.6;
const MASS: f64 = 1.7;

/// Three damped oscillators.
fn law() -> impl ForceLaw<f64> {
    |x: &[[f64; 3]], v: &[[f64; 3]], f: &mut [[f64; 3]]| {
        for i in 0..x.len() {
            f[i] = std::array::from_fn(|k| -STIFFNESS[k] * x[i][k] - DAMPING * v[i][k]);
        }
    }
}

/// x(t) and v(t) for x(0) = 1, v(0) = 0.5.
fn exact(k: usize, t: f64) -> (f64, f64) {
    let d = DAMPING / (2.0 * MASS);
    let w = (STIFFNESS[k] / MASS - d * d).sqrt();
    let (a, b) = (1.0, (0.5 + d) / w);
    let e = (-d * t).exp();
    let x = e * (a * (w * t).cos() + b * (w * t).sin());
    let v = -d * x + e * w * (b * (w * t).cos() - a * (w * t).sin());
    (x, v)
}

fn error(scheme: Scheme, steps: usize) -> (f64, f64) {
    let mut law = law();
    let mut stepper = Stepper::new(scheme, &[MASS], &[[0.0; 3]], &mut law, DAMPING / MASS).unwrap();
    let mut state = State { velocity: vec![[0.5; 3]], ..State::at_rest(vec![[1.0; 3]]) };
    stepper.start(&mut law, &mut state).unwrap();
    let dt = 2.0 / steps as f64;
    for _ in 0..steps {
        assert_eq!(stepper.step(&mut law, None, &mut state, dt).unwrap(), 1, "{scheme:?}");
    }
    assert!((state.time - 2.0).abs() < 1e-12);
    let mut worst = (0.0f64, 0.0f64);
    for k in 0..3 {
        let (x, v) = exact(k, 2.0);
        worst.0 = worst.0.max((state.position[0][k] - x).abs());
        worst.1 = worst.1.max((state.velocity[0][k] - v).abs());
    }
    worst
}

/// Halving the step divides the error of positions and velocities by two to the order.
#[test]
fn schemes_have_the_order_they_say() {
    for scheme in Scheme::ALL {
        let (coarse, fine) = (error(scheme, 800), error(scheme, 1600));
        assert!(coarse.0 > 1e-8, "{scheme:?}: there is an error to measure");
        for (a, b) in [(coarse.0, fine.0), (coarse.1, fine.1)] {
            let order = (a / b).log2();
            assert!((order - f64::from(scheme.order())).abs() < 0.15, "{scheme:?} {order} {a} {b}");
        }
    }
}

/// The largest frequency and damping of the operator itself: known here.
#[test]
fn the_spectrum_is_that_of_the_law() {
    let mut law = law();
    let stepper =
        Stepper::new(Scheme::Verlet, &[MASS; 4], &[[0.0; 3], [1.0; 3], [2.0; 3], [3.0; 3]], &mut law, DAMPING / MASS);
    let s = stepper.unwrap().spectrum();
    assert!((s.frequency - (STIFFNESS[0] / MASS).sqrt()).abs() < 1e-3 * s.frequency, "{s:?}");
    assert!((s.damping - DAMPING / MASS).abs() < 1e-6, "{s:?}");
}

/// A step beyond the limit is refused with the limit and what to do, or cut; never taken as it is.
#[test]
fn steps_beyond_the_limit_are_refused_or_cut() {
    let mut law = law();
    for scheme in [Scheme::EulerCromer, Scheme::Verlet] {
        let mut stepper = Stepper::new(scheme, &[MASS], &[[0.0; 3]], &mut law, DAMPING / MASS).unwrap();
        let limit = stepper.limit();
        let textbook = 2.0 / (STIFFNESS[0] / MASS).sqrt();
        assert!(limit > 0.5 * textbook && limit < textbook, "{scheme:?}: {limit} {textbook}");
        let start = State { velocity: vec![[0.5; 3]], ..State::at_rest(vec![[1.0; 3]]) };
        let mut state = start.clone();
        stepper.too_long = TooLong::Refuse;
        let refused = stepper.step(&mut law, None, &mut state, 3.3 * limit).unwrap_err();
        assert!(matches!(refused, StepperError::Unstable { substeps: 4, .. }), "{refused}");
        assert_eq!(state, start);
        stepper.too_long = TooLong::Substep;
        for _ in 0..1000 {
            assert_eq!(stepper.step(&mut law, None, &mut state, 3.3 * limit).unwrap(), 4);
            assert!(state.position[0].iter().all(|x| x.abs() < 3.0), "{scheme:?} {state:?}");
        }
    }
    let mut spring = |x: &[[f64; 3]], _: &[[f64; 3]], f: &mut [[f64; 3]]| f[0] = x[0].map(|x| -1e12 * x);
    let mut stepper = Stepper::new(Scheme::ExplicitEuler, &[1.0], &[[0.0; 3]], &mut spring, 0.0).unwrap();
    let mut state = State::at_rest(vec![[1.0; 3]]);
    let refused = stepper.step(&mut spring, None, &mut state, 0.1).unwrap_err();
    assert!(matches!(refused, StepperError::NeverStable { .. }), "{refused}");
    for dt in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        assert!(matches!(stepper.step(&mut spring, None, &mut state, dt), Err(StepperError::BadStep(_))));
    }
}

/// Implicit Euler takes any step of a stiff spring and comes to rest.
#[test]
fn implicit_euler_takes_any_step() {
    let mut spring = |x: &[[f64; 3]], _: &[[f64; 3]], f: &mut [[f64; 3]]| {
        f[0] = x[0].map(|x| -1e6 * (x + x * x * x));
    };
    let mut stepper = Stepper::new(Scheme::ImplicitEuler, &[1.0], &[[0.0; 3]], &mut spring, 0.0).unwrap();
    let mut state = State::at_rest(vec![[1.0; 3]]);
    assert_eq!(stepper.step(&mut spring, None, &mut state, 0.1).unwrap(), 1);
    // one step by hand: v = h a(x + h v), that is y = 1 - h² 1e6 (y + y³)
    let y = state.position[0][0];
    assert!((y - (1.0 - 1e4 * (y + y * y * y))).abs() < 1e-5, "{y}");
}
