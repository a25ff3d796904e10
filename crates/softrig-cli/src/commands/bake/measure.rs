//! What is measured while a clip is baked. It is kept in checkpoints, so that a resumed bake reports all of its frames.

use crate::report::{BakeReport, quantile};
use serde::{Deserialize, Serialize};
use softrig::couple::Binding;
use softrig::mesh::{VolumeMesh, deformation_stats};
use softrig::rig::{JointId, Pose, Skeleton, Transform};
use softrig::simulation::{FrameReport, JointReaction};
use std::time::Duration;

/// Everything measured so far.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Measures {
    steps: usize,
    substeps: usize,
    guarded_steps: usize,
    unconverged_steps: usize,
    teleports: usize,
    iterations: usize,
    /// Time and number of steps of each frame but the first.
    frames: Vec<(f64, usize)>,
    residual_max: f64,
    attachment_gap_max: f64,
    bone_length_error_max: f64,
    clip_bone_length_change_max: f64,
    volume: (f64, f64),
    cell_volume: (f64, f64),
    inverted_cells_max: usize,
    #[serde(default)]
    explicit_steps: usize,
    #[serde(default)]
    limit_violation_max: f64,
    /// Force and torque of each joint, frame by frame, where they are asked for.
    #[serde(default)]
    reactions: Vec<Vec<[f32; 6]>>,
    /// Name of the bone with most of the inverted cells in the frame that had most of them.
    crushed_bone: Option<String>,
}

impl Default for Measures {
    fn default() -> Self {
        Self {
            steps: 0,
            substeps: 0,
            guarded_steps: 0,
            unconverged_steps: 0,
            teleports: 0,
            iterations: 0,
            frames: Vec::new(),
            residual_max: 0.0,
            attachment_gap_max: 0.0,
            bone_length_error_max: 0.0,
            clip_bone_length_change_max: 0.0,
            volume: (f64::INFINITY, f64::NEG_INFINITY),
            cell_volume: (f64::INFINITY, f64::NEG_INFINITY),
            inverted_cells_max: 0,
            explicit_steps: 0,
            limit_violation_max: 0.0,
            reactions: Vec::new(),
            crushed_bone: None,
        }
    }
}

impl Measures {
    /// Counts what advancing to one frame did; `took` is `None` for the start.
    pub fn add_advance(&mut self, report: &FrameReport, took: Option<Duration>) {
        self.residual_max = self.residual_max.max(report.residual);
        self.unconverged_steps += report.unconverged_steps;
        self.guarded_steps += report.guarded_steps;
        self.teleports += usize::from(report.teleported);
        if let Some(took) = took {
            self.steps += report.substeps;
            self.substeps += report.substeps.saturating_sub(1);
            self.explicit_steps += report.explicit_steps;
            self.iterations += report.iterations;
            self.frames.push((1e3 * took.as_secs_f64(), report.substeps));
        }
    }

    /// Measures the flesh in one frame.
    pub fn add_shape(
        &mut self,
        skeleton: &Skeleton,
        binding: Option<&Binding>,
        rest: &VolumeMesh,
        nodes: &[[f64; 3]],
        attachment_gap: f64,
    ) {
        let stats = deformation_stats(rest, nodes);
        self.volume = (self.volume.0.min(stats.volume_ratio), self.volume.1.max(stats.volume_ratio));
        let cells = &mut self.cell_volume;
        *cells = (cells.0.min(stats.p1), cells.1.max(stats.p99));
        if stats.inverted.len() > self.inverted_cells_max {
            self.inverted_cells_max = stats.inverted.len();
            self.crushed_bone = binding.and_then(|binding| {
                let mut corners = vec![0usize; binding.bones.len()];
                for node in stats.inverted.iter().flat_map(|c| rest.cell(*c as usize)) {
                    if let Some(count) = corners.get_mut(binding.owner[*node as usize] as usize) {
                        *count += 1;
                    }
                }
                let most = corners.iter().enumerate().max_by_key(|(bone, count)| (**count, std::cmp::Reverse(*bone)));
                most.map(|(bone, _)| skeleton.joint(binding.joint(bone as u32)).name.clone())
            });
        }
        self.attachment_gap_max = self.attachment_gap_max.max(attachment_gap);
    }

    /// Measures the bones in one frame: how far the realised `pose` is from the lengths that the clip's local transforms
    /// `locals` give them, and how far those are from the rest shape.
    /// Joints in `free` leave their parent on purpose.
    pub fn add_pose(
        &mut self,
        skeleton: &Skeleton,
        binding: &Binding,
        pose: &Pose,
        locals: &[Transform],
        height: f64,
        free: &[JointId],
    ) {
        let distance = |a: [f64; 3], b: [f64; 3]| length([a[0] - b[0], a[1] - b[1], a[2] - b[2]]);
        for bone in binding.bones.iter().filter(|b| !free.contains(&b.joint)) {
            let joint = skeleton.joint(bone.joint);
            // a root's offset from what carries no flesh is no bone
            let Some(parent) = joint.parent.filter(|p| binding.bones.iter().any(|b| b.joint == *p)) else { continue };
            let rest = distance(joint.rest.translation, skeleton.joint(parent).rest.translation);
            // joints on top of each other have no length to compare with
            if rest > 1e-3 * height {
                let clip = clip_length(skeleton, bone.joint, locals);
                let now = distance(pose.joint(bone.joint).translation, pose.joint(parent).translation);
                // a clip may shrink a bone to nothing
                let scale = clip.max(1e-3 * rest);
                self.bone_length_error_max = self.bone_length_error_max.max((now - clip).abs() / scale);
                self.clip_bone_length_change_max = self.clip_bone_length_change_max.max((clip / rest - 1.0).abs());
            }
        }
    }

    /// Measures the joints in one frame; keeps what they pass on when it is asked for.
    pub fn add_joints(&mut self, limit_violation: f64, reactions: Option<&[JointReaction]>) {
        self.limit_violation_max = self.limit_violation_max.max(limit_violation);
        if let Some(all) = reactions {
            let row =
                |r: &JointReaction| std::array::from_fn(|k| if k < 3 { r.force[k] } else { r.torque[k - 3] } as f32);
            self.reactions.push(all.iter().map(row).collect());
        }
    }

    /// What [`Self::add_joints`] kept.
    #[must_use]
    pub fn reactions(&self) -> &[Vec<[f32; 6]>] {
        &self.reactions
    }

    /// In words: flesh that lost its shape, and what helps. A few cells turn over in creases; that is no loss.
    #[must_use]
    pub fn lost_shape(&self, cells: usize) -> Option<String> {
        let crushed = self.inverted_cells_max as f64 > 0.003 * cells as f64;
        if !(crushed || self.volume.0 < 0.9 || self.volume.1 > 1.1) {
            return None;
        }
        let remedy = "stiffer flesh (--preset muscle) or --dynamics calm may help";
        Some(match &self.crushed_bone {
            Some(bone) => format!(
                "the motion crushes flesh, most of it on the bone `{bone}`: in a scene file (--write-scene), [[bone]] with joint = \
                 \"{bone}\" and whole = true lets that bone carry its flesh whole; {remedy}"
            ),
            None => format!("the motion changes the volume of the body beyond a tenth; {remedy}"),
        })
    }

    /// Writes the measures into a report.
    pub fn report(&self, report: &mut BakeReport) {
        report.steps = self.steps;
        report.substeps = self.substeps;
        report.explicit_steps = self.explicit_steps;
        report.guarded_steps = self.guarded_steps;
        report.unconverged_steps = self.unconverged_steps;
        report.teleports = self.teleports;
        let frame_ms: Vec<f64> = self.frames.iter().map(|(ms, _)| *ms).collect();
        // the steps of one frame share its time evenly
        let shares = self.frames.iter().flat_map(|(ms, n)| std::iter::repeat_n(ms / (*n).max(1) as f64, *n));
        let step_ms: Vec<f64> = shares.collect();
        report.frame_ms_median = quantile(&frame_ms, 0.5);
        report.frame_ms_p95 = quantile(&frame_ms, 0.95);
        report.step_ms_median = quantile(&step_ms, 0.5);
        report.step_ms_p95 = quantile(&step_ms, 0.95);
        report.simulation_seconds = 1e-3 * frame_ms.iter().sum::<f64>();
        report.steps_per_second = match report.simulation_seconds {
            seconds if seconds > 0.0 => self.steps as f64 / seconds,
            _ => 0.0,
        };
        report.iterations_mean = self.iterations as f64 / self.steps.max(1) as f64;
        report.residual_max = self.residual_max;
        report.attachment_gap_max_m = self.attachment_gap_max;
        report.bone_length_error_max = self.bone_length_error_max;
        report.clip_bone_length_change_max = self.clip_bone_length_change_max;
        (report.volume_ratio_min, report.volume_ratio_max) = self.volume;
        (report.cell_volume_ratio_p01, report.cell_volume_ratio_p99) = self.cell_volume;
        report.inverted_cells_max = self.inverted_cells_max;
        report.limit_violation_max_rad = self.limit_violation_max;
    }
}

/// Distance of a joint from its parent as a clip's local transforms have it [m]: the offset carried up to the world, link by
/// link, without a pose.
fn clip_length(skeleton: &Skeleton, id: JointId, locals: &[Transform]) -> f64 {
    let local = |id: JointId| skeleton.joint(id).local_matrix.unwrap_or_else(|| locals[id.index()].to_affine());
    let mut offset = local(id).translation;
    let mut above = skeleton.joint(id).parent;
    while let Some(parent) = above {
        offset = local(parent).vector(offset);
        above = skeleton.joint(parent).parent;
    }
    length(skeleton.to_world().vector(offset))
}

fn length(v: [f64; 3]) -> f64 {
    v.iter().map(|x| x * x).sum::<f64>().sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use softrig::couple::BindSettings;
    use softrig::mesh::{LatticeOptions, Resolution, voxelize};

    /// What a clip does to bones and what a simulation does to them are told apart, each by a pose that does only that.
    #[test]
    fn changes_of_the_clip_are_no_errors_of_the_pose() {
        let character = softrig::sample::character();
        let options = LatticeOptions { resolution: Resolution::Cells(1000), ..LatticeOptions::default() };
        let volume = voxelize(&character.surface(true), &options).unwrap();
        let binding = Binding::new(&character, &volume, &BindSettings::default()).unwrap();
        let skeleton = &character.skeleton;
        let measure = |pose: &Pose, locals: &[Transform]| {
            let mut measures = Measures::default();
            measures.add_pose(skeleton, &binding, pose, locals, character.height(), &[]);
            (measures.bone_length_error_max, measures.clip_bone_length_change_max)
        };
        let still = character.clips[0].sample(skeleton, 0.3);
        let (error, change) = measure(&skeleton.pose(&still), &still);
        assert!(error < 1e-12 && change < 1e-6, "{error} {change}");
        // the clip stretches every bone by a tenth, and the pose follows
        let mut stretched = still.clone();
        stretched.iter_mut().for_each(|t| t.translation = t.translation.map(|v| 1.1 * v));
        let (error, change) = measure(&skeleton.pose(&stretched), &stretched);
        assert!(error < 1e-12 && (change - 0.1).abs() < 1e-6, "{error} {change}");
        // the clip does not, the pose does
        let (error, change) = measure(&skeleton.pose(&stretched), &still);
        assert!((error - 0.1).abs() < 1e-6 && change < 1e-6, "{error} {change}");
        assert!(binding.bones.len() > 5);
    }

    /// A root that the clip moves away from a joint without flesh stretches no bone.
    #[test]
    fn a_root_is_no_bone_of_what_carries_it() {
        let mut character = softrig::sample::character();
        let joints = character.skeleton.joints();
        let root = joints.iter().position(|j| j.parent.is_none()).unwrap();
        let mut joints = joints.to_vec();
        let mut scene = joints[root].clone();
        scene.name = "scene".into();
        scene.local = Transform { translation: [0.0, -1.0, 0.0], ..Transform::default() };
        scene.rest = scene.local.to_affine();
        joints[root].parent = Some(JointId(joints.len() as u32));
        joints[root].local.translation[1] += 1.0;
        joints.push(scene);
        let to_world = *character.skeleton.to_world();
        character.skeleton = Skeleton::new(joints, to_world).unwrap();
        let options = LatticeOptions { resolution: Resolution::Cells(1000), ..LatticeOptions::default() };
        let volume = voxelize(&character.surface(true), &options).unwrap();
        let binding = Binding::new(&character, &volume, &BindSettings::default()).unwrap();
        let skeleton = &character.skeleton;
        let mut locals: Vec<Transform> = skeleton.joints().iter().map(|j| j.local).collect();
        locals[root].translation[0] += 0.5;
        let mut measures = Measures::default();
        measures.add_pose(skeleton, &binding, &skeleton.pose(&locals), &locals, character.height(), &[]);
        assert!(measures.clip_bone_length_change_max < 1e-9, "{}", measures.clip_bone_length_change_max);
    }

    /// A slow frame of many steps is not a slow step.
    #[test]
    fn times_are_told_per_frame_and_per_step() {
        let mut measures = Measures::default();
        for (substeps, ms) in [(1, 10), (1, 10), (4, 40)] {
            let report = FrameReport { substeps, iterations: 3 * substeps, ..FrameReport::default() };
            measures.add_advance(&report, Some(Duration::from_millis(ms)));
        }
        let mut report = BakeReport::default();
        measures.report(&mut report);
        assert_eq!((report.frame_ms_median, report.frame_ms_p95), (10.0, 40.0));
        assert_eq!((report.step_ms_median, report.step_ms_p95), (10.0, 10.0));
        assert_eq!((report.steps, report.substeps, report.iterations_mean), (6, 3, 3.0));
        assert!((report.steps_per_second - 100.0).abs() < 1e-9, "{}", report.steps_per_second);
    }
}
