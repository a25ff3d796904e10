//! The staggered coupling [Georgii2010 §4.3]: flesh and skeleton one after the other. Forces of the flesh on the bones move
//! the joints by Verlet's rule, inverse kinematics makes a pose of where they want to be, and flesh follows that pose.
//!
//! Stable only while forces count for less than they are: s at most 0.75 L / (c h), with the speed of sound c of the flesh and the
//! size L of the chain; half of that is used. Motion is damped by 4 s a second, or it would never end. Where joints still swing to
//! the other side further every time, four times in a row, forces count for half as much from then on.

use super::coupling::{CoupledState, Moving};
use super::drive::Drive;
use super::{FrameReport, Simulation};
use crate::couple::{PointSpring, joint_masses, nearest_bone};
use crate::integrate::StepError;
use crate::rig::ik::{Goal, IkSettings, reach};
use crate::rig::{JointId, Pose};
use glam::DVec3;
use softrig_linalg::Scalar;

/// Share of the stable force factor that is used, and its largest value.
const FORCE_SHARE: (f64, f64) = (0.4, 0.5);
/// Damping of joints over the force factor [1/s].
const DAMPING: f64 = 4.0;
/// So many swings to the other side in a row, each further than the one before, are an instability.
const REVERSALS: f64 = 4.0;
/// How much more a dragged joint counts than others.
const DRAG_WEIGHT: f64 = 10.0;

/// What the staggered coupling knows of a skeleton.
#[derive(Clone, Debug, Default)]
pub(super) struct Staggered {
    /// Joint of each mass point: all bones' joints.
    joints: Vec<JointId>,
    /// [kg]
    mass: Vec<f64>,
    /// Mass that projects to no bone; the nearest joints have it [kg].
    pub unassigned: f64,
    /// Of each bound node: the two joints that carry it, and the share of the second.
    carried: Vec<(usize, usize, usize, f64)>,
    /// Length of the longest bone [m].
    longest: f64,
}

impl Staggered {
    pub fn new<R: Scalar>(sim: &Simulation<R>) -> Self {
        let binding = &sim.binding;
        let joints: Vec<JointId> = binding.bones.iter().map(|b| b.joint).collect();
        let place: Vec<[f64; 3]> = joints.iter().map(|j| sim.skeleton.joint(*j).rest.translation).collect();
        let bones: Vec<[usize; 2]> =
            binding.bones.iter().enumerate().filter_map(|(b, bone)| bone.parent.map(|p| [p, b])).collect();
        let mass: Vec<f64> = sim.body.mass.iter().map(|m| m.to_f64()).collect();
        let nodes = &sim.body.mesh.nodes;
        let found = joint_masses(&place, &bones, nodes, &mass);
        let mut out = Self { mass: found.mass, unassigned: found.unassigned, ..Self::default() };
        let at = |p: [f64; 3], q: [f64; 3]| DVec3::from(p).distance(DVec3::from(q));
        for (n, p) in nodes.iter().enumerate() {
            let owner = binding.owner[n] as usize;
            if nearest_bone(&place, &bones, *p).is_none() {
                out.mass[owner] += mass[n];
            }
            if binding.bound[n] {
                // along the owner's own bones
                let own: Vec<[usize; 2]> = bones.iter().copied().filter(|b| b[0] == owner).collect();
                out.carried.push(match nearest_bone(&place, &own, *p) {
                    Some((k, w)) => (n, owner, own[k][1], w),
                    None => (n, owner, owner, 0.0),
                });
            }
        }
        let total: f64 = mass.iter().sum();
        out.mass.iter_mut().for_each(|m| *m = m.max(1e-3 * total));
        out.longest = bones.iter().map(|[a, b]| at(place[*a], place[*b])).fold(0.0, f64::max);
        out.joints = joints;
        out
    }
}

impl Moving {
    /// Do joints swing to the other side, further every time? Then forces shall count for less.
    fn watch(&mut self, now: &[DVec3]) {
        let (mut across, mut size, mut before) = (0.0, 0.0, 0.0);
        for ((p, previous), moved) in now.iter().zip(&self.previous).zip(&mut self.moved) {
            let (step, last) = (*p - DVec3::from(*previous), DVec3::from(*moved));
            across += step.dot(last);
            size += step.length_squared();
            before += last.length_squared();
            *moved = step.into();
        }
        self.reversals = if across < 0.0 && size > before { self.reversals + 1.0 } else { 0.0 };
        if self.reversals >= REVERSALS {
            (self.calmed, self.reversals) = (0.5 * self.calmed, 0.0);
        }
    }
}

impl<R: Scalar> Simulation<R> {
    /// A spring on the flesh as a force, no stiffer than an explicit step stands.
    fn add_pull(&mut self, pull: &PointSpring, dt: f64) {
        let (mut here, mut velocity, mut mass) = (DVec3::ZERO, DVec3::ZERO, 0.0);
        for (n, w) in &pull.nodes {
            here += DVec3::from(self.state.position[*n as usize].map(Scalar::to_f64)) * *w;
            velocity += DVec3::from(self.state.velocity[*n as usize].map(Scalar::to_f64)) * *w;
            mass += w.abs() * self.body.mass[*n as usize].to_f64();
        }
        let stiffness = pull.stiffness.min(0.2 * mass / (dt * dt));
        let damping = pull.damping.min(0.2 * mass / dt);
        let force = (DVec3::from(pull.target) - here) * stiffness + (DVec3::from(pull.velocity) - velocity) * damping;
        for (n, w) in &pull.nodes {
            let f = &mut self.scratch.external_force[*n as usize];
            (0..3).for_each(|k| f[k] = R::from_f64(f[k].to_f64() + w * force[k]));
        }
    }

    /// One step: joints, then flesh.
    pub(super) fn staggered_step(
        &mut self,
        c: &mut CoupledState<R>,
        scheme: &Staggered,
        t: f64,
        report: &mut FrameReport,
    ) -> Result<(), StepError> {
        let dt = t - self.state.time;
        self.forces(c, t, dt);
        let size = self.height.max(1e-3);
        let factor = (FORCE_SHARE.0 * size / (self.wave_speed * dt)).min(FORCE_SHARE.1);
        let kept = (-DAMPING / FORCE_SHARE.1 * factor * dt).exp();
        let now: Vec<DVec3> = scheme.joints.iter().map(|j| DVec3::from(self.pose.joint(*j).translation)).collect();
        if c.now.previous.len() != now.len() {
            c.now.previous = now.iter().map(|p| p.to_array()).collect();
            c.now.pull = vec![[0.0; 3]; now.len()];
            c.now.moved = vec![[0.0; 3]; now.len()];
            (c.now.reversals, c.now.calmed) = (0.0, 1.0);
        }
        c.now.watch(&now);
        let factor = factor * c.now.calmed;
        let mut goals = Vec::with_capacity(now.len());
        for (k, &joint) in scheme.joints.iter().enumerate() {
            let drive = c.articulation.setup(joint).drive;
            let step = (now[k] - DVec3::from(c.now.previous[k])) * kept;
            let force = DVec3::from(c.now.pull[k]);
            let free = now[k] + step + force * (dt * dt * factor / scheme.mass[k]);
            // no joint gets further than the flesh can follow
            let free = now[k] + (free - now[k]).clamp_length_max(0.1 * size);
            let led = DVec3::from(c.base.world(joint).translation);
            goals.push(Goal { joint, position: free.lerp(led, drive).into(), weight: 1.0 });
        }
        for drag in &c.drags {
            let at = DVec3::from(self.pose.joint(drag.joint).translation);
            let position = at + (DVec3::from(drag.target) - at).clamp_length_max(drag.longest);
            goals.push(Goal { joint: drag.joint, position: position.into(), weight: DRAG_WEIGHT });
        }
        let settings = IkSettings { length: scheme.longest.max(1e-3), ..IkSettings::default() };
        let mut configuration = c.now.configuration.clone();
        reach(&c.articulation, &self.skeleton, &c.base, &goals, &settings, &mut configuration);
        let mut pose = Pose::default();
        c.articulation.pose_into(&self.skeleton, &c.base, &configuration, &mut pose);
        let drive = Drive::new(&self.skeleton, &self.binding, &pose);
        self.set_targets(&drive, dt);
        for pull in &c.pulls {
            self.add_pull(pull, dt);
        }
        let set: Vec<[R; 3]> = self.scratch.external_force.clone();
        self.integrate(dt, None, true, report)?;
        c.now.configuration = configuration;
        c.now.previous = now.iter().map(|p| p.to_array()).collect();
        self.pose = pose;
        self.state.time = t;
        // what the flesh does to the bones, shared between the ends of each
        c.now.pull.iter_mut().for_each(|f| *f = [0.0; 3]);
        c.load.clear();
        c.load.resize(set.len(), [0.0; 3]);
        for &(n, a, b, w) in &scheme.carried {
            for k in 0..3 {
                let f = set[n][k].to_f64() - self.output.reaction[n][k].to_f64();
                c.load[n][k] = f;
                c.now.pull[a][k] += (1.0 - w) * f;
                c.now.pull[b][k] += w * f;
            }
        }
        Ok(())
    }
}
