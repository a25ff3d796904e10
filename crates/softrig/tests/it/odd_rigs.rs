//! Rigs and clips that make little sense under two-way coupling: refused by name, or bounded and whole.

use crate::couple::limb;
use crate::twoway::{automatic_joints, ball, flesh, hinge, settings, simulation};
use glam::DVec3;
use softrig::character::Character;
use softrig::integrate::Dynamics;
use softrig::material::Material;
use softrig::rig::{
    Affine, Clip, Interpolation, Joint, JointId, JointKind, JointSetup, Property, RigError, RootKind, Skeleton,
    SkeletonError, Track, Transform,
};
use softrig::simulation::{
    ClipMotion, CoupleError, Coupling, Motion, RestMotion, Simulation, SimulationSettings, TwoWay, TwoWayScheme,
};

const FRAMES: usize = 30;

/// A second of hanging in the rig: every position finite and near, limits held, bones as long as the clip has them.
fn hang(character: &Character, joints: Vec<JointSetup>, motion: &dyn Motion) -> Simulation<f64> {
    let mut sim = simulation(character, 300, flesh(2e4), settings(1.0 / 60.0));
    let two = TwoWay { scheme: TwoWayScheme::Monolithic, joints, root: RootKind::Pinned };
    sim.couple(&Coupling::TwoWay(two), vec![]).unwrap();
    sim.start(motion).unwrap();
    for f in 1..=FRAMES {
        let time = f as f64 / 30.0;
        sim.advance(motion, time).unwrap();
        assert!(sim.limit_violation() <= 1e-6, "frame {f}: {}", sim.limit_violation());
        assert!(sim.attachment_gap() < 1e-6 * 0.12, "frame {f}: {}", sim.attachment_gap());
        let clip = motion.pose(time);
        for (j, joint) in character.skeleton.joints().iter().enumerate() {
            let Some(p) = joint.parent else { continue };
            let length = |world: &[Affine]| {
                DVec3::from(world[j].translation).distance(DVec3::from(world[p.index()].translation))
            };
            let (is, was) = (length(&sim.pose().world), length(&clip.world));
            assert!((is - was).abs() <= 1e-6 * was.max(1e-3), "frame {f} joint {j}: {is} {was}");
        }
        let far = sim.state.position.iter().map(|p| DVec3::from(*p).length()).fold(0.0, f64::max);
        assert!(far.is_finite() && far < 3.0, "frame {f}: {far}");
    }
    sim
}

fn with_joints(change: impl FnOnce(&mut Vec<Joint>)) -> Character {
    let mut character = limb();
    let mut joints = character.skeleton.joints().to_vec();
    change(&mut joints);
    character.skeleton = Skeleton::new(joints, Affine::IDENTITY).unwrap();
    character
}

/// A skeleton that bites its tail is no skeleton.
#[test]
fn a_loop_is_refused_by_name() {
    let mut joints = limb().skeleton.joints().to_vec();
    joints[0].parent = Some(JointId(1));
    let refused = Skeleton::new(joints, Affine::IDENTITY).unwrap_err();
    assert!(matches!(&refused, SkeletonError::Cycle(joint) if joint == "upper" || joint == "lower"), "{refused}");
}

/// The lower joint lies on the upper one: its bone starts where the other does.
#[test]
fn bones_without_length_swing_on() {
    let character = with_joints(|joints| {
        joints[1].local = Transform::default();
        joints[1].rest = joints[0].rest;
    });
    let motion = RestMotion(&character.skeleton);
    let sim = hang(&character, vec![ball(0.0), hinge([-0.5, 0.5], 0.0)], &motion);
    let lowest = sim.state.position.iter().map(|p| p[1]).fold(0.0, f64::min);
    assert!(lowest < -0.2, "it must have fallen: {lowest}");
}

/// The lower joint is half a metre above the flesh that hangs on it: a lever without flesh around it.
#[test]
fn joints_outside_the_flesh_carry_it() {
    let character = with_joints(|joints| {
        joints[1].local.translation = [0.3, 0.5, 0.0];
        joints[1].rest = Affine::from_translation([0.0, 0.5, 0.0]);
    });
    let motion = RestMotion(&character.skeleton);
    let sim = hang(&character, vec![hinge([-0.3, 0.3], 0.1), hinge([-0.4, 0.4], 0.1)], &motion);
    let moved = DVec3::from(sim.pose().world[1].translation).distance(DVec3::new(0.0, 0.5, 0.0));
    assert!(moved > 0.01, "it must have moved: {moved}");
}

/// Limits that the rest pose is outside of are refused, with the joint and the range.
#[test]
fn limits_that_leave_out_the_rest_pose_are_refused() {
    let mut sim = simulation(&limb(), 300, flesh(2e4), settings(1.0 / 60.0));
    let mut refused = |bad: JointSetup| {
        let two = TwoWay { scheme: TwoWayScheme::Monolithic, joints: vec![ball(0.0), bad], root: RootKind::Pinned };
        sim.couple(&Coupling::TwoWay(two), vec![]).unwrap_err()
    };
    let twisted = JointKind::Ball { axis: [1.0, 0.0, 0.0], cone: 1.0, twist: [0.2, 0.4] };
    let nan = JointKind::Ball { axis: [1.0, 0.0, 0.0], cone: f64::NAN, twist: [-0.2, 0.4] };
    for (bad, says) in [
        (hinge([0.1, 0.5], 0.0), "leaves out the rest pose"),
        (hinge([-0.5, -0.1], 0.0), "leaves out the rest pose"),
        (hinge([f64::NAN, 0.1], 0.0), "leaves out the rest pose"),
        (JointSetup { kind: twisted, ..ball(0.0) }, "leaves out the rest pose"),
        (JointSetup { kind: nan, ..ball(0.0) }, "0 or more"),
    ] {
        let error = refused(bad);
        assert!(matches!(&error, CoupleError::Rig(RigError::ExcludesRest { .. } | RigError::Value { .. })), "{error}");
        let text = error.to_string();
        assert!(text.contains("`lower`") && text.contains(says), "{text}");
    }
}

/// A clip made for a skeleton with more joints, turning those and, faster than they can follow, the ones that are there: tracks
/// without a joint move nothing, the others as far as limits let them.
#[test]
fn a_clip_of_other_joints_moves_what_is_there() {
    let character = limb();
    let turn = |joint: u32, angle: f64| Track {
        joint: JointId(joint),
        property: Property::Rotation,
        interpolation: Interpolation::Linear,
        times: vec![0.0, 0.5, 1.0],
        values: [0.0, angle, 0.0].map(|a: f64| [0.0, 0.0, (0.5 * a).sin(), (0.5 * a).cos()]).to_vec(),
    };
    let tracks = vec![turn(1, 2.5), turn(7, 1.0), turn(u32::MAX, 1.0)];
    let clip = Clip { name: "of another".into(), start: 0.0, end: 1.0, tracks };
    let motion = ClipMotion::new(&character.skeleton, &clip);
    let led = |setup: JointSetup| JointSetup { drive: 0.8, ..setup };
    let sim = hang(&character, vec![led(ball(0.0)), led(hinge([-0.4, 0.6], 0.0))], &motion);
    assert!(sim.pose().world.len() == 2);
}

/// The sample character, limp and pinned at its hips, comes to rest; what its root carries then is its weight.
#[test]
fn a_whole_character_weighs_on_its_root() {
    let character = softrig::sample::character();
    let motion = RestMotion(&character.skeleton);
    let s = SimulationSettings { dynamics: Dynamics::Calm, ..settings(1.0 / 30.0) };
    let mut sim = simulation(&character, 600, Material { mass_damping: 0.0, ..Material::default() }, s);
    let bones: Vec<JointId> = sim.binding.bones.iter().map(|b| b.joint).collect();
    let joints = automatic_joints(&character, &bones, &character.clips, 0.0, 3.0);
    let two = TwoWay { scheme: TwoWayScheme::Monolithic, joints, root: RootKind::Pinned };
    sim.couple(&Coupling::TwoWay(two), vec![]).unwrap();
    sim.start(&motion).unwrap();
    for f in 1..=300 {
        sim.advance(&motion, f as f64 / 30.0).unwrap();
        assert!(sim.limit_violation() <= 1e-6, "frame {f}: {}", sim.limit_violation());
    }
    let weight = sim.body.total_mass() * 9.81;
    let root = softrig::simulation::root_bones(&character.skeleton, &sim.binding);
    let carried: DVec3 = root.iter().map(|j| DVec3::from(sim.joint_reaction()[j.index()].force)).sum();
    eprintln!("the root carries {carried} of {weight} N");
    assert!((carried.y + weight).abs() < 1e-3 * weight, "{carried} {weight}");
    assert!(carried.x.hypot(carried.z) < 1e-3 * weight, "{carried}");
}
