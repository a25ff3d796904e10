//! What is measured while a clip is baked. It is kept in checkpoints, so that a resumed bake reports all of its frames.

use crate::report::{BakeReport, quantile};
use serde::{Deserialize, Serialize};
use softrig::couple::Binding;
use softrig::mesh::{VolumeMesh, deformation_stats};
use softrig::rig::{Pose, Skeleton};
use softrig::simulation::FrameReport;
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
    frame_ms: Vec<f64>,
    residual_max: f64,
    attachment_gap_max: f64,
    bone_length_error_max: f64,
    volume: (f64, f64),
    cell_volume: (f64, f64),
    inverted_cells_max: usize,
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
            frame_ms: Vec::new(),
            residual_max: 0.0,
            attachment_gap_max: 0.0,
            bone_length_error_max: 0.0,
            volume: (f64::INFINITY, f64::NEG_INFINITY),
            cell_volume: (f64::INFINITY, f64::NEG_INFINITY),
            inverted_cells_max: 0,
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
            self.iterations += report.iterations;
            self.frame_ms.push(1e3 * took.as_secs_f64());
        }
    }

    /// Measures the flesh in one frame.
    pub fn add_shape(&mut self, rest: &VolumeMesh, nodes: &[[f64; 3]], attachment_gap: f64) {
        let stats = deformation_stats(rest, nodes);
        self.volume = (self.volume.0.min(stats.volume_ratio), self.volume.1.max(stats.volume_ratio));
        let cells = &mut self.cell_volume;
        *cells = (cells.0.min(stats.p1), cells.1.max(stats.p99));
        self.inverted_cells_max = self.inverted_cells_max.max(stats.inverted.len());
        self.attachment_gap_max = self.attachment_gap_max.max(attachment_gap);
    }

    /// Measures the bones in one frame: by how much joints that hold flesh moved away from their parents.
    pub fn add_pose(&mut self, skeleton: &Skeleton, binding: &Binding, pose: &Pose, height: f64) {
        let distance = |a: [f64; 3], b: [f64; 3]| (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f64>().sqrt();
        for bone in &binding.bones {
            let joint = skeleton.joint(bone.joint);
            let Some(parent) = joint.parent else { continue };
            let rest = distance(joint.rest.translation, skeleton.joint(parent).rest.translation);
            // joints on top of each other have no length to compare with
            if rest > 1e-3 * height {
                let now = distance(pose.joint(bone.joint).translation, pose.joint(parent).translation);
                self.bone_length_error_max = self.bone_length_error_max.max((now / rest - 1.0).abs());
            }
        }
    }

    /// Writes the measures into a report.
    pub fn report(&self, report: &mut BakeReport) {
        report.steps = self.steps;
        report.substeps = self.substeps;
        report.guarded_steps = self.guarded_steps;
        report.unconverged_steps = self.unconverged_steps;
        report.teleports = self.teleports;
        report.step_ms_median = quantile(&self.frame_ms, 0.5);
        report.step_ms_p95 = quantile(&self.frame_ms, 0.95);
        report.iterations_mean = self.iterations as f64 / self.frame_ms.len().max(1) as f64;
        report.residual_max = self.residual_max;
        report.attachment_gap_max_m = self.attachment_gap_max;
        report.bone_length_error_max = self.bone_length_error_max;
        (report.volume_ratio_min, report.volume_ratio_max) = self.volume;
        (report.cell_volume_ratio_p01, report.cell_volume_ratio_p99) = self.cell_volume;
        report.inverted_cells_max = self.inverted_cells_max;
    }
}
