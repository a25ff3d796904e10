//! Flesh and skeleton against the laws of motion, worked out from positions and velocities alone: springs of joints and of hands,
//! drag, wind, and what joints carry while they move.

use crate::couple::{limb, stumps};
use crate::twoway::{ball, flesh, hinge, momentum, settings, simulation};
use glam::DVec3;
use softrig::character::Character;
use softrig::integrate::Dynamics;
use softrig::material::Material;
use softrig::rig::{JointId, JointSetup, RootKind};
use softrig::simulation::{
    Action, Coupling, Event, Key, RestMotion, Simulation, SimulationSettings, TwoWay, TwoWayScheme,
};
use std::collections::HashSet;
use std::f64::consts::TAU;

const H: f64 = 1.0 / 120.0;
const G: DVec3 = DVec3::new(0.0, -9.81, 0.0);
/// Where the first joint of limb and stumps rests.
const ROOT: DVec3 = DVec3::new(-0.3, 0.0, 0.0);

/// Started at rest, in steps of [`H`] that are solved far beyond what the checks ask for.
fn started(
    character: &Character,
    material: Material,
    (gravity, dynamics): (DVec3, Dynamics),
    joints: [JointSetup; 2],
    root: RootKind,
    events: Vec<Event>,
) -> Simulation<f64> {
    let exact = SimulationSettings {
        gravity: gravity.into(),
        dynamics,
        preroll: 0.0,
        tolerance: 1e-8,
        coupled_linearisations: 4,
        ..settings(H)
    };
    let mut sim = simulation(character, 200, material, exact);
    let two = TwoWay { scheme: TwoWayScheme::Monolithic, joints: joints.to_vec(), root };
    sim.couple(&Coupling::TwoWay(two), events).unwrap();
    sim.start(&RestMotion(&character.skeleton)).unwrap();
    sim
}

fn fixed() -> JointSetup {
    JointSetup::default()
}

fn place(sim: &Simulation<f64>, n: usize) -> DVec3 {
    DVec3::from(sim.state.position[n])
}

/// Gives all nodes the velocities of a rigid body that turns about an axis through `centre` and drifts.
fn set_spinning(sim: &mut Simulation<f64>, centre: DVec3, spin: DVec3, drift: DVec3) {
    for n in 0..sim.state.position.len() {
        sim.state.velocity[n] = (drift + spin.cross(place(sim, n) - centre)).into();
    }
}

/// Angle of the first bone about Z.
fn angle(sim: &Simulation<f64>) -> f64 {
    let l = &sim.pose().world[0].linear;
    l[1][0].atan2(l[0][0])
}

/// Moment about an axis along Z through the root, and the mean of those about all axes.
fn moments(sim: &Simulation<f64>) -> [f64; 2] {
    let mut sums = [0.0; 2];
    for (x, m) in sim.body.mesh.nodes.iter().zip(&sim.body.mass) {
        let r = DVec3::from(*x) - ROOT;
        sums[0] += m * (r.x * r.x + r.y * r.y);
        sums[1] += m * r.length_squared() * 2.0 / 3.0;
    }
    sums
}

/// A stiff limb on a hinge, pushed: led by its clip, sprung and damped by its joint, or both, it moves as the damped spring that the
/// settings describe, which is integrated on its own by the same rule.
#[test]
fn joints_swing_as_the_springs_they_are() {
    let character = limb();
    let motion = RestMotion(&character.skeleton);
    for (drive, stiffness, damping) in [(0.5, 0.0, 0.0), (0.0, 60.0, 0.0), (0.0, 30.0, 4.0), (0.2, 5.0, 1.0)] {
        let setup = JointSetup { drive, stiffness, ..hinge([-3.0, 3.0], damping) };
        let free = (DVec3::ZERO, Dynamics::Calm);
        let mut sim = started(&character, flesh(3e7), free, [setup, fixed()], RootKind::Pinned, vec![]);
        let [moment, mean] = moments(&sim);
        // twice a second at a drive of one half, damped just so that it does not overshoot
        let led = mean * (2.0 * TAU).powi(2) * drive / (1.0 - drive);
        let (k, c) = (led + stiffness, 2.0 * (led * mean).sqrt() + damping);
        let (mut theta, mut omega) = (0.0, 2.0);
        set_spinning(&mut sim, ROOT, DVec3::Z * omega, DVec3::ZERO);
        let mut most = 0.0f64;
        for f in 1..=60 {
            sim.advance(&motion, f as f64 * H).unwrap();
            omega = (moment * omega - H * k * theta) / (moment + H * c + H * H * k);
            theta += H * omega;
            most = most.max(theta);
            let off = angle(&sim) - theta;
            assert!(off.abs() < 0.01 * most, "{drive} {stiffness} {damping} step {f}: {} {theta}", angle(&sim));
        }
        assert!(most > 0.03, "it must have swung: {most}");
    }
}

/// A floating root that its clip leads by a half hangs below it by what its spring gives under the weight.
#[test]
fn a_led_root_hangs_on_its_spring() {
    let character = limb();
    let motion = RestMotion(&character.skeleton);
    let led = JointSetup { drive: 0.5, ..ball(0.0) };
    let mut sim = started(&character, flesh(3e6), (G, Dynamics::Calm), [led, fixed()], RootKind::Free, vec![]);
    for f in 1..=90 {
        sim.advance(&motion, f as f64 / 30.0).unwrap();
    }
    let hangs = DVec3::from(sim.pose().world[0].translation) - ROOT;
    let expected = G / (2.0 * TAU).powi(2);
    assert!(hangs.distance(expected) < 1e-4, "{hangs} {expected}");
}

/// Drag of mass takes the same share of speed from flesh and from what is bound to bones: a spin dies away by 1 + α h a step, about a
/// hinge that holds it and in the air, where the drift does too.
#[test]
fn drag_slows_bound_and_free_nodes_alike() {
    let character = limb();
    let motion = RestMotion(&character.skeleton);
    let alpha = 5.0;
    let material = Material { mass_damping: alpha, ..flesh(3e7) };
    let free = (DVec3::ZERO, Dynamics::Calm);
    let pinned = [hinge([-3.0, 3.0], 0.0), fixed()];
    let mut sim = started(&character, material, free, pinned, RootKind::Pinned, vec![]);
    let (mut omega, mut theta) = (1.0, 0.0);
    set_spinning(&mut sim, ROOT, DVec3::Z * omega, DVec3::ZERO);
    for f in 1..=60 {
        sim.advance(&motion, f as f64 * H).unwrap();
        omega /= 1.0 + alpha * H;
        theta += H * omega;
        assert!((angle(&sim) - theta).abs() < 1e-3 * theta, "step {f}: {} {theta}", angle(&sim));
    }
    let mut sim = started(&character, material, free, [ball(0.0), fixed()], RootKind::Free, vec![]);
    set_spinning(&mut sim, DVec3::ZERO, DVec3::new(0.2, 0.5, 1.0), DVec3::new(0.3, 0.1, 0.0));
    let (p, l, _) = momentum(&sim);
    for f in 1..=20 {
        sim.advance(&motion, f as f64 * H).unwrap();
        let left = (1.0 + alpha * H).powi(-f);
        let (q, k, _) = momentum(&sim);
        // a spin is slowed by drag at places that the step still moves a little
        let off = [(q - p * left).length() / p.length(), (k - l * left).length() / l.length()];
        assert!(off[0] < 1e-10 && off[1] < 1e-4, "step {f}: {q} of {p}, {k} of {l}: {off:?}");
    }
}

/// What springs of events give a floating body: stiffness times how far the target is at the end of the step (or as far as it counts),
/// and damping times how much faster the target is.
#[test]
fn hands_pull_by_their_law() {
    let character = limb();
    let motion = RestMotion(&character.skeleton);
    let keys = [(0.0, 0.0), (0.1, 0.05), (1.0, 0.7)];
    let path: Vec<Key> = keys.map(|(time, x)| Key { time, position: [x - 0.3, 2.0 * x, 0.1 * x] }).to_vec();
    let far = vec![Key { time: 0.0, position: [-300.0, 400.0, 0.0] }];
    let k = 300.0;
    for (flesh_pulled, path) in [(false, path.clone()), (true, path), (false, far.clone()), (true, far)] {
        let action = if flesh_pulled {
            Action::PullFlesh { mesh: 0, vertex: 700, path: path.clone(), stiffness: Some(k) }
        } else {
            Action::DragJoint { joint: JointId(0), path: path.clone(), stiffness: Some(k) }
        };
        let event = Event { start: 0.0, end: 9.0, action };
        let free = (DVec3::ZERO, Dynamics::Calm);
        let joints = [ball(0.0), hinge([-2.0, 2.0], 0.0)];
        let mut sim = started(&character, flesh(3e4), free, joints, RootKind::Free, vec![event]);
        let damping = 2.0 * (k * sim.body.total_mass()).sqrt();
        let (lo, hi) = sim.body.mesh.bounds().unwrap();
        let longest = 0.3 * (hi[0] - lo[0]);
        let point = |sim: &mut Simulation<f64>| {
            if flesh_pulled { sim.frame(0).skin[0][700] } else { sim.pose().world[0].translation }
        };
        for f in 1..=20 {
            let (t, before, then) = (f as f64 * H, momentum(&sim).0, DVec3::from(point(&mut sim)));
            assert_eq!(sim.advance(&motion, t).unwrap().substeps, 1);
            let now = DVec3::from(point(&mut sim));
            let last = path.iter().rposition(|k| k.time < t).unwrap();
            let (mut target, mut speed) = (DVec3::from(path[last].position), DVec3::ZERO);
            if let Some(next) = path.get(last + 1) {
                speed = (DVec3::from(next.position) - target) / (next.time - path[last].time);
                target += speed * (t - path[last].time);
            }
            // flesh is pulled to a nearer place on the way there, joints by no more than a spring of that length
            let reach = if flesh_pulled {
                then + (target - then).clamp_length_max(longest + H * speed.length()) - now
            } else {
                (target - now).clamp_length_max(longest)
            };
            let force = reach * k + (speed - (now - then) / H) * damping;
            let gained = (momentum(&sim).0 - before) / H;
            assert!(
                gained.distance(force) < 1e-3 * (1.0 + force.length()),
                "flesh {flesh_pulled}, step {f}: {gained} {force}"
            );
        }
    }
}

/// Wind on a body at rest presses on the faces that it meets, by half the density of air times the square of its speed; a body that
/// flies with it feels none.
#[test]
fn wind_presses_on_what_it_meets() {
    let character = limb();
    let motion = RestMotion(&character.skeleton);
    let wind = DVec3::new(0.0, 0.0, -6.0);
    for drift in [DVec3::ZERO, wind, wind * 0.5] {
        let event = Event { start: 0.0, end: 9.0, action: Action::Wind(wind.into()) };
        let free = (DVec3::ZERO, Dynamics::Calm);
        let joints = [ball(0.0), hinge([-2.0, 2.0], 0.0)];
        let mut sim = started(&character, flesh(3e4), free, joints, RootKind::Free, vec![event]);
        set_spinning(&mut sim, DVec3::ZERO, DVec3::ZERO, drift);
        // cubes without one in front of them
        let h = sim.body.mesh.lattice.as_ref().unwrap().spacing;
        let centre =
            |c: &[u32; 8]| c.iter().map(|n| DVec3::from(sim.body.mesh.nodes[*n as usize])).sum::<DVec3>() / 8.0;
        let cell = |p: DVec3| (p / (0.5 * h)).round().to_array().map(|v| v as i64);
        let all: HashSet<[i64; 3]> = sim.body.mesh.hexes.iter().map(|c| cell(centre(c))).collect();
        let faces = sim.body.mesh.hexes.iter().filter(|c| !all.contains(&cell(centre(c) + DVec3::Z * h))).count();
        let before = momentum(&sim).0;
        sim.advance(&motion, H).unwrap();
        let gained = (momentum(&sim).0 - before) / H;
        let against = wind - drift;
        let expected = against * against.length() * 0.5 * 1.2 * h * h * faces as f64;
        assert!(faces > 20 && gained.distance(expected) < 1e-5 * (0.1 + expected.length()), "{gained} {expected}");
    }
}

/// A double pendulum of soft, damped stumps, one of them held at a point of its flesh that bones carry: what each joint passes on is
/// weight, drag and pull less what the motion of all below it takes, and about the axes of hinges, which nothing resists, there is no torque.
#[test]
fn joints_pass_on_what_motion_leaves_of_the_loads() {
    let character = stumps();
    let motion = RestMotion(&character.skeleton);
    let pull = Action::PullFlesh { mesh: 0, vertex: 1443, path: vec![], stiffness: Some(100.0) };
    let events = vec![Event { start: 0.0, end: 9.0, action: pull }];
    let joints = [hinge([-3.1, 3.1], 0.0); 2];
    let material = Material { mass_damping: 2.0, ..flesh(5e4) };
    assert!(material.stiffness_damping > 0.0);
    let mut sim = started(&character, material, (G, Dynamics::Calm), joints, RootKind::Pinned, events);
    let damping = 2.0 * (100.0 * sim.body.total_mass()).sqrt();
    let target = DVec3::from(sim.frame(0).skin[0][1443]);
    for f in 1..=40 {
        let (before, then) = (sim.state.velocity.clone(), DVec3::from(sim.frame(0).skin[0][1443]));
        assert_eq!(sim.advance(&motion, f as f64 * H).unwrap().substeps, 1);
        let point = DVec3::from(sim.frame(0).skin[0][1443]);
        let pull = (target - point) * 100.0 - (point - then) / H * damping;
        for (joint, reaction) in sim.joint_reaction().iter().enumerate() {
            let at = DVec3::from(sim.pose().world[joint].translation);
            let (mut force, mut torque) = (pull, (point - at).cross(pull));
            for n in (0..before.len()).filter(|n| sim.binding.owner[*n] as usize >= joint) {
                let rate = (DVec3::from(sim.state.velocity[n]) - DVec3::from(before[n])) / H;
                let drag = DVec3::from(sim.state.velocity[n]) * 2.0;
                let f = (G - rate - drag) * sim.body.mass[n];
                force += f;
                torque += (place(&sim, n) - at).cross(f);
            }
            let (is, about) = (DVec3::from(reaction.force), DVec3::from(reaction.torque));
            let size = sim.body.total_mass() * G.length();
            assert!(is.distance(force) < 1e-3 * size, "step {f} joint {joint}: {is} {force}");
            assert!(about.distance(torque) < 1e-4 * size, "step {f} joint {joint}: {about} {torque}");
            assert!(about.z.abs() < 1e-4 * size, "step {f} joint {joint}: {about}");
        }
    }
    assert!(angle(&sim) < -0.1, "it must have swung: {}", angle(&sim));
}

/// Newmark's rule ties velocities and accelerations of free nodes together, also where the whole body is moved a little to keep its
/// momentum; bound nodes get where they are by their speed.
#[test]
fn velocities_follow_from_accelerations_by_the_scheme() {
    let character = limb();
    let motion = RestMotion(&character.skeleton);
    let free = (DVec3::ZERO, Dynamics::Lively);
    let joints = [ball(0.0), hinge([-2.0, 2.0], 0.0)];
    let mut sim = started(&character, flesh(2e4), free, joints, RootKind::Free, vec![]);
    set_spinning(&mut sim, DVec3::ZERO, DVec3::new(1.0, 3.0, 6.0), DVec3::new(0.3, 0.1, 0.0));
    for f in 1..=20 {
        let before = sim.state.clone();
        sim.advance(&motion, f as f64 * H).unwrap();
        for n in 0..before.position.len() {
            let of = |list: &[[f64; 3]]| DVec3::from(list[n]);
            let (was, is) = (of(&before.velocity), of(&sim.state.velocity));
            let expected = if sim.binding.bound[n] {
                (place(&sim, n) - of(&before.position)) / H
            } else {
                was + (of(&before.acceleration) * 0.4 + of(&sim.state.acceleration) * 0.6) * H
            };
            assert!(is.distance(expected) < 1e-9, "step {f} node {n}: {is} {expected}");
        }
    }
}
