//! `softrig bench`: standard bodies, measured on this machine.

mod body;
mod measure;
mod stages;

use crate::failure::{Failure, Outcome};
use crate::ui;
use measure::{Measurement, measure};
use softrig::simulation::SolverKind;
use std::path::Path;

/// Measures the named bodies (all without names) and prints a line or a JSON object for each.
///
/// # Errors
/// [`Failure::Usage`] for a name that is no body, [`Failure::Input`] for missing or damaged files, [`Failure::Simulation`]
/// when a step fails.
pub fn run(names: &[String], solver: SolverKind, threads: usize, json: bool, shared: &Path) -> Outcome {
    let all = body::NAMES.map(String::from);
    let names = if names.is_empty() { &all[..] } else { names };
    for name in names {
        let measurement = measure(body::load(name, shared)?, solver, threads)?;
        if json {
            let text = serde_json::to_string(&measurement);
            ui::result(text.map_err(|e| Failure::Machine(format!("cannot write JSON: {e}")))?);
        } else {
            ui::result(sentence(&measurement));
        }
    }
    Ok(())
}

fn sentence(m: &Measurement) -> String {
    let tip = |k: usize| m.tip_displacement_m[k].map(|v| format!("{v:.4}")).join(" ");
    let s = &m.stages;
    let mut lines = vec![
        format!(
            "{}: {} cells, {} nodes, {} threads, {} in {} ({})",
            m.name, m.cells, m.nodes, m.threads, m.solver, m.precision, m.instructions
        ),
        format!("  step      {:8.2} ms median, {:8.2} ms minimum of {}", m.step_ms_median, m.step_ms_min, m.steps - 1),
    ];
    for (stage, t) in [("force", s.force_ms), ("matrix", s.matrix_ms), ("solve", s.solve_ms), ("other", s.other_ms)] {
        lines.push(format!("  {stage:9} {:8.2} ms median, {:8.2} ms minimum", t.median, t.min));
    }
    lines.push(format!("  iterations {}, residual {:.1e}", m.iterations, m.residual));
    lines.push(format!("  tip moved ({}) m after 0.25 s, ({}) m after 0.5 s", tip(0), tip(1)));
    if let Some(peak) = m.peak_rss_mib {
        lines.push(format!("  peak memory {peak} MiB"));
    }
    lines.push(format!("  state {}", m.state_hash));
    lines.join("\n")
}
