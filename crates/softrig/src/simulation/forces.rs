//! What acts on a coupled body besides its skeleton: gravity, wind, forces and springs of its events.

use super::coupling::CoupledState;
use super::event::{Action, along};
use super::{Simulation, cast};
use crate::couple::{JointSpring, PointSpring};
use glam::DVec3;
use softrig_linalg::Scalar;

/// A dragged body as a whole swings this many times a second [1/s]: fast enough to follow a hand.
const DRAG_FREQUENCY: f64 = 3.0;
/// A spring pulls no harder than at this length, as a share of the body's longest side: a target out of reach must not tear.
const LONGEST_SPRING: f64 = 0.3;
/// Density of air [kg/m3].
const AIR: f64 = 1.2;
impl<R: Scalar> Simulation<R> {
    /// The fastest that forces, falls and drags can make a node [m/s].
    pub(super) fn bound(&self, dt: f64, c: &mut CoupledState<R>) -> f64 {
        let length = |v: [f64; 3]| DVec3::from(v).length();
        let mut acceleration = 9.81f64;
        let mut force = 0.0;
        for (f, m) in self.scratch.external_force.iter().zip(&self.body.mass).filter(|(_, m)| m.to_f64() > 0.0) {
            acceleration = acceleration.max(length(f.map(Scalar::to_f64)) / m.to_f64());
        }
        let mut hand = 0.0f64;
        for p in &c.pulls {
            force += p.stiffness * LONGEST_SPRING * self.size;
            hand = hand.max(length(p.velocity));
        }
        for d in &c.drags {
            force += d.stiffness * d.longest;
            hand = hand.max(length(d.velocity));
        }
        // what the clip alone does to joints that follow it
        c.articulation.pose_into(&self.skeleton, &c.base, &c.now.configuration, &mut c.led);
        let bone = c
            .led
            .world
            .iter()
            .zip(&self.pose.world)
            .map(|(a, b)| DVec3::from(a.translation).distance(DVec3::from(b.translation)) / dt);
        let bone = bone.fold(0.0, f64::max);
        let fall = (acceleration + 20.0 * force / c.mass.max(f64::MIN_POSITIVE)) * self.size;
        3.0 * ((2.0 * fall).sqrt() + 2.0 * bone + hand)
    }

    /// Gravity, wind, set forces into the external forces; springs as they are in a step that ends at `t`.
    pub(super) fn forces(&mut self, c: &mut CoupledState<R>, t: f64, dt: f64) {
        let gravity = self.settings.gravity;
        let mut wind = None;
        for event in c.events.iter().filter(|e| e.acts(t)) {
            match event.action {
                Action::Gravity(g) => self.settings.gravity = g,
                Action::Wind(v) => wind = Some(v),
                _ => {}
            }
        }
        let mut drive = std::mem::take(&mut c.step.from);
        drive.set(&self.skeleton, &self.binding, &self.pose);
        self.external_force(&drive);
        c.step.from = drive;
        self.settings.gravity = gravity;
        if let Some(wind) = wind {
            self.blow(c, wind);
        }
        c.pulls.clear();
        c.drags.clear();
        let omega = std::f64::consts::TAU * DRAG_FREQUENCY;
        let (longest, mass) = (LONGEST_SPRING * self.size, c.mass);
        for (event, anchor) in c.events.iter().zip(&mut c.now.anchors) {
            if !event.acts(t) {
                *anchor = None;
                continue;
            }
            let spring = |stiffness: &Option<f64>| {
                let stiffness = stiffness.unwrap_or(mass * omega * omega);
                (stiffness, 2.0 * (stiffness * mass).sqrt())
            };
            match &event.action {
                Action::DragJoint { joint, path, stiffness } => {
                    let at = *anchor.get_or_insert(self.pose.joint(*joint).translation);
                    let (target, velocity) = along(path, t).unwrap_or((at, [0.0; 3]));
                    let (stiffness, damping) = spring(stiffness);
                    c.drags.push(JointSpring { joint: *joint, target, velocity, stiffness, damping, longest });
                }
                Action::PullFlesh { mesh, vertex, path, stiffness } => {
                    let Some(nodes) = self.skin.point(*mesh, *vertex) else { continue };
                    let mut pull = PointSpring { nodes, ..PointSpring::default() };
                    let mut here = [0.0; 3];
                    for (n, w) in &pull.nodes {
                        (0..3).for_each(|k| here[k] += w * self.state.position[*n as usize][k].to_f64());
                    }
                    let at = *anchor.get_or_insert(here);
                    let (target, velocity) = along(path, t).unwrap_or((at, [0.0; 3]));
                    // no longer than it may be, seen from where the point is
                    let off: [f64; 3] = std::array::from_fn(|k| target[k] - here[k]);
                    let off = crate::couple::shortened(off, longest + dt * DVec3::from(velocity).length());
                    pull.target = std::array::from_fn(|k| here[k] + off[k]);
                    pull.velocity = velocity;
                    (pull.stiffness, pull.damping) = spring(stiffness);
                    c.pulls.push(pull);
                }
                Action::Force { mesh, vertex, force } => {
                    for (n, w) in self.skin.point(*mesh, *vertex).unwrap_or_default() {
                        let f = &mut self.scratch.external_force[n as usize];
                        (0..3).for_each(|k| f[k] = R::from_f64(f[k].to_f64() + w * force[k]));
                    }
                }
                Action::Gravity(_) | Action::Wind(_) => {}
            }
        }
    }

    /// Air presses on faces that it blows against: half its density times the square of its speed along their normal.
    fn blow(&mut self, c: &CoupledState<R>, wind: [f64; 3]) {
        let at = |n: u32| DVec3::from(self.state.position[n as usize].map(Scalar::to_f64));
        let velocity = |n: u32| DVec3::from(self.state.velocity[n as usize].map(Scalar::to_f64));
        let mut add = Vec::new();
        for t in &c.faces.triangles {
            let [p, q, r] = t.map(at);
            let area = (q - p).cross(r - p) * 0.5;
            let moving = t.map(velocity).iter().sum::<DVec3>() / 3.0;
            let Some(normal) = area.try_normalize() else { continue };
            let against = (DVec3::from(wind) - moving).dot(normal);
            if against < 0.0 {
                let force = area * (-0.5 * AIR * against * against / 3.0);
                t.iter().for_each(|n| add.push((*n, force)));
            }
        }
        for (n, f) in add {
            let to = &mut self.scratch.external_force[n as usize];
            *to = cast(std::array::from_fn(|k| to[k].to_f64() + f[k]));
        }
    }
}
