//! Two rigid links that hang on each other: stiff flesh on two hinges against the articulated pendulum, integrated on its own.

use crate::couple::stumps;
use crate::twoway::{flesh, hinge, settings, simulation};
use glam::DVec2;
use softrig::material::Material;
use softrig::rig::RootKind;
use softrig::simulation::{Coupling, RestMotion, Simulation, SimulationSettings, TwoWay, TwoWayScheme};

const G: f64 = 9.81;
const SECONDS: f64 = 0.5;

/// Mass, centre about its joint, and moment about its joint, in the plane of the swing.
#[derive(Default)]
struct Link {
    mass: f64,
    centre: DVec2,
    moment: f64,
}

impl Link {
    fn of(sim: &Simulation<f64>, joint: DVec2, bone: u32) -> Self {
        let mut out = Self::default();
        // by owner: cells reach beyond the skin, some across the joint
        let owned = sim.body.mesh.nodes.iter().zip(&sim.body.mass).zip(&sim.binding.owner);
        for ((p, m), _) in owned.filter(|(_, owner)| **owner == bone) {
            let r = DVec2::new(p[0], p[1]) - joint;
            out.mass += m;
            out.centre += r * *m;
            out.moment += m * r.length_squared();
        }
        out.centre /= out.mass;
        out
    }
}

/// Accelerations of the two angles: Lagrange's equations of the double pendulum, the second joint at `arm` from the first.
fn acceleration(first: &Link, second: &Link, arm: DVec2, angle: [f64; 2], rate: [f64; 2]) -> [f64; 2] {
    let turn = |a: f64, v: DVec2| DVec2::from_angle(a).rotate(v);
    let (l, c1, c2) = (turn(angle[0], arm), turn(angle[0], first.centre), turn(angle[1], second.centre));
    let m2 = second.mass;
    let (a, b) = (first.moment + m2 * arm.length_squared(), m2 * l.dot(c2));
    let c = second.moment;
    let f = [
        -m2 * l.dot(c2.perp()) * rate[1] * rate[1] - G * (first.mass * c1.x + m2 * l.x),
        -m2 * l.perp().dot(c2) * rate[0] * rate[0] - G * m2 * c2.x,
    ];
    let det = a * c - b * b;
    [(f[0] * c - b * f[1]) / det, (a * f[1] - b * f[0]) / det]
}

/// Angles of the links after [`SECONDS`], by Runge and Kutta's method of fourth order.
fn pendulum(first: &Link, second: &Link, arm: DVec2) -> [f64; 2] {
    let steps = 5000;
    let h = SECONDS / f64::from(steps);
    let mut y = [0.0f64; 4];
    let slope = |y: [f64; 4]| {
        let a = acceleration(first, second, arm, [y[0], y[1]], [y[2], y[3]]);
        [y[2], y[3], a[0], a[1]]
    };
    let at = |y: [f64; 4], k: [f64; 4], h: f64| std::array::from_fn(|i| y[i] + h * k[i]);
    for _ in 0..steps {
        let k1 = slope(y);
        let k2 = slope(at(y, k1, 0.5 * h));
        let k3 = slope(at(y, k2, 0.5 * h));
        let k4 = slope(at(y, k3, h));
        y = std::array::from_fn(|i| y[i] + h / 6.0 * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i]));
    }
    [y[0], y[1]]
}

/// Angles of the two bones against the pendulum's, after [`SECONDS`] from the horizontal.
fn errors(young_modulus: f64, h: f64, tolerance: f64) -> [f64; 2] {
    let character = stumps();
    let motion = RestMotion(&character.skeleton);
    let material = Material { stiffness_damping: 0.0, ..flesh(young_modulus) };
    let settings = SimulationSettings { preroll: 0.0, tolerance, ..settings(h) };
    let mut sim = simulation(&character, 200, material, settings);
    let joints = vec![hinge([-3.1, 3.1], 0.0); 2];
    let two = TwoWay { scheme: TwoWayScheme::Monolithic, joints, root: RootKind::Pinned };
    sim.couple(&Coupling::TwoWay(two), vec![]).unwrap();
    let [root, elbow] = [DVec2::new(-0.3, 0.0), DVec2::ZERO];
    let (first, second) = (Link::of(&sim, root, 0), Link::of(&sim, elbow, 1));
    assert!(first.mass > 1.0 && second.mass > 1.0);
    let expected = pendulum(&first, &second, elbow - root);
    assert!(expected[0] < -1.0, "it must have swung: {expected:?}");
    sim.start(&motion).unwrap();
    let frames = (SECONDS / h).round() as usize;
    for f in 1..=frames {
        let report = sim.advance(&motion, f as f64 * h).unwrap();
        // fast bones cut a frame into more steps, and then the step is not the one that is asked about
        assert_eq!(report.substeps, 1, "frame {f} of {frames}");
        assert_eq!(report.unconverged_steps, 0, "frame {f} of {frames}");
    }
    [0, 1].map(|j| {
        let l = &sim.pose().world[j].linear;
        let is = l[1][0].atan2(l[0][0]);
        let off = is - expected[j];
        off - std::f64::consts::TAU * (off / std::f64::consts::TAU).round()
    })
}

/// In steps half as long, half as much is missing; by extrapolation nothing: first order, and the right pendulum.
#[test]
fn stiff_links_swing_as_an_articulated_pendulum() {
    let all = [480.0, 960.0, 1920.0].map(|n| errors(3e7, 1.0 / n, 1e-8));
    eprintln!("angles off by {all:?} rad at h 1/480, 1/960, 1/1920");
    for joint in 0..2 {
        let e = all.map(|e| e[joint]);
        let ratio = [e[0] / e[1], e[1] / e[2]];
        assert!(ratio.iter().all(|r| (r - 2.0).abs() < 0.15), "joint {joint}: {e:?}");
        let left = 2.0 * e[2] - e[1];
        assert!(left.abs() < 5e-4 && e[2].abs() < 0.01, "joint {joint}: {e:?}, {left} at no step");
    }
}

/// As the flesh gets stiff it swings as the pendulum does: ten times the stiffness leaves less of the error of sagging.
#[test]
fn links_approach_the_pendulum_as_they_get_stiff() {
    let e: Vec<[f64; 2]> = [1e4, 1e5, 3e7].iter().map(|e| errors(*e, 1.0 / 480.0, 1e-6)).collect();
    let off = |k: usize| (0..2).map(|j| (e[k][j] - e[2][j]).abs()).fold(0.0, f64::max);
    eprintln!("soft links are off the stiff ones by {:.1e} and {:.1e} rad", off(0), off(1));
    assert!(off(0) > 5.0 * off(1) && off(1) < 0.01, "{e:?}");
}
