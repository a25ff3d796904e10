//! Flesh and skeleton together: what two-way coupling promises, on a limb of two bones and on the sample character.

use crate::couple::limb;
use glam::DVec3;
use softrig::character::Character;
use softrig::couple::{BindSettings, Binding};
use softrig::integrate::Dynamics;
use softrig::material::{Material, MaterialMap};
use softrig::mesh::{self, LatticeOptions, Resolution};
use softrig::rig::{Affine, Clip, JointId, JointKind, JointSetup, Pose, RootKind, automatic};
use softrig::simulation::{
    Action, Coupling, Event, Key, Motion, RestMotion, Simulation, SimulationSettings, TwoWay, TwoWayScheme,
};
use std::f64::consts::PI;

const G: f64 = 9.81;

fn simulation(
    character: &Character,
    cells: usize,
    material: Material,
    settings: SimulationSettings,
) -> Simulation<f64> {
    let options = LatticeOptions { resolution: Resolution::Cells(cells), ..LatticeOptions::default() };
    let volume = mesh::voxelize(&character.surface(true), &options).unwrap();
    let binding = Binding::new(character, &volume, &BindSettings::default()).unwrap();
    Simulation::new(character, volume, binding, &MaterialMap::uniform(material), settings).unwrap()
}

fn flesh(young_modulus: f64) -> Material {
    Material { young_modulus, mass_damping: 0.0, ..Material::default() }
}

fn ball(damping: f64) -> JointSetup {
    let kind = JointKind::Ball { axis: [1.0, 0.0, 0.0], cone: PI, twist: [-PI, PI] };
    JointSetup { kind, drive: 0.0, stiffness: 0.0, damping }
}

fn hinge(range: [f64; 2], damping: f64) -> JointSetup {
    JointSetup { kind: JointKind::Hinge { axis: [0.0, 0.0, 1.0], range }, drive: 0.0, stiffness: 0.0, damping }
}

/// The limb with its two joints as given.
fn coupled_limb(
    e: f64,
    settings: SimulationSettings,
    joints: [JointSetup; 2],
    root: RootKind,
    events: Vec<Event>,
) -> Simulation<f64> {
    let mut sim = simulation(&limb(), 400, flesh(e), settings);
    sim.couple(&Coupling::TwoWay(TwoWay { scheme: TwoWayScheme::Monolithic, joints: joints.to_vec(), root }), events)
        .unwrap();
    sim
}

fn settings(h: f64) -> SimulationSettings {
    SimulationSettings { longest_step: h, preroll: 0.2, tolerance: 1e-6, ..SimulationSettings::default() }
}

/// Runs for `seconds` in frames of 1/30 s; checks on the way that limits hold, bones are rigid, and flesh hangs on them.
fn run(sim: &mut Simulation<f64>, motion: &dyn Motion, seconds: f64) {
    let frames = (seconds * 30.0).round() as usize;
    for f in 1..=frames {
        sim.advance(motion, f as f64 / 30.0).unwrap();
        assert!(sim.limit_violation() <= 1e-6, "frame {f}: {}", sim.limit_violation());
        assert!(sim.attachment_gap() < 1e-6 * 0.12, "frame {f}: {}", sim.attachment_gap());
        let bone = DVec3::from(sim.pose().world[1].translation).distance(DVec3::from(sim.pose().world[0].translation));
        assert!((bone - 0.3).abs() < 1e-9, "frame {f}: {bone}");
    }
}

fn weight(sim: &Simulation<f64>) -> f64 {
    sim.body.total_mass() * G
}

/// Let go from the horizontal, the limb swings down and hangs: its root holds its weight, and the tip is below the root.
#[test]
fn a_hanging_limb_pulls_on_its_root_with_its_weight() {
    let character = limb();
    let motion = RestMotion(&character.skeleton);
    let mut sim =
        coupled_limb(2e5, settings(1.0 / 60.0), [ball(0.6), hinge([-1.0, 1.0], 0.3)], RootKind::Pinned, vec![]);
    sim.start(&motion).unwrap();
    run(&mut sim, &motion, 12.0);
    let reaction = sim.joint_reaction()[0].force;
    let down = DVec3::from(sim.pose().world[1].translation) - DVec3::from(sim.pose().world[0].translation);
    eprintln!("reaction {reaction:?} weight {} down {down}", weight(&sim));
    assert!(down.y < -0.29, "{down}");
    assert!((reaction[1] + weight(&sim)).abs() < 1e-3 * weight(&sim), "{reaction:?} {}", weight(&sim));
    assert!(reaction[0].hypot(reaction[2]) < 1e-3 * weight(&sim), "{reaction:?}");
}

/// A pose that turns the whole limb about Z by `angle(t)`.
struct Swing<'a, F>(&'a Character, F);

impl<F: Fn(f64) -> f64 + Sync> Motion for Swing<'_, F> {
    fn pose(&self, time: f64) -> Pose {
        let q = glam::DQuat::from_rotation_z((self.1)(time));
        let turn = Affine::from_rotation(q.to_array());
        Pose { world: self.0.skeleton.joints().iter().map(|j| turn.after(&j.rest)).collect() }
    }
}

/// Wholly led by its clip, a coupled skeleton is the one-way simulation: the same equations, solved by another iteration.
#[test]
fn a_skeleton_led_by_its_clip_alone_is_one_way() {
    let character = limb();
    let motion = Swing(&character, |t: f64| 0.5 * (5.0 * t).sin());
    let calm = SimulationSettings { dynamics: Dynamics::Calm, tolerance: 1e-10, ..settings(1.0 / 60.0) };
    let mut one = simulation(&character, 400, flesh(2e4), calm.clone());
    one.start(&motion).unwrap();
    let led = JointSetup { drive: 1.0, ..ball(0.0) };
    let mut two = coupled_limb(2e4, calm, [led; 2], RootKind::Driven, vec![]);
    two.start(&motion).unwrap();
    let mut swung = 0.0f64;
    for f in 1..=20 {
        one.advance(&motion, f as f64 / 30.0).unwrap();
        two.advance(&motion, f as f64 / 30.0).unwrap();
        for (n, (a, b)) in one.state.position.iter().zip(&two.state.position).enumerate() {
            let off = DVec3::from(*a).distance(DVec3::from(*b));
            // one linearisation against two
            assert!(off < 2e-3, "frame {f} node {n}: {off}");
            swung = swung.max(DVec3::from(one.body.mesh.nodes[n]).distance(DVec3::from(*a)));
        }
    }
    assert!(swung > 0.1, "{swung}");
}

/// Stiff flesh on a hinge at its end is a physical pendulum: against the ordinary differential equation of that pendulum.
#[test]
fn stiff_flesh_swings_as_a_pendulum() {
    let character = limb();
    let motion = RestMotion(&character.skeleton);
    let fixed = JointSetup::default();
    let material = Material { stiffness_damping: 0.0, ..flesh(3e7) };
    let mut sim = simulation(&character, 400, material, SimulationSettings { preroll: 0.0, ..settings(1.0 / 480.0) });
    sim.couple(
        &Coupling::TwoWay(TwoWay {
            scheme: TwoWayScheme::Monolithic,
            joints: vec![hinge([-3.1, 3.1], 0.0), fixed],
            root: RootKind::Pinned,
        }),
        vec![],
    )
    .unwrap();
    let at = DVec3::from(character.skeleton.joints()[0].rest.translation);
    let (mut inertia, mut moment) = (0.0, DVec3::ZERO);
    for (p, m) in sim.body.mesh.nodes.iter().zip(&sim.body.mass) {
        let r = DVec3::from(*p) - at;
        inertia += m * (r.x * r.x + r.y * r.y);
        moment += r * *m;
    }
    let (arm, phase) = (moment.x.hypot(moment.y), moment.y.atan2(moment.x));
    sim.start(&motion).unwrap();
    let (mut theta, mut omega, step) = (0.0f64, 0.0f64, 1e-4f64);
    for f in 1..=30 {
        let t = f as f64 / 30.0;
        for _ in 0..(1.0 / 30.0 / step).round() as usize {
            // midpoint rule
            let a = |theta: f64| -G * arm * (theta + phase).cos() / inertia;
            let (middle, speed) = (theta + 0.5 * step * omega, omega + 0.5 * step * a(theta));
            omega += step * a(middle);
            theta += step * speed;
        }
        sim.advance(&motion, t).unwrap();
        let bone = DVec3::from(sim.pose().world[1].translation) - DVec3::from(sim.pose().world[0].translation);
        let is = bone.y.atan2(bone.x);
        let expected = (theta + PI).rem_euclid(2.0 * PI) - PI;
        // implicit Euler on the bound part damps a little: 1/2 h w^2 a second of the amplitude at most
        assert!((is - expected).abs() < 0.1, "{t}: {is} {expected}");
    }
    assert!(theta < -1.5, "{theta}");
}

/// Without gravity and drag, what a push has given a floating body stays: momentum as a whole, and torques balance.
#[test]
fn a_floating_body_keeps_its_momentum() {
    for tets in [false, true] {
        let character = limb();
        let motion = RestMotion(&character.skeleton);
        let calm = SimulationSettings {
            dynamics: Dynamics::Calm,
            tolerance: 1e-12,
            gravity: [0.0; 3],
            preroll: 0.0,
            ..settings(1.0 / 60.0)
        };
        let options = LatticeOptions { resolution: Resolution::Cells(200), ..LatticeOptions::default() };
        let mut volume = mesh::voxelize(&character.surface(true), &options).unwrap();
        if tets {
            volume = mesh::tetrahedralize(&volume);
        }
        let binding = Binding::new(&character, &volume, &BindSettings::default()).unwrap();
        let material = Material { stiffness_damping: 0.0, ..flesh(2e4) };
        let mut sim =
            Simulation::<f64>::new(&character, volume, binding, &MaterialMap::uniform(material), calm).unwrap();
        let push =
            Event { start: 0.0, end: 0.1, action: Action::Force { mesh: 0, vertex: 700, force: [3.0, 40.0, 10.0] } };
        let joints = vec![ball(0.0), hinge([-2.0, 2.0], 0.0)];
        sim.couple(
            &Coupling::TwoWay(TwoWay { scheme: TwoWayScheme::Monolithic, joints, root: RootKind::Free }),
            vec![push],
        )
        .unwrap();
        sim.start(&motion).unwrap();
        let momentum = |sim: &Simulation<f64>| {
            let each = sim.state.velocity.iter().zip(&sim.body.mass).map(|(v, m)| DVec3::from(*v) * *m);
            each.sum::<DVec3>()
        };
        for f in 1..=3 {
            sim.advance(&motion, f as f64 / 30.0).unwrap();
        }
        sim.advance(&motion, 0.12).unwrap();
        let start = momentum(&sim);
        assert!((start - DVec3::new(3.0, 40.0, 10.0) * 0.1).length() < 1e-3 * start.length(), "{start}");
        let (mut linear, mut torque, mut size) = (0.0f64, 0.0f64, 0.0f64);
        for f in 4..=40 {
            let before = sim.state.clone();
            // one step, so that the balance of the step can be told
            sim.advance(&motion, 0.12 + f as f64 / 60.0 - 4.0 / 60.0 + 1e-3).unwrap();
            linear = linear.max((momentum(&sim) - start).length() / start.length());
            let mut balance = DVec3::ZERO;
            for n in 0..before.position.len() {
                let (x, m) = (DVec3::from(sim.state.position[n]), sim.body.mass[n]);
                balance += x.cross((DVec3::from(sim.state.velocity[n]) - DVec3::from(before.velocity[n])) * m);
                size += x.cross(DVec3::from(before.velocity[n]) * m).length() / 37.0;
            }
            torque = torque.max(balance.length());
        }
        eprintln!("tets {tets}: momentum drift {linear:.1e}, torque balance {:.1e}", torque / size);
        assert!(linear < 1e-3, "{linear}");
        assert!(torque < 2e-3 * size, "{torque} {size}");
    }
}

/// Where a limb comes to rest does not depend on the step.
#[test]
fn the_settled_pose_does_not_depend_on_the_step() {
    let character = limb();
    let motion = RestMotion(&character.skeleton);
    let places: Vec<Vec<DVec3>> = [1.0 / 30.0, 1.0 / 240.0]
        .map(|h| {
            let sprung = JointSetup { stiffness: 8.0, damping: 2.0, ..hinge([-1.5, 1.5], 0.0) };
            let calm = SimulationSettings { dynamics: Dynamics::Calm, ..settings(h) };
            let mut sim = coupled_limb(
                1e5,
                calm,
                [sprung, JointSetup { stiffness: 3.0, damping: 1.0, ..ball(0.0) }],
                RootKind::Pinned,
                vec![],
            );
            sim.start(&motion).unwrap();
            run(&mut sim, &motion, 5.0);
            sim.state.position.iter().map(|p| DVec3::from(*p)).collect()
        })
        .to_vec();
    let off = places[0].iter().zip(&places[1]).map(|(a, b)| a.distance(*b)).fold(0.0, f64::max);
    let start = simulation(&character, 400, flesh(1e5), settings(0.1)).body.mesh.nodes;
    let fell = places[0].iter().zip(&start);
    let fell = fell.map(|(a, b)| a.distance(DVec3::from(*b))).fold(0.0, f64::max);
    eprintln!("settled: {off:.1e} m apart after {fell:.2} m");
    assert!(off < 0.01 * 0.6 && fell > 0.1, "{off} {fell}");
}

/// Limits hit, dragged at 10 m/s out of reach, for a second: nothing blows up.
fn shake(e: f64, h: f64, dynamics: Dynamics, seconds: f64) {
    let character = limb();
    let motion = RestMotion(&character.skeleton);
    let keys =
        (0..20).map(|k| Key { time: 0.1 * f64::from(k), position: [0.3, if k % 2 == 0 { 0.5 } else { -0.5 }, 0.2] });
    let drag = Action::DragJoint { joint: JointId(1), path: keys.collect(), stiffness: None };
    let events = vec![Event { start: 0.1, end: 1.0, action: drag }];
    let s = SimulationSettings { dynamics, ..settings(h) };
    let mut sim = coupled_limb(e, s, [ball(0.0), hinge([-0.4, 0.6], 0.0)], RootKind::Pinned, events);
    sim.start(&motion).unwrap();
    run(&mut sim, &motion, seconds);
    let far = sim.state.position.iter().map(|p| DVec3::from(*p).length()).fold(0.0, f64::max);
    let fast = sim.state.velocity.iter().map(|p| DVec3::from(*p).length()).fold(0.0, f64::max);
    assert!(far < 2.0 && fast < 60.0, "E {e} h {h} {dynamics:?}: {far} m, {fast} m/s");
}

/// The softest and the stiffest flesh at the longest step; `every_setting_is_shaken` has the others.
#[test]
fn nothing_blows_up() {
    shake(3e3, 1.0 / 30.0, Dynamics::Lively, 0.4);
    shake(3e7, 1.0 / 30.0, Dynamics::Calm, 0.4);
}

/// Any stiffness, any step: minutes.
#[test]
#[ignore = "takes minutes"]
fn every_setting_is_shaken() {
    for e in [3e3, 3e5, 3e7] {
        for h in [1.0 / 30.0, 1.0 / 120.0] {
            for dynamics in [Dynamics::Lively, Dynamics::Calm] {
                shake(e, h, dynamics, 1.2);
            }
        }
    }
}

fn take(threads: usize, stop: Option<usize>) -> Vec<u64> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
    pool.install(|| {
        let character = limb();
        let motion = Swing(&character, |t: f64| 0.3 * (7.0 * t).sin());
        let path = vec![Key { time: 0.1, position: [0.0, 0.1, 0.0] }, Key { time: 0.4, position: [-0.1, 0.3, 0.1] }];
        let events = || {
            vec![
                Event {
                    start: 0.1,
                    end: 0.5,
                    action: Action::DragJoint { joint: JointId(1), path: path.clone(), stiffness: None },
                },
                Event {
                    start: 0.2,
                    end: 0.6,
                    action: Action::PullFlesh { mesh: 0, vertex: 900, path: vec![], stiffness: Some(300.0) },
                },
                Event { start: 0.3, end: f64::INFINITY, action: Action::Wind([4.0, 0.0, 2.0]) },
                Event { start: 0.4, end: 0.5, action: Action::Gravity([0.0, 3.0, 0.0]) },
                Event { start: 0.0, end: 0.2, action: Action::Force { mesh: 0, vertex: 100, force: [0.0, 5.0, 0.0] } },
            ]
        };
        let half = JointSetup { drive: 0.5, ..ball(0.0) };
        let make =
            || coupled_limb(2e4, settings(1.0 / 60.0), [half, hinge([-0.3, 0.3], 0.01)], RootKind::Pinned, events());
        let mut sim = make();
        sim.start(&motion).unwrap();
        for f in 1..=20 {
            sim.advance(&motion, f as f64 / 30.0).unwrap();
            // a checkpoint is taken in every run: it makes what lags behind forgotten
            if f == 10 {
                let checkpoint = sim.checkpoint();
                if stop.is_some() {
                    sim = make();
                    sim.restore(&checkpoint, &motion).unwrap();
                }
            }
        }
        let skin = sim.frame(20).skin.to_vec();
        skin.iter().flatten().flatten().map(|v| v.to_bits()).collect()
    })
}

/// A take is baked again bit for bit: on one thread, on two, and gone on with in another process.
#[test]
fn a_take_is_repeated_bit_for_bit() {
    let first = take(1, None);
    assert!(first == take(2, None), "threads");
    assert!(first == take(1, Some(10)), "resumed");
}

/// A step that cannot be done leaves everything as it was.
#[test]
fn a_failed_step_changes_nothing() {
    let character = limb();
    let motion = RestMotion(&character.skeleton);
    let mut sim =
        coupled_limb(2e4, settings(1.0 / 60.0), [ball(0.0), hinge([-0.3, 0.3], 0.0)], RootKind::Pinned, vec![]);
    sim.start(&motion).unwrap();
    sim.advance(&motion, 0.1).unwrap();
    let (state, pose, violation) = (sim.state.clone(), sim.pose().clone(), sim.limit_violation());
    assert!(sim.advance(&motion, 0.05).is_err());
    let density = sim.body.mass[5];
    sim.body.mass[5] = f64::NAN;
    assert!(sim.advance(&motion, 0.2).is_err());
    assert!(sim.state == state && *sim.pose() == pose && sim.limit_violation().to_bits() == violation.to_bits());
    sim.body.mass[5] = density;
    sim.advance(&motion, 0.2).unwrap();
}

/// Events that make no sense are refused before anything moves.
#[test]
fn events_are_checked() {
    let character = limb();
    let mut sim = simulation(&character, 400, flesh(2e4), settings(1.0 / 60.0));
    let two = Coupling::TwoWay(TwoWay {
        scheme: TwoWayScheme::Monolithic,
        joints: vec![ball(0.0); 2],
        root: RootKind::Pinned,
    });
    let mut error = |start, end, action, coupling: &Coupling| {
        sim.couple(coupling, vec![Event { start, end, action }]).unwrap_err().to_string()
    };
    let drag = |joint| Action::DragJoint { joint: JointId(joint), path: vec![], stiffness: None };
    assert!(error(1.0, 0.5, drag(0), &two).contains("must end after"));
    assert!(error(0.0, 0.5, drag(7), &two).contains("no joint 7"));
    assert!(error(0.0, 0.5, drag(0), &Coupling::OneWay).contains("two-way"));
    let far = Action::PullFlesh { mesh: 3, vertex: 0, path: vec![], stiffness: None };
    assert!(error(0.0, 0.5, far, &two).contains("mesh 3"));
    let pull = Action::PullFlesh { mesh: 0, vertex: 0, path: vec![], stiffness: Some(-1.0) };
    assert!(error(0.0, 0.5, pull, &two).contains("stiffness"));
}

/// The sample character with automatic joints, led by its clips to `drive`.
pub fn automatic_joints(
    character: &Character,
    bones: &[JointId],
    clips: &[Clip],
    drive: f64,
    damping: f64,
) -> Vec<JointSetup> {
    let mut joints = vec![JointSetup::default(); character.skeleton.joint_count()];
    for choice in automatic(&character.skeleton, bones, clips) {
        joints[choice.joint.index()] = JointSetup { drive, damping, ..choice.setup };
    }
    joints
}

/// What a two-way step costs over a one-way step of the same body: `cargo test --release -p softrig --test it cost -- --ignored --nocapture`.
#[test]
#[ignore = "a measurement"]
fn cost_of_a_two_way_step() {
    let cells = std::env::var("CELLS").ok().and_then(|c| c.parse().ok()).unwrap_or(30_000);
    let character = softrig::sample::character();
    let motion = softrig::simulation::ClipMotion::new(&character.skeleton, &character.clips[0]);
    let tolerance = 1e-6;
    for two_way in [false, true] {
        let s = SimulationSettings { tolerance, ..SimulationSettings::default() };
        let mut sim = simulation(&character, cells, Material::default(), s);
        let bones: Vec<JointId> = sim.binding.bones.iter().map(|b| b.joint).collect();
        let mut unknowns = 0;
        if two_way {
            let joints = automatic_joints(&character, &bones, &character.clips, 0.7, 0.0);
            unknowns = joints
                .iter()
                .map(|j| match j.kind {
                    JointKind::Fixed => 0,
                    JointKind::Hinge { .. } => 1,
                    JointKind::Ball { .. } => 3,
                })
                .sum();
            sim.couple(
                &Coupling::TwoWay(TwoWay { scheme: TwoWayScheme::Monolithic, joints, root: RootKind::Driven }),
                vec![],
            )
            .unwrap();
        }
        sim.start(&motion).unwrap();
        let (mut ms, mut iterations, mut steps) = (Vec::new(), 0, 0);
        for f in 1..=24 {
            let begun = std::time::Instant::now();
            let r = sim.advance(&motion, f as f64 / 60.0).unwrap();
            if f > 4 {
                ms.push(1e3 * begun.elapsed().as_secs_f64() / r.substeps as f64);
                iterations += r.iterations;
                steps += r.substeps;
            }
            if two_way && f % 6 == 0 {
                eprintln!("  frame {f}: {r:?}");
            }
        }
        ms.sort_by(f64::total_cmp);
        eprintln!(
            "two-way {two_way}: {} cells, {} bones, {unknowns} unknowns, {:.1} ms a step (median), {:.1} iterations",
            sim.body.mesh.cell_count(),
            bones.len(),
            ms[ms.len() / 2],
            iterations as f64 / steps as f64
        );
    }
}
