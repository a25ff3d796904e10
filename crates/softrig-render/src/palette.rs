//! Few colours for many: boxes of the colour cube, split where they vary most, then moved to the middle of what they stand for.

use std::collections::BTreeMap;

/// Colours that stand for a picture's.
pub(crate) struct Palette {
    pub(crate) colors: Vec<[u8; 3]>,
    /// Nearest palette colour of each cell of the colour cube, found when first asked for.
    nearest: Vec<u16>,
}

const UNKNOWN: u16 = u16::MAX;

/// Cell of the colour cube: 6 bits a channel.
fn cell(c: [u8; 3]) -> usize {
    c.iter().fold(0, |n, v| n << 6 | usize::from(v >> 2))
}

/// Number of colours and their sum, per cell.
#[derive(Clone, Copy, Default)]
struct Weight {
    count: f64,
    sum: [f64; 3],
}

impl Weight {
    fn mean(&self) -> [f64; 3] {
        self.sum.map(|s| s / self.count)
    }
}

impl Palette {
    /// At most `size` colours for `pixels`.
    pub(crate) fn new(pixels: impl Iterator<Item = [u8; 3]>, size: usize) -> Self {
        let mut cells: BTreeMap<usize, Weight> = BTreeMap::new();
        for p in pixels {
            let w = cells.entry(cell(p)).or_default();
            w.count += 1.0;
            (0..3).for_each(|k| w.sum[k] += f64::from(p[k]));
        }
        let mut points: Vec<Weight> = cells.into_values().collect();
        // rare colours count for more than their number: small bright spots are seen
        for p in &mut points {
            let boost = p.count.powf(-0.35);
            p.count *= boost;
            p.sum = p.sum.map(|s| s * boost);
        }
        let mut boxes = vec![points.clone()];
        while boxes.len() < size {
            let Some((widest, axis)) = widest(&boxes) else { break };
            let (low, high) = split(std::mem::take(&mut boxes[widest]), axis);
            boxes[widest] = low;
            boxes.push(high);
        }
        let mut colors: Vec<[f64; 3]> = boxes.iter().filter(|b| !b.is_empty()).map(|b| total(b).mean()).collect();
        // two rounds of moving each colour to the mean of its own
        for _ in 0..2 {
            let mut own = vec![Weight::default(); colors.len()];
            for p in &points {
                let w = &mut own[closest(&colors, p.mean())];
                w.count += p.count;
                (0..3).for_each(|k| w.sum[k] += p.sum[k]);
            }
            for (color, w) in colors.iter_mut().zip(&own).filter(|(_, w)| w.count > 0.0) {
                *color = w.mean();
            }
        }
        let colors = colors.iter().map(|c| c.map(|v| (v + 0.5) as u8)).collect();
        Self { colors, nearest: vec![UNKNOWN; 1 << 18] }
    }

    /// Index of the palette colour nearest to `c`, within the fineness of the colour cube.
    pub(crate) fn index(&mut self, c: [u8; 3]) -> u8 {
        let slot = &mut self.nearest[cell(c)];
        if *slot == UNKNOWN {
            let middle = c.map(|v| f64::from(v & !3) + 1.5);
            let colors = self.colors.iter().map(|c| c.map(f64::from));
            let far = |a: [f64; 3]| (0..3).map(|k| (a[k] - middle[k]).powi(2)).sum::<f64>();
            let best = colors.map(far).enumerate().min_by(|a, b| a.1.total_cmp(&b.1));
            *slot = best.map_or(0, |b| b.0 as u16);
        }
        *slot as u8
    }
}

fn total(points: &[Weight]) -> Weight {
    points.iter().fold(Weight::default(), |mut a, p| {
        a.count += p.count;
        (0..3).for_each(|k| a.sum[k] += p.sum[k]);
        a
    })
}

fn closest(colors: &[[f64; 3]], c: [f64; 3]) -> usize {
    let far = |a: &[f64; 3]| (0..3).map(|k| (a[k] - c[k]).powi(2)).sum::<f64>();
    (0..colors.len()).min_by(|i, j| far(&colors[*i]).total_cmp(&far(&colors[*j]))).unwrap_or(0)
}

/// The box that varies most, and along which channel; `None` when no box can be split.
fn widest(boxes: &[Vec<Weight>]) -> Option<(usize, usize)> {
    let mut best = None;
    let mut most = 0.0;
    for (i, points) in boxes.iter().enumerate().filter(|(_, b)| b.len() > 1) {
        let mean = total(points).mean();
        for k in 0..3 {
            let spread: f64 = points.iter().map(|p| p.count * (p.mean()[k] - mean[k]).powi(2)).sum();
            if spread > most {
                most = spread;
                best = Some((i, k));
            }
        }
    }
    best
}

/// Splits at the mean; both halves hold something because the box varies along the channel.
fn split(points: Vec<Weight>, axis: usize) -> (Vec<Weight>, Vec<Weight>) {
    let middle = total(&points).mean()[axis];
    points.into_iter().partition(|p| p.mean()[axis] <= middle)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn few_colours_are_kept_as_they_are() {
        let colors = [[255, 0, 0], [0, 255, 0], [12, 200, 240], [0, 0, 0]];
        let mut palette = Palette::new(colors.iter().copied().cycle().take(400), 16);
        for c in colors {
            let i = palette.index(c);
            assert_eq!(palette.colors[usize::from(i)], c);
        }
    }

    #[test]
    fn a_gradient_is_met_closely() {
        let all = || (0..=255u8).flat_map(|a| (0..16u8).map(move |b| [a, a / 2 + b, 255 - a]));
        let mut palette = Palette::new(all(), 255);
        assert!(palette.colors.len() <= 255);
        let worst = all()
            .map(|c| {
                let i = palette.index(c);
                let p = palette.colors[usize::from(i)];
                (0..3).map(|k| u32::from(c[k].abs_diff(p[k]))).max().unwrap()
            })
            .max()
            .unwrap();
        assert!(worst <= 8, "{worst}");
    }
}
