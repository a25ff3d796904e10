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

pub fn simulation(
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

pub fn flesh(young_modulus: f64) -> Material {
    Material { young_modulus, mass_damping: 0.0, ..Material::default() }
}

pub fn ball(damping: f64) -> JointSetup {
    let kind = JointKind::Ball { axis: [1.0, 0.0, 0.0], cone: PI, twist: [-PI, PI] };
    JointSetup { kind, drive: 0.0, stiffness: 0.0, damping }
}

pub fn hinge(range: [f64; 2], damping: f64) -> JointSetup {
    JointSetup { kind: JointKind::Hinge { axis: [0.0, 0.0, 1.0], range }, drive: 0.0, stiffness: 0.0, damping }
}

/// The limb of so many cells and that stiffness, coupled.
pub fn coupled(
    (cells, e): (usize, f64),
    settings: SimulationSettings,
    two: TwoWay,
    events: Vec<Event>,
) -> Simulation<f64> {
    let mut sim = simulation(&limb(), cells, flesh(e), settings);
    sim.couple(&Coupling::TwoWay(two), events).unwrap();
    sim
}

/// The limb with its two joints as given.
fn coupled_limb(
    e: f64,
    settings: SimulationSettings,
    joints: [JointSetup; 2],
    root: RootKind,
    events: Vec<Event>,
) -> Simulation<f64> {
    let two = TwoWay { scheme: TwoWayScheme::Monolithic, joints: joints.to_vec(), root };
    coupled((400, e), settings, two, events)
}

pub fn settings(h: f64) -> SimulationSettings {
    SimulationSettings { longest_step: h, preroll: 0.2, tolerance: 1e-6, ..SimulationSettings::default() }
}

/// Runs for `seconds` in frames of 1/30 s; checks on the way that limits hold, bones are rigid, and flesh hangs on them.
pub fn run(sim: &mut Simulation<f64>, motion: &dyn Motion, seconds: f64) {
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

/// Linear momentum, angular momentum about the origin, and the sum of sizes of its parts.
pub fn momentum(sim: &Simulation<f64>) -> (DVec3, DVec3, f64) {
    let (mut linear, mut angular, mut size) = (DVec3::ZERO, DVec3::ZERO, 0.0);
    for ((x, v), m) in sim.state.position.iter().zip(&sim.state.velocity).zip(&sim.body.mass) {
        let p = DVec3::from(*v) * *m;
        linear += p;
        angular += DVec3::from(*x).cross(p);
        size += DVec3::from(*x).cross(p).length();
    }
    (linear, angular, size)
}

/// The limb, floating: pushed off its axis for a tenth of a second, then left alone.
pub fn floating(tets: bool, dynamics: Dynamics, damping: f64, scheme: TwoWayScheme) -> Simulation<f64> {
    let character = limb();
    let settings =
        SimulationSettings { dynamics, tolerance: 1e-9, gravity: [0.0; 3], preroll: 0.0, ..settings(1.0 / 60.0) };
    let options = LatticeOptions { resolution: Resolution::Cells(200), ..LatticeOptions::default() };
    let mut volume = mesh::voxelize(&character.surface(true), &options).unwrap();
    if tets {
        volume = mesh::tetrahedralize(&volume);
    }
    let binding = Binding::new(&character, &volume, &BindSettings::default()).unwrap();
    let material = Material { stiffness_damping: damping, ..flesh(2e4) };
    let mut sim =
        Simulation::<f64>::new(&character, volume, binding, &MaterialMap::uniform(material), settings).unwrap();
    let push = Event { start: 0.0, end: 0.1, action: Action::Force { mesh: 0, vertex: 700, force: [3.0, 40.0, 10.0] } };
    let joints = vec![ball(0.0), hinge([-2.0, 2.0], 0.0)];
    sim.couple(&Coupling::TwoWay(TwoWay { scheme, joints, root: RootKind::Free }), vec![push]).unwrap();
    sim
}

/// Without gravity and drag, what a push has given a floating body stays, to rounding: linear and angular momentum, for cubes and
/// tetrahedra, damped and undamped flesh, and either scheme.
#[test]
fn a_floating_body_keeps_its_momentum() {
    for (tets, dynamics, damping) in [
        (false, Dynamics::Calm, 0.0),
        (true, Dynamics::Calm, 0.0),
        (false, Dynamics::Lively, 0.005),
        (true, Dynamics::Lively, 0.0),
    ] {
        let character = limb();
        let motion = RestMotion(&character.skeleton);
        let mut sim = floating(tets, dynamics, damping, TwoWayScheme::Monolithic);
        sim.start(&motion).unwrap();
        for f in 1..=3 {
            sim.advance(&motion, f as f64 / 30.0).unwrap();
        }
        sim.advance(&motion, 0.12).unwrap();
        let (linear, angular, size) = momentum(&sim);
        // steps end at 1/60, .. 6/60 s = the end of the push
        let pushed = DVec3::new(3.0, 40.0, 10.0) * 0.1;
        assert!((linear - pushed).length() < 1e-9 * pushed.length(), "{linear}");
        assert!(angular.length() > 0.05 * size, "it must spin: {angular} {size}");
        let (mut off, mut spun) = ([0.0f64; 2], 0.0f64);
        let first = DVec3::from(sim.pose().world[1].translation) - DVec3::from(sim.pose().world[0].translation);
        for f in 1..=60 {
            sim.advance(&motion, 0.12 + f as f64 / 60.0).unwrap();
            let (p, l, _) = momentum(&sim);
            off = [off[0].max((p - linear).length() / linear.length()), off[1].max((l - angular).length() / size)];
            let bone = DVec3::from(sim.pose().world[1].translation) - DVec3::from(sim.pose().world[0].translation);
            spun = spun.max(bone.angle_between(first));
        }
        eprintln!(
            "tets {tets}, {dynamics:?}: drift in 60 steps, linear {:.1e}, angular {:.1e}; turned {spun:.2}",
            off[0], off[1]
        );
        assert!(off[0] < 1e-12 && off[1] < 1e-12, "{off:?}");
        assert!(spun > 0.5, "it must have turned: {spun}");
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

/// Limits hit, dragged at 10 m/s to and fro, out of reach at the ends: nothing blows up. Says in words how it went.
fn shake(e: f64, h: f64, dynamics: Dynamics, steps: usize) -> String {
    let character = limb();
    let motion = RestMotion(&character.skeleton);
    let seconds = steps as f64 * h;
    let keys = (0..(10.0 * seconds) as usize + 2)
        .map(|k| Key { time: 0.1 * k as f64, position: [0.3, if k % 2 == 0 { 0.5 } else { -0.5 }, 0.2] });
    let drag = Action::DragJoint { joint: JointId(1), path: keys.collect(), stiffness: None };
    let events = vec![Event { start: 0.1, end: seconds - 0.1, action: drag }];
    let s = SimulationSettings { dynamics, ..settings(h) };
    let cone = JointKind::Ball { axis: [1.0, 0.0, 0.0], cone: 0.5, twist: [-0.3, 0.3] };
    let root = JointSetup { kind: cone, ..ball(0.0) };
    let joints = vec![root, hinge([-0.4, 0.6], 0.0)];
    let two = TwoWay { scheme: TwoWayScheme::Monolithic, joints, root: RootKind::Pinned };
    let mut sim = coupled((120, e), s, two, events);
    sim.start(&motion).unwrap();
    let (mut done, mut hit, mut far, mut fast) = (0, 0.0f64, 0.0f64, 0.0f64);
    let mut frame = 0;
    let (begun, mut guarded, mut missed) = (std::time::Instant::now(), 0, 0);
    while done < steps {
        frame += 1;
        let r = sim.advance(&motion, f64::from(frame) * h).unwrap();
        done += r.substeps;
        guarded += r.guarded_steps;
        missed += r.unconverged_steps;
        assert!(sim.limit_violation() <= 1e-6, "frame {frame}: {}", sim.limit_violation());
        assert!(sim.attachment_gap() < 1e-6 * 0.12, "frame {frame}: {}", sim.attachment_gap());
        let [root, elbow] = [0, 1].map(|j| DVec3::from(sim.pose().world[j].translation));
        assert!((elbow.distance(root) - 0.3).abs() < 1e-9, "frame {frame}: {elbow} {root}");
        hit = hit.max(swing(&sim));
        far = sim.state.position.iter().map(|p| DVec3::from(*p).length()).fold(far, f64::max);
        fast = sim.state.velocity.iter().map(|p| DVec3::from(*p).length()).fold(fast, f64::max);
    }
    // the hand pulls with up to 3 kN at 10 m/s: single nodes of soft flesh whip, the body stays together
    assert!(far < 2.0 && fast < 150.0, "E {e} h {h} {dynamics:?}: {far} m, {fast} m/s");
    assert!(hit > 0.499, "a limit must have been hit: {hit}");
    assert!(missed == 0, "E {e} h {h} {dynamics:?}: {missed} steps missed their tolerance");
    let ms = 1e3 * begun.elapsed().as_secs_f64() / done as f64;
    format!(
        "E {e:e} h 1/{:.0} {dynamics:?}: {frame} frames, {done} steps ({ms:.1} ms each), at most {far:.2} m off and {fast:.1} m/s, \
         {guarded} guarded, {missed} missed their tolerance",
        1.0 / h
    )
}

/// How far the root has swung from where it rests [rad].
fn swing(sim: &Simulation<f64>) -> f64 {
    let l = &sim.pose().world[0].linear;
    DVec3::new(l[0][0], l[1][0], l[2][0]).angle_between(DVec3::X)
}

/// The softest and the stiffest flesh at the longest step; those that are ignored have the others, and ten thousand steps.
#[test]
fn nothing_blows_up() {
    eprintln!("{}", shake(3e3, 1.0 / 30.0, Dynamics::Lively, 30));
    eprintln!("{}", shake(3e7, 1.0 / 30.0, Dynamics::Calm, 30));
}

/// Ten thousand steps with each dynamics.
fn shake_long(e: f64, h: f64) -> [String; 2] {
    [Dynamics::Lively, Dynamics::Calm].map(|dynamics| shake(e, h, dynamics, 10_000))
}

/// See `shake_long`.
#[test]
#[ignore = "takes minutes"]
fn soft_flesh_is_shaken_in_long_steps() {
    eprintln!("{:?}", shake_long(3e3, 1.0 / 30.0));
}

/// See `shake_long`.
#[test]
#[ignore = "takes minutes"]
fn soft_flesh_is_shaken_in_short_steps() {
    eprintln!("{:?}", shake_long(3e3, 1.0 / 240.0));
}

/// See `shake_long`.
#[test]
#[ignore = "takes minutes"]
fn firm_flesh_is_shaken_in_long_steps() {
    eprintln!("{:?}", shake_long(3e5, 1.0 / 30.0));
}

/// See `shake_long`.
#[test]
#[ignore = "takes minutes"]
fn firm_flesh_is_shaken_in_short_steps() {
    eprintln!("{:?}", shake_long(3e5, 1.0 / 240.0));
}

/// See `shake_long`.
#[test]
#[ignore = "takes minutes"]
fn stiff_flesh_is_shaken_in_long_steps() {
    eprintln!("{:?}", shake_long(3e7, 1.0 / 30.0));
}

/// See `shake_long`.
#[test]
#[ignore = "takes minutes"]
fn stiff_flesh_is_shaken_in_short_steps() {
    eprintln!("{:?}", shake_long(3e7, 1.0 / 240.0));
}

/// A ball joint may spin about its bone; under a swing across its axis nothing makes it: neither spin nor spikes.
#[test]
fn a_swinging_limb_does_not_spin() {
    let character = limb();
    let motion = RestMotion(&character.skeleton);
    let mut sim = coupled_limb(3e5, settings(1.0 / 60.0), [ball(0.0), ball(0.0)], RootKind::Pinned, vec![]);
    sim.start(&motion).unwrap();
    let elbow = |sim: &Simulation<f64>| DVec3::from(sim.pose().world[1].translation);
    let mut places = vec![elbow(&sim)];
    for f in 1..=90 {
        sim.advance(&motion, f as f64 / 60.0).unwrap();
        places.push(elbow(&sim));
        for world in &sim.pose().world {
            // the third axis of both bones stays that of the swing; symmetric flesh is so up to its lattice
            assert!(world.linear[2][2] > 0.999, "frame {f}: {:?}", world.linear);
        }
    }
    let swung = places.iter().map(|p| p.distance(places[0])).fold(0.0, f64::max);
    let jerks = places.windows(3).map(|w| (w[2] - 2.0 * w[1] + w[0]).length() * 3600.0);
    let most = jerks.fold(0.0, f64::max);
    eprintln!("swung {swung:.2} m, at most {most:.1} m/s2");
    assert!(swung > 0.5 && most < 60.0, "{swung} {most}");
}

/// Two drags that pull one joint apart, a target a kilometre away, a drag on the pinned root: bounded, whole, and at rest afterwards.
#[test]
fn senseless_drags_stay_bounded() {
    let character = limb();
    let motion = RestMotion(&character.skeleton);
    let at = |p: [f64; 3]| vec![Key { time: 0.0, position: p }];
    let drag = |joint, p| Event {
        start: 0.0,
        end: 0.5,
        action: Action::DragJoint { joint: JointId(joint), path: at(p), stiffness: None },
    };
    for events in [
        vec![drag(1, [0.5, 0.5, 0.0]), drag(1, [-0.5, -0.5, 0.0])],
        vec![drag(1, [1000.0, 0.0, 0.0])],
        vec![drag(0, [0.0, 1.0, 0.0]), drag(1, [0.0, -500.0, 3.0])],
    ] {
        let mut sim =
            coupled_limb(2e4, settings(1.0 / 60.0), [ball(0.1), hinge([-0.4, 0.6], 0.1)], RootKind::Pinned, events);
        sim.start(&motion).unwrap();
        run(&mut sim, &motion, 0.7);
        let far = sim.state.position.iter().map(|p| DVec3::from(*p).length()).fold(0.0, f64::max);
        assert!(far < 1.5, "{far}");
    }
}

/// A joint on top of the one above it has no bone: the step is finite, and whole.
#[test]
fn a_bone_without_length_is_carried() {
    let mut character = limb();
    let mut joints = character.skeleton.joints().to_vec();
    let mut spare = joints[1].clone();
    spare.name = "spare".into();
    spare.parent = Some(JointId(0));
    // in between, at the place of the upper joint
    spare.local = softrig::rig::Transform::default();
    spare.rest = joints[0].rest;
    joints[1].parent = Some(JointId(2));
    joints.push(spare);
    character.skeleton = softrig::rig::Skeleton::new(joints, Affine::IDENTITY).unwrap();
    let motion = RestMotion(&character.skeleton);
    let mut sim = simulation(&character, 300, flesh(2e4), settings(1.0 / 60.0));
    let joints = vec![ball(0.0), ball(0.0), ball(0.0)];
    let two = TwoWay { scheme: TwoWayScheme::Monolithic, joints, root: RootKind::Pinned };
    sim.couple(&Coupling::TwoWay(two), vec![]).unwrap();
    sim.start(&motion).unwrap();
    run(&mut sim, &motion, 0.5);
    let elbow = DVec3::from(sim.pose().world[1].translation);
    assert!(elbow.y < -0.05 && elbow.is_finite(), "{elbow}");
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
