//! Animation clips: key frames on the local transforms of joints.

use super::affine::Transform;
use super::skeleton::{JointId, Skeleton};
use glam::DQuat;

/// What a track moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Property {
    /// Three numbers per key, in file units.
    Translation,
    /// A quaternion (x, y, z, w) per key.
    Rotation,
    /// Three factors per key.
    Scale,
}

/// How values between keys are found, as glTF defines it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Interpolation {
    /// Constant until the next key.
    Step,
    /// Straight line; spherical for rotations.
    Linear,
    /// Cubic Hermite spline: three values per key (in-tangent, value, out-tangent).
    CubicSpline,
}

/// Key frames of one property of one joint.
#[derive(Clone, Debug, PartialEq)]
pub struct Track {
    /// The joint it moves.
    pub joint: JointId,
    /// What of it.
    pub property: Property,
    /// How to interpolate.
    pub interpolation: Interpolation,
    /// Key times [s], ascending.
    pub times: Vec<f64>,
    /// One value per key (three for [`Interpolation::CubicSpline`]); only the first three numbers count for vectors.
    pub values: Vec<[f64; 4]>,
}

/// A named animation.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Clip {
    /// Name in the file, or one made up from its index.
    pub name: String,
    /// Time of the first key [s].
    pub start: f64,
    /// Time of the last key [s].
    pub end: f64,
    /// One track per animated property.
    pub tracks: Vec<Track>,
}

impl Clip {
    /// Length [s].
    #[must_use]
    pub fn duration(&self) -> f64 {
        self.end - self.start
    }

    /// Local transforms of all joints at `time` [s] of the clip's own clock; before the first key and after the last one the
    /// nearest key holds. Joints without a track keep the skeleton's own transform.
    #[must_use]
    pub fn sample(&self, skeleton: &Skeleton, time: f64) -> Vec<Transform> {
        let mut locals = Vec::new();
        self.sample_into(skeleton, time, &mut locals);
        locals
    }

    /// As [`Self::sample`], into a list that is kept.
    pub fn sample_into(&self, skeleton: &Skeleton, time: f64, locals: &mut Vec<Transform>) {
        locals.clear();
        locals.extend(skeleton.joints().iter().map(|j| j.local));
        for track in &self.tracks {
            let Some(local) = locals.get_mut(track.joint.index()) else { continue };
            let Some(v) = track.sample(time) else { continue };
            match track.property {
                Property::Translation => local.translation = [v[0], v[1], v[2]],
                Property::Rotation => local.rotation = v,
                Property::Scale => local.scale = [v[0], v[1], v[2]],
            }
        }
    }
}

impl Track {
    /// Value at `time` [s]; `None` for a track without keys.
    #[must_use]
    pub fn sample(&self, time: f64) -> Option<[f64; 4]> {
        let last = self.times.len().checked_sub(1)?;
        let per_key = if self.interpolation == Interpolation::CubicSpline { 3 } else { 1 };
        if self.values.len() < per_key * self.times.len() {
            return None;
        }
        let key = |i: usize| self.values[per_key * i + per_key / 2];
        let after = self.times.partition_point(|t| *t <= time);
        if after == 0 || after > last {
            return Some(self.finish(key(if after == 0 { 0 } else { last })));
        }
        let (i, j) = (after - 1, after);
        let span = self.times[j] - self.times[i];
        let s = if span > 0.0 { (time - self.times[i]) / span } else { 1.0 };
        let value = match self.interpolation {
            Interpolation::Step => key(i),
            Interpolation::Linear if self.property == Property::Rotation => {
                let (a, b) = (DQuat::from_array(key(i)).normalize(), DQuat::from_array(key(j)).normalize());
                a.slerp(b, s).to_array()
            }
            Interpolation::Linear => std::array::from_fn(|k| key(i)[k] + s * (key(j)[k] - key(i)[k])),
            Interpolation::CubicSpline => {
                // Hermite basis; tangents are per second, hence times the span
                let (s2, s3) = (s * s, s * s * s);
                let (out, into) = (self.values[3 * i + 2], self.values[3 * j]);
                std::array::from_fn(|k| {
                    (2.0 * s3 - 3.0 * s2 + 1.0) * key(i)[k]
                        + span * (s3 - 2.0 * s2 + s) * out[k]
                        + (3.0 * s2 - 2.0 * s3) * key(j)[k]
                        + span * (s3 - s2) * into[k]
                })
            }
        };
        Some(self.finish(value))
    }

    /// Rotations leave normalised; everything else as it is.
    fn finish(&self, v: [f64; 4]) -> [f64; 4] {
        if self.property != Property::Rotation {
            return v;
        }
        let q = DQuat::from_array(v);
        let length = q.length();
        if length.is_finite() && length > 0.0 { (q / length).to_array() } else { DQuat::IDENTITY.to_array() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn track(interpolation: Interpolation, values: Vec<[f64; 4]>) -> Track {
        Track { joint: JointId(0), property: Property::Translation, interpolation, times: vec![1.0, 3.0], values }
    }

    #[test]
    fn keys_hold_outside_their_times() {
        let t = track(Interpolation::Linear, vec![[1.0, 0.0, 0.0, 0.0], [2.0, 0.0, 0.0, 0.0]]);
        assert_eq!(t.sample(0.0).unwrap()[0], 1.0);
        assert_eq!(t.sample(2.0).unwrap()[0], 1.5);
        assert_eq!(t.sample(9.0).unwrap()[0], 2.0);
    }

    /// A cubic with value and slope of x³ at both ends is x³ in between: checks the factor of the span on the tangents.
    #[test]
    fn cubic_spline_reproduces_a_cubic() {
        let f = |x: f64| [x * x * x, 0.0, 0.0, 0.0];
        let d = |x: f64| [3.0 * x * x, 0.0, 0.0, 0.0];
        let t = track(Interpolation::CubicSpline, vec![d(1.0), f(1.0), d(1.0), d(3.0), f(3.0), d(3.0)]);
        assert!((t.sample(1.7).unwrap()[0] - 1.7f64.powi(3)).abs() < 1e-12);
    }
}
