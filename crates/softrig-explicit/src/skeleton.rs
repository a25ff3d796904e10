//! A skeleton inside a body: nodes near its bones move with them.
//!
//! Implements [Tang2009 §4.1]. The nodes of a joint and of all joints below it are nested sets: what moves the joint moves them all. Two
//! ways to hold them: **exactly**, their positions prescribed and so eliminated from the equation of motion, or by the
//! **forces** of eq. 9. Deviations: eq. 8 takes both velocities at the same place c and so loses the change of c, the centripetal part
//! (a constant turn needs no force by it); here each velocity has its own c. Eq. 5 adds these forces to weight and elastic
//! forces, so bound nodes fall and are pulled off; [`Driven`] lets the constraint balance those. Forces are open-loop even then: nothing
//! corrects what differences of velocities and rounding leave, unless [`SkeletonConstraints::add_corrections`] does. The printed form is
//! kept for comparison.
//! Terms: Φ = (ω, υ) spatial velocity of a joint about the world's origin; c position of a node [m]; h step [s].

use crate::stepper::ForceLaw;
use glam::{DMat3, DQuat, DVec3};
use softrig::integrate::State;
use softrig::mesh::VolumeMesh;
use softrig::rig::{Affine, JointId, Pose, Skeleton};
use softrig_linalg::Scalar;

/// Spatial velocity of a rigid body, Φ.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Twist {
    /// ω [rad/s].
    pub angular: [f64; 3],
    /// υ, the velocity of the body's point that is at the origin [m/s].
    pub linear: [f64; 3],
}

impl Twist {
    /// The constant twist that takes a joint frame from one place to another within `dt` [s]; scale and shear are left out.
    #[must_use]
    pub fn between(before: &Affine, after: &Affine, dt: f64) -> Self {
        let (a, b) = (turn(before), turn(after));
        let mut q = b * a.inverse();
        if q.w < 0.0 {
            q = -q;
        }
        let w = q.to_scaled_axis() / dt;
        // screw motion: x' = ω x x + υ takes one origin to the other
        let (p, r) = (DVec3::from(before.translation), DVec3::from(after.translation));
        let v = mean_turn(w * dt).inverse() * (r - q * p) / dt;
        Self { angular: w.to_array(), linear: v.to_array() }
    }

    /// ċ = ω x c + υ at a place [Tang2009 eq. 7], [m/s].
    #[must_use]
    pub fn velocity(&self, at: [f64; 3]) -> [f64; 3] {
        (DVec3::from(self.angular).cross(DVec3::from(at)) + DVec3::from(self.linear)).to_array()
    }
}

/// ∫ exp [s w] ds over s from 0 to 1.
fn mean_turn(w: DVec3) -> DMat3 {
    let angle = w.length();
    let cross = DMat3::from_cols(DVec3::new(0.0, w.z, -w.y), DVec3::new(-w.z, 0.0, w.x), DVec3::new(w.y, -w.x, 0.0));
    let (b, c) = if angle > 1e-3 {
        ((1.0 - angle.cos()) / (angle * angle), (angle - angle.sin()) / angle.powi(3))
    } else {
        (0.5 - angle * angle / 24.0, 1.0 / 6.0 - angle * angle / 120.0)
    };
    DMat3::IDENTITY + cross * b + cross * cross * c
}

fn turn(a: &Affine) -> DQuat {
    let m = a.linear;
    let columns = [0, 1, 2].map(|j| DVec3::new(m[0][j], m[1][j], m[2][j]).normalize_or_zero());
    let [x, y, _] = columns;
    let y = (y - x * x.dot(y)).normalize_or_zero();
    DQuat::from_mat3(&DMat3::from_cols(x, y, x.cross(y))).normalize()
}

/// m (ċ(t) - ċ(t-h)) / h with each velocity at its own place: [Tang2009 eq. 9] with the centripetal part, [N].
#[must_use]
pub fn constraint_force(mass: f64, dt: f64, before: (&Twist, [f64; 3]), now: (&Twist, [f64; 3])) -> [f64; 3] {
    let (a, b) = (before.0.velocity(before.1), now.0.velocity(now.1));
    std::array::from_fn(|k| mass * (b[k] - a[k]) / dt)
}

/// m (Φ(t) - Φ(t-h)) applied at one place: [Tang2009 eq. 9] as printed, [N].
#[must_use]
pub fn printed_force(mass: f64, dt: f64, before: &Twist, now: &Twist, at: [f64; 3]) -> [f64; 3] {
    constraint_force(mass, dt, (before, at), (now, at))
}

/// Which form of the constraint forces.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ForceForm {
    /// With the centripetal part.
    #[default]
    Complete,
    /// As printed.
    Printed,
}

/// What holds nodes to a joint.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Reach {
    /// Point constraint: all nodes within a distance of the joint [m].
    Point(f64),
    /// Line constraint: all nodes within a distance of the bones from the joint to its children [m].
    Line(f64),
}

/// Nodes bound to the joints of a skeleton.
#[derive(Clone, Debug)]
pub struct SkeletonConstraints {
    bound: Vec<(u32, JointId)>,
    /// Each bound node in the rest frame of its joint.
    local: Vec<[f64; 3]>,
    parent: Vec<Option<JointId>>,
}

impl SkeletonConstraints {
    /// Binds the nodes of a mesh that lie within reach of a joint's rest place; a node within reach of several goes to the nearest.
    #[must_use]
    pub fn bind(skeleton: &Skeleton, mesh: &VolumeMesh, joints: &[JointId], reach: Reach) -> Self {
        let at = |j: JointId| DVec3::from(skeleton.joint(j).rest.translation);
        let children = skeleton.children();
        let mut bones = Vec::new();
        for &j in joints {
            bones.push((j, at(j), at(j)));
            if let Reach::Line(_) = reach {
                bones.extend(children[j.index()].iter().map(|c| (j, at(j), at(*c))));
            }
        }
        let (Reach::Point(limit) | Reach::Line(limit)) = reach;
        let mut out =
            Self { bound: Vec::new(), local: Vec::new(), parent: skeleton.joints().iter().map(|j| j.parent).collect() };
        for (i, p) in mesh.nodes.iter().enumerate() {
            let p = DVec3::from(*p);
            let distance = |a: DVec3, b: DVec3| {
                let d = b - a;
                let s =
                    if d.length_squared() > 0.0 { ((p - a).dot(d) / d.length_squared()).clamp(0.0, 1.0) } else { 0.0 };
                p.distance(a + d * s)
            };
            // of equal distances the later joint: a bone's end belongs to the joint there
            let nearest = bones.iter().rev().map(|b| (distance(b.1, b.2), b.0)).min_by(|a, b| a.0.total_cmp(&b.0));
            let Some((far, joint)) = nearest else { continue };
            let Some(inverse) = skeleton.joint(joint).rest.inverse() else { continue };
            if far <= limit {
                out.bound.push((i as u32, joint));
                out.local.push(inverse.point(p.to_array()));
            }
        }
        out
    }

    /// Bound nodes, ascending, each with its joint.
    #[must_use]
    pub fn bound(&self) -> &[(u32, JointId)] {
        &self.bound
    }

    /// The nodes that a joint moves: its own and those of all joints below it. The set of a joint holds the sets of its children.
    #[must_use]
    pub fn nested(&self, joint: JointId) -> Vec<u32> {
        let below = |mut j: JointId| {
            loop {
                if j == joint {
                    return true;
                }
                match self.parent[j.index()] {
                    Some(p) => j = p,
                    None => return false,
                }
            }
        };
        self.bound.iter().filter(|(_, j)| below(*j)).map(|(n, _)| *n).collect()
    }

    /// The masses with those of bound nodes zero: so a stepper leaves them where [`Self::place`] puts them.
    #[must_use]
    pub fn free_mass<R: Scalar>(&self, mass: &[R]) -> Vec<R> {
        let mut out = mass.to_vec();
        self.bound.iter().for_each(|(n, _)| out[*n as usize] = R::zero());
        out
    }

    /// Puts bound nodes where a pose has them; velocities are those of the way there within `dt` [s]. Exact at every call.
    pub fn place<R: Scalar>(&self, pose: &Pose, dt: f64, state: &mut State<R>) {
        for ((n, joint), local) in self.bound.iter().zip(&self.local) {
            let to = pose.joint(*joint).point(*local);
            let n = *n as usize;
            for k in 0..3 {
                let from = state.position[n][k].to_f64();
                state.velocity[n][k] = R::from_f64((to[k] - from) / dt);
                state.position[n][k] = R::from_f64(to[k]);
            }
        }
    }

    /// Largest distance of a bound node from where a pose has it [m].
    #[must_use]
    pub fn largest_miss<R: Scalar>(&self, pose: &Pose, position: &[[R; 3]]) -> f64 {
        let miss = self.bound.iter().zip(&self.local).map(|((n, joint), local)| {
            let to = DVec3::from(pose.joint(*joint).point(*local));
            to.distance(DVec3::from(position[*n as usize].map(Scalar::to_f64)))
        });
        miss.fold(0.0, f64::max)
    }

    /// Adds forces that pull bound nodes back to where the pose has them: m (r² e + 2 r ė), which takes an error e away within a few times
    /// 1/r with r = `rate` [1/s]; at most a tenth of 1/h, or steps overshoot. `poses` are those one step before and at the start of the step.
    pub fn add_corrections<R: Scalar>(
        &self,
        rate: f64,
        poses: [&Pose; 2],
        dt: f64,
        mass: &[R],
        state: &State<R>,
        force: &mut [[R; 3]],
    ) {
        for ((n, joint), local) in self.bound.iter().zip(&self.local) {
            let n = *n as usize;
            let [was, is] = poses.map(|p| p.joint(*joint).point(*local));
            let m = mass[n].to_f64();
            for k in 0..3 {
                let error = is[k] - state.position[n][k].to_f64();
                let slip = (is[k] - was[k]) / dt - state.velocity[n][k].to_f64();
                force[n][k] += R::from_f64(m * rate * (rate * error + 2.0 * slip));
            }
        }
    }

    /// Adds the constraint forces of a step that begins at pose `poses[1]`: `poses` are those one step before, at the start and at the
    /// end of the step; `before` and `now` are the positions that go with the first two.
    pub fn add_forces<R: Scalar>(
        &self,
        form: ForceForm,
        poses: [&Pose; 3],
        dt: f64,
        mass: &[R],
        places: [&[[R; 3]]; 2],
        force: &mut [[R; 3]],
    ) {
        let mut last = None;
        for (n, joint) in &self.bound {
            let (j, n) = (*joint, *n as usize);
            let (was, is) = match last {
                Some((k, was, is)) if k == j => (was, is),
                _ => {
                    let was = Twist::between(poses[0].joint(j), poses[1].joint(j), dt);
                    (was, Twist::between(poses[1].joint(j), poses[2].joint(j), dt))
                }
            };
            last = Some((j, was, is));
            let m = mass[n].to_f64();
            let [before, now] = places.map(|p| p[n].map(Scalar::to_f64));
            let f = match form {
                ForceForm::Complete => constraint_force(m, dt, (&was, before), (&is, now)),
                ForceForm::Printed => printed_force(m, dt, &was, &is, now),
            };
            (0..3).for_each(|k| force[n][k] += R::from_f64(f[k]));
        }
    }
}

/// A force law with a fixed force on every node added: weights, and the constraint forces of a step.
pub struct Loaded<'a, R> {
    /// What acts by itself.
    pub law: &'a mut dyn ForceLaw<R>,
    /// What is added [N].
    pub load: &'a [[R; 3]],
}

impl<R: Scalar> ForceLaw<R> for Loaded<'_, R> {
    fn force(&mut self, position: &[[R; 3]], velocity: &[[R; 3]], force: &mut [[R; 3]]) {
        self.law.force(position, velocity, force);
        for (f, l) in force.iter_mut().zip(self.load) {
            (0..3).for_each(|k| f[k] += l[k]);
        }
    }
}

/// A force law in which the constraint forces are all that acts on bound nodes: whatever else acts there, weight and elastic forces, the
/// constraint balances. Without that bound nodes fall ([Tang2009 eq. 5] adds the forces of eq. 9 to the others).
pub struct Driven<'a, R> {
    /// What acts by itself.
    pub law: &'a mut dyn ForceLaw<R>,
    /// The constraints.
    pub bound: &'a SkeletonConstraints,
    /// Their forces [N].
    pub load: &'a [[R; 3]],
}

impl<R: Scalar> ForceLaw<R> for Driven<'_, R> {
    fn force(&mut self, position: &[[R; 3]], velocity: &[[R; 3]], force: &mut [[R; 3]]) {
        self.law.force(position, velocity, force);
        for (n, _) in self.bound.bound() {
            force[*n as usize] = self.load[*n as usize];
        }
    }
}
