//! Where a picture is taken from.

use crate::scene::Settings;

/// A box around everything that is to be seen, over all frames.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds {
    /// Lowest corner [m].
    pub low: [f64; 3],
    /// Highest corner [m].
    pub high: [f64; 3],
}

impl Default for Bounds {
    /// Holds nothing yet.
    fn default() -> Self {
        Self { low: [f64::INFINITY; 3], high: [f64::NEG_INFINITY; 3] }
    }
}

impl Bounds {
    /// Grows to hold points; those that are not finite are passed over.
    pub fn extend(&mut self, points: &[[f64; 3]]) {
        for p in points.iter().filter(|p| p.iter().all(|v| v.is_finite())) {
            for k in 0..3 {
                self.low[k] = self.low[k].min(p[k]);
                self.high[k] = self.high[k].max(p[k]);
            }
        }
    }

    /// Whether it holds nothing.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        (0..3).any(|k| self.high[k] < self.low[k])
    }

    /// The box, or a unit cube around the origin when nothing was put in.
    fn or_unit(self) -> Self {
        if self.is_empty() { Self { low: [-0.5; 3], high: [0.5; 3] } } else { self }
    }
}

/// Named directions to look from. Characters face +Z.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum View {
    /// From +Z.
    Front,
    /// From +X: the character's left.
    Side,
    /// From -Z.
    Back,
    /// From the front, a little to its left and above.
    ThreeQuarter,
    /// From above.
    Top,
    /// Turned about the vertical by so many degrees from the front, a little above.
    Turntable(f64),
}

impl View {
    /// The view of this name: `front`, `side`, `back`, `three-quarter`, `top`, or a turntable angle in degrees.
    #[must_use]
    pub fn parse(name: &str) -> Option<Self> {
        Some(match name {
            "front" => Self::Front,
            "side" => Self::Side,
            "back" => Self::Back,
            "three-quarter" => Self::ThreeQuarter,
            "top" => Self::Top,
            _ => Self::Turntable(name.parse().ok().filter(|a: &f64| a.is_finite())?),
        })
    }

    /// Yaw and pitch [degrees].
    fn angles(self) -> [f64; 2] {
        match self {
            Self::Front => [0.0, 4.0],
            Self::Side => [90.0, 4.0],
            Self::Back => [180.0, 4.0],
            Self::ThreeQuarter => [32.0, 9.0],
            // not quite overhead: the ground keeps a direction
            Self::Top => [0.0, 80.0],
            Self::Turntable(yaw) => [yaw, 9.0],
        }
    }
}

/// A perspective camera that circles a target.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    /// What is in the middle of the picture [m].
    pub target: [f64; 3],
    /// From the target [m].
    pub distance: f64,
    /// About the vertical, 0 from +Z, 90 from +X [degrees].
    pub yaw: f64,
    /// Above the horizon [degrees], within -89 to 89.
    pub pitch: f64,
    /// Height of the picture as an angle [degrees]. 24 shows a figure with little distortion.
    pub field_of_view: f64,
}

impl Default for Camera {
    fn default() -> Self {
        Self { target: [0.0, 0.8, 0.0], distance: 5.0, yaw: 0.0, pitch: 5.0, field_of_view: 24.0 }
    }
}

impl Camera {
    /// A camera that sees all of `bounds` with a margin, as large as possible.
    #[must_use]
    pub fn framing(bounds: Bounds, view: View, settings: &Settings) -> Self {
        let bounds = bounds.or_unit();
        let [yaw, pitch] = view.angles();
        let mut camera = Self { yaw, pitch, ..Self::default() };
        camera.target = std::array::from_fn(|k| 0.5 * (bounds.low[k] + bounds.high[k]));
        let diagonal = (0..3).map(|k| (bounds.high[k] - bounds.low[k]).powi(2)).sum::<f64>().sqrt().max(1e-6);
        let half = (0.5 * camera.field_of_view.to_radians()).tan();
        let aspect = f64::from(settings.width.max(1)) / f64::from(settings.height.max(1));
        let [right, up, back] = camera.axes();
        let corners: Vec<[f64; 3]> = (0..8)
            .map(|c| std::array::from_fn(|k| if c >> k & 1 == 0 { bounds.low[k] } else { bounds.high[k] }))
            .collect();
        // corners as (right, up, towards the camera) from the target
        let local = |target: [f64; 3]| -> Vec<[f64; 3]> {
            corners
                .iter()
                .map(|c| {
                    let d: [f64; 3] = std::array::from_fn(|k| c[k] - target[k]);
                    [dot(d, right), dot(d, up), dot(d, back)]
                })
                .collect()
        };
        // the least distance from which every corner is within the picture, the target moved to the middle of what is seen
        const MARGIN: f64 = 1.06;
        for _ in 0..3 {
            camera.distance = local(camera.target)
                .iter()
                .map(|c| c[2] + MARGIN * (c[0].abs() / (half * aspect)).max(c[1].abs() / half))
                .fold(0.5 * diagonal, f64::max);
            let seen = local(camera.target);
            let middle = |k: usize| {
                let at = |c: &[f64; 3]| c[k] / (camera.distance - c[2]).max(1e-9);
                let low = seen.iter().map(at).fold(f64::INFINITY, f64::min);
                let high = seen.iter().map(at).fold(f64::NEG_INFINITY, f64::max);
                0.5 * (low + high) * camera.distance
            };
            let (x, y) = (middle(0), middle(1));
            camera.target = std::array::from_fn(|k| camera.target[k] + x * right[k] + y * up[k]);
        }
        camera
    }

    /// Right, up, and towards the camera, in the world.
    pub(crate) fn axes(&self) -> [[f64; 3]; 3] {
        let (sy, cy) = self.yaw.to_radians().sin_cos();
        let (sp, cp) = self.pitch.to_radians().sin_cos();
        [[cy, 0.0, -sy], [-sy * sp, cp, -cy * sp], [sy * cp, sp, cy * cp]]
    }
}

pub(crate) fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Projects the corners of boxes of all proportions: each must land inside the picture, and one close to its edge.
    #[test]
    fn framing_fills_the_picture_and_cuts_nothing_off() {
        let settings = Settings { width: 400, height: 300, ..Settings::default() };
        for (i, view) in
            [View::Front, View::Side, View::ThreeQuarter, View::Top, View::Turntable(217.0)].iter().enumerate()
        {
            let size = [1.0, 0.1 + i as f64, 3.0 / (1.0 + i as f64)];
            let bounds = Bounds { low: [5.0, 1.0, -2.0], high: [5.0 + size[0], 1.0 + size[1], -2.0 + size[2]] };
            let camera = Camera::framing(bounds, *view, &settings);
            let [right, up, back] = camera.axes();
            let half = (0.5 * camera.field_of_view.to_radians()).tan();
            let mut most: f64 = 0.0;
            for c in 0..8 {
                let p: [f64; 3] = std::array::from_fn(|k| {
                    (if c >> k & 1 == 0 { bounds.low[k] } else { bounds.high[k] }) - camera.target[k]
                });
                let depth = camera.distance - dot(p, back);
                most = most
                    .max((dot(p, right) / (depth * half * 4.0 / 3.0)).abs())
                    .max((dot(p, up) / (depth * half)).abs());
            }
            assert!((0.85..1.0).contains(&most), "{view:?} {most}");
        }
    }
}
