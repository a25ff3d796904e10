//! Steps that are undone, cut or cut short: nothing of them is left.

use crate::couple::limb;
use crate::twoway::{ball, coupled, hinge, settings};
use glam::DVec3;
use softrig::integrate::Dynamics;
use softrig::rig::{Affine, JointId, JointKind, JointSetup, Pose, RootKind, Skeleton};
use softrig::simulation::{Action, Event, Motion, RestMotion, Simulation, SimulationSettings, TwoWay, TwoWayScheme};

const H: f64 = 1.0 / 60.0;

fn two_way(joints: [JointSetup; 2], root: RootKind) -> TwoWay {
    TwoWay { scheme: TwoWayScheme::Monolithic, joints: joints.to_vec(), root }
}

/// Stands still, and for a moment between two frames says where in numbers that are none.
struct Torn<'a>(&'a Skeleton);

impl Motion for Torn<'_> {
    fn pose(&self, time: f64) -> Pose {
        let x = if time > 0.155 && time < 0.195 { f64::NAN } else { 0.0 };
        let off = Affine::from_translation([x, 0.0, 0.0]);
        Pose { world: self.0.joints().iter().map(|j| off.after(&j.rest)).collect() }
    }
}

/// A frame that fails in its fourth step of six takes back what the first three have moved: everything that the next step reads, as
/// the bytes of a checkpoint have it.
#[test]
fn a_frame_that_fails_half_way_changes_nothing() {
    let character = limb();
    let motion = Torn(&character.skeleton);
    let joints = [JointSetup { drive: 0.3, ..ball(0.0) }, hinge([-0.3, 0.3], 0.0)];
    let drag = Action::DragJoint { joint: JointId(1), path: vec![], stiffness: None };
    let pull = Action::PullFlesh { mesh: 0, vertex: 900, path: vec![], stiffness: None };
    let events = vec![Event { start: 0.05, end: 9.0, action: drag }, Event { start: 0.1, end: 9.0, action: pull }];
    let mut sim = coupled((200, 2e4), settings(H), two_way(joints, RootKind::Pinned), events);
    sim.start(&motion).unwrap();
    sim.advance(&motion, 0.1).unwrap();
    let (state, pose) = (sim.checkpoint(), sim.pose().clone());
    sim.advance(&motion, 0.2).unwrap_err();
    assert!(sim.checkpoint() == state && *sim.pose() == pose);
    sim.advance(&motion, 0.15).unwrap();
}

/// A heavy jerk takes bones further in a step than one may go: the step is undone and cut in two, and the frame is then bit for bit
/// the one that had been asked for in two.
#[test]
fn a_cut_step_is_as_good_as_shorter_ones() {
    let character = limb();
    let motion = RestMotion(&character.skeleton);
    let frame = |h: f64| {
        let joints = [JointSetup { drive: 0.1, ..ball(0.0) }, hinge([-0.3, 0.3], 0.0)];
        let jerk = Event { start: 0.0, end: 9.0, action: Action::Gravity([20.0, -200.0, 10.0]) };
        let exact = SimulationSettings { dynamics: Dynamics::Calm, preroll: 0.0, ..settings(h) };
        let mut sim = coupled((200, 2e4), exact, two_way(joints, RootKind::Free), vec![jerk]);
        sim.start(&motion).unwrap();
        assert_eq!(sim.advance(&motion, 2.0 * H).unwrap().substeps, 2, "steps of {h} s");
        sim
    };
    let (mut cut, mut asked) = (frame(2.0 * H), frame(H));
    let apart = cut.state.position.iter().zip(&asked.state.position);
    let off = apart.map(|(a, b)| DVec3::from(*a).distance(DVec3::from(*b))).fold(0.0, f64::max);
    assert!(cut.checkpoint() == asked.checkpoint(), "{off} m apart");
}

/// A floating body that its root's limits stop: they act on it from outside, and hold.
#[test]
fn limits_of_a_floating_root_hold() {
    let character = limb();
    let motion = RestMotion(&character.skeleton);
    let cone = JointKind::Ball { axis: [1.0, 0.0, 0.0], cone: 0.3, twist: [-0.2, 0.2] };
    let joints = [JointSetup { kind: cone, ..ball(0.0) }, hinge([-0.4, 0.6], 0.0)];
    let push = Action::Force { mesh: 0, vertex: 1300, force: [0.0, 30.0, 20.0] };
    let events = vec![Event { start: 0.0, end: 0.3, action: push }];
    let floating = SimulationSettings { gravity: [0.0; 3], ..settings(H) };
    let mut sim = coupled((200, 2e4), floating, two_way(joints, RootKind::Free), events);
    sim.start(&motion).unwrap();
    let mut turned = 0.0f64;
    for f in 1..=60 {
        sim.advance(&motion, f as f64 * H).unwrap();
        assert!(sim.limit_violation() < 1e-9, "frame {f}: {}", sim.limit_violation());
        turned = turned.max(turn(&sim));
    }
    assert!(turned > 0.299, "a limit must have been reached: {turned}");
}

/// How far the root's bone has swung from where it rests [rad].
fn turn(sim: &Simulation<f64>) -> f64 {
    let l = &sim.pose().world[0].linear;
    DVec3::new(l[0][0], l[1][0], l[2][0]).angle_between(DVec3::X)
}
