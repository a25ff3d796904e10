//! The tree of joints, and its poses.

use super::affine::{Affine, Transform};

/// Index of a joint in its [`Skeleton`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct JointId(pub u32);

impl JointId {
    /// As an index.
    #[must_use]
    pub fn index(self) -> usize {
        self.0 as usize
    }
}

/// One joint: a node of the file's scene. Which joints are *bones* is decided by the skin weights, not here.
#[derive(Clone, Debug, PartialEq)]
pub struct Joint {
    /// Name in the file, made unique by the importer.
    pub name: String,
    /// `None` for a root.
    pub parent: Option<JointId>,
    /// Local transform while no clip moves the joint, in file units. What the file stores as a matrix is in `local_matrix`.
    pub local: Transform,
    /// Set when the file gives the node a matrix instead; such a node cannot be animated.
    pub local_matrix: Option<Affine>,
    /// Joint frame in the rest (bind) shape of the character, to the world [m]. Where the file has inverse bind matrices it
    /// comes from them, not from `local`.
    pub rest: Affine,
}

/// Why a list of joints is no skeleton.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum SkeletonError {
    /// A joint is its own ancestor.
    #[error("joint `{0}` is its own ancestor; the node hierarchy must be a tree")]
    Cycle(String),
    /// A parent index is out of range.
    #[error("joint `{0}` names a parent that does not exist")]
    MissingParent(String),
}

/// All nodes of a file's scene as joints. Parents may come after their children.
#[derive(Clone, Debug, PartialEq)]
pub struct Skeleton {
    joints: Vec<Joint>,
    /// Parents before children.
    order: Vec<JointId>,
    /// File units and axes to metres, Y up: applied above every root.
    to_world: Affine,
}

/// World frames of all joints at one instant: joint frame to the world [m].
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Pose {
    /// One frame per joint of the skeleton.
    pub world: Vec<Affine>,
}

impl Skeleton {
    /// A skeleton from joints; `to_world` takes file units and axes to metres, Y up.
    ///
    /// # Errors
    /// [`SkeletonError`] when the parents do not form a forest.
    pub fn new(joints: Vec<Joint>, to_world: Affine) -> Result<Self, SkeletonError> {
        let mut order = Vec::with_capacity(joints.len());
        let mut children = vec![Vec::new(); joints.len()];
        for (i, joint) in joints.iter().enumerate() {
            match joint.parent {
                None => order.push(JointId(i as u32)),
                Some(p) if p.index() < joints.len() => children[p.index()].push(JointId(i as u32)),
                Some(_) => return Err(SkeletonError::MissingParent(joint.name.clone())),
            }
        }
        let mut next = 0;
        while next < order.len() {
            let at: JointId = order[next];
            order.extend_from_slice(&children[at.index()]);
            next += 1;
        }
        if order.len() < joints.len() {
            let mut reached = vec![false; joints.len()];
            order.iter().for_each(|j| reached[j.index()] = true);
            let lost = reached.iter().position(|r| !r).expect("fewer joints reached than there are");
            return Err(SkeletonError::Cycle(joints[lost].name.clone()));
        }
        Ok(Self { joints, order, to_world })
    }

    /// All joints, in the file's order.
    #[must_use]
    pub fn joints(&self) -> &[Joint] {
        &self.joints
    }

    /// One joint.
    #[must_use]
    pub fn joint(&self, id: JointId) -> &Joint {
        &self.joints[id.index()]
    }

    /// Number of joints.
    #[must_use]
    pub fn joint_count(&self) -> usize {
        self.joints.len()
    }

    /// Joints with every parent before its children.
    #[must_use]
    pub fn order(&self) -> &[JointId] {
        &self.order
    }

    /// File units and axes to metres, Y up.
    #[must_use]
    pub fn to_world(&self) -> &Affine {
        &self.to_world
    }

    /// Replaces the map from file units and axes to metres, Y up; rest frames stay as they are.
    pub fn set_to_world(&mut self, to_world: Affine) {
        self.to_world = to_world;
    }

    /// Applies a world map to every rest frame.
    pub fn map_rest(&mut self, map: &Affine) {
        for joint in &mut self.joints {
            joint.rest = map.after(&joint.rest);
        }
    }

    /// The first joint of this name.
    #[must_use]
    pub fn find(&self, name: &str) -> Option<JointId> {
        self.joints.iter().position(|j| j.name == name).map(|i| JointId(i as u32))
    }

    /// Local transforms while no clip plays.
    #[must_use]
    pub fn rest_locals(&self) -> Vec<Transform> {
        self.joints.iter().map(|j| j.local).collect()
    }

    /// Forward kinematics: the world frames for one local transform per joint.
    ///
    /// # Panics
    /// When `locals` has another length than the skeleton.
    #[must_use]
    pub fn pose(&self, locals: &[Transform]) -> Pose {
        let mut pose = Pose { world: Vec::new() };
        self.pose_into(locals, &mut pose);
        pose
    }

    /// As [`Self::pose`], into a pose that is kept.
    ///
    /// # Panics
    /// As [`Self::pose`].
    pub fn pose_into(&self, locals: &[Transform], pose: &mut Pose) {
        assert_eq!(locals.len(), self.joints.len(), "one local transform per joint");
        let world = &mut pose.world;
        world.clear();
        world.resize(self.joints.len(), Affine::IDENTITY);
        for &id in &self.order {
            let joint = &self.joints[id.index()];
            let local = joint.local_matrix.unwrap_or_else(|| locals[id.index()].to_affine());
            let parent = joint.parent.map_or(self.to_world, |p| world[p.index()]);
            world[id.index()] = parent.after(&local);
        }
    }

    /// Children of each joint.
    #[must_use]
    pub fn children(&self) -> Vec<Vec<JointId>> {
        let mut children = vec![Vec::new(); self.joints.len()];
        for (i, joint) in self.joints.iter().enumerate() {
            if let Some(p) = joint.parent {
                children[p.index()].push(JointId(i as u32));
            }
        }
        children
    }
}

impl Pose {
    /// World frame of one joint.
    #[must_use]
    pub fn joint(&self, id: JointId) -> &Affine {
        &self.world[id.index()]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn joint(name: &str, parent: Option<u32>, translation: [f64; 3]) -> Joint {
        Joint {
            name: name.into(),
            parent: parent.map(JointId),
            local: Transform { translation, ..Transform::default() },
            local_matrix: None,
            rest: Affine::IDENTITY,
        }
    }

    #[test]
    fn children_may_come_before_their_parents() {
        let s = Skeleton::new(
            vec![joint("hand", Some(1), [0.0, 1.0, 0.0]), joint("arm", None, [2.0, 0.0, 0.0])],
            Affine::from_scale(0.5),
        )
        .unwrap();
        let pose = s.pose(&s.rest_locals());
        assert_eq!(pose.joint(JointId(0)).translation, [1.0, 0.5, 0.0]);
    }

    #[test]
    fn a_cycle_is_named() {
        let e = Skeleton::new(vec![joint("a", Some(1), [0.0; 3]), joint("b", Some(0), [0.0; 3])], Affine::IDENTITY);
        assert_eq!(e.unwrap_err(), SkeletonError::Cycle("a".into()));
    }
}
