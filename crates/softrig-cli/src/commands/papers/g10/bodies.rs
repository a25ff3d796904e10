//! The bodies of Table 1, each with a skeleton along its spine.

use super::{Job, failed};
use crate::failure::Failure;
use crate::load;
use glam::{DQuat, DVec3};
use rayon::prelude::*;
use softrig::body::Body;
use softrig::force::ElasticModel;
use softrig::material::{Material, MaterialMap};
use softrig::mesh::{
    self, CellKind, HierarchyOptions, LatticeOptions, Prolongation, Resolution, VolumeMesh, hierarchy,
    nested_hierarchy, renumbered, tetrahedralize,
};
use softrig_linalg::{BlockCsr, DofConstraints, Scalar, par};

/// A body and what its solver needs.
pub struct PaperBody {
    /// As the paper calls it.
    pub name: &'static str,
    /// Rest shape.
    pub mesh: VolumeMesh,
    /// From level to level, finest first.
    pub levels: Vec<Prolongation>,
    /// Which kind of levels.
    pub kind: &'static str,
    /// Its bones.
    pub spine: Spine,
}

/// A chain of bones, all joints bent alike.
pub struct Spine {
    /// Ends of the bones [m].
    pub joints: Vec<DVec3>,
    /// Bone of each node, where it has one.
    pub bone: Vec<Option<usize>>,
    /// About which the joints bend.
    pub axis: DVec3,
}

/// Cells of the bar of the paper's figures: 24,576 tetrahedra and four levels after three refinements.
const BAR: [usize; 3] = [8, 1, 1];
const BAR_CELL: f64 = 0.2;

/// The bar, refined so many times.
pub fn bar(refinements: usize) -> Result<PaperBody, Failure> {
    let coarsest = mesh::bar(BAR, BAR.map(|n| n as f64 * BAR_CELL), CellKind::Tet4);
    let (mesh, levels) = nested_hierarchy(&coarsest, refinements).map_err(|e| failed("bar", &e))?;
    let width = BAR_CELL / f64::from(1u32 << refinements);
    let ends = [0.0, 0.5, 1.0].map(|s| DVec3::new(s * BAR[0] as f64 * BAR_CELL, 0.1, 0.1));
    let spine = Spine::new(&mesh, ends.to_vec(), 1.001 * width);
    Ok(PaperBody { name: "bar", mesh, levels, kind: "nested tetrahedra", spine })
}

/// About the paper's manikin: the built-in character cut into tetrahedra.
pub fn manikin(cells: usize) -> Result<PaperBody, Failure> {
    let character = softrig::sample::character();
    let options = LatticeOptions { resolution: Resolution::Cells(cells / 6), ..LatticeOptions::default() };
    let lattice = mesh::voxelize(&character.surface(true), &options).map_err(|e| failed("manikin", &e))?;
    Ok(independent("manikin", &tetrahedralize(&lattice), 5))
}

/// The dragon, as long as the bar (its file is ten of some unit long), where its file is; the built-in character with as many cells
/// elsewhere.
pub fn dragon(job: &Job) -> Result<PaperBody, Failure> {
    let path = job.shared.join("data/volumes/stanford/dragon_67k.node");
    if job.quick || !path.exists() {
        let body = manikin(if job.quick { 6_000 } else { 67_309 })?;
        return Ok(PaperBody { name: "manikin instead of the dragon", ..body });
    }
    let mut mesh = load::volume(&path)?;
    let (low, high) = mesh.bounds().unwrap_or_default();
    let scale = BAR[0] as f64 * BAR_CELL / (high[0] - low[0]);
    for x in &mut mesh.nodes {
        *x = x.map(|v| scale * v);
    }
    Ok(independent("dragon", &mesh, 6))
}

fn independent(name: &'static str, mesh: &VolumeMesh, bones: usize) -> PaperBody {
    let (mesh, _) = renumbered(mesh);
    let levels = hierarchy(&mesh, &HierarchyOptions { levels: Some(3), ..HierarchyOptions::default() });
    let spine = Spine::along(&mesh, bones);
    PaperBody { name, mesh, levels, kind: "independent tetrahedra that contain it", spine }
}

/// From a point to the bone that starts at a joint [m].
fn distance_to_bone(joints: &[DVec3], bone: usize, x: &[f64; 3]) -> f64 {
    let (a, b, x) = (joints[bone], joints[bone + 1], DVec3::from(*x));
    let t = ((x - a).dot(b - a) / (b - a).length_squared()).clamp(0.0, 1.0);
    x.distance(a + t * (b - a))
}

impl Spine {
    /// Nodes closer than `radius` to the chain are bound.
    fn new(mesh: &VolumeMesh, joints: Vec<DVec3>, radius: f64) -> Self {
        let along = (joints[joints.len() - 1] - joints[0]).normalize_or(DVec3::X);
        let bone_of = |x: &[f64; 3]| {
            let distance = |k: usize| distance_to_bone(&joints, k, x);
            (0..joints.len() - 1)
                .min_by(|a, b| distance(*a).total_cmp(&distance(*b)))
                .filter(|k| distance(*k) <= radius)
        };
        Self { bone: mesh.nodes.iter().map(bone_of).collect(), axis: along.any_orthonormal_vector(), joints }
    }

    /// Through the centroids of slices across the longest extent; bound is what is nearer than a third of the mean distance to it.
    fn along(mesh: &VolumeMesh, bones: usize) -> Self {
        let (low, high) = mesh.bounds().unwrap_or_default();
        let axis = (0..3).max_by(|a, b| (high[*a] - low[*a]).total_cmp(&(high[*b] - low[*b]))).unwrap_or(0);
        let mut sum = vec![(DVec3::ZERO, 0.0); bones + 1];
        for x in &mesh.nodes {
            let s = (x[axis] - low[axis]) / (high[axis] - low[axis]);
            #[allow(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "between 0 and the number of bones"
            )]
            let slice = &mut sum[(s * (bones as f64 + 1.0)).clamp(0.0, bones as f64) as usize];
            *slice = (slice.0 + DVec3::from(*x), slice.1 + 1.0);
        }
        let joints: Vec<DVec3> = sum.iter().filter(|s| s.1 > 0.0).map(|s| s.0 / s.1).collect();
        let all = Self::new(mesh, joints.clone(), f64::INFINITY);
        let distance = |(x, bone): (&[f64; 3], &Option<usize>)| distance_to_bone(&joints, bone.unwrap_or(0), x);
        let mean = mesh.nodes.iter().zip(&all.bone).map(distance).sum::<f64>() / mesh.node_count().max(1) as f64;
        Self::new(mesh, joints, mean / 3.0)
    }

    /// Where the bound nodes are when every joint after the first is bent by `angle` [rad]; the others stay.
    pub fn bent(&self, mesh: &VolumeMesh, angle: f64) -> Vec<[f64; 3]> {
        let mut frames = vec![(DQuat::IDENTITY, self.joints[0])];
        for k in 1..self.joints.len() - 1 {
            let (turn, at) = frames[k - 1];
            let next = at + turn * (self.joints[k] - self.joints[k - 1]);
            frames.push((DQuat::from_axis_angle(self.axis, angle) * turn, next));
        }
        let moved = |(x, bone): (&[f64; 3], &Option<usize>)| {
            bone.map_or(*x, |k| (frames[k].1 + frames[k].0 * (DVec3::from(*x) - self.joints[k])).into())
        };
        mesh.nodes.par_iter().zip(&self.bone).with_min_len(par::CHUNK).map(moved).collect()
    }

    /// Which nodes are bound.
    pub fn bound(&self) -> Vec<bool> {
        self.bone.iter().map(Option::is_some).collect()
    }
}

/// Flesh of the figures: E 5e4 Pa, 1000 kg/m3, undamped.
pub fn flesh<R: Scalar>(body: &PaperBody, poisson_ratio: f64) -> Result<Body<R>, Failure> {
    let material =
        Material { young_modulus: 5e4, poisson_ratio, density: 1000.0, mass_damping: 0.0, stiffness_damping: 0.0 };
    let constraints = DofConstraints::from_mask(body.spine.bound());
    Body::new(body.mesh.clone(), &MaterialMap::uniform(material), ElasticModel::Corotated, constraints)
        .map_err(|e| failed(body.name, &e))
}

/// K + M / dt² at rest; K alone without `dt`.
pub fn system(body: &mut Body<f64>, dt: Option<f64>) -> BlockCsr<f64> {
    let rest = body.mesh.nodes.clone();
    body.model.linearise(&rest);
    body.system_matrix(dt.map_or(0.0, |dt| 1.0 / (dt * dt)))
}
