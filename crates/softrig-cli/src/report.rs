//! What a bake says about itself: stable keys for scripts and tests.

use schemars::JsonSchema;
use serde::Serialize;

/// Report of one baked clip.
#[derive(Clone, Debug, Default, PartialEq, Serialize, JsonSchema)]
pub struct BakeReport {
    /// Version of softrig.
    pub version: String,
    /// Character file.
    pub character: String,
    /// Name of the clip.
    pub clip: String,
    /// What was written.
    pub outputs: Vec<String>,
    /// Frames of the result.
    pub frames: usize,
    /// Frames per second of the result [1/s].
    pub fps: f64,
    /// Time in the clip, counted as its keys are, of the first frame of the result [s].
    pub start_time_s: f64,
    /// Cells of the body.
    pub cells: usize,
    /// `hex` or `tet`.
    pub cell_kind: String,
    /// Edge of a cell [m].
    pub spacing_m: f64,
    /// Nodes of the body.
    pub nodes: usize,
    /// Nodes that hang on bones.
    pub bound_nodes: usize,
    /// Bones that hold flesh.
    pub bones: usize,
    /// Parts of the body that are not connected.
    pub parts: usize,
    /// Skin vertices of all meshes.
    pub skin_vertices: usize,
    /// Height of the character in its rest shape [m].
    pub height_m: f64,
    /// What computed the flesh.
    pub method: String,
    /// Explicit steps that the steps were cut into; 0 for `implicit`.
    pub explicit_steps: usize,
    /// Linear solver.
    pub solver: String,
    /// How time passed.
    pub dynamics: String,
    /// Numbers computed with.
    pub precision: String,
    /// Threads.
    pub threads: usize,
    /// Steps of the simulation after the pre-roll.
    pub steps: usize,
    /// Steps beyond one a frame, because bones moved far.
    pub substeps: usize,
    /// Steps that the growth guard did again with implicit Euler.
    pub guarded_steps: usize,
    /// Steps in which a linear solve did not reach the tolerance.
    pub unconverged_steps: usize,
    /// Jumps of the clip that were not simulated through.
    pub teleports: usize,
    /// Time of a frame's simulation, all of its steps: median [ms].
    pub frame_ms_median: f64,
    /// Time of a frame's simulation, all of its steps: 95th percentile [ms].
    pub frame_ms_p95: f64,
    /// Time of one step, where the steps of a frame share its time evenly: median [ms].
    pub step_ms_median: f64,
    /// Time of one step, where the steps of a frame share its time evenly: 95th percentile [ms].
    pub step_ms_p95: f64,
    /// Steps in a second of simulation [1/s].
    pub steps_per_second: f64,
    /// Seconds of simulation after the pre-roll, without reading and writing [s].
    pub simulation_seconds: f64,
    /// Linear iterations of a step: mean.
    pub iterations_mean: f64,
    /// Largest true relative residual of a linear solve [-].
    pub residual_max: f64,
    /// Largest distance between a bound node and where its bones are [m].
    pub attachment_gap_max_m: f64,
    /// Largest relative deviation of a bone's length from what the clip gives it [-].
    pub bone_length_error_max: f64,
    /// Largest relative change of a bone's length by the clip itself [-]: clips may move joints.
    pub clip_bone_length_change_max: f64,
    /// Smallest volume of the whole body over that at rest [-].
    pub volume_ratio_min: f64,
    /// Largest volume of the whole body over that at rest [-].
    pub volume_ratio_max: f64,
    /// Volume of a cell over that at rest: 1st percentile, least of all frames [-].
    pub cell_volume_ratio_p01: f64,
    /// Volume of a cell over that at rest: 99th percentile, largest of all frames [-].
    pub cell_volume_ratio_p99: f64,
    /// Most cells inverted in one frame.
    pub inverted_cells_max: usize,
    /// Whether flesh moves the skeleton too.
    pub two_way: bool,
    /// Unknowns of the skeleton: what its joints leave free.
    pub joint_unknowns: usize,
    /// Mass of flesh that projects to no bone, which the nearest joint got [kg]: staggered coupling only.
    pub unassigned_mass_kg: f64,
    /// How far the worst joint was beyond its limits [rad].
    pub limit_violation_max_rad: f64,
    /// How many times stiffer than asked for the stiffest cell is, so that the clip does not crush it [-]; 1 where none is.
    pub stiffened_max: f64,
    /// Largest part of the morph targets' fit that is wrong, over the height [-]; only for .glb.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub morph_error_max: Option<f64>,
    /// Most memory the process had in use [MiB]; 0 where the system does not tell.
    pub peak_rss_mib: f64,
    /// Seconds for reading, cells and binding.
    pub setup_seconds: f64,
    /// Seconds for everything.
    pub total_seconds: f64,
    /// XXH64 of every skin position of every frame: the same for the same input on any number of threads.
    pub state_hash: String,
    /// What was assumed, repaired or dropped, in words.
    pub notes: Vec<String>,
}

/// Most memory the process had in use so far [MiB], from Linux's status file; `None` where the system does not tell.
#[must_use]
pub fn peak_rss_mib() -> Option<f64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|l| l.strip_prefix("VmHWM:"))?;
    let kib: f64 = line.split_whitespace().next()?.parse().ok()?;
    Some(kib / 1024.0)
}

/// The `fraction` quantile of `values` by nearest rank; 0 without values.
#[must_use]
pub fn quantile(values: &[f64], fraction: f64) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let rank = (fraction * sorted.len() as f64).ceil() as usize;
    sorted.get(rank.saturating_sub(1)).copied().unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_members_of_the_list() {
        let v = [4.0, 1.0, 3.0, 2.0];
        assert_eq!((quantile(&v, 0.5), quantile(&v, 0.95), quantile(&[], 0.5)), (2.0, 4.0, 0.0));
    }
}
