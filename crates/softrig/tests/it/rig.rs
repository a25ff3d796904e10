//! The skeleton by itself: forward and inverse kinematics, limits, derivatives.

use glam::{DMat3, DQuat, DVec3};
use serde_json::Value as Json;
use softrig::couple::{BoneMotion, blend_point, joint_masses, nearest_bone};
use softrig::rig::ik::{Goal, IkMethod, IkSettings, reach};
use softrig::rig::{
    Affine, Articulation, Base, Configuration, Joint, JointId, JointKind, JointSetup, Pose, RigError, RootKind,
    Skeleton, Transform, Value,
};

fn golden() -> Json {
    serde_json::from_str(include_str!("../golden/ik.json")).unwrap()
}

fn numbers(v: &Json) -> Vec<f64> {
    v.as_array().unwrap().iter().map(|x| x.as_f64().unwrap()).collect()
}

fn vector(v: &Json) -> [f64; 3] {
    numbers(v).try_into().unwrap()
}

/// A chain along X of joints at the given distances, its frames turned and mirrored now and then by `local`.
fn chain(lengths: &[f64], local: impl Fn(usize) -> Transform) -> Skeleton {
    let mut joints: Vec<Joint> = Vec::new();
    let mut world = Affine::IDENTITY;
    for i in 0..=lengths.len() {
        let mut t = local(i);
        if i > 0 {
            t.translation = [lengths[i - 1], 0.0, 0.0];
        }
        world = world.after(&t.to_affine());
        let parent = i.checked_sub(1).map(|p| JointId(p as u32));
        joints.push(Joint { name: format!("j{i}"), parent, local: t, local_matrix: None, rest: world });
    }
    Skeleton::new(joints, Affine::IDENTITY).unwrap()
}

pub fn straight(lengths: &[f64]) -> Skeleton {
    chain(lengths, |_| Transform::default())
}

pub fn hinge(range: [f64; 2]) -> JointSetup {
    JointSetup { kind: JointKind::Hinge { axis: [0.0, 0.0, 1.0], range }, drive: 0.0, ..JointSetup::default() }
}

pub fn ball(cone: f64, twist: [f64; 2]) -> JointSetup {
    JointSetup { kind: JointKind::Ball { axis: [1.0, 0.0, 0.0], cone, twist }, drive: 0.0, ..JointSetup::default() }
}

/// An articulation with its rest pose as the clip's.
pub struct Rig {
    pub skeleton: Skeleton,
    pub articulation: Articulation,
    pub base: Base,
    pub configuration: Configuration,
}

impl Rig {
    pub fn new(skeleton: Skeleton, mut setups: Vec<JointSetup>, root: RootKind) -> Self {
        setups.resize(skeleton.joint_count(), JointSetup::default());
        let roots = if root == RootKind::Driven { vec![] } else { vec![JointId(0)] };
        let articulation = Articulation::new(&skeleton, setups, &roots, root).unwrap();
        let clip = Pose { world: skeleton.joints().iter().map(|j| j.rest).collect() };
        let mut base = Base::default();
        articulation.base_into(&skeleton, &clip, &mut base);
        let configuration = articulation.configuration(&base);
        Self { skeleton, articulation, base, configuration }
    }

    pub fn pose(&self, configuration: &Configuration) -> Pose {
        let mut pose = Pose::default();
        self.articulation.pose_into(&self.skeleton, &self.base, configuration, &mut pose);
        pose
    }

    pub fn place(&self, joint: u32) -> DVec3 {
        DVec3::from(self.pose(&self.configuration).joint(JointId(joint)).translation)
    }
}

pub fn goal(joint: u32, position: [f64; 3]) -> Goal {
    Goal { joint: JointId(joint), position, weight: 1.0 }
}

/// Both links have a goal that they can reach: the closed form, whichever method.
#[test]
fn two_links_reach_what_they_can_reach() {
    let all = &golden()["two_link_planar"];
    let lengths = numbers(&all["L"]);
    for method in [IkMethod::DampedLeastSquares { damping: 0.02 }, IkMethod::JacobianTranspose] {
        let mut worst = 0.0f64;
        for case in all["cases"].as_array().unwrap() {
            let mut rig = Rig::new(straight(&lengths), vec![hinge([-3.1, 3.1]); 2], RootKind::Driven);
            let goals = [goal(1, vector(&case["elbow"])), goal(2, vector(&case["tip"]))];
            let settings = IkSettings { method, iterations: 400, tolerance: 1e-9, length: 0.4 };
            let report = reach(&rig.articulation, &rig.skeleton, &rig.base, &goals, &settings, &mut rig.configuration);
            worst = worst.max(report.error);
            let theta = numbers(&case["theta"]);
            for (value, expected) in rig.configuration.values.iter().zip(theta) {
                let Value::Angle(angle) = value else { panic!("a hinge has an angle") };
                let off = (angle - expected).rem_euclid(std::f64::consts::TAU);
                assert!(off.min(std::f64::consts::TAU - off) < 1e-3, "{method:?} {angle} {expected}");
            }
        }
        assert!(worst < 1e-3 * 0.7, "{worst}");
    }
}

/// Goals for every joint, out of reach or beyond limits: the global optimum of a bounded least-squares solver.
#[test]
fn three_links_with_limits_reach_the_best_compromise() {
    let all = &golden()["three_link_all_goals"];
    let lengths = numbers(&all["L"]);
    let total: f64 = lengths.iter().sum();
    let limits: Vec<[f64; 2]> =
        all["limits"].as_array().unwrap().iter().map(|l| numbers(l).try_into().unwrap()).collect();
    for method in [IkMethod::DampedLeastSquares { damping: 0.02 }, IkMethod::JacobianTranspose] {
        for case in all["cases"].as_array().unwrap() {
            let setups = limits.iter().map(|l| hinge(*l)).collect();
            let mut rig = Rig::new(straight(&lengths), setups, RootKind::Driven);
            let positions = case["goals"].as_array().unwrap();
            let goals: Vec<Goal> = positions.iter().zip(1..).map(|(p, j)| goal(j, vector(p))).collect();
            let settings = IkSettings { method, iterations: 2000, tolerance: 1e-10, length: 0.4 };
            let report = reach(&rig.articulation, &rig.skeleton, &rig.base, &goals, &settings, &mut rig.configuration);
            let best = case["residual_norm"].as_f64().unwrap();
            assert!(report.error < best + 1e-3 * total, "{method:?} {} {best}", report.error);
            assert!(rig.articulation.violation(&rig.configuration) <= 0.0);
        }
    }
}

/// Swing and twist about the bone are limited one by one.
#[test]
fn balls_are_clamped_in_swing_and_twist() {
    for case in golden()["swing_twist_x"]["cases"].as_array().unwrap() {
        let matrix = |v: &Json| {
            let rows: Vec<DVec3> = v.as_array().unwrap().iter().map(|r| DVec3::from(vector(r))).collect();
            DMat3::from_cols(rows[0], rows[1], rows[2]).transpose()
        };
        let rig = Rig::new(straight(&[1.0]), vec![ball(0.6, [-0.5, 0.5])], RootKind::Driven);
        let d = DQuat::from_mat3(&matrix(&case["R"]));
        let mut configuration = Configuration { values: vec![Value::Turn(d.to_array())] };
        rig.articulation.clamp(&mut configuration);
        let Value::Turn(clamped) = configuration.values[0] else { panic!("a ball has a rotation") };
        let off = (DMat3::from_quat(DQuat::from_array(clamped)) - matrix(&case["clamped_R"])).to_cols_array();
        assert!(off.iter().all(|v| v.abs() < 1e-9), "{off:?}");
        assert!(rig.articulation.violation(&configuration) < 1e-12);
    }
}

/// A rig with turned, scaled and mirrored frames, hinges off the axes, and a free root. Scales differ between axes by rounding, as in
/// files that went through f32.
fn odd_rig(root: RootKind) -> Rig {
    let local = |i: usize| Transform {
        translation: [0.1, 0.2, -0.3],
        rotation: DQuat::from_scaled_axis(DVec3::new(0.3 * i as f64, 0.5 - 0.2 * i as f64, 0.4)).to_array(),
        scale: if i == 1 { [-1.4, -1.40001, -1.39999] } else { [1.10001, 1.1, 1.09999] },
    };
    let skeleton = chain(&[0.4, 0.3, 0.5, 0.2], local);
    let axis = [0.3, -0.5, 0.8];
    let slanted =
        JointSetup { kind: JointKind::Hinge { axis, range: [-2.0, 2.0] }, drive: 0.0, ..JointSetup::default() };
    Rig::new(skeleton, vec![ball(3.0, [-3.0, 3.0]), slanted, ball(3.0, [-3.0, 3.0]), slanted], root)
}

/// The columns are the derivatives of the pose: central differences of forward kinematics, through mirrored and scaled frames.
#[test]
fn columns_are_the_derivatives_of_the_pose() {
    let mut rig = odd_rig(RootKind::Free);
    let n = rig.articulation.unknown_count();
    assert_eq!(n, 3 + 3 + 1 + 3 + 1);
    // away from rest
    let start: Vec<f64> = (0..n).map(|k| 0.3 * (1.7 * k as f64).sin()).collect();
    let pose = rig.pose(&rig.configuration);
    rig.articulation.advance(&rig.skeleton, &pose, &start, &mut rig.configuration);
    let pose = rig.pose(&rig.configuration);
    let mut columns = Vec::new();
    rig.articulation.columns_into(&rig.skeleton, &pose, &mut columns);
    let h = 1e-5;
    let mut moved = 0;
    for k in 0..n {
        let side = |s: f64| {
            let mut c = rig.configuration.clone();
            let step: Vec<f64> = (0..n).map(|i| if i == k { s * h } else { 0.0 }).collect();
            rig.articulation.advance(&rig.skeleton, &pose, &step, &mut c);
            rig.pose(&c)
        };
        let (a, b) = (side(-1.0), side(1.0));
        for j in 0..rig.skeleton.joint_count() as u32 {
            let is_moved = rig.articulation.moved_by(JointId(j)).iter().any(|e| {
                let e = rig.articulation.entries()[*e as usize];
                (e.first..e.first + e.count()).contains(&k)
            });
            let p = [0.2, -0.3, 0.4];
            let difference =
                (DVec3::from(b.joint(JointId(j)).point(p)) - DVec3::from(a.joint(JointId(j)).point(p))) / (2.0 * h);
            let x = DVec3::from(pose.joint(JointId(j)).point(p));
            let column = DVec3::from(columns[k].omega).cross(x) + DVec3::from(columns[k].velocity);
            let expected = if is_moved { column } else { DVec3::ZERO };
            assert!((difference - expected).length() < 1e-8, "{k} {j} {difference} {expected}");
            moved += usize::from(is_moved && expected.length() > 1e-3);
        }
    }
    assert!(moved > 20, "{moved}");
}

/// Limits are linearised right: central differences of swing and twist, which limits report as their gaps.
#[test]
fn normals_are_the_derivatives_of_the_gaps() {
    let mut rig = odd_rig(RootKind::Driven);
    let n = rig.articulation.unknown_count();
    let start: Vec<f64> = (0..n).map(|k| 0.4 * (1.3 * k as f64 + 0.5).sin()).collect();
    let pose = rig.pose(&rig.configuration);
    rig.articulation.advance(&rig.skeleton, &pose, &start, &mut rig.configuration);
    let limits = |c: &Configuration| {
        let mut out = Vec::new();
        rig.articulation.limits_into(&rig.skeleton, &rig.pose(c), c, &mut out);
        out
    };
    let here = limits(&rig.configuration);
    assert_eq!(here.len(), 3 + 2 + 3 + 2);
    let pose = rig.pose(&rig.configuration);
    for k in 0..n {
        let side = |s: f64| {
            let mut c = rig.configuration.clone();
            let step: Vec<f64> = (0..n).map(|i| if i == k { s * 1e-5 } else { 0.0 }).collect();
            rig.articulation.advance(&rig.skeleton, &pose, &step, &mut c);
            limits(&c)
        };
        for ((a, b), limit) in side(-1.0).iter().zip(side(1.0)).zip(&here) {
            let difference = -(b.gap - a.gap) / 2e-5;
            let within = k.checked_sub(limit.first).filter(|k| *k < limit.count);
            let normal = within.map_or(0.0, |k| limit.normal[k]);
            assert!((difference - normal).abs() < 1e-8, "{limit:?} {k} {difference}");
        }
    }
}

/// The bones keep their lengths whatever the unknowns are, also where the clip has changed them.
#[test]
fn bones_keep_the_length_the_clip_gives_them() {
    let mut rig = odd_rig(RootKind::Free);
    let mut clip = Pose { world: rig.skeleton.joints().iter().map(|j| j.rest).collect() };
    for w in &mut clip.world[2..] {
        w.translation[0] += 0.15;
    }
    rig.articulation.base_into(&rig.skeleton, &clip, &mut rig.base);
    let n = rig.articulation.unknown_count();
    let at = |pose: &Pose, j: usize| DVec3::from(pose.world[j].translation);
    for trial in 0..20 {
        let pose = rig.pose(&rig.configuration);
        let step: Vec<f64> = (0..n).map(|k| (1.3 * (k + 7 * trial) as f64).sin()).collect();
        rig.articulation.advance(&rig.skeleton, &pose, &step, &mut rig.configuration);
        let pose = rig.pose(&rig.configuration);
        for j in 1..5 {
            let (was, is) = (at(&clip, j).distance(at(&clip, j - 1)), at(&pose, j).distance(at(&pose, j - 1)));
            assert!((was - is).abs() < 1e-12 * was, "{trial} {j} {was} {is}");
        }
    }
    assert!(rig.place(4).distance(at(&clip, 4)) > 0.1);
}

/// The clip's own values give the clip's own pose.
#[test]
fn a_clip_alone_is_followed_exactly() {
    let rig = odd_rig(RootKind::Free);
    let pose = rig.pose(&rig.configuration);
    for (a, b) in pose.world.iter().zip(rig.skeleton.joints()) {
        let off = a.linear.iter().flatten().zip(b.rest.linear.iter().flatten()).map(|(a, b)| (a - b).abs());
        assert!(off.fold(0.0, f64::max) < 1e-12);
    }
}

/// Far goals, goals that contradict each other, goals that are no numbers, bones without length: an answer within the limits.
#[test]
fn impossible_goals_end_within_the_limits() {
    let mut rig = Rig::new(
        straight(&[0.4, 0.0, 0.3]),
        vec![hinge([-1.0, 1.0]), ball(0.5, [-0.2, 0.2]), hinge([0.0, 0.5])],
        RootKind::Driven,
    );
    let far = [goal(3, [1e9, 1e9, 0.0]), goal(3, [-5.0, 2.0, 0.0]), goal(2, [f64::NAN; 3]), goal(9, [0.0; 3])];
    for method in [IkMethod::DampedLeastSquares { damping: 0.02 }, IkMethod::JacobianTranspose] {
        let settings = IkSettings { method, ..IkSettings::default() };
        let report = reach(&rig.articulation, &rig.skeleton, &rig.base, &far, &settings, &mut rig.configuration);
        assert!(report.error.is_finite() && report.iterations > 0);
        assert!(rig.articulation.violation(&rig.configuration) <= 1e-12);
        assert!((rig.place(3) - rig.place(0)).length() < 0.7 + 1e-9);
    }
}

#[test]
fn setups_that_make_no_sense_are_refused_by_name() {
    let error = |setup: JointSetup| {
        let skeleton = straight(&[0.4]);
        Articulation::new(&skeleton, vec![setup, JointSetup::default()], &[], RootKind::Driven).unwrap_err()
    };
    assert!(matches!(error(hinge([0.2, 1.0])), RigError::ExcludesRest { joint, .. } if joint == "j0"));
    assert!(matches!(error(hinge([f64::NAN, 1.0])), RigError::ExcludesRest { .. }));
    assert!(matches!(error(ball(-0.1, [0.0, 0.0])), RigError::Value { what: "cone", .. }));
    assert!(matches!(error(JointSetup { drive: 1.5, ..hinge([-1.0, 1.0]) }), RigError::Value { what: "drive", .. }));
    let axis = JointSetup { kind: JointKind::Hinge { axis: [0.0; 3], range: [-1.0, 1.0] }, ..JointSetup::default() };
    assert!(matches!(error(axis), RigError::Axis { .. }));
    let squeezed =
        chain(&[0.4], |i| Transform { scale: if i == 0 { [1.0, 2.0, 1.0] } else { [1.0; 3] }, ..Transform::default() });
    let setups = vec![JointSetup::default(), hinge([-1.0, 1.0])];
    assert!(matches!(Articulation::new(&squeezed, setups, &[], RootKind::Driven), Err(RigError::Unmovable { .. })));
}

/// Masses of joints and where nodes project to, against plain loops over a bar of Kuhn's tetrahedra; a rigid bone frame against the
/// rotation it was made with.
#[test]
fn joints_get_the_mass_of_what_projects_to_their_bones() {
    let golden: Json = serde_json::from_str(include_str!("../golden/binding.json")).unwrap();
    let place: Vec<[f64; 3]> = golden["J"].as_array().unwrap().iter().map(vector).collect();
    let bones = [[0, 1], [1, 2]];
    let at = |i: [usize; 3]| (i[0] * 3 + i[1]) * 3 + i[2];
    let (mut nodes, mut mass) = (vec![[0.0; 3]; 63], vec![0.0; 63]);
    for x in 0..7 {
        for y in 0..3 {
            for z in 0..3 {
                nodes[at([x, y, z])] = [0.1 * x as f64, 0.1 * y as f64, 0.1 * z as f64];
            }
        }
    }
    // six tetrahedra around the diagonal of each cube, one for each order of the axes
    for cube in 0..24 {
        let corner = [cube / 4, cube / 2 % 2, cube % 2];
        for order in [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]] {
            let mut p = corner;
            mass[at(p)] += 1.0 / 24.0;
            for axis in order {
                p[axis] += 1;
                mass[at(p)] += 1.0 / 24.0;
            }
        }
    }
    let found = joint_masses(&place, &bones, &nodes, &mass);
    for (m, expected) in found.mass.iter().zip(numbers(&golden["joint_mass"])) {
        assert!((m - expected).abs() < 1e-10, "{found:?}");
    }
    assert!((found.unassigned - golden["unassigned_mass"].as_f64().unwrap()).abs() < 1e-10, "{found:?}");
    let bound = golden["bound"].as_array().unwrap();
    for case in bound {
        let n = case["vertex"].as_u64().unwrap() as usize;
        let (bone, w) = nearest_bone(&place, &bones, nodes[n]).unwrap();
        assert_eq!(bone as u64, case["bone"].as_u64().unwrap(), "{case}");
        assert!((w - case["w"].as_f64().unwrap()).abs() < 1e-12, "{case} {w}");
    }
    assert_eq!(bound.len(), 22);
    let example = &golden["rigid_example"];
    let rows: Vec<[f64; 3]> = example["R"].as_array().unwrap().iter().map(vector).collect();
    let linear = DMat3::from_cols(rows[0].into(), rows[1].into(), rows[2].into()).transpose();
    let joint = DVec3::from(place[1]);
    let map = Affine { linear: [rows[0], rows[1], rows[2]], translation: (joint - linear * joint).into() };
    let motion = [BoneMotion::new(&map, place[1])];
    for case in example["verts"].as_array().unwrap() {
        let n = case["vertex"].as_u64().unwrap() as usize;
        let is = DVec3::from(blend_point(&motion, &[(0, 1.0)], nodes[n]));
        assert!(is.distance(DVec3::from(vector(&case["rigid"]))) < 1e-12, "{case} {is}");
    }
}
