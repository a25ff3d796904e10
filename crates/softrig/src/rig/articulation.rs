//! A skeleton with joints that move by themselves: its unknowns, their limits, and the pose they make.
//!
//! The unknowns sit on top of a clip's pose: joints without unknowns turn as the clip says, and every joint moves rigidly from where the
//! clip has it, so bones are as long as the clip makes them whatever the unknowns are.
//!
//! Terms: a joint's local rotation is q = q0 d, with q0 that of the rest shape. A ball has d as its unknown; a hinge about a
//! has d = exp(a θ) s with the unknown θ and what is left of the clip's rotation, s. Increments of balls and places are along
//! the world's axes, those of hinges about their own.

use super::affine::Affine;
use super::joint::{JointKind, JointSetup, RigError, RootKind};
use super::rotation::{axis_map, clamp_swing_twist, exp, keeps_angles, log, rotation_in, swing_twist, twist};
use super::skeleton::{JointId, Pose, Skeleton};
use glam::{DMat3, DQuat, DVec3};

/// A skeleton's unknowns.
#[derive(Clone, Debug)]
pub struct Articulation {
    setups: Vec<JointSetup>,
    /// Local rotation of each joint in the rest shape.
    rest: Vec<DQuat>,
    entries: Vec<Entry>,
    unknown_count: usize,
    /// First entry at each joint, if any; a free root has two.
    entry_of: Vec<Option<usize>>,
    /// Entries at each joint and above it, from the top.
    moved_by: Vec<Vec<u32>>,
}

/// One to three unknowns of a joint.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Entry {
    /// The joint.
    pub joint: JointId,
    /// Its first unknown.
    pub first: usize,
    /// What they are.
    pub kind: EntryKind,
}

/// What unknowns mean.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EntryKind {
    /// Place of a free root in the world [m], three unknowns.
    Place,
    /// Angle of a hinge [rad], one unknown.
    Angle,
    /// Rotation of a ball, three unknowns [rad].
    Turn,
}

impl Entry {
    /// Number of unknowns.
    #[must_use]
    pub fn count(&self) -> usize {
        if self.kind == EntryKind::Angle { 1 } else { 3 }
    }
}

/// Value of one [`Entry`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Value {
    /// World position [m].
    Place([f64; 3]),
    /// Angle [rad].
    Angle(f64),
    /// Rotation since rest in the joint's frame, a unit quaternion (x, y, z, w).
    Turn([f64; 4]),
}

/// Values of all unknowns: with a clip's pose they make a pose.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Configuration {
    /// One per [`Entry`].
    pub values: Vec<Value>,
}

/// A clip's pose, taken apart for [`Articulation::pose_into`].
#[derive(Clone, Debug, Default)]
pub struct Base {
    /// Rotation of each joint in its parent's frame; `None` where that is singular.
    rotation: Vec<Option<DQuat>>,
    world: Vec<Affine>,
}

impl Base {
    /// World frame that the clip gives a joint.
    #[must_use]
    pub fn world(&self, joint: JointId) -> &Affine {
        &self.world[joint.index()]
    }
}

/// How the skeleton moves with one unknown: each point x of a moved bone by `omega` × x + `velocity`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Column {
    /// The joint; it and those below are moved.
    pub joint: JointId,
    /// Axis of a turn, or zero.
    pub omega: [f64; 3],
    /// Velocity at the origin of the world.
    pub velocity: [f64; 3],
}

/// A limit, linear in the next increment: normal · increment ≤ gap.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limit {
    /// Tells the limit from the others, always the same number for the same limit.
    pub id: usize,
    /// First unknown it concerns.
    pub first: usize,
    /// How many.
    pub count: usize,
    /// Factors on the increments of these unknowns.
    pub normal: [f64; 3],
    /// What is left until the limit [rad]; negative beyond it.
    pub gap: f64,
}

impl Articulation {
    /// Unknowns for every joint whose setup leaves it any, `roots` held as `root` says. The roots' own setups are used for
    /// their turns when they are not driven; a root whose setup is fixed turns freely then.
    ///
    /// # Errors
    /// [`RigError`] names the joint and what to change.
    pub fn new(
        skeleton: &Skeleton,
        setups: Vec<JointSetup>,
        roots: &[JointId],
        root: RootKind,
    ) -> Result<Self, RigError> {
        let n = skeleton.joint_count();
        if setups.len() != n {
            return Err(RigError::Count { found: setups.len(), expected: n });
        }
        let mut is_root = vec![false; n];
        for r in roots {
            *is_root.get_mut(r.index()).ok_or(RigError::NoSuchJoint(*r))? = true;
        }
        let mut checked = Vec::with_capacity(n);
        for (i, (setup, joint)) in setups.into_iter().zip(skeleton.joints()).enumerate() {
            let mut setup = setup.checked(&joint.name)?;
            if is_root[i] {
                match (root, setup.kind) {
                    (RootKind::Driven, _) => setup.kind = JointKind::Fixed,
                    (_, JointKind::Fixed) => {
                        let (pi, axis) = (std::f64::consts::PI, [0.0, 1.0, 0.0]);
                        setup = JointSetup {
                            kind: JointKind::Ball { axis, cone: pi, twist: [-pi, pi] },
                            drive: 0.0,
                            ..setup
                        };
                    }
                    _ => {}
                }
            }
            checked.push(setup);
        }
        let above = |j: JointId| skeleton.joint(j).parent;
        let rest_world = |j: JointId| skeleton.joint(j).rest;
        let rest = (0..n)
            .map(|i| {
                let joint = &skeleton.joints()[i];
                let parent = joint.parent.map_or(*skeleton.to_world(), rest_world);
                parent.inverse().map_or(DQuat::IDENTITY, |back| rotation_in(&back.after(&joint.rest)))
            })
            .collect();
        let mut out = Self {
            setups: checked,
            rest,
            entries: Vec::new(),
            unknown_count: 0,
            entry_of: vec![None; n],
            moved_by: vec![Vec::new(); n],
        };
        for &id in skeleton.order() {
            let i = id.index();
            out.moved_by[i] = above(id).map_or_else(Vec::new, |p| out.moved_by[p.index()].clone());
            let setup = out.setups[i];
            let turns = setup.kind != JointKind::Fixed && setup.drive < 1.0;
            let unmovable = |reason| RigError::Unmovable { joint: skeleton.joint(id).name.clone(), reason };
            let parent = above(id).map_or(*skeleton.to_world(), rest_world);
            let moves = is_root[i] && root == RootKind::Free && setup.drive < 1.0;
            if turns {
                if skeleton.joint(id).local_matrix.is_some() {
                    return Err(unmovable("the file gives its node a matrix, which cannot be animated"));
                }
                if !keeps_angles(&parent) {
                    return Err(unmovable("the joints above it scale differently along different axes"));
                }
            }
            let kinds = [
                moves.then_some(EntryKind::Place),
                turns.then_some(match setup.kind {
                    JointKind::Hinge { .. } => EntryKind::Angle,
                    _ => EntryKind::Turn,
                }),
            ];
            for kind in kinds.into_iter().flatten() {
                let entry = Entry { joint: id, first: out.unknown_count, kind };
                out.entry_of[i].get_or_insert(out.entries.len());
                out.moved_by[i].push(out.entries.len() as u32);
                out.entries.push(entry);
                out.unknown_count += entry.count();
            }
        }
        Ok(out)
    }

    /// Number of unknowns.
    #[must_use]
    pub fn unknown_count(&self) -> usize {
        self.unknown_count
    }

    /// The unknowns, joint by joint from the top.
    #[must_use]
    pub fn entries(&self) -> &[Entry] {
        &self.entries
    }

    /// What joint `j` can do.
    #[must_use]
    pub fn setup(&self, j: JointId) -> &JointSetup {
        &self.setups[j.index()]
    }

    /// Entries that move joint `j`: its own and those above.
    #[must_use]
    pub fn moved_by(&self, j: JointId) -> &[u32] {
        &self.moved_by[j.index()]
    }

    /// Takes a clip's pose apart.
    pub fn base_into(&self, skeleton: &Skeleton, clip: &Pose, base: &mut Base) {
        base.world.clone_from(&clip.world);
        base.rotation.clear();
        for (joint, world) in skeleton.joints().iter().zip(&clip.world) {
            let parent = joint.parent.map_or(*skeleton.to_world(), |p| clip.world[p.index()]);
            base.rotation.push(parent.inverse().map(|back| rotation_in(&back.after(world))));
        }
    }

    /// What the clip alone makes of the unknowns, within their limits.
    #[must_use]
    pub fn configuration(&self, base: &Base) -> Configuration {
        let values = self.entries.iter().map(|e| self.clip_value(e, base)).collect();
        let mut configuration = Configuration { values };
        self.clamp(&mut configuration);
        configuration
    }

    /// The clip's own value.
    fn clip_value(&self, entry: &Entry, base: &Base) -> Value {
        let i = entry.joint.index();
        let d = self.rest[i].conjugate() * base.rotation[i].unwrap_or(DQuat::IDENTITY);
        match entry.kind {
            EntryKind::Place => Value::Place(base.world[i].translation),
            EntryKind::Angle => Value::Angle(twist(d, self.axis(entry))),
            EntryKind::Turn => Value::Turn(d.to_array()),
        }
    }

    fn axis(&self, entry: &Entry) -> DVec3 {
        match self.setups[entry.joint.index()].kind {
            JointKind::Hinge { axis, .. } | JointKind::Ball { axis, .. } => DVec3::from(axis),
            JointKind::Fixed => DVec3::Y,
        }
    }

    /// Puts every value within its limits, exactly.
    pub fn clamp(&self, configuration: &mut Configuration) {
        for (entry, value) in self.entries.iter().zip(&mut configuration.values) {
            match (value, self.setups[entry.joint.index()].kind) {
                (Value::Angle(angle), JointKind::Hinge { range, .. }) => *angle = angle.clamp(range[0], range[1]),
                (Value::Turn(d), JointKind::Ball { axis, cone, twist }) => {
                    *d = clamp_swing_twist(DQuat::from_array(*d), DVec3::from(axis), cone, twist).to_array();
                }
                _ => {}
            }
        }
    }

    /// Forward kinematics: the clip's pose with the unknowns in place of its own values. Every joint moves rigidly from where
    /// the clip has it, so no bone is longer or shorter than in the clip, whatever scales its parents have.
    ///
    /// # Panics
    /// When base or configuration are of another articulation.
    pub fn pose_into(&self, skeleton: &Skeleton, base: &Base, configuration: &Configuration, pose: &mut Pose) {
        let world = &mut pose.world;
        world.clear();
        world.resize(skeleton.joint_count(), Affine::IDENTITY);
        for &id in skeleton.order() {
            let i = id.index();
            let (Some(rotation), false) = (base.rotation[i], self.moved_by[i].is_empty()) else {
                world[i] = base.world[i];
                continue;
            };
            // where the parent is, where the clip has it, and the turn between the two
            let to_world = *skeleton.to_world();
            let (parent, clip) =
                skeleton.joint(id).parent.map_or((to_world, to_world), |p| (world[p.index()], base.world[p.index()]));
            let clip_axes = axis_map(&clip);
            let mut turn = axis_map(&parent) * clip_axes.transpose();
            let offset = DVec3::from(base.world[i].translation) - DVec3::from(clip.translation);
            let mut place = (DVec3::from(parent.translation) + turn * offset).to_array();
            if let Some(first) = self.entry_of[i] {
                let d = self.rest[i].conjugate() * rotation;
                let mut turned = rotation;
                for (entry, value) in self.entries[first..].iter().zip(&configuration.values[first..]).take(2) {
                    if entry.joint != id {
                        break;
                    }
                    match *value {
                        Value::Place(p) => place = p,
                        Value::Angle(angle) => {
                            let axis = self.axis(entry);
                            turned = self.rest[i] * DQuat::from_axis_angle(axis, angle - twist(d, axis)) * d;
                        }
                        Value::Turn(d) => turned = self.rest[i] * DQuat::from_array(d),
                    }
                }
                let change = DMat3::from_quat((turned * rotation.conjugate()).normalize());
                turn *= clip_axes * change * clip_axes.transpose();
            }
            let linear = turn * DMat3::from_cols_array_2d(&base.world[i].linear).transpose();
            world[i] = Affine { linear: linear.transpose().to_cols_array_2d(), translation: place };
        }
    }

    /// World directions of the local axes in which the unknown of an entry is measured.
    fn frame(&self, skeleton: &Skeleton, pose: &Pose, entry: &Entry) -> DMat3 {
        let parent = skeleton.joint(entry.joint).parent.map_or(*skeleton.to_world(), |p| pose.world[p.index()]);
        axis_map(&parent) * DMat3::from_quat(self.rest[entry.joint.index()])
    }

    /// How the skeleton moves with each unknown.
    pub fn columns_into(&self, skeleton: &Skeleton, pose: &Pose, columns: &mut Vec<Column>) {
        columns.clear();
        for entry in &self.entries {
            let at = DVec3::from(pose.joint(entry.joint).translation);
            let turn = |axis: DVec3| Column { joint: entry.joint, omega: axis.into(), velocity: at.cross(axis).into() };
            match entry.kind {
                EntryKind::Place => columns.extend(DVec3::AXES.map(|axis| Column {
                    joint: entry.joint,
                    omega: [0.0; 3],
                    velocity: axis.into(),
                })),
                EntryKind::Angle => columns.push(turn(self.frame(skeleton, pose, entry) * self.axis(entry))),
                EntryKind::Turn => columns.extend(DVec3::AXES.map(turn)),
            }
        }
    }

    /// Adds an increment of every unknown. Limits are not looked at: see [`Self::clamp`].
    pub fn advance(&self, skeleton: &Skeleton, pose: &Pose, increment: &[f64], configuration: &mut Configuration) {
        for (entry, value) in self.entries.iter().zip(&mut configuration.values) {
            let by = |k: usize| increment[entry.first + k];
            match value {
                Value::Place(p) => (0..3).for_each(|k| p[k] += by(k)),
                Value::Angle(angle) => *angle += by(0),
                Value::Turn(d) => {
                    let turn = self.frame(skeleton, pose, entry).transpose() * DVec3::new(by(0), by(1), by(2));
                    *d = (exp(turn) * DQuat::from_array(*d)).normalize().to_array();
                }
            }
        }
    }

    /// How far each unknown is from the clip's own value [rad, m], along the axes of increments.
    pub fn deviation_into(
        &self,
        skeleton: &Skeleton,
        pose: &Pose,
        base: &Base,
        configuration: &Configuration,
        out: &mut Vec<f64>,
    ) {
        out.clear();
        for (entry, value) in self.entries.iter().zip(&configuration.values) {
            match (*value, self.clip_value(entry, base)) {
                (Value::Place(p), Value::Place(clip)) => out.extend((0..3).map(|k| p[k] - clip[k])),
                (Value::Angle(angle), Value::Angle(clip)) => out.push(angle - clip),
                (Value::Turn(d), Value::Turn(clip)) => {
                    let local = log(DQuat::from_array(d) * DQuat::from_array(clip).conjugate());
                    out.extend((self.frame(skeleton, pose, entry) * local).to_array());
                }
                _ => out.extend((0..entry.count()).map(|_| 0.0)),
            }
        }
    }

    /// All limits, seen from a configuration.
    pub fn limits_into(&self, skeleton: &Skeleton, pose: &Pose, configuration: &Configuration, out: &mut Vec<Limit>) {
        out.clear();
        for (e, (entry, value)) in self.entries.iter().zip(&configuration.values).enumerate() {
            let mut push = |k: usize, normal: DVec3, gap: f64| {
                let (first, count) = (entry.first, entry.count());
                out.push(Limit { id: 3 * e + k, first, count, normal: normal.into(), gap });
            };
            match (*value, self.setups[entry.joint.index()].kind) {
                (Value::Angle(angle), JointKind::Hinge { range, .. }) => {
                    push(0, DVec3::X, range[1] - angle);
                    push(1, -DVec3::X, angle - range[0]);
                }
                (Value::Turn(d), JointKind::Ball { axis, cone, twist: range }) => {
                    let (axis, frame) = (DVec3::from(axis), self.frame(skeleton, pose, entry));
                    let d = DQuat::from_array(d);
                    let (swing, angle) = swing_twist(d, axis);
                    let length = swing.length();
                    if cone < std::f64::consts::PI && length > 1e-9 {
                        push(0, frame * (swing / length), cone - length);
                    }
                    if range[1] - range[0] < std::f64::consts::TAU {
                        // the twist grows with turns about the middle between the bone's directions at rest and now
                        let middle = axis + d * axis;
                        let normal = frame * (middle / (0.5 * middle.length_squared()).max(1e-3));
                        push(1, normal, range[1] - angle);
                        push(2, -normal, angle - range[0]);
                    }
                }
                _ => {}
            }
        }
    }

    /// How far the worst value is beyond its limits [rad].
    #[must_use]
    pub fn violation(&self, configuration: &Configuration) -> f64 {
        let mut worst = 0.0f64;
        for (entry, value) in self.entries.iter().zip(&configuration.values) {
            let over = |x: f64, range: [f64; 2]| (x - range[1]).max(range[0] - x);
            match (*value, self.setups[entry.joint.index()].kind) {
                (Value::Angle(angle), JointKind::Hinge { range, .. }) => worst = worst.max(over(angle, range)),
                (Value::Turn(d), JointKind::Ball { axis, cone, twist }) => {
                    let (swing, angle) = swing_twist(DQuat::from_array(d), DVec3::from(axis));
                    worst = worst.max(swing.length() - cone).max(over(angle, twist));
                }
                _ => {}
            }
        }
        worst
    }
}
