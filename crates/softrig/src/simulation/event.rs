//! What happens to a character from outside: drags, pulls, pins, wind. Every event carries its times, so that a take that was
//! recorded is baked again exactly.

use crate::rig::JointId;

/// Something that acts for a while.
#[derive(Clone, Debug, PartialEq)]
pub struct Event {
    /// When it begins [s].
    pub start: f64,
    /// When it ends [s]; infinite for good.
    pub end: f64,
    /// What it does.
    pub action: Action,
}

/// A place at a time; between two of them a point moves straight.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Key {
    /// [s]
    pub time: f64,
    /// World position [m].
    pub position: [f64; 3],
}

/// What an event does.
#[derive(Clone, Debug, PartialEq)]
pub enum Action {
    /// Pulls a joint along a path. Without a path it is held where it is when the event begins.
    DragJoint {
        /// The joint.
        joint: JointId,
        /// Where to, times ascending.
        path: Vec<Key>,
        /// Of the spring that pulls [N/m]; `None`: one that swings the whole body three times a second.
        stiffness: Option<f64>,
    },
    /// Pulls the flesh at a skin vertex along a path. Without a path it is held where it is when the event begins.
    PullFlesh {
        /// Mesh of the character.
        mesh: usize,
        /// Its vertex.
        vertex: usize,
        /// Where to, times ascending.
        path: Vec<Key>,
        /// As for joints.
        stiffness: Option<f64>,
    },
    /// Acts on the flesh at a skin vertex with a set force.
    Force {
        /// Mesh of the character.
        mesh: usize,
        /// Its vertex.
        vertex: usize,
        /// [N]
        force: [f64; 3],
    },
    /// Other gravity than the settings' [m/s2].
    Gravity([f64; 3]),
    /// Moving air [m/s], which presses on the surface it meets.
    Wind([f64; 3]),
}

impl Event {
    /// Whether it acts in a step that ends at `time`.
    #[must_use]
    pub fn acts(&self, time: f64) -> bool {
        // the first step that begins at or after the start: a hair for rounding of times
        time > self.start + 1e-9 && time <= self.end + 1e-9
    }
}

/// Place and velocity on a path at `time`; the ends are held. `None` without keys.
#[must_use]
pub fn along(path: &[Key], time: f64) -> Option<([f64; 3], [f64; 3])> {
    let last = path.last()?;
    let after = path.partition_point(|k| k.time < time);
    if after == 0 {
        return Some((path[0].position, [0.0; 3]));
    }
    if after == path.len() {
        return Some((last.position, [0.0; 3]));
    }
    let (a, b) = (path[after - 1], path[after]);
    let span = b.time - a.time;
    if span <= 0.0 {
        return Some((b.position, [0.0; 3]));
    }
    let s = (time - a.time) / span;
    let velocity = std::array::from_fn(|k| (b.position[k] - a.position[k]) / span);
    Some((std::array::from_fn(|k| a.position[k] + s * (b.position[k] - a.position[k])), velocity))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_are_straight_between_their_keys() {
        let path = [(1.0, 0.0), (2.0, 4.0), (2.0, 5.0)].map(|(time, x)| Key { time, position: [x, 0.0, 0.0] });
        let at = |t| along(&path, t).map(|(p, v)| (p[0], v[0]));
        assert_eq!(at(0.5), Some((0.0, 0.0)));
        assert_eq!(at(1.25), Some((1.0, 4.0)));
        assert_eq!(at(3.0), Some((5.0, 0.0)));
        assert_eq!(along(&[], 1.0), None);
    }

    /// A step from the start of an event on has it, the one that ends there has not.
    #[test]
    fn events_act_from_their_start_to_their_end() {
        let e = Event { start: 1.0, end: 2.0, action: Action::Gravity([0.0; 3]) };
        assert_eq!([1.0, 1.01, 2.0, 2.01].map(|t| e.acts(t)), [false, true, true, false]);
    }
}
