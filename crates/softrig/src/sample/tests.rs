use super::character;
use crate::character::Skin;
use crate::rig::Property;
use std::collections::BTreeMap;

/// Every directed edge once, and its reverse once: closed, 2-manifold along edges, consistently oriented.
#[test]
fn skin_is_closed_and_oriented() {
    let c = character();
    let mesh = &c.meshes[0];
    let mut edges: BTreeMap<(u32, u32), usize> = BTreeMap::new();
    for t in &mesh.triangles {
        for k in 0..3 {
            *edges.entry((t[k], t[(k + 1) % 3])).or_default() += 1;
        }
    }
    for (&(a, b), &count) in &edges {
        assert_eq!(
            (count, edges.get(&(b, a)).copied()),
            (1, Some(1)),
            "edge {a}-{b} at {:?}",
            mesh.positions[a as usize]
        );
    }
    // one fan of triangles around every vertex
    let mut around: Vec<Vec<(u32, u32)>> = vec![Vec::new(); mesh.positions.len()];
    for t in &mesh.triangles {
        for k in 0..3 {
            around[t[k] as usize].push((t[(k + 1) % 3], t[(k + 2) % 3]));
        }
    }
    for (v, fan) in around.iter().enumerate() {
        let next: BTreeMap<u32, u32> = fan.iter().copied().collect();
        let (first, mut at, mut steps) = (fan[0].0, fan[0].1, 1);
        while at != first {
            at = next[&at];
            steps += 1;
        }
        assert_eq!(steps, fan.len(), "vertex {v} joins two sheets");
    }
    // outwards: the divergence theorem gives a positive volume, that of a very chubby person
    let volume: f64 = mesh
        .triangles
        .iter()
        .map(|t| {
            let [a, b, c] = t.map(|v| glam::DVec3::from_array(mesh.positions[v as usize]));
            a.dot(b.cross(c)) / 6.0
        })
        .sum();
    assert!((0.12..0.20).contains(&volume), "{volume} m3");
}

#[test]
fn numbers_are_as_promised() {
    let c = character();
    let mesh = &c.meshes[0];
    assert!((5_000..=10_000).contains(&c.vertex_count()), "{} vertices", c.vertex_count());
    assert!((16..=24).contains(&c.skeleton.joint_count()));
    assert!((c.height() - 1.6).abs() <= 0.05, "{} m", c.height());
    assert_eq!(mesh.look.len(), mesh.triangles.len());
    assert_eq!(mesh.colors.len(), mesh.positions.len());
    assert!(mesh.look.iter().all(|l| (*l as usize) < c.looks.len()));
    assert!(mesh.positions.iter().flatten().all(|x| x.is_finite()));
}

#[test]
fn every_vertex_has_up_to_four_weights_of_sum_one() {
    let c = character();
    let Skin::Weighted(rows) = &c.meshes[0].skin else { panic!("not weighted") };
    assert_eq!(rows.start.len(), c.meshes[0].positions.len() + 1);
    let mut dominant = vec![0; c.skeleton.joint_count()];
    for v in 0..c.meshes[0].positions.len() {
        let row: Vec<_> = rows.of(v).collect();
        assert!((1..=4).contains(&row.len()));
        assert!((row.iter().map(|r| r.1).sum::<f32>() - 1.0).abs() < 1e-6);
        let best = row.iter().max_by(|a, b| a.1.total_cmp(&b.1)).unwrap().0;
        dominant[best.index()] += 1;
    }
    // every joint is a bone with skin of its own
    assert!(dominant.iter().all(|n| *n >= 40), "{dominant:?}");
}

/// No triangle is a sliver: the smallest angle of the skin is what cutting along the clothes leaves.
#[test]
fn triangles_are_well_shaped() {
    let c = character();
    let mesh = &c.meshes[0];
    let least = |t: &[u32; 3]| {
        let p = t.map(|v| glam::DVec3::from_array(mesh.positions[v as usize]));
        (0..3).map(|k| (p[(k + 1) % 3] - p[k]).angle_between(p[(k + 2) % 3] - p[k])).fold(f64::MAX, f64::min)
    };
    let mut angles: Vec<f64> = mesh.triangles.iter().map(|t| least(t).to_degrees()).collect();
    angles.sort_by(f64::total_cmp);
    let share = angles.iter().filter(|a| **a < 15.0).count() as f64 / angles.len() as f64;
    assert!(angles[0] > 4.0 && share < 0.01, "least {} degrees, {:.2} % below 15", angles[0], 100.0 * share);
}

#[test]
fn rest_frames_are_the_forward_kinematics_of_the_rest_transforms() {
    let c = character();
    let pose = c.skeleton.pose(&c.skeleton.rest_locals());
    for (joint, world) in c.skeleton.joints().iter().zip(&pose.world) {
        for k in 0..3 {
            assert!((joint.rest.translation[k] - world.translation[k]).abs() < 1e-12, "{}", joint.name);
            assert_eq!(joint.rest.linear, world.linear);
        }
    }
}

#[test]
fn walk_loops_and_all_clips_are_finite_and_smooth() {
    let c = character();
    assert_eq!(c.clips.iter().map(|c| c.name.as_str()).collect::<Vec<_>>(), ["walk", "jump", "turn"]);
    for track in &c.clips[0].tracks {
        let (a, b) = (track.values[0], *track.values.last().unwrap());
        let same = (0..4).all(|k| (a[k] - b[k]).abs() < 1e-9) || (0..4).all(|k| (a[k] + b[k]).abs() < 1e-9);
        assert!(same, "{:?} {a:?} {b:?}", track.joint);
    }
    for clip in &c.clips {
        for track in &clip.tracks {
            assert!(track.values.iter().flatten().all(|v| v.is_finite()));
            for (a, b) in track.values.iter().zip(&track.values[1..]) {
                // a joint that turns by more than 45 degrees in a thirtieth of a second has snapped
                let dot: f64 = (0..4).map(|k| a[k] * b[k]).sum();
                let name = &c.skeleton.joint(track.joint).name;
                let turned = 2.0 * dot.abs().min(1.0).acos();
                assert!(track.property != Property::Rotation || turned < 0.8, "{} {name} {turned}", clip.name);
            }
        }
    }
}

/// Flight of the jump: second differences of the hips' height are gravity.
#[test]
fn jump_is_ballistic() {
    let c = character();
    let clip = &c.clips[1];
    let y: Vec<f64> = clip.tracks[0].values.iter().map(|v| v[1]).collect();
    let g: Vec<f64> = y.windows(3).map(|w| (w[2] - 2.0 * w[1] + w[0]) * 900.0).collect();
    let falling = g.iter().filter(|g| (*g + 9.81).abs() < 1e-6).count();
    assert!(falling >= 12, "{g:?}");
}

/// A standing foot of the walk stays on the ground and moves back at one speed.
#[test]
fn feet_stand_on_the_ground() {
    let c = character();
    for clip in &c.clips {
        let low = (0..=72)
            .map(|i| {
                let pose = c.skeleton.pose(&clip.sample(&c.skeleton, f64::from(i) / 30.0));
                let skin = c.blend_skin(0, &pose);
                skin.iter().map(|p| p[1]).fold(f64::MAX, f64::min)
            })
            .fold(f64::MAX, f64::min);
        assert!(low > -0.035, "{}: the skin reaches {low} m", clip.name);
    }
}

#[test]
fn the_same_every_time() {
    assert_eq!(character(), character());
}
