//! Flesh on bones: what binding, blending and the simulation promise, on a limb of two bones.

use softrig::character::{Character, CharacterMesh, Skin, SkinWeights, bone_maps};
use softrig::couple::{BindError, BindSettings, Binding, BoneRule};
use softrig::integrate::Dynamics;
use softrig::material::{Material, MaterialMap};
use softrig::mesh::{self, LatticeOptions, Resolution};
use softrig::rig::{Affine, Joint, JointId, Pose, Skeleton, Transform};
use softrig::simulation::{Motion, RestMotion, Simulation, SimulationSettings};

const RADIUS: f64 = 0.06;
const HALF: f64 = 0.3;
const RINGS: usize = 61;
const SIDES: usize = 24;

/// A limb along X from -0.3 to 0.3 m, radius 6 cm, with its joint at the origin and weights that change over three radii.
pub fn limb() -> Character {
    let mut skin = Tubes::default();
    skin.add(-HALF, HALF, RINGS, |x| (0.5 + 0.5 * x / (1.5 * RADIUS)).clamp(0.0, 1.0) as f32);
    skin.on_two_bones("limb")
}

/// Two stumps of a limb with a gap of 6 cm between them at the joint, each on a bone of its own: nothing but the joint holds the second.
pub fn stumps() -> Character {
    let mut skin = Tubes::default();
    skin.add(-HALF, -0.03, RINGS / 2, |_| 0.0);
    skin.add(0.03, HALF, RINGS / 2, |_| 1.0);
    skin.on_two_bones("stumps")
}

/// Closed tubes along X.
#[derive(Default)]
struct Tubes {
    positions: Vec<[f64; 3]>,
    triangles: Vec<[u32; 3]>,
    weights: SkinWeights,
}

impl Tubes {
    /// A tube from `from` to `to`, with the weight of the second bone as a function of x.
    fn add(&mut self, from: f64, to: f64, rings: usize, second: impl Fn(f64) -> f32) {
        let first = self.positions.len();
        let mut put = |p: [f64; 3]| {
            let w = second(p[0]);
            self.weights.push([(JointId(0), 1.0 - w), (JointId(1), w)]);
            self.positions.push(p);
            self.positions.len() as u32 - 1
        };
        for r in 0..rings {
            let x = from + (to - from) * r as f64 / (rings - 1) as f64;
            for s in 0..SIDES {
                let a = std::f64::consts::TAU * s as f64 / SIDES as f64;
                put([x, RADIUS * a.cos(), RADIUS * a.sin()]);
            }
        }
        let centres = [put([from, 0.0, 0.0]), put([to, 0.0, 0.0])];
        let at = |r: usize, s: usize| (first + r * SIDES + s % SIDES) as u32;
        for r in 0..rings - 1 {
            for s in 0..SIDES {
                self.triangles.push([at(r, s), at(r + 1, s), at(r, s + 1)]);
                self.triangles.push([at(r + 1, s), at(r + 1, s + 1), at(r, s + 1)]);
            }
        }
        for s in 0..SIDES {
            self.triangles.push([centres[0], at(0, s), at(0, s + 1)]);
            self.triangles.push([centres[1], at(rings - 1, s + 1), at(rings - 1, s)]);
        }
    }

    fn on_two_bones(self, name: &str) -> Character {
        let joint = |name: &str, parent: Option<u32>, x: f64, world: f64| Joint {
            name: name.into(),
            parent: parent.map(JointId),
            local: Transform { translation: [x, 0.0, 0.0], ..Transform::default() },
            local_matrix: None,
            rest: Affine::from_translation([world, 0.0, 0.0]),
        };
        let joints = vec![joint("upper", None, -HALF, -HALF), joint("lower", Some(0), HALF, 0.0)];
        Character {
            name: name.into(),
            meshes: vec![CharacterMesh {
                name: "skin".into(),
                positions: self.positions,
                triangles: self.triangles,
                skin: Skin::Weighted(self.weights),
                ..CharacterMesh::default()
            }],
            skeleton: Skeleton::new(joints, Affine::IDENTITY).unwrap(),
            clips: Vec::new(),
            looks: Vec::new(),
            textures: Vec::new(),
            notes: Vec::new(),
        }
    }
}

/// Turns the lower bone about an axis to `angle` over one second, then holds.
struct Bend<'a> {
    skeleton: &'a Skeleton,
    axis: [f64; 3],
    angle: f64,
}

impl Motion for Bend<'_> {
    fn pose(&self, time: f64) -> Pose {
        let half = 0.5 * self.angle.to_radians() * time.clamp(0.0, 1.0);
        let mut locals = self.skeleton.rest_locals();
        let [x, y, z] = self.axis.map(|a| a * half.sin());
        locals[1].rotation = [x, y, z, half.cos()];
        self.skeleton.pose(&locals)
    }
}

fn settings() -> SimulationSettings {
    SimulationSettings { gravity: [0.0; 3], tolerance: 1e-5, ..SimulationSettings::default() }
}

fn simulation(character: &Character, settings: SimulationSettings) -> Simulation<f64> {
    let options = LatticeOptions { resolution: Resolution::Cells(1500), ..LatticeOptions::default() };
    let volume = mesh::voxelize(&character.surface(true), &options).unwrap();
    let binding = Binding::new(character, &volume, &BindSettings::default()).unwrap();
    Simulation::new(character, volume, binding, &MaterialMap::uniform(Material::default()), settings).unwrap()
}

/// Perimeter over rest perimeter at the joint: mean over the rings within half a radius of it.
fn girth(skin: &[[f64; 3]]) -> f64 {
    let dist = |a: [f64; 3], b: [f64; 3]| (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f64>().sqrt();
    let rest = 2.0 * RADIUS * (std::f64::consts::PI / SIDES as f64).sin() * SIDES as f64;
    let reach = (0.5 * RADIUS / (2.0 * HALF) * (RINGS - 1) as f64) as usize;
    let rings = (RINGS / 2 - reach)..=(RINGS / 2 + reach);
    let count = rings.clone().count() as f64;
    rings
        .map(|r| (0..SIDES).map(|s| dist(skin[r * SIDES + s], skin[r * SIDES + (s + 1) % SIDES])).sum::<f64>() / rest)
        .sum::<f64>()
        / count
}

fn bent_girth(axis: [f64; 3], angle: f64) -> (f64, f64) {
    let character = limb();
    let motion = Bend { skeleton: &character.skeleton, axis, angle };
    let mut sim = simulation(&character, settings());
    sim.start(&motion).unwrap();
    for f in 1..=90 {
        sim.advance(&motion, f as f64 / 60.0).unwrap();
    }
    let flesh = girth(&sim.frame(90).skin[0]);
    let blended = girth(&character.blend_skin(0, &motion.pose(1.5)));
    (flesh, blended)
}

/// The candy wrapper: plain skinning collapses a twisted elbow, flesh keeps nine tenths of its girth.
#[test]
fn elbow_twisted_by_170_degrees_keeps_its_girth() {
    let (flesh, blended) = bent_girth([1.0, 0.0, 0.0], 170.0);
    println!("twist 170: flesh {flesh:.3}, linear blend skinning {blended:.3}");
    assert!(blended < 0.4, "the case is hard for plain skinning: {blended}");
    assert!(flesh >= 0.9, "{flesh}");
}

/// The folded elbow.
#[test]
fn elbow_flexed_by_130_degrees_keeps_its_girth() {
    let (flesh, blended) = bent_girth([0.0, 0.0, 1.0], 130.0);
    println!("flex 130: flesh {flesh:.3}, linear blend skinning {blended:.3}");
    assert!(blended < 0.85, "the case is hard for plain skinning: {blended}");
    assert!(flesh >= 0.9, "{flesh}");
}

/// In the bind pose, without gravity, nothing may move: not in the settling, not in a second of standing still.
#[test]
fn rest_pose_is_held() {
    let character = limb();
    let motion = RestMotion(&character.skeleton);
    for dynamics in [Dynamics::Lively, Dynamics::Calm, Dynamics::Paper] {
        let mut sim = simulation(&character, SimulationSettings { dynamics, ..settings() });
        sim.start(&motion).unwrap();
        for f in 1..=60 {
            sim.advance(&motion, f as f64 / 60.0).unwrap();
        }
        let frame = sim.frame(60);
        let moved = frame.skin[0].iter().zip(&character.meshes[0].positions);
        let worst = moved.flat_map(|(a, b)| (0..3).map(move |k| (a[k] - b[k]).abs())).fold(0.0, f64::max);
        assert!(worst < 1e-6 * 2.0 * HALF, "{dynamics:?}: {worst}");
    }
}

/// Without sag the bind shape is in balance with gravity; with it the flesh hangs visibly lower. Both start without a snap:
/// the first simulated frames move the skin by far less than the sag itself.
#[test]
fn the_first_frames_neither_drop_nor_snap() {
    let character = limb();
    let motion = RestMotion(&character.skeleton);
    let mut sagged = Vec::new();
    for sag in [true, false] {
        let gravity = [0.0, -9.81, 0.0];
        let mut sim = simulation(&character, SimulationSettings { gravity, sag, ..settings() });
        sim.start(&motion).unwrap();
        let drop = |skin: &[[f64; 3]]| {
            let moved = skin.iter().zip(&character.meshes[0].positions);
            moved.map(|(a, b)| (a[1] - b[1]).abs()).fold(0.0, f64::max)
        };
        let first = drop(&sim.frame(0).skin[0]);
        for f in 1..=30 {
            sim.advance(&motion, f as f64 / 60.0).unwrap();
        }
        let later = drop(&sim.frame(30).skin[0]);
        assert!((first - later).abs() < 0.05 * first + 1e-7, "sag {sag}: {first} then {later}");
        sagged.push(first);
    }
    assert!(sagged[0] > 1e-4, "flesh sags: {}", sagged[0]);
    assert!(sagged[1] < 1e-6, "and does not without: {}", sagged[1]);
}

/// Bound nodes are where the pose says, at any speed; those on one bone exactly on its frame.
#[test]
fn attachment_has_no_gap_at_ten_metres_a_second() {
    struct Dash<'a>(&'a Skeleton);
    impl Motion for Dash<'_> {
        fn pose(&self, time: f64) -> Pose {
            let mut locals = self.0.rest_locals();
            locals[0].translation[1] += 10.0 * time;
            self.0.pose(&locals)
        }
    }
    let character = limb();
    let motion = Dash(&character.skeleton);
    let mut sim = simulation(&character, settings());
    sim.start(&motion).unwrap();
    for f in 1..=60 {
        let report = sim.advance(&motion, f as f64 / 60.0).unwrap();
        assert!(!report.teleported, "a fast motion is no teleport");
        let maps = bone_maps(&character.skeleton, sim.pose());
        let mut checked = 0;
        for n in (0..sim.binding.bound.len()).filter(|n| sim.binding.bound[*n]) {
            if let [(bone, _)] = sim.binding.blend(n) {
                let target = maps[sim.binding.joint(*bone).index()].point(sim.body.mesh.nodes[n]);
                for k in 0..3 {
                    assert!((sim.state.position[n][k] - target[k]).abs() < 1e-12 * 10.0, "node {n}");
                }
                checked += 1;
            }
        }
        assert!(checked > 10, "only {checked} nodes on one bone");
        assert!(sim.attachment_gap() < 1e-12 * 10.0);
    }
    assert!(sim.state.position.iter().flatten().all(|v| v.is_finite()));
}

/// A jump of half the height between two frames is carried over, not simulated through.
#[test]
fn teleports_are_carried_over() {
    struct Jump<'a>(&'a Skeleton);
    impl Motion for Jump<'_> {
        fn pose(&self, time: f64) -> Pose {
            let mut locals = self.0.rest_locals();
            locals[0].translation[0] += if time > 0.5 { 5.0 } else { 0.0 };
            self.0.pose(&locals)
        }
    }
    let character = limb();
    let motion = Jump(&character.skeleton);
    let mut sim = simulation(&character, settings());
    sim.start(&motion).unwrap();
    let mut jumps = 0;
    for f in 1..=60 {
        jumps += usize::from(sim.advance(&motion, f as f64 / 60.0).unwrap().teleported);
    }
    assert_eq!(jumps, 1);
    let skin = &sim.frame(60).skin[0];
    let worst =
        skin.iter().zip(&character.meshes[0].positions).map(|(a, b)| (a[0] - b[0] - 5.0).abs()).fold(0.0, f64::max);
    assert!(worst < 1e-6, "{worst}");
}

/// A snapshot restored into a new simulation goes on with the same bits.
#[test]
fn a_restored_checkpoint_goes_on_bit_for_bit() {
    let character = limb();
    let motion = Bend { skeleton: &character.skeleton, axis: [0.0, 0.0, 1.0], angle: 90.0 };
    let gravity = [0.0, -9.81, 0.0];
    let mut straight = simulation(&character, SimulationSettings { gravity, ..settings() });
    straight.start(&motion).unwrap();
    let mut snapshot = None;
    for f in 1..=20 {
        straight.advance(&motion, f as f64 / 60.0).unwrap();
        if f == 10 {
            snapshot = Some(straight.checkpoint());
        }
    }
    let mut resumed = simulation(&character, SimulationSettings { gravity, ..settings() });
    resumed.restore(&snapshot.unwrap(), &motion).unwrap();
    for f in 11..=20 {
        resumed.advance(&motion, f as f64 / 60.0).unwrap();
    }
    assert_eq!(straight.state, resumed.state);
    assert_eq!(straight.joint_force(), resumed.joint_force());
}

/// Static balance: the bones carry the weight of all flesh.
#[test]
fn joint_forces_add_up_to_the_weight() {
    let character = limb();
    let motion = RestMotion(&character.skeleton);
    let gravity = [0.0, -9.81, 0.0];
    let mut sim = simulation(&character, SimulationSettings { gravity, tolerance: 1e-8, ..settings() });
    sim.start(&motion).unwrap();
    for f in 1..=120 {
        sim.advance(&motion, f as f64 / 60.0).unwrap();
    }
    let force: f64 = sim.joint_force().iter().map(|f| f[1]).sum();
    let weight = -9.81 * sim.body.mass.iter().sum::<f64>();
    assert!((force - weight).abs() < 1e-3 * weight.abs(), "{force} N against {weight} N");
}

#[test]
fn what_cannot_be_bound_is_said_by_name() {
    let character = limb();
    let volume = mesh::voxelize(&character.surface(true), &LatticeOptions::default()).unwrap();
    let bind = |bones: Vec<(String, BoneRule)>| {
        Binding::new(&character, &volume, &BindSettings { bones, ..BindSettings::default() })
    };
    let error = bind(vec![("elbow".into(), BoneRule::Whole)]).unwrap_err();
    assert!(matches!(&error, BindError::UnknownBone { joint, known } if joint == "elbow" && known == "upper, lower"));
    let both = [("upper".into(), BoneRule::Exclude), ("lower".into(), BoneRule::Exclude)];
    assert_eq!(bind(both.to_vec()).unwrap_err(), BindError::NothingBound);
    let all = [("upper".into(), BoneRule::Whole), ("lower".into(), BoneRule::Whole)];
    assert_eq!(bind(all.to_vec()).unwrap().bound_count(), volume.node_count());
    let bare = Character { meshes: Vec::new(), ..limb() };
    assert!(matches!(Binding::new(&bare, &volume, &BindSettings::default()), Err(BindError::NoSkin(_))));
}
