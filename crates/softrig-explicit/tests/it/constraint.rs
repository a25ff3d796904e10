//! Constraints on bodies in motion: exact at every step, momentum kept, conflicts named.

use softrig::integrate::State;
use softrig_explicit::constraint::{Constraint, ConstraintError, ConstraintId, Constraints};
use softrig_explicit::scheme::Scheme;
use softrig_explicit::stepper::{Stepper, StepperError};

/// Uniform in [0, 1): a fixed sequence (xorshift).
pub struct Random(u64);

impl Random {
    pub fn new(seed: u8) -> Self {
        Self(0x9E37_79B9_7F4A_7C15 ^ (u64::from(seed) << 32))
    }
    pub fn unit(&mut self) -> f64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }
    pub fn below(&mut self, n: usize) -> usize {
        (self.unit() * n as f64) as usize
    }
    pub fn point(&mut self) -> [f64; 3] {
        std::array::from_fn(|_| 2.0 * self.unit() - 1.0)
    }
}

const N: usize = 24;

/// Damped springs between all neighbours on a ring and across it: inner forces only.
fn springs(x: &[[f64; 3]], v: &[[f64; 3]], f: &mut [[f64; 3]]) {
    f.fill([0.0; 3]);
    for (reach, rest) in [(1, 0.3), (5, 0.9)] {
        for i in 0..N {
            let j = (i + reach) % N;
            let d: [f64; 3] = std::array::from_fn(|k| x[j][k] - x[i][k]);
            let l = d.iter().map(|d| d * d).sum::<f64>().sqrt().max(1e-6);
            for k in 0..3 {
                let p = 40.0 * (l - rest) * d[k] / l + 0.2 * (v[j][k] - v[i][k]);
                f[i][k] += p;
                f[j][k] -= p;
            }
        }
    }
}

fn body(seed: u8) -> (Vec<f64>, State<f64>) {
    let mut random = Random::new(seed);
    let mass: Vec<f64> = (0..N).map(|_| 0.5 + random.unit()).collect();
    let x: Vec<[f64; 3]> = (0..N).map(|_| random.point()).collect();
    let v: Vec<[f64; 3]> = (0..N).map(|_| random.point()).collect();
    (mass, State { velocity: v, ..State::at_rest(x) })
}

/// One of each two-way kind, on different nodes; no spring joins nodes that become one.
fn two_way(set: &mut Constraints) {
    for c in [
        Constraint::PointsToPoint { nodes: vec![0, 3] },
        Constraint::PointsToPoint { nodes: vec![1, 4, 8, 11] },
        Constraint::PointToLine { node: 6, carriers: [2, 5], weights: [0.25, 0.75] },
        Constraint::PointToTriangle { node: 7, carriers: [10, 12, 14], weights: [0.5, 0.2, 0.3] },
        Constraint::PointToTetrahedron { node: 9, carriers: [13, 15, 16, 17], weights: [0.1, 0.2, 0.3, 0.4] },
    ] {
        set.add(c).unwrap();
    }
    let surface = set.add_surface(vec![[18, 19, 20], [18, 21, 19], [19, 21, 20], [20, 21, 18]]).unwrap();
    set.add(Constraint::PointToSurface { node: 22, surface }).unwrap();
}

/// How far the constraints of [`two_way`] are from being met, sliding left out [m].
fn miss(x: &[[f64; 3]]) -> f64 {
    let sum = |w: &[(usize, f64)]| -> f64 {
        (0..3).map(|k| w.iter().map(|(n, w)| w * x[*n][k]).sum::<f64>().abs()).fold(0.0, f64::max)
    };
    [
        sum(&[(0, 1.0), (3, -1.0)]),
        sum(&[(1, 1.0), (4, -1.0)]),
        sum(&[(1, 1.0), (11, -1.0)]),
        sum(&[(6, -1.0), (2, 0.25), (5, 0.75)]),
        sum(&[(7, -1.0), (10, 0.5), (12, 0.2), (14, 0.3)]),
        sum(&[(9, -1.0), (13, 0.1), (15, 0.2), (16, 0.3), (17, 0.4)]),
    ]
    .into_iter()
    .fold(0.0, f64::max)
}

fn momentum(mass: &[f64], v: &[[f64; 3]]) -> [f64; 3] {
    std::array::from_fn(|k| mass.iter().zip(v).map(|(m, v)| m * v[k]).sum())
}

/// Every step of every scheme ends exactly on all constraints, and ten thousand of them leave the momentum where it was: inner and
/// constraint forces sum to zero. Rounding: each of some 1e4 steps x 24 nodes adds at most an ulp of about 1.
#[test]
fn two_way_constraints_are_exact_and_keep_momentum() {
    for scheme in Scheme::ALL {
        if scheme == Scheme::ExplicitEuler {
            continue;
        }
        let (mass, mut state) = body(3);
        let mut law = springs;
        let mut stepper = Stepper::new(scheme, &mass, &state.position, &mut law, 0.0).unwrap();
        stepper.start(&mut law, &mut state).unwrap();
        let mut set = Constraints::new(N);
        two_way(&mut set);
        // a start far from the constraints throws the nodes together in the first step
        let before = momentum(&mass, &state.velocity);
        let steps = if scheme == Scheme::ImplicitEuler { 300 } else { 10_000 };
        let start = state.position.clone();
        let mut fastest = 0.0f64;
        for step in 0..steps {
            stepper.step(&mut law, Some(&mut set), &mut state, 2e-3).unwrap();
            let size = state.position.iter().flatten().fold(1.0f64, |m, x| m.max(x.abs()));
            assert!(miss(&state.position) < 1e-14 * size, "{scheme:?} step {step}: {}", miss(&state.position));
            fastest = state.velocity.iter().flatten().fold(fastest, |m, v| m.max(v.abs()));
        }
        assert!(start.iter().zip(&state.position).all(|(a, b)| a != b), "{scheme:?}: nothing moved");
        let after = momentum(&mass, &state.velocity);
        let drift = (0..3).map(|k| (after[k] - before[k]).abs()).fold(0.0, f64::max);
        // implicit Euler solves to a tolerance, but its forces sum to zero too
        assert!(drift < 1e-13 * fastest * N as f64, "{scheme:?}: momentum {before:?} {after:?}, fastest {fastest}");
    }
}

/// A nail is met to the bit in every step, also while it moves, and holds with minus the other forces when all is at rest.
#[test]
fn nails_are_met_to_the_bit() {
    let mut law = |_: &[[f64; 3]], _: &[[f64; 3]], f: &mut [[f64; 3]]| f.fill([0.0, -9.81 * 2.0, 0.0]);
    for scheme in [Scheme::EulerCromer, Scheme::Verlet, Scheme::Midpoint, Scheme::RungeKutta2, Scheme::ImplicitEuler] {
        let mut stepper = Stepper::new(scheme, &[2.0], &[[0.0; 3]], &mut law, 0.0).unwrap();
        let mut state = State::at_rest(vec![[0.1, 0.2, 0.3]]);
        stepper.start(&mut law, &mut state).unwrap();
        let mut set = Constraints::new(1);
        let nail = set.add(Constraint::Nail { node: 0, goal: [0.1, 0.2, 0.3] }).unwrap();
        for _ in 0..10 {
            stepper.step(&mut law, Some(&mut set), &mut state, 0.01).unwrap();
            assert_eq!(state.position[0], [0.1, 0.2, 0.3]);
        }
        assert!((set.force()[0][1] - 9.81 * 2.0).abs() < 1e-9, "{scheme:?} {:?}", set.force());
        for k in 0..50 {
            let goal = [0.1 + 0.001 * f64::from(k), 0.2, 0.3];
            set.set_goal(nail, goal).unwrap();
            stepper.step(&mut law, Some(&mut set), &mut state, 0.01).unwrap();
            assert_eq!(state.position[0], goal);
        }
        set.set_active(nail, false).unwrap();
        stepper.step(&mut law, Some(&mut set), &mut state, 0.01).unwrap();
        assert!(state.position[0][1] < 0.2, "{scheme:?}: released, it falls");
        assert_eq!(set.force()[0], [0.0; 3]);
    }
}

/// j/n of the force in step j: the gap closes as the product of what each step leaves, and is shut from step n on.
#[test]
fn a_ramp_closes_a_gap_gradually() {
    let mut law = |_: &[[f64; 3]], _: &[[f64; 3]], f: &mut [[f64; 3]]| f.fill([0.0; 3]);
    let start = State::at_rest(vec![[0.0; 3], [10.0, 0.0, 0.0]]);
    let mut stepper = Stepper::new(Scheme::EulerCromer, &[1.0, 3.0], &start.position, &mut law, 0.0).unwrap();
    let mut set = Constraints::new(2);
    let id = set.add(Constraint::PointsToPoint { nodes: vec![0, 1] }).unwrap();
    set.ramp(id, 8).unwrap();
    let mut state = start.clone();
    let mut gaps = vec![10.0];
    for _ in 0..8 {
        stepper.step(&mut law, Some(&mut set), &mut state, 0.01).unwrap();
        gaps.push(state.position[1][0] - state.position[0][0]);
    }
    assert!((gaps[1] - 10.0 * (1.0 - 1.0 / 8.0)).abs() < 1e-12, "{gaps:?}");
    assert_eq!(gaps[8], 0.0, "{gaps:?}");
    // without a ramp the first step does it all, sixteen times as fast
    let mut set = Constraints::new(2);
    set.add(Constraint::PointsToPoint { nodes: vec![0, 1] }).unwrap();
    let mut sudden = start;
    stepper.step(&mut law, Some(&mut set), &mut sudden, 0.01).unwrap();
    assert_eq!(sudden.position[0], sudden.position[1]);
}

/// An approach closes every kind of gap as (1 - 3 s² + 2 s³) of what it was, from the first step to the last, keeps the momentum, and no node is
/// faster than 1.5 gaps over the whole time; a ramp of the force over as many steps is.
#[test]
fn an_approach_closes_gaps_evenly() {
    const N: u32 = 200;
    const H: f64 = 1e-3;
    let mut law = |_: &[[f64; 3]], _: &[[f64; 3]], f: &mut [[f64; 3]]| f.fill([0.0; 3]);
    let mut random = Random::new(31);
    let rest: Vec<[f64; 3]> = (0..10).map(|_| random.point()).collect();
    let mass: Vec<f64> = (0..10).map(|_| 1.5 + random.unit()).collect();
    let goal = [0.3, -0.2, 0.9];
    let list = [
        Constraint::PointsToPoint { nodes: vec![0, 1] },
        Constraint::PointsToPoint { nodes: vec![2, 3, 4] },
        Constraint::PointToTriangle { node: 5, carriers: [6, 7, 8], weights: [0.2, 0.5, 0.3] },
        Constraint::Nail { node: 9, goal },
    ];
    let gaps = |x: &[[f64; 3]]| -> Vec<f64> {
        let far = |a: [f64; 3], b: [f64; 3]| (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f64>().sqrt();
        let carried = std::array::from_fn(|k| 0.2 * x[6][k] + 0.5 * x[7][k] + 0.3 * x[8][k]);
        vec![far(x[0], x[1]), far(x[2], x[3]), far(x[3], x[4]), far(x[5], carried), far(x[9], goal)]
    };
    let before = gaps(&rest);
    let largest = before.iter().fold(0.0f64, |m, g| m.max(*g));
    for scheme in [Scheme::EulerCromer, Scheme::Verlet] {
        let fastest = [true, false].map(|even| {
            let mut set = Constraints::new(10);
            for c in &list {
                let id = set.add(c.clone()).unwrap();
                if even { set.approach(id, N) } else { set.ramp(id, N) }.unwrap();
            }
            let mut stepper = Stepper::new(scheme, &mass, &rest, &mut law, 0.0).unwrap();
            let mut state = State::at_rest(rest.clone());
            let mut fastest = 0.0f64;
            for j in 1..=N + 3 {
                let was = state.position.clone();
                stepper.step(&mut law, Some(&mut set), &mut state, H).unwrap();
                for (a, b) in was.iter().zip(&state.position) {
                    fastest = (0..3).fold(fastest, |m, k| m.max((a[k] - b[k]).abs() / H));
                }
                if even {
                    let s = (f64::from(j) / f64::from(N)).min(1.0);
                    for (now, then) in gaps(&state.position).iter().zip(&before) {
                        assert!(
                            (now - then * (1.0 - s * s * (3.0 - 2.0 * s))).abs() < 1e-13,
                            "{scheme:?} {j} {now} {then}"
                        );
                    }
                    for k in 0..3 {
                        // all but what the nail holds
                        let p: f64 = (0..9).map(|i| mass[i] * state.velocity[i][k]).sum();
                        // positions are rounded, and a step divides that by its length: 200 steps, 9 nodes of 2.5 kg
                        assert!(p.abs() < 1e-9, "{scheme:?} {j} {p}");
                    }
                }
            }
            fastest
        });
        assert!(
            fastest[0] > 0.1 && fastest[0] <= 1.5 * largest / (f64::from(N) * H),
            "{scheme:?} {fastest:?} {largest}"
        );
        assert!(fastest[1] > 4.0 * fastest[0], "{scheme:?} {fastest:?}");
    }
}

/// A point on a moving closed surface stays on it and slides along it.
#[test]
fn a_sliding_point_stays_on_its_surface() {
    // a fixed box of two by two by two around the origin, and a heavy point thrown across its top
    let corner = |i: u32| -> [f64; 3] { std::array::from_fn(|k| if i >> k & 1 == 1 { 1.0 } else { -1.0 }) };
    let faces = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let triangles: Vec<[u32; 3]> = faces.iter().flat_map(|f| [[f[0], f[1], f[2]], [f[0], f[2], f[3]]]).collect();
    let mut x: Vec<[f64; 3]> = (0..8).map(corner).collect();
    x.push([0.3, 1.0, 0.1]);
    let mut state = State::at_rest(x.clone());
    state.velocity[8] = [-0.7, 2.0, 0.4];
    let mut mass = vec![0.0; 8];
    mass.push(1.5);
    let mut law = |_: &[[f64; 3]], _: &[[f64; 3]], f: &mut [[f64; 3]]| f.fill([0.0; 3]);
    let mut stepper = Stepper::new(Scheme::Verlet, &mass, &x, &mut law, 0.0).unwrap();
    let mut set = Constraints::new(9);
    let surface = set.add_surface(triangles.clone()).unwrap();
    set.add(Constraint::PointToSurface { node: 8, surface }).unwrap();
    for _ in 0..100 {
        stepper.step(&mut law, Some(&mut set), &mut state, 0.01).unwrap();
        assert!((state.position[8][1] - 1.0).abs() < 1e-14, "{:?}", state.position[8]);
    }
    // tangential motion is free
    assert!((state.position[8][0] - (0.3 - 0.7)).abs() < 1e-9, "{:?}", state.position[8]);
    assert_eq!(state.position[..8], x[..8]);
    // an open surface has a rim to slide off
    let mut open = Constraints::new(9);
    let refused = open.add_surface(triangles[1..].to_vec()).unwrap_err();
    assert!(matches!(refused, ConstraintError::OpenSurface { edges: 3, .. }), "{refused}");
}

#[test]
fn what_is_no_constraint_is_refused_by_name() {
    let mut set = Constraints::new(5);
    let nail = |node| Constraint::Nail { node, goal: [0.0; 3] };
    let first = set.add(nail(2)).unwrap();
    let joined = Constraint::PointsToPoint { nodes: vec![2, 3] };
    let e = set.add(joined.clone()).unwrap_err();
    assert!(e.to_string().contains("node 2 is held by nail 0 and by points-to-point 1"), "{e}");
    assert!(matches!(set.add(nail(5)), Err(ConstraintError::MissingNode { node: 5, .. })));
    let line = |weights| Constraint::PointToLine { node: 0, carriers: [1, 3], weights };
    for weights in [[1.2, -0.2], [0.4, 0.4], [f64::NAN, 1.0]] {
        assert!(matches!(set.add(line(weights)), Err(ConstraintError::Weights { .. })), "{weights:?}");
    }
    assert!(matches!(set.add(Constraint::PointsToPoint { nodes: vec![1] }), Err(ConstraintError::TooFewNodes { .. })));
    let twice = Constraint::PointToLine { node: 1, carriers: [1, 3], weights: [0.5, 0.5] };
    assert!(matches!(set.add(twice), Err(ConstraintError::RepeatedNode { node: 1, .. })));
    let far = Constraint::Nail { node: 0, goal: [f64::NAN, 0.0, 0.0] };
    assert!(matches!(set.add(far), Err(ConstraintError::NotFinite { .. })));
    assert!(matches!(set.set_goal(ConstraintId(9), [0.0; 3]), Err(ConstraintError::Unknown { id: 9, .. })));
    // switched off, the nail no longer holds its node; switching it on again meets the other
    set.set_active(first, false).unwrap();
    let other = set.add(joined).unwrap();
    assert!(matches!(set.set_active(first, true), Err(ConstraintError::Conflict { .. })));
    set.remove(other).unwrap();
    set.set_active(first, true).unwrap();
    assert_eq!(set.active_count(), 1);
    let mut state = State::at_rest(vec![[0.0; 3]; 4]);
    assert!(matches!(
        set.enforce(Scheme::Verlet, 0.01, &[1.0; 4], &mut state),
        Err(ConstraintError::NodeCount { expected: 5, found: 4 })
    ));
}

/// A hundred thousand random sets, most of them with nonsense in them: constraints, switches, ramps and steps. What is accepted gives numbers;
/// what is refused leaves the state alone.
#[test]
fn random_sets_never_give_nan() {
    let mut random = Random::new(7);
    let (mut accepted, mut refused, mut failed) = (0u32, 0u32, 0u32);
    let (mass, start) = body(11);
    let mut law = springs;
    let mut steppers: Vec<_> = Scheme::ALL
        .iter()
        .filter(|s| **s != Scheme::ImplicitEuler)
        .map(|s| Stepper::new(*s, &mass, &start.position, &mut law, 0.0).unwrap())
        .collect();
    for round in 0..100_000 {
        let mut set = Constraints::new(N);
        let node = |random: &mut Random| random.below(N + 1) as u32;
        for _ in 0..=random.below(6) {
            let weight = |random: &mut Random| {
                let a = if random.below(8) == 0 { 1.5 } else { random.unit() };
                [a, 1.0 - a]
            };
            let c = match random.below(6) {
                0 => Constraint::Nail { node: node(&mut random), goal: random.point() },
                1 => Constraint::Velocity { node: node(&mut random), goal: random.point() },
                2 => {
                    let count = random.below(5);
                    Constraint::PointsToPoint { nodes: (0..count).map(|_| node(&mut random)).collect() }
                }
                3 => Constraint::PointToLine {
                    node: node(&mut random),
                    carriers: [node(&mut random), node(&mut random)],
                    weights: weight(&mut random),
                },
                4 => {
                    let [a, b] = weight(&mut random);
                    let carriers = std::array::from_fn(|_| node(&mut random));
                    Constraint::PointToTriangle { node: node(&mut random), carriers, weights: [a, 0.5 * b, 0.5 * b] }
                }
                _ => {
                    let t = random.below(N - 4) as u32;
                    let f = [[t, t + 1, t + 2], [t, t + 3, t + 1], [t + 1, t + 3, t + 2], [t + 2, t + 3, t]];
                    match set.add_surface(f[..3 + random.below(2)].to_vec()) {
                        Ok(surface) => Constraint::PointToSurface { node: node(&mut random), surface },
                        Err(_) => continue,
                    }
                }
            };
            match set.add(c) {
                Ok(id) => {
                    accepted += 1;
                    if random.below(4) == 0 {
                        let steps = random.below(5) as u32;
                        if random.below(2) == 0 { set.ramp(id, steps) } else { set.approach(id, steps) }.unwrap();
                    }
                }
                Err(_) => refused += 1,
            }
        }
        let count = steppers.len();
        let stepper = &mut steppers[round % count];
        let mut state = start.clone();
        for _ in 0..2 {
            let before = state.clone();
            match stepper.step(&mut law, Some(&mut set), &mut state, 1e-3) {
                Ok(_) => assert!(state.position.iter().chain(&state.velocity).flatten().all(|x| x.is_finite())),
                Err(StepperError::Constraint(_)) => {
                    failed += 1;
                    assert_eq!(before, state);
                }
                Err(e) => panic!("{e}"),
            }
        }
    }
    assert!(accepted > 50_000 && refused > 50_000 && failed > 1000, "{accepted} {refused} {failed}");
}
