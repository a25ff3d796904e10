//! Which nodes hang on which bones: rule M.
//!
//! 1. Node weights are the mean skin weights of the surface in the node's cells, harmonic inside; the heaviest bone owns the node.
//! 2. Distance is measured to the owner's own segments only.
//! 3. A node is bound when it is nearer than half the local thickness of flesh over its bone (or 3/4 of a cell). Thickness is
//!    measured on the skin, not in cells, so the character looks the same at every resolution. Nodes deeper than the thickest
//!    layer of flesh are bound too: big heads and bellies have a skull and ribs.
//! 4. Every bone that owns skin gets at least four nodes: three for its frame, one to spare.
//! 5. A piece of the body with fewer than four bound nodes would drift or spin: it is bound whole.
//! 6. Bound nodes follow the blend of their owner's frame and its skeleton neighbours' (see `blend`).

use super::bone::{Bone, OwnedVertex, find_bones, lay_segments};
use super::depth::depth;
use super::surface::WeightedSurface;
use super::weight::{NodeWeights, WeightSample, node_weights};
use crate::character::Character;
use crate::mesh::{self, MeshError, VolumeMesh};
use crate::rig::JointId;

/// How one bone is bound when rule M is not what the artist wants.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum BoneRule {
    /// No node is bound to it: its flesh hangs on its neighbours (ears, tails that shall swing by themselves).
    Exclude,
    /// Its nodes within this distance are bound [m].
    Radius(f64),
    /// All its nodes are bound: it moves as plain skinning.
    Whole,
}

/// Settings of the binding.
#[derive(Clone, Debug, PartialEq)]
pub struct BindSettings {
    /// Part of the local thickness that is bound [-]. Default 0.5: 10-14 % of all nodes; 0.35 is softer.
    pub thickness_share: f64,
    /// Flesh is at most this thick, as a share of the height [-]. Default 0.06: 10 cm on a human. A head of half a metre made
    /// of flesh only would collapse under its own swing.
    pub thickest_layer: f64,
    /// Joint names with rules of their own.
    pub bones: Vec<(String, BoneRule)>,
}

impl Default for BindSettings {
    fn default() -> Self {
        Self { thickness_share: 0.5, thickest_layer: 0.06, bones: Vec::new() }
    }
}

/// Why a character cannot be bound to a volume mesh.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum BindError {
    /// There is no mesh with skin weights.
    #[error(
        "`{0}` has no skinned mesh: softrig needs a skeleton and skin weights (JOINTS_0 / WEIGHTS_0); bind the mesh to an armature first"
    )]
    NoSkin(String),
    /// A bone that moves skin got no node.
    #[error(
        "joint `{joint}` moves {vertices} skin vertices but no cell of the volume mesh lies on it; use more cells (--cells) or exclude the bone in the scene file"
    )]
    Unbound {
        /// Name of the joint.
        joint: String,
        /// Skin vertices it dominates.
        vertices: usize,
    },
    /// A rule names a joint that is not a bone of the character.
    #[error(
        "the scene has a rule for bone `{joint}`, but no skin hangs on a joint of that name; the bones are: {known}"
    )]
    UnknownBone {
        /// Name in the scene.
        joint: String,
        /// Names of all bones.
        known: String,
    },
    /// No node at all would be bound.
    #[error("every bone is excluded: nothing would hold the flesh; remove some `exclude` rules")]
    NothingBound,
    /// The volume mesh cannot carry the skin.
    #[error(transparent)]
    Mesh(#[from] MeshError),
    /// The volume mesh has no cells.
    #[error("the volume mesh has no cells")]
    EmptyMesh,
}

/// Nodes tied to bones, and the bones every node blends.
#[derive(Clone, Debug, PartialEq)]
pub struct Binding {
    /// The bones of the character.
    pub bones: Vec<Bone>,
    /// Whether each node is bound.
    pub bound: Vec<bool>,
    /// The bone that owns each node.
    pub owner: Vec<u32>,
    /// Nodes that belong to pieces bound whole, because too few of their nodes were.
    pub whole_nodes: usize,
    /// First entry of each node in `bone` and `weight`, and one past the last.
    pub(super) start: Vec<u32>,
    pub(super) entry: Vec<(u32, f64)>,
}

impl Binding {
    /// Bones and weights that node `i` blends, heaviest first; weights sum to 1.
    #[must_use]
    pub fn blend(&self, i: usize) -> &[(u32, f64)] {
        &self.entry[self.start[i] as usize..self.start[i + 1] as usize]
    }

    /// Number of bound nodes.
    #[must_use]
    pub fn bound_count(&self) -> usize {
        self.bound.iter().filter(|b| **b).count()
    }

    /// Ties the nodes of `mesh` to the bones of `character`.
    ///
    /// # Errors
    /// [`BindError`] when there is nothing to bind, or a bone that moves skin gets no node.
    pub fn new(character: &Character, mesh: &VolumeMesh, settings: &BindSettings) -> Result<Self, BindError> {
        if mesh.cell_count() == 0 {
            return Err(BindError::EmptyMesh);
        }
        let surface = WeightedSurface::new(character).ok_or_else(|| BindError::NoSkin(character.name.clone()))?;
        let mut bones = find_bones(&character.skeleton, surface.weighted_joints());
        let owned = surface.owned_vertices(&bones, mesh)?;
        lay_segments(&character.skeleton, &mut bones, &owned, character.height());
        let rules = resolve_rules(character, &bones, settings)?;

        let cell_size = cell_size(mesh);
        let samples = surface.samples(&bones, cell_size, mesh)?;
        let weights =
            node_weights(mesh, bones.len(), samples.iter().map(|s| WeightSample { cell: s.cell, weights: &s.weights }));
        let mut owner: Vec<u32> = (0..mesh.node_count()).map(|n| weights.owner(n) as u32).collect();
        let skin = SkinOverBones::new(&bones, &owned);
        let (depth, thickest) = (depth(mesh), settings.thickest_layer * character.height());
        let mut bound: Vec<bool> = (0..mesh.node_count())
            .map(|n| {
                let o = owner[n] as usize;
                let near = bones[o].nearest(mesh.nodes[n]);
                match rules[o] {
                    Some(BoneRule::Exclude) => false,
                    Some(BoneRule::Whole) => true,
                    Some(BoneRule::Radius(r)) => near.distance <= r,
                    None => {
                        let thickness = skin.thickness(o, near.segment, near.along);
                        near.distance <= (0.75 * cell_size).max(settings.thickness_share * thickness)
                            || (depth[n] > thickest + 0.5 * cell_size && weights.row(n)[o] > CORE_WEIGHT)
                    }
                }
            })
            .collect();

        let carried = nodes_under_skin(mesh, &samples, &bones, &weights);
        for b in 0..bones.len() {
            if skin.vertex_count(b) > 0 && rules[b] != Some(BoneRule::Exclude) {
                top_up(b, &bones[b], mesh, &weights, &carried[b], &mut owner, &mut bound).map_err(|()| {
                    BindError::Unbound {
                        joint: character.skeleton.joint(bones[b].joint).name.clone(),
                        vertices: skin.vertex_count(b),
                    }
                })?;
            }
        }
        if !bound.contains(&true) {
            return Err(BindError::NothingBound);
        }
        let whole_nodes = bind_small_pieces(mesh, &mut bound);
        let (start, entry) = blend_rows(&bones, &weights, &owner);
        Ok(Self { bones, bound, owner, whole_nodes, start, entry })
    }

    /// Joint of bone `b`.
    #[must_use]
    pub fn joint(&self, b: u32) -> JointId {
        self.bones[b as usize].joint
    }
}

/// Fewer bound nodes than this do not hold a piece of flesh: three fix a frame, a fourth off their plane fixes its spin.
const NODES_PER_BONE: usize = 4;

/// Deep nodes are bound only where one bone has all the say: between bones that turn apart, flesh is what gives.
const CORE_WEIGHT: f64 = 0.98;

fn resolve_rules(
    character: &Character,
    bones: &[Bone],
    settings: &BindSettings,
) -> Result<Vec<Option<BoneRule>>, BindError> {
    let name = |b: &Bone| character.skeleton.joint(b.joint).name.as_str();
    let mut rules = vec![None; bones.len()];
    for (joint, rule) in &settings.bones {
        let Some(b) = bones.iter().position(|b| name(b) == joint) else {
            let known = bones.iter().map(name).collect::<Vec<_>>().join(", ");
            return Err(BindError::UnknownBone { joint: joint.clone(), known });
        };
        rules[b] = Some(*rule);
    }
    Ok(rules)
}

/// Edge of a typical cell [m].
fn cell_size(mesh: &VolumeMesh) -> f64 {
    if let Some(lattice) = &mesh.lattice {
        return lattice.spacing;
    }
    let edge = |c: &[u32]| {
        let (a, b) = (mesh.nodes[c[0] as usize], mesh.nodes[c[1] as usize]);
        (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f64>().sqrt()
    };
    mesh.cells().map(edge).sum::<f64>() / mesh.cell_count() as f64
}

/// Where the skin lies along each bone: what tells thickness.
struct SkinOverBones {
    /// Per bone: (segment, along, distance) of the outer vertices it owns, sorted by segment and along.
    over: Vec<Vec<(usize, f64, f64)>>,
    /// Vertices each bone owns, buried ones too.
    count: Vec<usize>,
}

/// Vertices asked about the thickness at one place.
const THICKNESS_VERTICES: usize = 12;

impl SkinOverBones {
    fn new(bones: &[Bone], owned: &[OwnedVertex]) -> Self {
        let mut over = vec![Vec::new(); bones.len()];
        let mut count = vec![0; bones.len()];
        let mut outside = vec![0; bones.len()];
        for v in owned {
            count[v.bone] += 1;
            outside[v.bone] += usize::from(v.exposed);
        }
        // thickness is measured to the outside; a bone that only moves buried skin has nothing else to go by
        for v in owned.iter().filter(|v| v.exposed || outside[v.bone] < NODES_PER_BONE) {
            let near = bones[v.bone].nearest(v.position);
            over[v.bone].push((near.segment, near.along, near.distance));
        }
        for list in &mut over {
            list.sort_by(|a: &(usize, f64, f64), b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)).then(a.2.total_cmp(&b.2)));
        }
        Self { over, count }
    }

    fn vertex_count(&self, bone: usize) -> usize {
        self.count[bone]
    }

    /// Lower quartile of the distance from bone to skin, over the owned vertices nearest along the bone [m].
    fn thickness(&self, bone: usize, segment: usize, along: f64) -> f64 {
        let all = &self.over[bone];
        let (first, last) = (all.partition_point(|v| v.0 < segment), all.partition_point(|v| v.0 <= segment));
        let on_segment = &all[first..last];
        // a segment that hardly any skin projects to (hips to thigh) asks the whole bone
        let mut near: Vec<(f64, f64)> = if on_segment.len() >= NODES_PER_BONE {
            on_segment.iter().map(|v| ((v.1 - along).abs(), v.2)).collect()
        } else {
            all.iter().map(|v| (0.0, v.2)).collect()
        };
        if near.is_empty() {
            return 0.0;
        }
        let count = if on_segment.len() >= NODES_PER_BONE { near.len().min(THICKNESS_VERTICES) } else { near.len() };
        near.select_nth_unstable_by(count - 1, |a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
        let mut distance: Vec<f64> = near[..count].iter().map(|v| v.1).collect();
        distance.sort_by(f64::total_cmp);
        distance[count / 4]
    }
}

/// For every bone, the nodes of the cells under the skin it dominates, ascending.
fn nodes_under_skin(
    mesh: &VolumeMesh,
    samples: &[super::surface::CellSample],
    bones: &[Bone],
    weights: &NodeWeights,
) -> Vec<Vec<u32>> {
    let mut under = vec![Vec::new(); bones.len()];
    for s in samples {
        let heaviest = s.weights.iter().copied().fold((usize::MAX, 0.0), |a, b| if b.1 > a.1 { b } else { a });
        if heaviest.0 < bones.len() {
            under[heaviest.0].extend_from_slice(mesh.cell(s.cell as usize));
        }
    }
    for (b, list) in under.iter_mut().enumerate() {
        list.sort_unstable();
        list.dedup();
        list.retain(|n| weights.row(*n as usize)[b] > 0.0);
    }
    under
}

/// Rule 4: binds the nearest nodes until the bone has four. Nodes it owns come first, then those under its skin.
fn top_up(
    b: usize,
    bone: &Bone,
    mesh: &VolumeMesh,
    weights: &NodeWeights,
    carried: &[u32],
    owner: &mut [u32],
    bound: &mut [bool],
) -> Result<(), ()> {
    let mine = |owner: &[u32], n: usize| owner[n] as usize == b;
    let mut have = (0..bound.len()).filter(|n| bound[*n] && mine(owner, *n)).count();
    if have >= NODES_PER_BONE {
        return Ok(());
    }
    let mut candidates: Vec<(bool, f64, usize)> = (0..bound.len())
        .filter(|n| mine(owner, *n) && !bound[*n])
        .map(|n| (false, bone.nearest(mesh.nodes[n]).distance, n))
        // under the skin of a bone too small to own four nodes: those it weighs most on
        .chain(
            carried
                .iter()
                .map(|n| *n as usize)
                .filter(|n| !mine(owner, *n) && !bound[*n])
                .map(|n| (true, -weights.row(n)[b], n)),
        )
        .collect();
    candidates.sort_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)).then(a.2.cmp(&b.2)));
    for (_, _, n) in candidates {
        if have >= NODES_PER_BONE {
            break;
        }
        bound[n] = true;
        owner[n] = b as u32;
        have += 1;
    }
    // nodes that hold the bone's skin may all be bound to its neighbours already: then its skin is held, and that is enough
    let held = carried.iter().any(|n| bound[*n as usize]);
    if have > 0 || held { Ok(()) } else { Err(()) }
}

/// Rule 5. Returns how many nodes were bound by it.
fn bind_small_pieces(mesh: &VolumeMesh, bound: &mut [bool]) -> usize {
    let pieces = mesh::components(mesh);
    let mut held = vec![0usize; pieces.count];
    // nodes without a cell belong to no piece
    let of_node = || pieces.of_node.iter().enumerate().filter(|(_, p)| **p != u32::MAX);
    for (n, p) in of_node() {
        held[*p as usize] += usize::from(bound[n]);
    }
    let mut whole = 0;
    for (n, p) in of_node() {
        if held[*p as usize] < NODES_PER_BONE {
            bound[n] = true;
            whole += 1;
        }
    }
    whole
}

/// Weights below this share of the owner's do not move a node visibly; leaving them out keeps far nodes on one exact frame.
const NEGLIGIBLE: f64 = 1e-3;

/// Rule 6: each node's weights over its owner and the owner's skeleton neighbours, normalised, heaviest (the owner) first.
fn blend_rows(bones: &[Bone], weights: &NodeWeights, owner: &[u32]) -> (Vec<u32>, Vec<(u32, f64)>) {
    let mut start = vec![0];
    let mut entry = Vec::new();
    for (n, &o) in owner.iter().enumerate() {
        let row = weights.row(n);
        let first = entry.len();
        // an owner by rule 4 may weigh less than its neighbours: it leads all the same
        let own = row[o as usize].max(NEGLIGIBLE);
        entry.push((o, own));
        for (b, bone) in bones.iter().enumerate() {
            let related = bone.parent == Some(o as usize) || bones[o as usize].parent == Some(b);
            if related && row[b] > NEGLIGIBLE * own {
                entry.push((b as u32, row[b]));
            }
        }
        entry[first + 1..].sort_by(|a: &(u32, f64), b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
        let sum: f64 = entry[first..].iter().map(|e| e.1).sum();
        entry[first..].iter_mut().for_each(|e| e.1 /= sum);
        start.push(entry.len() as u32);
    }
    (start, entry)
}
