//! Every real character, from file to flesh: finite, attached, few inverted cells, volume kept.

use crate::shared::real_file;
use softrig::character::Character;
use softrig::couple::{BindSettings, Binding};
use softrig::material::{Material, MaterialMap};
use softrig::mesh::{self, LatticeOptions, Resolution};
use softrig::simulation::{ClipMotion, Motion, Simulation, SimulationSettings, stiffening};
use softrig_io::{ImportOptions, import};

/// Character, clips to bake (empty: the first one). The Knight's head is a metre of flesh, which its clips stop within a frame.
const CHARACTERS: [(&str, &[&str]); 8] = [
    ("CesiumMan.glb", &[]),
    ("Fox.glb", &["Survey", "Run"]),
    ("Cow.glb", &["Gallop", "Idle"]),
    ("Horse.glb", &["Gallop", "Walk"]),
    ("Knight.glb", &["1H_Melee_Attack_Chop", "Running_A", "Jump_Full_Long", "Walking_A", "Idle"]),
    ("RobotExpressive.glb", &["Dance", "Running"]),
    ("RobotExpressive_quantized.glb", &["Dance"]),
    ("RiggedSimple.gltf", &[]),
];

const FPS: f64 = 30.0;
const MOST_FRAMES: usize = 75;

/// As the command bakes it: stiff enough for the motion, where there is one.
fn simulation(character: &Character, cells: usize, motion: Option<&ClipMotion<'_>>) -> Simulation<f64> {
    let options = LatticeOptions { resolution: Resolution::Cells(cells), ..LatticeOptions::default() };
    let volume = mesh::voxelize(&character.surface(true), &options).unwrap();
    let binding = Binding::new(character, &volume, &BindSettings::default()).unwrap();
    let mut materials = MaterialMap::uniform(Material::default());
    if let Some(motion) = motion {
        let duration = motion.duration().min(MOST_FRAMES as f64 / FPS);
        let factors = stiffening(&character.skeleton, &volume, &binding, &materials, motion, duration);
        materials.stiffen(&factors);
    }
    Simulation::new(character, volume, binding, &materials, SimulationSettings::default()).unwrap()
}

/// What a bake of one clip looked like at its worst.
#[derive(Debug, Default)]
struct Worst {
    frames: usize,
    inverted_share: f64,
    longest_inverted: usize,
    volume: (f64, f64),
    gap: f64,
    guarded: usize,
    unconverged: usize,
    teleports: usize,
    speed: f64,
}

fn bake(character: &Character, sim: &mut Simulation<f64>, motion: &ClipMotion<'_>) -> Worst {
    let mut worst = Worst { volume: (1.0, 1.0), ..Worst::default() };
    let mut inverted_for = vec![0usize; sim.body.mesh.cell_count()];
    sim.start(motion).unwrap();
    let frames = motion.frame_count(FPS).min(MOST_FRAMES);
    for f in 0..frames {
        if f > 0 {
            let r = sim.advance(motion, f as f64 / FPS).unwrap();
            worst.guarded += r.guarded_steps;
            worst.unconverged += r.unconverged_steps;
            worst.teleports += usize::from(r.teleported);
        }
        let stats = mesh::deformation_stats(&sim.body.mesh, &sim.state.position);
        worst.inverted_share = worst.inverted_share.max(stats.inverted.len() as f64 / inverted_for.len() as f64);
        worst.volume.0 = worst.volume.0.min(stats.volume_ratio);
        worst.volume.1 = worst.volume.1.max(stats.volume_ratio);
        let mut now = vec![false; inverted_for.len()];
        stats.inverted.iter().for_each(|c| now[*c as usize] = true);
        for (count, inverted) in inverted_for.iter_mut().zip(now) {
            *count = if inverted { *count + 1 } else { 0 };
            worst.longest_inverted = worst.longest_inverted.max(*count);
        }
        worst.gap = worst.gap.max(sim.attachment_gap());
        worst.speed = sim.state.velocity.iter().flatten().fold(worst.speed, |s, v| s.max(v.abs()));
        let frame = sim.frame(f);
        assert!(frame.skin.iter().flatten().flatten().all(|v| v.is_finite()), "{} frame {f}", character.name);
        worst.frames += 1;
    }
    worst
}

fn clips(character: &Character, names: &[&str]) -> Vec<usize> {
    if names.is_empty() {
        return vec![0];
    }
    names
        .iter()
        .map(|n| {
            let by_end = |c: &&softrig::rig::Clip| c.name == *n || c.name.ends_with(&format!("|{n}"));
            let found = character.clips.iter().find(by_end);
            let known: Vec<&str> = character.clips.iter().map(|c| c.name.as_str()).collect();
            let found = found.unwrap_or_else(|| panic!("{}: no clip {n}; there are {known:?}", character.name));
            character.find_clip(&found.name).unwrap()
        })
        .collect()
}

#[test]
fn real_characters_bake_to_sound_flesh() {
    for (file, names) in CHARACTERS {
        let Some(path) = real_file(&format!("data/characters/{file}")) else { continue };
        let character = import(&path, &ImportOptions::default()).unwrap();
        for clip in clips(&character, names) {
            let motion = ClipMotion::new(&character.skeleton, &character.clips[clip]);
            let mut sim = simulation(&character, 3000, Some(&motion));
            let worst = bake(&character, &mut sim, &motion);
            println!("{file} `{}`: {worst:?}", character.clips[clip].name);
            assert!(worst.inverted_share <= 0.003, "{file}: {:.2} % of cells inverted", 100.0 * worst.inverted_share);
            assert!(
                worst.longest_inverted < FPS as usize,
                "{file}: a cell inverted for {} frames",
                worst.longest_inverted
            );
            assert!(worst.volume.0 >= 0.9 && worst.volume.1 <= 1.1, "{file}: volume {:?}", worst.volume);
            assert!(worst.gap <= 1e-6 * character.height(), "{file}: gap {}", worst.gap);
            assert_eq!((worst.unconverged, worst.teleports), (0, 0), "{file}");
        }
    }
}

/// At ten times the clip's speed flesh may look as it likes, but it stays finite, attached and bounded.
#[test]
fn real_characters_survive_ten_times_the_speed() {
    for (file, names) in CHARACTERS {
        let Some(path) = real_file(&format!("data/characters/{file}")) else { continue };
        let character = import(&path, &ImportOptions::default()).unwrap();
        for clip in clips(&character, names) {
            let motion = ClipMotion { speed: 10.0, ..ClipMotion::new(&character.skeleton, &character.clips[clip]) };
            let mut sim = simulation(&character, 1000, None);
            let worst = bake(&character, &mut sim, &motion);
            println!("{file} `{}` x10: {worst:?}", character.clips[clip].name);
            assert!(worst.gap <= 1e-6 * character.height(), "{file}: gap {}", worst.gap);
            let far = sim.state.position.iter().zip(&sim.body.mesh.nodes);
            let far = far.map(|(a, b)| (0..3).map(|k| (a[k] - b[k]).abs()).fold(0.0, f64::max)).fold(0.0, f64::max);
            assert!(far < 20.0 * character.height(), "{file}: a node went {far} m");
        }
    }
}

/// Bound nodes against a plain evaluation of the pose, on every frame of every clip of every character.
#[test]
fn bound_nodes_follow_the_file_on_every_frame_of_every_clip() {
    for (file, _) in CHARACTERS {
        let Some(path) = real_file(&format!("data/characters/{file}")) else { continue };
        let character = import(&path, &ImportOptions::default()).unwrap();
        let mut sim = simulation(&character, 1000, None);
        let mut frames = 0;
        for clip in &character.clips {
            let motion = ClipMotion::new(&character.skeleton, clip);
            let mut most = 0.0f64;
            for f in 0..motion.frame_count(FPS) {
                let time = f as f64 / FPS;
                sim.place(&motion, time);
                let maps = character.bone_maps(&motion.pose(time));
                for n in (0..sim.binding.bound.len()).filter(|n| sim.binding.bound[*n]) {
                    let [(bone, _)] = sim.binding.blend(n) else { continue };
                    let target = maps[sim.binding.joint(*bone).index()].point(sim.body.mesh.nodes[n]);
                    most = (0..3).map(|k| (sim.state.position[n][k] - target[k]).abs()).fold(most, f64::max);
                }
                frames += 1;
            }
            assert!(most <= 1e-6 * character.height(), "{file} `{}`: {most}", clip.name);
        }
        assert!(frames > 0);
        println!("{file}: {frames} frames of {} clips", character.clips.len());
    }
}
