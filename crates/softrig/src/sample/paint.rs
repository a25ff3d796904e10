//! Colours of the sample character.

use crate::character::Look;
use crate::mesh::SurfaceMesh;
use glam::DVec3;

/// Look of whatever no region covers.
pub(super) const SKIN: u32 = 0;
/// Look of hair and brows.
pub(super) const HAIR: u32 = 5;
/// Look of the eyes.
pub(super) const EYE: u32 = 6;
/// Look of the light in the eyes.
pub(super) const GLINT: u32 = 7;
/// Look of the mouth.
pub(super) const MOUTH: u32 = 8;

/// A piece of clothing: covers where its border function is negative. Earlier ones lie over later ones.
pub(super) struct Region {
    /// Index into [`looks`].
    pub(super) look: u32,
    /// About the distance to the border [m], negative inside.
    pub(super) border: fn(DVec3) -> f64,
}

/// What the character wears.
pub(super) const REGIONS: [Region; 5] = [
    // sole
    Region { look: 3, border: |p| p.y - 0.028 },
    // shoe
    Region { look: 2, border: |p| p.y - (0.128 - 0.12 * p.z) },
    // sock
    Region { look: 4, border: |p| p.y - 0.172 },
    // shorts: a waistband that dips under the belly, hems above the knee, never the hands
    Region { look: 1, border: |p| (p.y - (0.628 - 0.26 * p.z)).max(0.395 - p.y).max(p.x.abs() - 0.42) },
    // hair
    Region { look: HAIR, border: |p| 1.392 + 0.55 * p.z - 0.12 * p.x * p.x - p.y },
];

/// The looks, in linear light.
pub(super) fn looks() -> Vec<Look> {
    let look = |name: &str, srgb: [u8; 3]| Look {
        name: name.into(),
        base_color: [linear(srgb[0]), linear(srgb[1]), linear(srgb[2]), 1.0],
        texture: None,
    };
    vec![
        look("skin", [242, 184, 148]),
        look("shorts", [43, 98, 160]),
        look("shoes", [205, 62, 52]),
        look("soles", [240, 236, 226]),
        look("socks", [238, 238, 234]),
        look("hair", [92, 52, 34]),
        look("eyes", [34, 24, 24]),
        look("glint", [255, 255, 255]),
        look("mouth", [128, 48, 44]),
    ]
}

fn linear(srgb: u8) -> f32 {
    (f32::from(srgb) / 255.0).powf(2.2)
}

/// Tint of each vertex over its look: rosy cheeks, nose, ears, knees and elbows on bare skin, white elsewhere.
pub(super) fn colors(skin: &SurfaceMesh, look: &[u32]) -> Vec<[f32; 4]> {
    // place, radius, strength
    const ROSY: [([f64; 3], f64, f64); 7] = [
        ([0.118, 1.262, 0.16], 0.042, 1.0),
        ([0.0, 1.297, 0.235], 0.03, 0.75),
        ([0.22, 1.305, 0.0], 0.04, 0.6),
        ([0.43, 0.80, -0.07], 0.05, 0.45),
        ([0.165, 0.325, 0.09], 0.05, 0.5),
        ([0.61, 0.57, 0.0], 0.06, 0.4),
        ([0.0, 0.70, 0.29], 0.022, 0.7),
    ];
    let mut bare = vec![true; skin.positions.len()];
    for (t, look) in skin.triangles.iter().zip(look) {
        if *look != SKIN {
            t.iter().for_each(|v| bare[*v as usize] = false);
        }
    }
    let tint = |(p, bare): (&[f64; 3], &bool)| {
        let p = DVec3::new(p[0].abs(), p[1], p[2]);
        let rosy = ROSY.iter().map(|(at, r, s)| s * (-(p - DVec3::from_array(*at)).length_squared() / (r * r)).exp());
        let t = if *bare { rosy.fold(0.0, f64::max) as f32 } else { 0.0 };
        [1.0 - 0.06 * t, 1.0 - 0.42 * t, 1.0 - 0.40 * t, 1.0]
    };
    skin.positions.iter().zip(&bare).map(tint).collect()
}
