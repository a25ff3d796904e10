//! What inverse kinematics promises besides reaching its goals: how goals are weighed, how far a step goes, how many it takes; and
//! what the distance of a joint from its clip means.

use crate::rig::{Rig, ball, goal, hinge, straight};
use glam::{DMat3, DQuat, DVec3};
use softrig::rig::ik::{Goal, IkMethod, IkReport, IkSettings, reach};
use softrig::rig::{Affine, Pose, RootKind, Value};

const METHODS: [IkMethod; 2] = [IkMethod::DampedLeastSquares { damping: 0.02 }, IkMethod::JacobianTranspose];

fn reached(rig: &mut Rig, goals: &[Goal], method: IkMethod, iterations: usize) -> IkReport {
    let settings = IkSettings { method, iterations, tolerance: 1e-9, length: 0.4 };
    reach(&rig.articulation, &rig.skeleton, &rig.base, goals, &settings, &mut rig.configuration)
}

/// Of two goals for one joint, both within reach, one counts three times as much: it ends at their weighted mean.
#[test]
fn goals_count_by_their_weights() {
    for method in METHODS {
        let mut rig = Rig::new(straight(&[0.4, 0.3]), vec![hinge([-3.1, 3.1]); 2], RootKind::Driven);
        let (a, b) = (DVec3::new(0.5, 0.2, 0.0), DVec3::new(0.4, 0.4, 0.0));
        let goals = [goal(2, a.into()), Goal { weight: 3.0, ..goal(2, b.into()) }];
        let report = reached(&mut rig, &goals, method, 2000);
        let mean = (a + b * 3.0) / 4.0;
        assert!(rig.place(2).distance(mean) < 1e-4, "{method:?}: {} {mean}", rig.place(2));
        let left = (mean.distance_squared(a) + 3.0 * mean.distance_squared(b)).sqrt();
        assert!((report.error - left).abs() < 1e-5, "{method:?}: {} {left}", report.error);
    }
}

/// However far the goals, one step turns no joint by more than half a radian; one that would is cut to just that.
#[test]
fn a_step_turns_no_joint_further_than_half_a_radian() {
    for method in METHODS {
        let mut rig = Rig::new(straight(&[0.4, 0.3]), vec![hinge([-3.1, 3.1]); 2], RootKind::Driven);
        reached(&mut rig, &[goal(1, [-0.4, 0.1, 0.0]), goal(2, [-0.5, -3.0, 0.0])], method, 1);
        let turned = rig.configuration.values.iter().map(|v| match v {
            Value::Angle(angle) => angle.abs(),
            _ => panic!("a hinge has an angle"),
        });
        let most = turned.fold(0.0, f64::max);
        assert!((most - 0.5).abs() < 1e-12, "{method:?}: {most}");
    }
}

/// Least squares comes to rest in a handful of steps where the goals can be reached; half a line search along the transpose of the
/// Jacobian in some dozens.
#[test]
fn goals_in_reach_take_few_steps() {
    let mut most = [0; 2];
    for k in 0..12 {
        let (first, second) = (0.25 * f64::from(k) - 1.4, 1.2 - 0.15 * f64::from(k));
        let elbow = DVec3::new(first.cos(), first.sin(), 0.0) * 0.4;
        let tip = elbow + DVec3::new((first + second).cos(), (first + second).sin(), 0.0) * 0.3;
        for (method, most) in METHODS.iter().zip(&mut most) {
            let mut rig = Rig::new(straight(&[0.4, 0.3]), vec![hinge([-3.1, 3.1]); 2], RootKind::Driven);
            let report = reached(&mut rig, &[goal(1, elbow.into()), goal(2, tip.into())], *method, 1000);
            assert!(report.converged && rig.place(2).distance(tip) < 1e-6, "{method:?} {k}: {report:?}");
            *most = report.iterations.max(*most);
        }
    }
    eprintln!("at most {most:?} steps");
    assert!(most[0] <= 10 && most[1] <= 200, "{most:?}");
}

/// A ball that has swung far and would have to twist beyond its limit: the transpose of the Jacobian ends where least squares does.
#[test]
fn twist_limits_bend_both_methods_alike() {
    for swing in [0.6, 1.5, 2.4] {
        let [one, other] = METHODS.map(|method| {
            let setups = vec![ball(3.0, [-0.2, 0.2]), hinge([-1.5, 1.5])];
            let mut rig = Rig::new(straight(&[0.4, 0.3]), setups, RootKind::Driven);
            let q = DQuat::from_rotation_z(swing) * DQuat::from_rotation_x(1.0);
            let (elbow, tip) = (q * DVec3::X * 0.4, q * DVec3::new(0.4 + 0.3 * 1f64.cos(), 0.3 * 1f64.sin(), 0.0));
            let report = reached(&mut rig, &[goal(1, elbow.into()), goal(2, tip.into())], method, 3000);
            assert!(rig.articulation.violation(&rig.configuration) < 1e-12);
            report.error
        });
        assert!(one > 0.02 && (one - other).abs() < 1e-4, "swing {swing}: {one} {other}");
    }
}

/// How far a ball is from its clip is the turn, along the world's axes, that takes the clip's frame to the present one.
#[test]
fn the_deviation_turns_the_clip_into_the_pose() {
    let mut rig = Rig::new(straight(&[0.4, 0.3]), vec![ball(3.0, [-3.0, 3.0])], RootKind::Driven);
    let turn = Affine::from_rotation(DQuat::from_scaled_axis(DVec3::new(0.4, 0.9, -0.3)).to_array());
    let clip = Pose { world: rig.skeleton.joints().iter().map(|j| turn.after(&j.rest)).collect() };
    rig.articulation.base_into(&rig.skeleton, &clip, &mut rig.base);
    rig.configuration = rig.articulation.configuration(&rig.base);
    let start = rig.pose(&rig.configuration);
    rig.articulation.advance(&rig.skeleton, &start, &[0.5, -0.8, 0.6], &mut rig.configuration);
    let pose = rig.pose(&rig.configuration);
    let mut deviation = Vec::new();
    rig.articulation.deviation_into(&rig.skeleton, &pose, &rig.base, &rig.configuration, &mut deviation);
    let by = DMat3::from_quat(DQuat::from_scaled_axis(DVec3::new(deviation[0], deviation[1], deviation[2])));
    let axes = |a: &Affine| DMat3::from_cols_array_2d(&a.linear).transpose();
    let off = (by * axes(&clip.world[0]) - axes(&pose.world[0])).to_cols_array();
    assert!(off.iter().all(|v| v.abs() < 1e-12), "{deviation:?} {off:?}");
}
