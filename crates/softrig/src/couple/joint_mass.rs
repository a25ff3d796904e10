//! The mass that joints stand for in the staggered coupling [Georgii2010 §4.2]: every node's mass goes to the two ends of its
//! nearest bone, by where it projects to.

use glam::DVec3;

/// What [`joint_masses`] finds.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct JointMasses {
    /// Mass of each joint [kg].
    pub mass: Vec<f64>,
    /// Mass of nodes beside all bones, of which no joint has any yet [kg].
    pub unassigned: f64,
}

/// Mass of joints at `place` [m], connected by `bones`, from nodes with their masses. Nodes that project to no bone are left over.
#[must_use]
pub fn joint_masses(place: &[[f64; 3]], bones: &[[usize; 2]], nodes: &[[f64; 3]], mass: &[f64]) -> JointMasses {
    let mut out = JointMasses { mass: vec![0.0; place.len()], unassigned: 0.0 };
    for (p, m) in nodes.iter().zip(mass) {
        match nearest_bone(place, bones, *p) {
            Some((bone, w)) => {
                out.mass[bones[bone][0]] += (1.0 - w) * m;
                out.mass[bones[bone][1]] += w * m;
            }
            None => out.unassigned += m,
        }
    }
    out
}

/// The nearest bone that a point projects to, the first one on a tie, and how far along it [-].
#[must_use]
pub fn nearest_bone(place: &[[f64; 3]], bones: &[[usize; 2]], p: [f64; 3]) -> Option<(usize, f64)> {
    let mut best: Option<(usize, f64, f64)> = None;
    for (i, [a, b]) in bones.iter().enumerate() {
        let (a, axis) = (DVec3::from(place[*a]), DVec3::from(place[*b]) - DVec3::from(place[*a]));
        let square = axis.length_squared();
        let w = if square > 0.0 { (DVec3::from(p) - a).dot(axis) / square } else { f64::NAN };
        let distance = (DVec3::from(p) - a - axis * w).length();
        if (0.0..=1.0).contains(&w) && best.is_none_or(|b| distance < b.2) {
            best = Some((i, w, distance));
        }
    }
    best.map(|b| (b.0, b.1))
}
