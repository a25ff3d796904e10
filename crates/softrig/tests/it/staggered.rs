//! The staggered coupling of the paper: slower to follow, damped, and stable within its rule.

use crate::couple::limb;
use crate::twoway::{ball, coupled, flesh, floating, hinge, momentum, run, settings, simulation};
use glam::{DQuat, DVec3};
use softrig::integrate::Dynamics;
use softrig::rig::{JointId, JointSetup, Pose, RootKind, Skeleton};
use softrig::simulation::{
    Action, CoupleError, Coupling, Event, Key, Motion, RestMotion, Simulation, SimulationSettings, TwoWay, TwoWayScheme,
};

fn staggered(
    e: f64,
    settings: SimulationSettings,
    joints: [JointSetup; 2],
    root: RootKind,
    events: Vec<Event>,
) -> Simulation<f64> {
    let two = TwoWay { scheme: TwoWayScheme::Staggered, joints: joints.to_vec(), root };
    coupled((300, e), settings, two, events)
}

fn elbow(sim: &Simulation<f64>) -> DVec3 {
    DVec3::from(sim.pose().world[1].translation)
}

/// Flesh that is pulled up lifts the bones, smoothly for any stiffness and step; limits hold, bones stay as long as they are.
#[test]
fn pulled_flesh_lifts_the_bones() {
    for (e, h) in [(3e4, 1.0 / 30.0), (3e4, 1.0 / 120.0), (3e6, 1.0 / 30.0), (3e7, 1.0 / 60.0)] {
        let character = limb();
        let motion = RestMotion(&character.skeleton);
        let pull =
            Event { start: 0.0, end: 9.0, action: Action::Force { mesh: 0, vertex: 1300, force: [0.0, 15.0, 0.0] } };
        let s = SimulationSettings { gravity: [0.0; 3], dynamics: Dynamics::Calm, ..settings(h) };
        let mut sim = staggered(e, s, [ball(0.0), hinge([-0.2, 0.3], 0.0)], RootKind::Pinned, vec![pull]);
        sim.start(&motion).unwrap();
        let mut places = vec![elbow(&sim)];
        for f in 1..=45 {
            sim.advance(&motion, f as f64 / 30.0).unwrap();
            assert!(sim.limit_violation() <= 1e-6, "frame {f}: {}", sim.limit_violation());
            assert!(sim.attachment_gap() < 1e-6 * 0.12, "frame {f}: {}", sim.attachment_gap());
            places.push(elbow(&sim));
        }
        let lifted = places[45].y - places[0].y;
        let most = places.windows(3).map(|w| (w[2] - 2.0 * w[1] + w[0]).length() * 900.0).fold(0.0, f64::max);
        eprintln!("E {e:e} h 1/{:.0}: lifted {lifted:.3} m, at most {most:.1} m/s2", 1.0 / h);
        assert!(lifted > 0.02, "E {e} h {h}: {lifted}");
        assert!(most < 40.0, "E {e} h {h}: {most}");
    }
}

/// Let go it swings down, comes to rest hanging, and its root says that it carries it.
#[test]
fn it_hangs_in_the_end() {
    let character = limb();
    let motion = RestMotion(&character.skeleton);
    let mut sim = staggered(2e5, settings(1.0 / 60.0), [ball(0.0), hinge([-1.0, 1.0], 0.0)], RootKind::Pinned, vec![]);
    sim.start(&motion).unwrap();
    run(&mut sim, &motion, 10.0);
    let down = elbow(&sim) - DVec3::from(sim.pose().world[0].translation);
    let (weight, carried) = (sim.body.total_mass() * 9.81, sim.joint_reaction()[0].force);
    eprintln!("down {down}, the root carries {carried:?} of {weight}");
    assert!(down.y < -0.28, "{down}");
    assert!((carried[1] + weight).abs() < 0.03 * weight, "{carried:?} {weight}");
}

/// A joint that is held without a path stays where it is; one that is dragged gets there.
#[test]
fn drags_are_goals() {
    let character = limb();
    let motion = RestMotion(&character.skeleton);
    let keys = vec![Key { time: 0.0, position: [0.0, 0.0, 0.0] }, Key { time: 0.5, position: [-0.1, 0.2, 0.0] }];
    for (path, to) in [(vec![], DVec3::ZERO), (keys, DVec3::new(-0.1, 0.2, 0.0))] {
        let drag =
            Event { start: 0.0, end: 9.0, action: Action::DragJoint { joint: JointId(1), path, stiffness: None } };
        let s = settings(1.0 / 60.0);
        let mut sim = staggered(2e4, s, [ball(0.0), hinge([-0.3, 0.3], 0.0)], RootKind::Pinned, vec![drag]);
        sim.start(&motion).unwrap();
        run(&mut sim, &motion, 1.0);
        assert!(elbow(&sim).distance(to) < 0.08, "{} {to}", elbow(&sim));
    }
}

/// Turns the limb about its root by half a radian in half a second.
struct Raise<'a>(&'a Skeleton);

impl Motion for Raise<'_> {
    fn pose(&self, time: f64) -> Pose {
        let q = DQuat::from_rotation_z(time.clamp(0.0, 0.5));
        let mut locals = self.0.rest_locals();
        locals[0].rotation = q.to_array();
        self.0.pose(&locals)
    }
}

/// Joints that their clip leads go where it has them; those that it does not lead stay.
#[test]
fn leads_are_followed() {
    let character = limb();
    let motion = Raise(&character.skeleton);
    let away = [0.0, 0.9].map(|drive| {
        let s = SimulationSettings { gravity: [0.0; 3], dynamics: Dynamics::Calm, ..settings(1.0 / 60.0) };
        let led = |setup: JointSetup| JointSetup { drive, ..setup };
        let joints = [led(ball(0.0)), led(hinge([-1.0, 1.0], 0.0))];
        let mut sim = staggered(1e5, s, joints, RootKind::Pinned, vec![]);
        sim.start(&motion).unwrap();
        for f in 1..=60 {
            sim.advance(&motion, f as f64 / 60.0).unwrap();
        }
        elbow(&sim).distance(DVec3::from(motion.pose(1.0).world[1].translation))
    });
    eprintln!("off the clip by {away:?} m");
    assert!(away[0] > 0.1 && away[1] < 0.02, "{away:?}");
}

/// How much momentum a push leaves: forces count for less than they are and joints are damped, so most is lost, where the monolithic
/// scheme keeps all of it.
#[test]
fn momentum_is_lost_at_the_rate_of_its_damping() {
    let character = limb();
    let motion = RestMotion(&character.skeleton);
    let mut kept = [TwoWayScheme::Monolithic, TwoWayScheme::Staggered].map(|scheme| {
        let mut sim = floating(false, Dynamics::Calm, 0.0, scheme);
        sim.start(&motion).unwrap();
        for f in 1..=6 {
            sim.advance(&motion, f as f64 * 0.02).unwrap();
        }
        let before = momentum(&sim).0;
        for f in 1..=30 {
            sim.advance(&motion, 0.12 + f as f64 / 60.0).unwrap();
        }
        assert!(before.length() > 0.1, "it must move: {before}");
        momentum(&sim).0.length() / before.length()
    });
    eprintln!("after half a second: {kept:?}");
    kept[0] -= 1.0;
    assert!(kept[0].abs() < 1e-12 && kept[1] < 0.9, "{kept:?}");
}

/// What the scheme cannot do is refused by name.
#[test]
fn springs_of_joints_are_refused() {
    let mut sim = simulation(&limb(), 300, flesh(2e4), settings(1.0 / 60.0));
    let joints = vec![JointSetup { stiffness: 3.0, ..ball(0.0) }, ball(0.0)];
    let two = TwoWay { scheme: TwoWayScheme::Staggered, joints, root: RootKind::Pinned };
    let refused = sim.couple(&Coupling::TwoWay(two), vec![]).unwrap_err();
    assert!(matches!(&refused, CoupleError::Unsupported(s) if s.contains("`upper`")), "{refused}");
}

/// A force on the flesh of a bone is shared between its ends by how near they are: close to the joint that may move it lifts that one
/// well, close to the one that is pinned hardly at all.
#[test]
fn the_nearer_end_of_a_bone_carries_more() {
    let character = limb();
    let motion = RestMotion(&character.skeleton);
    // on top of the limb, 2 cm from the root and 2 cm from the elbow
    let lifted = [2, 28].map(|ring| {
        let action = Action::Force { mesh: 0, vertex: 24 * ring, force: [0.0, 15.0, 0.0] };
        let s = SimulationSettings { gravity: [0.0; 3], dynamics: Dynamics::Calm, ..settings(1.0 / 60.0) };
        let joints = [hinge([-1.0, 1.0], 0.0), JointSetup { drive: 0.0, ..JointSetup::default() }];
        let events = vec![Event { start: 0.0, end: 9.0, action }];
        let mut sim = staggered(1e5, s, joints, RootKind::Pinned, events);
        sim.start(&motion).unwrap();
        for f in 1..=10 {
            sim.advance(&motion, f64::from(f) / 60.0).unwrap();
        }
        elbow(&sim).y
    });
    assert!(lifted[1] > 0.005 && lifted[0].abs() < 0.4 * lifted[1], "{lifted:?}");
}
