//! Meshes that only follow one joint: motion as translation, rotation and scale.

use super::ExportError;
use crate::journal::{JournalFrame, JournalReader};
use softrig::character::{Character, Skin};
use softrig::rig::{Affine, Transform};
use std::io::{Read, Seek};

/// A mesh that moves as a whole.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct RigidMotion {
    /// Vertices in the frame of the node that carries them.
    pub positions: Vec<[f64; 3]>,
    /// What the node does in each frame; one entry when it stands still.
    pub transforms: Vec<Transform>,
}

/// The motion of one mesh as that of a rigid node, when it is one to within `tolerance` [m].
pub(super) fn rigid_motion<S: Read + Seek>(
    journal: &mut JournalReader<S>,
    character: &Character,
    mesh: usize,
    tolerance: f64,
) -> Result<Option<RigidMotion>, ExportError> {
    let rest = &character.meshes[mesh].positions;
    let joint = match &character.meshes[mesh].skin {
        Skin::Weighted(_) => return Ok(None),
        Skin::Free => None,
        Skin::Rigid(joint) => Some(*joint),
    };
    let back = match joint.map(|j| character.skeleton.joint(j).rest.inverse()) {
        None => Affine::IDENTITY,
        Some(Some(back)) => back,
        Some(None) => return Ok(None),
    };
    let positions: Vec<[f64; 3]> = rest.iter().map(|p| back.point(*p)).collect();
    let mut transforms: Vec<Transform> = Vec::new();
    let mut frame = JournalFrame::default();
    for t in 0..journal.frame_count() {
        journal.read_frame(t, &mut frame)?;
        let world = joint.map_or(Affine::IDENTITY, |j| *frame.pose.joint(j));
        let mut transform = decompose(&world);
        if let Some(before) = transforms.last() {
            // the same rotation on the side of the sphere that lies closer to the last one
            let dot: f64 = before.rotation.iter().zip(&transform.rotation).map(|(a, b)| a * b).sum();
            if dot < 0.0 {
                transform.rotation = transform.rotation.map(|v| -v);
            }
        }
        let placed = transform.to_affine();
        let off = |(p, q): (&[f64; 3], &[f32; 3])| {
            let r = placed.point(*p);
            (0..3).map(|k| (r[k] - f64::from(q[k])).powi(2)).sum::<f64>() > tolerance * tolerance
        };
        if positions.iter().zip(&frame.skin[mesh]).any(off) {
            return Ok(None);
        }
        transforms.push(transform);
    }
    if joint.is_none() {
        transforms.truncate(1);
    }
    Ok(Some(RigidMotion { positions, transforms }))
}

/// Translation, rotation and scale nearest to a map: exact unless it shears.
fn decompose(map: &Affine) -> Transform {
    let column = |j: usize| [map.linear[0][j], map.linear[1][j], map.linear[2][j]];
    let length = |v: [f64; 3]| (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]).sqrt();
    let mut scale = [length(column(0)), length(column(1)), length(column(2))];
    if map.determinant() < 0.0 {
        scale[0] = -scale[0];
    }
    let r: [[f64; 3]; 3] = std::array::from_fn(|i| std::array::from_fn(|j| map.linear[i][j] / nonzero(scale[j])));
    Transform { translation: map.translation, rotation: quaternion(&r), scale }
}

fn nonzero(v: f64) -> f64 {
    if v == 0.0 { 1.0 } else { v }
}

/// Unit quaternion (x, y, z, w) of a rotation given by rows; the largest component is found first, so nothing cancels.
fn quaternion(r: &[[f64; 3]; 3]) -> [f64; 4] {
    let trace = r[0][0] + r[1][1] + r[2][2];
    let q = if trace > 0.0 {
        [r[2][1] - r[1][2], r[0][2] - r[2][0], r[1][0] - r[0][1], 1.0 + trace]
    } else {
        let i = (0..3).fold(0, |i, k| if r[k][k] > r[i][i] { k } else { i });
        let (j, k) = ((i + 1) % 3, (i + 2) % 3);
        let mut q = [0.0; 4];
        q[i] = 1.0 + r[i][i] - r[j][j] - r[k][k];
        q[j] = r[j][i] + r[i][j];
        q[k] = r[k][i] + r[i][k];
        q[3] = r[k][j] - r[j][k];
        q
    };
    let length = q.iter().map(|v| v * v).sum::<f64>().sqrt();
    if length > 0.0 && length.is_finite() { q.map(|v| v / length) } else { [0.0, 0.0, 0.0, 1.0] }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn decomposition_gives_the_map_back() {
        for rotation in [[0.1, 0.7, -0.2, 0.6], [0.9, 0.1, 0.0, -0.1], [0.0, 1.0, 0.0, 0.0], [0.1, 0.0, 0.9, 0.05]] {
            for x in [100.0, -2.0] {
                let t = Transform { translation: [1.0, -2.0, 3.0], rotation, scale: [x, 50.0, 0.1] };
                let (map, back) = (t.to_affine(), decompose(&t.to_affine()).to_affine());
                for (a, b) in map.linear.iter().flatten().zip(back.linear.iter().flatten()) {
                    assert!((a - b).abs() < 1e-10, "{map:?} {back:?}");
                }
            }
        }
    }
}
