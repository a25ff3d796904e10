//! Skeleton constraints of [Tang2009 §4.1], and explicit steps of bodies with prescribed nodes.

use glam::{DQuat, DVec3};
use softrig::body::Body;
use softrig::force::ElasticModel;
use softrig::integrate::{Dynamics, Integrator, State, StepError, StepInput, StepOutput};
use softrig::material::{Material, MaterialMap};
use softrig::mesh::VolumeMesh;
use softrig::rig::{Affine, Joint, JointId, Pose, Skeleton, Transform};
use softrig_explicit::explicit::Explicit;
use softrig_explicit::sample::five_tets;
use softrig_explicit::scheme::Scheme;
use softrig_explicit::skeleton::{
    Driven, ForceForm, Loaded, Reach, SkeletonConstraints, Twist, constraint_force, printed_force,
};
use softrig_explicit::stepper::{Stepper, TooLong};
use softrig_linalg::DofConstraints;
use softrig_linalg::solver::Direct;

fn turned(angle: f64, place: [f64; 3]) -> Affine {
    let mut a = Affine::from_rotation(DQuat::from_rotation_z(angle).to_array());
    a.translation = place;
    a
}

/// A twist goes through all points of a rigid motion: the velocity it gives, integrated, takes any point from one place to the other.
#[test]
fn twists_are_rigid_velocities() {
    let before = Affine::from_rotation(DQuat::from_scaled_axis(DVec3::new(0.2, -0.5, 0.9)).to_array());
    let mut after = Affine::from_rotation(DQuat::from_scaled_axis(DVec3::new(-0.3, 0.4, 1.3)).to_array());
    after.translation = [0.3, -0.2, 0.5];
    let twist = Twist::between(&before, &after, 0.25);
    for local in [[1.0, 2.0, -0.5], [0.0, 0.0, 0.0]] {
        let (mut c, to) = (DVec3::from(before.point(local)), DVec3::from(after.point(local)));
        let n = 20_000;
        for _ in 0..n {
            let h = 0.25 / f64::from(n);
            let middle = c + 0.5 * h * DVec3::from(twist.velocity(c.to_array()));
            c += h * DVec3::from(twist.velocity(middle.to_array()));
        }
        assert!(c.distance(to) < 1e-8, "{c} {to}");
    }
}

/// A constant turn: eq. 9 as printed asks for no force at all; the complete form for the centripetal -m ω² r.
#[test]
fn the_complete_force_is_centripetal() {
    let (h, w, m) = (1e-4, 3.0, 2.0);
    let frame = |k: f64| turned(w * h * k, [0.0; 3]);
    let (was, is) = (Twist::between(&frame(0.0), &frame(1.0), h), Twist::between(&frame(1.0), &frame(2.0), h));
    let at = |k: f64| frame(k).point([0.7, 0.0, 0.2]);
    let complete = constraint_force(m, h, (&was, at(0.0)), (&is, at(1.0)));
    let exact = [-m * w * w * 0.7, 0.0, 0.0];
    for k in 0..3 {
        assert!((complete[k] - exact[k]).abs() < 1e-3 * m * w * w, "{complete:?}");
    }
    assert!(printed_force(m, h, &was, &is, at(1.0)).iter().all(|f| f.abs() < 1e-6));
}

fn arm() -> Skeleton {
    let joint = |name: &str, parent: Option<u32>, x: f64| Joint {
        name: name.into(),
        parent: parent.map(JointId),
        local: Transform { translation: [if parent.is_some() { 0.5 } else { x }, 0.0, 0.0], ..Transform::default() },
        local_matrix: None,
        rest: Affine::from_translation([x, 0.0, 0.0]),
    };
    Skeleton::new(
        vec![joint("shoulder", None, 0.0), joint("elbow", Some(0), 0.5), joint("wrist", Some(1), 1.0)],
        Affine::IDENTITY,
    )
    .unwrap()
}

fn pose(skeleton: &Skeleton, angle: f64) -> Pose {
    let mut locals = skeleton.rest_locals();
    locals[0].rotation = DQuat::from_rotation_z(angle).to_array();
    locals[1].rotation = DQuat::from_rotation_z(0.5 * angle).to_array();
    skeleton.pose(&locals)
}

/// Ω1 ⊂ Ω2 ⊂ Ω3: the set of a joint holds those below it; lines reach more than points.
#[test]
fn sets_of_joints_are_nested() {
    let mesh = five_tets([20, 4, 4], false, |p| [1.2 * p[0] - 0.1, 0.2 * p[1] - 0.1, 0.2 * p[2] - 0.1]);
    let s = arm();
    let ids = [JointId(0), JointId(1), JointId(2)];
    let lines = SkeletonConstraints::bind(&s, &mesh, &ids, Reach::Line(0.051));
    let points = SkeletonConstraints::bind(&s, &mesh, &ids, Reach::Point(0.051));
    let sets = ids.map(|j| lines.nested(j));
    assert!(!sets[2].is_empty() && sets[2].len() < sets[1].len() && sets[1].len() < sets[0].len());
    for k in 0..2 {
        assert!(sets[k + 1].iter().all(|n| sets[k].contains(n)));
    }
    assert_eq!(sets[0].len(), lines.bound().len());
    assert!(points.bound().len() < lines.bound().len() && !points.bound().is_empty());
}

/// A box of flesh around the arm, bound to it; every node weighs 20 g.
fn fleshed_arm() -> (VolumeMesh, Skeleton, SkeletonConstraints, Vec<f64>) {
    let mesh = five_tets([20, 4, 4], false, |p| [1.2 * p[0] - 0.1, 0.2 * p[1] - 0.1, 0.2 * p[2] - 0.1]);
    let skeleton = arm();
    let ids = [JointId(0), JointId(1), JointId(2)];
    let set = SkeletonConstraints::bind(&skeleton, &mesh, &ids, Reach::Line(0.051));
    let mass = vec![0.02; mesh.node_count()];
    (mesh, skeleton, set, mass)
}

/// Held exactly, bound nodes are where the pose has them in every step. By the forces of eq. 9 they drift: less with the centripetal part
/// than as printed, never not at all.
#[test]
fn forces_drift_where_elimination_is_exact() {
    let (mesh, skeleton, set, mass) = fleshed_arm();
    let h = 1e-3;
    // a steady turn, under way from the start
    let at = |k: i32| pose(&skeleton, 2.0 * h * f64::from(k));
    let start = |mass: &[f64]| {
        let mut law = |_: &[[f64; 3]], _: &[[f64; 3]], f: &mut [[f64; 3]]| f.fill([0.0; 3]);
        let stepper = Stepper::new(Scheme::EulerCromer, mass, &mesh.nodes, &mut law, 0.0).unwrap();
        let mut state = State::at_rest(mesh.nodes.clone());
        set.place(&at(-1), h, &mut state);
        let before = state.position.clone();
        set.place(&at(0), h, &mut state);
        (stepper, state, before)
    };
    let (mut stepper, mut state, _) = start(&set.free_mass(&mass));
    for k in 1..=400 {
        let mut nothing = |_: &[[f64; 3]], _: &[[f64; 3]], f: &mut [[f64; 3]]| f.fill([0.0; 3]);
        stepper.step(&mut nothing, None, &mut state, h).unwrap();
        set.place(&at(k), h, &mut state);
        assert!(set.largest_miss(&at(k), &state.position) < 1e-15);
    }
    let drift = [ForceForm::Complete, ForceForm::Printed].map(|form| {
        let (mut stepper, mut state, mut before) = start(&mass);
        for k in 0..400 {
            let mut load = vec![[0.0; 3]; mass.len()];
            let poses = [&at(k - 1), &at(k), &at(k + 1)];
            set.add_forces(form, poses, h, &mass, [&before, &state.position], &mut load);
            before.clone_from(&state.position);
            let mut law = |_: &[[f64; 3]], _: &[[f64; 3]], f: &mut [[f64; 3]]| f.copy_from_slice(&load);
            stepper.step(&mut law, None, &mut state, h).unwrap();
        }
        set.largest_miss(&at(400), &state.position)
    });
    // after a turn of 0.8 rad (1.2 rad for the forearm): millimetres against decimetres
    assert!(drift[0] > 1e-6 && drift[0] < 0.01, "{drift:?}");
    assert!(drift[1] > 0.1, "{drift:?}");
}

/// Under their weight bound nodes fall freely when the forces of eq. 9 are added to it, as in eq. 5. When the constraint balances what else acts
/// there, only its own drift is left, and corrections take that away.
#[test]
fn constraint_forces_have_to_balance_the_others() {
    let (mesh, skeleton, set, mass) = fleshed_arm();
    let h = 1e-3;
    let at = |k: i32| pose(&skeleton, 2.0 * h * f64::from(k));
    let run = |balanced: bool, rate: f64| {
        let mut weight = |_: &[[f64; 3]], _: &[[f64; 3]], f: &mut [[f64; 3]]| f.fill([0.0, -9.81 * 0.02, 0.0]);
        let mut stepper = Stepper::new(Scheme::EulerCromer, &mass, &mesh.nodes, &mut weight, 0.0).unwrap();
        let mut state = State::at_rest(mesh.nodes.clone());
        set.place(&at(-1), h, &mut state);
        let mut before = state.position.clone();
        set.place(&at(0), h, &mut state);
        for k in 0..400 {
            let mut load = vec![[0.0; 3]; mass.len()];
            let poses = [&at(k - 1), &at(k), &at(k + 1)];
            set.add_forces(ForceForm::Complete, poses, h, &mass, [&before, &state.position], &mut load);
            if rate > 0.0 {
                set.add_corrections(rate, [poses[0], poses[1]], h, &mass, &state, &mut load);
            }
            before.clone_from(&state.position);
            if balanced {
                let law = &mut Driven { law: &mut weight, bound: &set, load: &load };
                stepper.step(law, None, &mut state, h).unwrap();
            } else {
                let law = &mut Loaded { law: &mut weight, load: &load };
                stepper.step(law, None, &mut state, h).unwrap();
            }
        }
        set.largest_miss(&at(400), &state.position)
    };
    let (added, balanced, corrected) = (run(false, 0.0), run(true, 0.0), run(true, 100.0));
    // g t²/2 after 0.4 s
    assert!((added - 0.785).abs() < 0.02, "{added}");
    assert!(balanced < 0.01 && corrected < 0.1 * balanced, "{balanced} {corrected}");
}

fn cantilever() -> Body<f64> {
    let mesh = five_tets([8, 2, 2], false, |p| [0.4 * p[0], 0.1 * p[1], 0.1 * p[2]]);
    let mask = mesh.nodes.iter().map(|p| p[0] == 0.0).collect();
    let m = Material { young_modulus: 5e4, mass_damping: 1.0, stiffness_damping: 0.002, ..Material::default() };
    Body::new(mesh, &MaterialMap::uniform(m), ElasticModel::Corotated, DofConstraints::from_mask(mask)).unwrap()
}

/// The explicit integrator in the place of the implicit one: the same motion, prescribed nodes met to the bit, long steps cut or refused.
#[test]
fn explicit_steps_agree_with_implicit_ones() {
    let run = |integrator: &mut dyn Integrator<f64>, dt: f64| {
        let mut body = cantilever();
        let mut solver = Direct::new();
        softrig_linalg::LinearSolver::<f64>::prepare(&mut solver, &body.pattern, &body.constraints).unwrap();
        let rest = body.mesh.nodes.clone();
        let weight = body.weight([0.0, -9.81, 0.0]);
        let mut state = State::at_rest(rest.clone());
        let mut out = StepOutput::default();
        let steps = (0.2 / dt).round() as usize;
        for k in 1..=steps {
            // the held end is lifted
            let t = k as f64 * dt;
            let target: Vec<[f64; 3]> = rest.iter().map(|p| [p[0], p[1] + 0.5 * t * t, p[2]]).collect();
            let input = StepInput {
                target_position: &target,
                target_velocity: &vec![[0.0, t, 0.0]; rest.len()],
                external_force: &weight,
                dt,
                tolerance: 1e-10,
                reactions: true,
            };
            integrator.step(&mut body, &mut solver, &input, &mut state, &mut out).unwrap();
            for i in (0..rest.len()).filter(|i| body.constraints.is_constrained(*i)) {
                assert_eq!(state.position[i], target[i]);
            }
        }
        (state, out, rest)
    };
    let (explicit, out, rest) = run(&mut Explicit::new(Scheme::Verlet), 2e-3);
    let (implicit, other, _) = run(&mut Dynamics::Lively.method(), 5e-4);
    let moved = (0..rest.len()).map(|i| (explicit.position[i][1] - rest[i][1]).abs()).fold(0.0, f64::max);
    let apart = (0..rest.len()).map(|i| (explicit.position[i][1] - implicit.position[i][1]).abs()).fold(0.0, f64::max);
    assert!(moved > 0.02 && apart < 0.02 * moved, "{moved} {apart}");
    assert!((out.elastic_energy - other.elastic_energy).abs() < 0.05 * other.elastic_energy);
    let mut strict = Explicit::<f64>::new(Scheme::Verlet);
    strict.too_long = TooLong::Refuse;
    let mut body = cantilever();
    let zero = vec![[0.0; 3]; rest.len()];
    let input = StepInput {
        target_position: &rest,
        target_velocity: &zero,
        external_force: &zero,
        dt: 0.1,
        tolerance: 1e-6,
        reactions: true,
    };
    let mut state = State::at_rest(rest.clone());
    let refused = strict.step(&mut body, &mut Direct::new(), &input, &mut state, &mut StepOutput::default());
    assert!(matches!(&refused, Err(StepError::Unsupported(e)) if e.contains("stability limit")), "{refused:?}");
    assert_eq!(state, State::at_rest(rest.clone()));
}
