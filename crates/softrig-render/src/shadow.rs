//! Shadows: what the key light does not reach, and the soft dark patch that puts a figure on the ground.

use crate::geometry::{Geometry, cross, dot, unit};

/// Texels a side of the map seen from the key light.
const MAP: usize = 640;

/// Cells a side of the maps on the ground.
const GROUND: usize = 256;

pub(crate) struct Shadow {
    /// Right and up of the map, and towards the light.
    axes: [[f32; 3]; 3],
    low: [f32; 2],
    texel: f32,
    /// Nearest to the light in each texel, as distance along the way to it.
    nearest: Vec<f32>,
    ground: Option<GroundShadow>,
}

/// Darkness of the ground.
struct GroundShadow {
    low: [f32; 2],
    cell: f32,
    /// 1 lit, 0 black.
    light: Vec<f32>,
}

impl Shadow {
    /// `None` when nothing throws a shadow.
    pub(crate) fn new(geometry: &Geometry, key: [f32; 3], ground: Option<f32>) -> Option<Self> {
        let at = |v: u32| geometry.vertices[v as usize].position;
        let (mut low, mut high) = ([f32::MAX; 3], [f32::MIN; 3]);
        for p in geometry.casters.iter().flatten().map(|v| at(*v)) {
            for k in 0..3 {
                low[k] = low[k].min(p[k]);
                high[k] = high[k].max(p[k]);
            }
        }
        let middle: [f32; 3] = std::array::from_fn(|k| 0.5 * (low[k] + high[k]));
        let radius = 0.5 * (0..3).map(|k| (high[k] - low[k]) * (high[k] - low[k])).sum::<f32>().sqrt();
        if geometry.casters.is_empty() || !(radius > 0.0 && radius.is_finite()) {
            return None;
        }
        let right = unit(cross([0.0, 1.0, 0.0], key));
        let up = cross(key, right);
        let axes = [right, up, key];
        let texel = 2.04 * radius / MAP as f32;
        let low = [dot(middle, right) - 1.02 * radius, dot(middle, up) - 1.02 * radius];
        let mut nearest = vec![f32::MIN; MAP * MAP];
        for t in &geometry.casters {
            let p = t.map(|v| {
                let p = at(v);
                [(dot(p, right) - low[0]) / texel, (dot(p, up) - low[1]) / texel, dot(p, key)]
            });
            fill(p, MAP, |i, depth| nearest[i] = nearest[i].max(depth));
        }
        let ground = ground.map(|y| GroundShadow::new(geometry, key, y, middle, radius));
        Some(Self { axes, low, texel, nearest, ground })
    }

    /// How much of the key light reaches a surface, 0 to 1.
    pub(crate) fn light_at(&self, position: [f32; 3], normal: [f32; 3]) -> f32 {
        // a step out of the surface, longer where light grazes it, keeps it from shadowing itself
        let slope = 1.0 - dot(normal, self.axes[2]).clamp(0.0, 1.0);
        let step = self.texel * (1.5 + 2.5 * slope);
        let p: [f32; 3] = std::array::from_fn(|k| position[k] + step * normal[k]);
        let depth = dot(p, self.axes[2]) + self.texel;
        let place = |k: usize| (dot(p, self.axes[k]) - self.low[k]) / self.texel - 0.5;
        let (x, y) = (place(0), place(1));
        let (i, j) = (x.floor(), y.floor());
        let (fx, fy) = (x - i, y - j);
        // a box five texels wide that slides smoothly over the map
        const REACH: i64 = 3;
        let width = |d: i64, f: f32| match d {
            d if d == 1 - REACH => 1.0 - f,
            d if d == REACH => f,
            _ => 1.0,
        };
        let (mut lit, mut all) = (0.0, 0.0);
        for dy in 1 - REACH..=REACH {
            for dx in 1 - REACH..=REACH {
                let share = width(dx, fx) * width(dy, fy);
                let (u, v) = (i as i64 + dx, j as i64 + dy);
                let free = !(0..MAP as i64).contains(&u)
                    || !(0..MAP as i64).contains(&v)
                    || self.nearest[v as usize * MAP + u as usize] <= depth;
                all += share;
                lit += if free { share } else { 0.0 };
            }
        }
        lit / all
    }

    /// Light on the ground at a point of it, 0 to 1.
    pub(crate) fn ground_at(&self, p: [f32; 3]) -> f32 {
        self.ground.as_ref().map_or(1.0, |g| g.at(p))
    }
}

impl GroundShadow {
    fn new(geometry: &Geometry, key: [f32; 3], ground: f32, middle: [f32; 3], radius: f32) -> Self {
        // wide enough for the key light's shadow, whose far end is the head's
        let reach = 2.2 * radius;
        let cell = 2.0 * reach / GROUND as f32;
        let lean = [key[0] / key[1].max(0.3), key[2] / key[1].max(0.3)];
        // the middle of both kinds of shadow
        let low = [middle[0] - 0.4 * lean[0] * radius - reach, middle[2] - 0.4 * lean[1] * radius - reach];
        let (mut cast, mut above, mut touch) =
            (vec![0.0f32; GROUND * GROUND], vec![0.0f32; GROUND * GROUND], vec![0.0f32; GROUND * GROUND]);
        for t in &geometry.casters {
            let p = t.map(|v| geometry.vertices[v as usize].position);
            let place = |p: [f32; 3], lean: [f32; 2]| {
                let h = (p[1] - ground).max(0.0);
                [(p[0] - h * lean[0] - low[0]) / cell, (p[2] - h * lean[1] - low[1]) / cell, h / radius]
            };
            fill(p.map(|p| place(p, lean)), GROUND, |i, _| cast[i] = 1.0);
            fill(p.map(|p| place(p, [0.0; 2])), GROUND, |i, h| {
                above[i] = above[i].max((1.0 - 0.8 * h).max(0.0));
                touch[i] = touch[i].max((1.0 - 9.0 * h).max(0.0));
            });
        }
        let cells = |share: f32| ((share * radius / cell) as usize).max(1);
        blur(&mut cast, cells(0.035));
        blur(&mut above, cells(0.075));
        blur(&mut touch, cells(0.018));
        let light = (0..GROUND * GROUND)
            .map(|i| (1.0 - 0.30 * cast[i]) * (1.0 - 0.38 * above[i]) * (1.0 - 0.45 * touch[i]))
            .collect();
        Self { low, cell, light }
    }

    fn at(&self, p: [f32; 3]) -> f32 {
        let place = |k: usize, c: f32| (c - self.low[k]) / self.cell - 0.5;
        let (x, y) = (place(0, p[0]), place(1, p[2]));
        let last = (GROUND - 1) as f32;
        if !(x > 0.0 && y > 0.0 && x < last && y < last) {
            return 1.0;
        }
        let (i, j) = (x as usize, y as usize);
        let (fx, fy) = (x - i as f32, y - j as f32);
        let row = |j: usize| self.light[j * GROUND + i] * (1.0 - fx) + self.light[j * GROUND + i + 1] * fx;
        row(j) * (1.0 - fy) + row(j + 1) * fy
    }
}

/// Calls `put` with every cell whose middle a triangle covers, and its third coordinate there. Cells on an edge count for both
/// sides: a shadow may be drawn twice, but must not have a gap.
fn fill(p: [[f32; 3]; 3], size: usize, mut put: impl FnMut(usize, f32)) {
    let low = |k: usize| p.iter().map(|p| p[k]).fold(f32::MAX, f32::min);
    let high = |k: usize| p.iter().map(|p| p[k]).fold(f32::MIN, f32::max);
    let clip = |v: f32| v.clamp(0.0, size as f32) as usize;
    let area = (p[1][0] - p[0][0]) * (p[2][1] - p[0][1]) - (p[2][0] - p[0][0]) * (p[1][1] - p[0][1]);
    if area.is_nan() || area == 0.0 {
        return;
    }
    for j in clip(low(1) - 0.5)..clip(high(1) + 0.5) {
        for i in clip(low(0) - 0.5)..clip(high(0) + 0.5) {
            let (x, y) = (i as f32 + 0.5, j as f32 + 0.5);
            let weight = |a: usize, b: usize| ((p[a][0] - x) * (p[b][1] - y) - (p[b][0] - x) * (p[a][1] - y)) / area;
            let (w0, w1, w2) = (weight(1, 2), weight(2, 0), weight(0, 1));
            if w0.min(w1).min(w2) >= -1e-4 {
                put(j * size + i, w0 * p[0][2] + w1 * p[1][2] + w2 * p[2][2]);
            }
        }
    }
}

/// Three box averages in each direction: close to a Gaussian of the box's width.
fn blur(map: &mut [f32], half: usize) {
    let mut line = vec![0.0; GROUND];
    for _ in 0..3 {
        for (step, stride) in [(1, GROUND), (GROUND, 1)] {
            for l in 0..GROUND {
                let at = |i: usize| l * stride + i * step;
                let mut sum = 0.0f64;
                for (i, out) in line.iter_mut().enumerate() {
                    if i == 0 {
                        sum = (0..=half.min(GROUND - 1)).map(|k| f64::from(map[at(k)])).sum();
                    } else {
                        if i + half < GROUND {
                            sum += f64::from(map[at(i + half)]);
                        }
                        if i > half {
                            sum -= f64::from(map[at(i - half - 1)]);
                        }
                    }
                    *out = (sum / (2 * half + 1) as f64) as f32;
                }
                for (i, v) in line.iter().enumerate() {
                    map[at(i)] = *v;
                }
            }
        }
    }
}
