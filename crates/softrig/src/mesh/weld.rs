//! Vertices at the same place made one: seams of texture coordinates, soups of separate triangles.

use std::collections::HashMap;

/// Vertices merged by position.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Weld {
    /// Index into `positions` for each vertex given.
    pub vertex_to_welded: Vec<u32>,
    /// One position for each group of merged vertices: that of its first vertex [m].
    pub positions: Vec<[f64; 3]>,
}

/// Merges vertices that lie within `tolerance` [m] of the first vertex of a group. Groups are numbered in the order of their first
/// vertices, and each vertex joins the lowest-numbered group it can. A tolerance of 0 merges equal positions only. Vertices that are not finite stay
/// alone.
#[must_use]
pub fn weld(positions: &[[f64; 3]], tolerance: f64) -> Weld {
    let reach = positions.iter().flatten().filter(|x| x.is_finite()).fold(0.0, |m: f64, x| m.max(x.abs()));
    // below the spacing of floats at the far end, buckets could no longer be told apart
    let tolerance = tolerance.max(0.0);
    // buckets much wider than the tolerance, so that nearly every vertex looks into one only
    let bucket = (64.0 * tolerance).max(reach * 1e-9).max(f64::MIN_POSITIVE);
    let mut first_in: HashMap<[i64; 3], u32> = HashMap::with_capacity(positions.len());
    let mut next: Vec<u32> = Vec::new();
    let mut out = Weld { vertex_to_welded: Vec::with_capacity(positions.len()), positions: Vec::new() };
    for p in positions {
        let mut found = u32::MAX;
        let finite = p.iter().all(|x| x.is_finite());
        if finite {
            let lo = p.map(|x| ((x - tolerance) / bucket).floor() as i64);
            let hi = p.map(|x| ((x + tolerance) / bucket).floor() as i64);
            for z in lo[2]..=hi[2] {
                for y in lo[1]..=hi[1] {
                    for x in lo[0]..=hi[0] {
                        let mut w = first_in.get(&[x, y, z]).copied().unwrap_or(u32::MAX);
                        while w != u32::MAX {
                            let q = out.positions[w as usize];
                            let d2: f64 = (0..3).map(|k| (p[k] - q[k]).powi(2)).sum();
                            if d2 <= tolerance * tolerance && w < found {
                                found = w;
                            }
                            w = next[w as usize];
                        }
                    }
                }
            }
        }
        if found == u32::MAX {
            found = out.positions.len() as u32;
            out.positions.push(*p);
            next.push(u32::MAX);
            if finite {
                let key = p.map(|x| (x / bucket).floor() as i64);
                next[found as usize] = first_in.insert(key, found).unwrap_or(u32::MAX);
            }
        }
        out.vertex_to_welded.push(found);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every pair across every bucket border: against the quadratic loop that the definition says.
    #[test]
    fn welds_what_the_plain_loop_welds() {
        let p: Vec<[f64; 3]> = (0..600)
            .map(|i| {
                let r = |k: u64| ((i as u64 * 7919 + k * 104_729) % 41) as f64 * 0.01 + ((i * 13) % 7) as f64 * 1e-5;
                [r(1), r(2), r(3) * 0.1]
            })
            .collect();
        let tolerance = 3e-5;
        let fast = weld(&p, tolerance);
        let mut slow: Vec<[f64; 3]> = Vec::new();
        for (i, a) in p.iter().enumerate() {
            let near = |b: &[f64; 3]| (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f64>() <= tolerance * tolerance;
            let w = slow.iter().position(near).unwrap_or_else(|| {
                slow.push(*a);
                slow.len() - 1
            });
            assert_eq!(w as u32, fast.vertex_to_welded[i]);
        }
        assert_eq!(slow, fast.positions);
        assert!(slow.len() < p.len());
    }

    #[test]
    fn equal_positions_weld_at_tolerance_zero_and_nan_never() {
        let w = weld(&[[0.0; 3], [-0.0; 3], [f64::NAN; 3], [f64::NAN; 3], [1e300; 3], [1e300; 3]], 0.0);
        assert_eq!(w.vertex_to_welded, [0, 0, 1, 2, 3, 3]);
    }
}
