//! Colours: sRGB to light and back, colour maps, colours of bones.

use std::sync::LazyLock;

/// sRGB level to linear light.
static TO_LINEAR: LazyLock<[f32; 256]> = LazyLock::new(|| {
    std::array::from_fn(|i| {
        let c = i as f32 / 255.0;
        if c <= 0.04045 { c / 12.92 } else { ((c + 0.055) / 1.055).powf(2.4) }
    })
});

/// Linear light to sRGB level, at 4096 equal steps of the square root: fine where the curve is steep.
static TO_SRGB: LazyLock<Vec<u8>> = LazyLock::new(|| {
    (0..=4096)
        .map(|i| {
            let l = (i as f32 / 4096.0).powi(2);
            let c = if l <= 0.003_130_8 { 12.92 * l } else { 1.055 * l.powf(1.0 / 2.4) - 0.055 };
            (c * 255.0 + 0.5) as u8
        })
        .collect()
});

/// Linear light of an sRGB level.
pub(crate) fn linear(level: u8) -> f32 {
    TO_LINEAR[usize::from(level)]
}

/// Linear light of an sRGB colour.
pub(crate) fn linear_rgb(c: [u8; 3]) -> [f32; 3] {
    c.map(linear)
}

/// Nearest sRGB levels of linear light; what is not finite becomes black or white.
pub(crate) fn srgb(light: [f32; 3]) -> [u8; 3] {
    light.map(|l| TO_SRGB[(l.clamp(0.0, 1.0).sqrt() * 4096.0 + 0.5) as usize])
}

/// From numbers to colours.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ColorMap {
    /// Dark blue over green to yellow: for amounts, such as stress or displacement.
    #[default]
    Amount,
    /// Pale to deep red: for parts of one, such as skin weights.
    Heat,
    /// Blue over white to red: for signed numbers, the middle of the range white.
    Signed,
}

impl ColorMap {
    /// sRGB colours at equal steps.
    fn stops(self) -> &'static [[u8; 3]] {
        match self {
            Self::Amount => {
                &[[52, 36, 110], [50, 84, 158], [36, 130, 160], [52, 172, 136], [130, 208, 92], [248, 226, 68]]
            }
            Self::Heat => &[[238, 236, 232], [250, 214, 160], [244, 154, 92], [216, 82, 62], [138, 22, 48]],
            Self::Signed => &[[40, 76, 160], [118, 168, 214], [240, 240, 240], [236, 150, 116], [166, 32, 44]],
        }
    }

    /// Linear RGB at `t` in 0 to 1; beyond, the colour of the nearer end; grey where `t` is not a number.
    #[must_use]
    pub fn at(self, t: f32) -> [f32; 3] {
        if t.is_nan() {
            return linear_rgb([150, 150, 150]);
        }
        let stops = self.stops();
        let s = t.clamp(0.0, 1.0) * (stops.len() - 1) as f32;
        let i = (s as usize).min(stops.len() - 2);
        let (a, b, u) = (linear_rgb(stops[i]), linear_rgb(stops[i + 1]), s - i as f32);
        std::array::from_fn(|k| a[k] + u * (b[k] - a[k]))
    }
}

/// A colour for bone number `index`, linear RGB: neighbours differ, and the same number has the same colour in every picture.
#[must_use]
pub fn bone_color(index: usize) -> [f32; 3] {
    // steps of the golden ratio round the colour circle keep any run of numbers apart
    let hue = (index as f32 * 0.618_034 + 0.02).fract() * 6.0;
    let bright = if index.is_multiple_of(2) { 1.0 } else { 0.80 };
    let channel = |shift: f32| {
        let d = ((hue + shift) % 6.0 - 3.0).abs() - 1.0;
        (0.16 + 0.72 * d.clamp(0.0, 1.0)) * bright
    };
    let c = [channel(0.0), channel(4.0), channel(2.0)];
    c.map(|v| v * v)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn light_and_back_gives_the_same_level() {
        for level in 0..=255 {
            assert_eq!(srgb([linear(level); 3]), [level; 3]);
        }
    }
}
