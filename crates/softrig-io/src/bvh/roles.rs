//! What joints are in a human figure, by the names that tools give them: so that a motion drives a character whose joints are
//! called otherwise.

use softrig::rig::{JointId, Skeleton};
use std::collections::HashMap;

/// A part of the body, `L`, `R` or neither.
pub(super) type Role = (&'static str, char);

/// Names of each role, without side, digits and separators.
const NAMES: [(&str, &[&str]); 13] = [
    ("hips", &["hips", "hip", "pelvis"]),
    ("spine", &["spine"]),
    ("chest", &["chest", "upperchest", "thorax", "spine1", "spine2"]),
    ("neck", &["neck"]),
    ("head", &["head"]),
    ("shoulder", &["shoulder", "clavicle", "collar"]),
    ("upper arm", &["arm", "upperarm", "uparm"]),
    ("forearm", &["forearm", "lowerarm", "lowarm", "elbow"]),
    ("hand", &["hand", "wrist"]),
    ("thigh", &["thigh", "upleg", "upperleg"]),
    ("shin", &["shin", "leg", "lowerleg", "lowleg", "calf", "knee"]),
    ("foot", &["foot", "ankle"]),
    ("toes", &["toes", "toe", "toebase", "ball"]),
];

/// Limbs whose joints some tools number instead of naming: from the body outward.
const NUMBERED: [(&str, &[&str]); 4] = [
    ("leg", &["thigh", "shin", "foot", "toes"]),
    ("arm", &["upper arm", "forearm", "hand"]),
    ("torso", &["hips", "spine", "chest"]),
    ("neck", &["neck", "head"]),
];

/// The joint of each role, where the names tell; the topmost of several.
pub(super) fn roles(skeleton: &Skeleton) -> HashMap<Role, JointId> {
    let parts: Vec<(JointId, String, char)> = skeleton
        .order()
        .iter()
        .map(|id| {
            let (base, side) = taken_apart(&skeleton.joint(*id).name);
            (*id, base, side)
        })
        .collect();
    let mut out = HashMap::new();
    let letters = |base: &str| base.trim_end_matches(|c: char| c.is_ascii_digit()).to_owned();
    let mut numbered = vec![false; parts.len()];
    for (base, chain) in NUMBERED {
        for side in ['L', 'R', ' '] {
            let limb: Vec<usize> =
                (0..parts.len()).filter(|i| letters(&parts[*i].1) == base && parts[*i].2 == side).collect();
            // a neck of two bones under a head is a neck
            let has_head = parts.iter().any(|p| p.1 == "head");
            if limb.len() < 2 || (base == "neck" && has_head) {
                continue;
            }
            for (i, role) in limb.iter().zip(chain) {
                out.entry((*role, side)).or_insert(parts[*i].0);
            }
            limb.iter().for_each(|i| numbered[*i] = true);
        }
    }
    for ((id, base, side), _) in parts.iter().zip(&numbered).filter(|(_, n)| !**n) {
        let named = |names: &[&str]| names.contains(&base.as_str());
        if let Some((role, _)) = NAMES.iter().find(|(_, names)| named(names)) {
            out.entry((*role, *side)).or_insert(*id);
        }
    }
    out
}

/// A name without namespace, side, separators and what tools put before it; digits stay at the end.
fn taken_apart(name: &str) -> (String, char) {
    let name = name.rsplit([':', '|']).next().unwrap_or(name);
    // words: at separators, and where a capital follows a small letter
    let mut words: Vec<String> = vec![String::new()];
    let mut before = ' ';
    for c in name.chars() {
        let begins = c.is_uppercase() && before.is_lowercase() || c.is_ascii_digit() != before.is_ascii_digit();
        if !c.is_alphanumeric() || begins {
            words.push(String::new());
        }
        if c.is_alphanumeric()
            && let Some(word) = words.last_mut()
        {
            word.extend(c.to_lowercase());
        }
        before = c;
    }
    let (mut side, mut base) = (' ', String::new());
    for word in words {
        match word.as_str() {
            "l" | "left" => side = 'L',
            "r" | "right" => side = 'R',
            "skeleton" | "joint" | "mixamorig" | "bip" | "def" | "bone" | "armature" => {}
            w => base.push_str(w),
        }
    }
    (base, side)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_many_tools_say_the_same() {
        for (name, base, side) in [
            ("mixamorig:LeftForeArm", "forearm", 'L'),
            ("LeftUpLeg", "upleg", 'L'),
            ("upper_arm.R", "upperarm", 'R'),
            ("Skeleton_arm_joint_L__4_", "arm4", 'L'),
            ("RightToeBase", "toebase", 'R'),
            ("Spine1", "spine1", ' '),
        ] {
            assert_eq!(taken_apart(name), (base.to_owned(), side), "{name}");
        }
    }
}
