//! How skeleton and flesh are coupled, and what a coupled simulation knows besides its flesh.

use super::checkpoint::put;
use super::drive::Drive;
use super::event::Event;
use super::staggered::Staggered;
use crate::couple::{Binding, JointSpring, Lead, Monolithic, PointSpring};
use crate::integrate::State;
use crate::mesh::{BoundaryFaces, VolumeMesh, boundary_faces};
use crate::rig::{
    Articulation, Base, Configuration, EntryKind, JointId, JointSetup, Pose, RigError, RootKind, Skeleton, Value,
};
use glam::DVec3;
use softrig_linalg::Scalar;

/// Who moves whom.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum Coupling {
    /// The skeleton moves the flesh.
    #[default]
    OneWay,
    /// The flesh moves the skeleton too.
    TwoWay(TwoWay),
}

/// What joints can do, and how they are computed.
#[derive(Clone, Debug, PartialEq)]
pub struct TwoWay {
    /// How both are computed.
    pub scheme: TwoWayScheme,
    /// One per joint of the skeleton.
    pub joints: Vec<JointSetup>,
    /// How the skeleton as a whole is held.
    pub root: RootKind,
}

/// How flesh and skeleton are computed together.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum TwoWayScheme {
    /// In one implicit step: stable for any stiffness and step.
    #[default]
    Monolithic,
    /// One after the other, joints by Verlet's rule and inverse kinematics, as in [Georgii2010]: forces count for less than they are,
    /// so that it is stable.
    Staggered,
}

/// Frequency at which a joint that is half led by its clip swings back to it [1/s].
const LEAD_FREQUENCY: f64 = 2.0;

/// Force and torque that a joint passes on.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct JointReaction {
    /// Of all that hangs on the joint, on what carries it [N].
    pub force: [f64; 3],
    /// About the joint [N m].
    pub torque: [f64; 3],
}

/// A coupled simulation's own state.
pub(super) struct CoupledState<R> {
    pub articulation: Articulation,
    pub stepper: Monolithic<R>,
    pub leads: Vec<Lead>,
    pub events: Vec<Event>,
    pub now: Moving,
    /// [`Self::now`] at the start of the frame and of the step.
    pub before: Moving,
    pub before_step: Moving,
    pub base: Base,
    pub faces: BoundaryFaces,
    /// Which joints may move in space.
    pub roots: Vec<JointId>,
    /// Total mass [kg].
    pub mass: f64,
    pub reaction: Vec<JointReaction>,
    pub staggered: Option<Staggered>,
    /// Force that bound flesh exerts at each node [N]: staggered coupling only.
    pub load: Vec<[f64; 3]>,
    /// Springs of the present step.
    pub pulls: Vec<PointSpring>,
    pub drags: Vec<JointSpring>,
    /// The pose at the start of the frame, and a spare one.
    pub pose_before: Pose,
    pub led: Pose,
    pub step: StepStart<R>,
}

/// Where a step starts, and the bones before and after it.
pub(super) struct StepStart<R> {
    pub state: State<R>,
    pub pose: Pose,
    pub from: Drive,
    pub to: Drive,
}

/// What changes from step to step.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Moving {
    pub configuration: Configuration,
    /// Of each unknown from the clip.
    pub deviation: Vec<f64>,
    /// Where the point of each event was when it began.
    pub anchors: Vec<Option<[f64; 3]>>,
    /// Place of each bone's joint before the last step, and the pull of the flesh on it in that step: staggered coupling only.
    pub previous: Vec<[f64; 3]>,
    pub pull: Vec<[f64; 3]>,
    /// How far each joint moved in the last step; how often in a row that grew and changed sides; and what forces are
    /// multiplied by since it last did so too often: staggered coupling only.
    pub moved: Vec<[f64; 3]>,
    pub reversals: f64,
    pub calmed: f64,
    /// Largest rate at which a bone turned in the last step [rad/s].
    pub turn_rate: f64,
    /// Largest speed of a bound node in the last step [m/s].
    pub speed: f64,
}

impl<R: Scalar> CoupledState<R> {
    pub fn new(
        skeleton: &Skeleton,
        binding: &Binding,
        mesh: &VolumeMesh,
        mass: &[R],
        coupling: &Coupling,
        events: Vec<Event>,
    ) -> Result<Self, RigError> {
        let roots = root_bones(skeleton, binding);
        let articulation = match coupling {
            Coupling::OneWay => {
                let fixed = vec![JointSetup::default(); skeleton.joint_count()];
                Articulation::new(skeleton, fixed, &[], RootKind::Driven)?
            }
            Coupling::TwoWay(two) => Articulation::new(skeleton, two.joints.clone(), &roots, two.root)?,
        };
        let leads = leads(&articulation, skeleton, binding, mesh, mass);
        let anchors = vec![None; events.len()];
        // in the rest shape until it is started
        let (mut base, rest) = (Base::default(), skeleton.joints().iter().map(|j| j.rest).collect());
        articulation.base_into(skeleton, &Pose { world: rest }, &mut base);
        let deviation = vec![0.0; articulation.unknown_count()];
        let now = Moving { configuration: articulation.configuration(&base), deviation, anchors, ..Moving::default() };
        Ok(Self {
            articulation,
            stepper: Monolithic::new(),
            leads,
            events,
            now,
            before: Moving::default(),
            before_step: Moving::default(),
            base,
            faces: boundary_faces(mesh),
            roots,
            mass: mass.iter().map(|m| m.to_f64()).sum(),
            reaction: vec![JointReaction::default(); skeleton.joint_count()],
            staggered: None,
            load: Vec::new(),
            pulls: Vec::new(),
            drags: Vec::new(),
            pose_before: Pose::default(),
            led: Pose::default(),
            step: StepStart {
                state: State::at_rest(Vec::new()),
                pose: Pose::default(),
                from: Drive::default(),
                to: Drive::default(),
            },
        })
    }
}

/// Joints with flesh that have no joint with flesh above them.
#[must_use]
pub fn root_bones(skeleton: &Skeleton, binding: &Binding) -> Vec<JointId> {
    debug_assert!(binding.bones.iter().all(|b| b.joint.index() < skeleton.joint_count()));
    binding.bones.iter().filter(|b| b.parent.is_none()).map(|b| b.joint).collect()
}

/// Springs toward the clip. A drive of 1/2 is a spring that swings what hangs on the joint [`LEAD_FREQUENCY`] times a second,
/// damped so that it does not overshoot; toward 1 it stiffens without bound, at 0 it is not there.
fn leads<R: Scalar>(
    articulation: &Articulation,
    skeleton: &Skeleton,
    binding: &Binding,
    mesh: &VolumeMesh,
    mass: &[R],
) -> Vec<Lead> {
    let mut leads = vec![Lead::default(); articulation.unknown_count()];
    let entries = articulation.entries();
    // mass, and its moment about the joint (mean over axes), of all that each entry moves
    let mut moved = vec![(0.0, 0.0); entries.len()];
    for (n, m) in mass.iter().enumerate() {
        let joint = binding.joint(binding.owner[n]);
        for e in articulation.moved_by(joint) {
            let at = DVec3::from(skeleton.joint(entries[*e as usize].joint).rest.translation);
            let arm = DVec3::from(mesh.nodes[n]).distance_squared(at);
            let (sum, moment) = &mut moved[*e as usize];
            *sum += m.to_f64();
            *moment += m.to_f64() * arm * 2.0 / 3.0;
        }
    }
    for (entry, (sum, moment)) in entries.iter().zip(moved) {
        let setup = articulation.setup(entry.joint);
        let inertia = if entry.kind == EntryKind::Place { sum } else { moment };
        let omega = std::f64::consts::TAU * LEAD_FREQUENCY;
        let drive = inertia * omega * omega * setup.drive / (1.0 - setup.drive);
        let (mut stiffness, mut damping) = (drive, 2.0 * (drive * inertia).sqrt());
        if entry.kind != EntryKind::Place {
            stiffness += setup.stiffness;
            damping += setup.damping;
        }
        leads[entry.first..entry.first + entry.count()].fill(Lead { stiffness, damping });
    }
    leads
}

impl Moving {
    /// Becomes another, in the memory that is there.
    pub fn copy(&mut self, other: &Self) {
        self.configuration.values.clone_from(&other.configuration.values);
        self.deviation.clone_from(&other.deviation);
        self.anchors.clone_from(&other.anchors);
        self.previous.clone_from(&other.previous);
        self.pull.clone_from(&other.pull);
        self.moved.clone_from(&other.moved);
        (self.reversals, self.calmed) = (other.reversals, other.calmed);
        (self.turn_rate, self.speed) = (other.turn_rate, other.speed);
    }

    /// As bytes for a checkpoint.
    pub fn write(&self, out: &mut Vec<u8>) {
        for value in &self.configuration.values {
            match value {
                Value::Place(p) => p.iter().for_each(|v| put(out, *v)),
                Value::Angle(a) => put(out, *a),
                Value::Turn(q) => q.iter().for_each(|v| put(out, *v)),
            }
        }
        self.deviation.iter().for_each(|v| put(out, *v));
        for anchor in &self.anchors {
            anchor.unwrap_or([f64::NAN; 3]).iter().for_each(|v| put(out, *v));
        }
        put(out, self.previous.len() as f64);
        self.previous.iter().chain(&self.pull).chain(&self.moved).flatten().for_each(|v| put(out, *v));
        put(out, self.reversals);
        put(out, self.calmed);
        put(out, self.turn_rate);
        put(out, self.speed);
    }

    /// From the numbers of [`Self::write`], for a simulation set up as this one; `None` where they do not fit.
    pub fn read(&self, numbers: &[f64]) -> Option<Self> {
        let mut rest = numbers;
        let mut take = |n: usize| {
            let (head, tail) = rest.split_at_checked(n)?;
            rest = tail;
            Some(head)
        };
        let mut out = self.clone();
        for value in &mut out.configuration.values {
            *value = match value {
                Value::Place(_) => Value::Place(take(3)?.try_into().ok()?),
                Value::Angle(_) => Value::Angle(take(1)?[0]),
                Value::Turn(_) => Value::Turn(take(4)?.try_into().ok()?),
            };
        }
        out.deviation = take(self.deviation.len())?.to_vec();
        for anchor in &mut out.anchors {
            let p: [f64; 3] = take(3)?.try_into().ok()?;
            *anchor = p[0].is_finite().then_some(p);
        }
        // as many joints as a skeleton may have, or none before the first step
        let count = take(1)?[0];
        let count = if (0.0..1e6).contains(&count) { count as usize } else { return None };
        for list in [&mut out.previous, &mut out.pull, &mut out.moved] {
            *list = take(3 * count)?.as_chunks::<3>().0.to_vec();
        }
        (out.reversals, out.calmed) = (take(1)?[0], take(1)?[0]);
        (out.turn_rate, out.speed) = (take(1)?[0], take(1)?[0]);
        rest.is_empty().then_some(out)
    }
}
