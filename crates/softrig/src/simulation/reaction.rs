//! What joints pass on to what carries them.

use super::Simulation;
use super::coupling::{CoupledState, JointReaction};
use crate::rig::JointId;
use glam::DVec3;
use softrig_linalg::Scalar;

impl<R: Scalar> Simulation<R> {
    /// What every joint passes on: the load of all bones at and below it.
    pub(super) fn collect_reactions(&self, c: &mut CoupledState<R>) {
        c.reaction.fill(JointReaction::default());
        let load = if c.staggered.is_some() { &c.load[..] } else { c.stepper.load() };
        let place = |j: JointId| DVec3::from(self.pose.joint(j).translation);
        for n in (0..load.len()).filter(|n| self.binding.bound[*n]) {
            let (f, x) = (DVec3::from(load[n]), DVec3::from(self.state.position[n].map(Scalar::to_f64)));
            for &(bone, w) in self.binding.blend(n) {
                let joint = self.binding.joint(bone);
                add(&mut c.reaction[joint.index()], f * w, (x - place(joint)).cross(f * w));
            }
        }
        for &id in self.skeleton.order().iter().rev() {
            if let Some(p) = self.skeleton.joint(id).parent {
                let own = c.reaction[id.index()];
                let (f, t) = (DVec3::from(own.force), DVec3::from(own.torque));
                add(&mut c.reaction[p.index()], f, t + (place(id) - place(p)).cross(f));
            }
        }
    }
}

fn add(to: &mut JointReaction, force: DVec3, torque: DVec3) {
    to.force = (DVec3::from(to.force) + force).into();
    to.torque = (DVec3::from(to.torque) + torque).into();
}
