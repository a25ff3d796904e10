//! `softrig bench`: standard bodies, measured on this machine.

mod body;
mod character;
mod machine;
mod measure;
mod stages;
mod statics;
mod two_way;

use crate::args::BenchArgs;
use crate::failure::{Failure, Outcome};
use crate::load::shared_folder;
use crate::ui;
pub use measure::Time;
use measure::{Measurement, measure};
use softrig_linalg::Instructions;
pub use stages::{Clocks, TimedModel, TimedSolver};

/// Measures the named bodies (the two standard ones without names) and prints some lines or a JSON object for each.
///
/// # Errors
/// [`Failure::Usage`] for a name that is no body and instructions that this machine does not have, [`Failure::Input`] for missing or
/// damaged files, [`Failure::Simulation`] when a step fails.
pub fn run(args: &BenchArgs) -> Outcome {
    let default = body::DEFAULT.map(String::from);
    let names = if args.names.is_empty() { &default[..] } else { &args.names };
    let solver = args.solver.unwrap_or_default().into();
    if let Some(name) = args.instructions
        && !Instructions::from(name).use_at_most()
    {
        let has: Vec<_> =
            Instructions::ALL.into_iter().filter(|set| set.is_available()).map(instructions_name).collect();
        let asked = instructions_name(name.into());
        return Err(Failure::Usage(format!("this machine has no {asked}; it has {}", has.join(", "))));
    }
    for name in names {
        if args.statics {
            let measured = statics::measure(body::load(name, &shared_folder(args.shared.as_deref()))?, solver)?;
            ui::result(if args.json { json(&measured)? } else { measured.sentence() });
            continue;
        }
        if let Some(cells) = name.strip_prefix("two_way_") {
            let measured = two_way::measure(name, cells, solver)?;
            ui::result(if args.json { json(&measured)? } else { measured.sentence() });
            continue;
        }
        let measurement = match name.strip_prefix("character_") {
            Some(cells) => character::measure(name, cells, solver)?,
            None => measure(body::load(name, &shared_folder(args.shared.as_deref()))?, solver)?,
        };
        ui::result(if args.json { json(&measurement)? } else { sentence(&measurement) });
    }
    Ok(())
}

/// Name in reports.
fn instructions_name(set: Instructions) -> String {
    format!("{set:?}").to_lowercase()
}

fn json(measurement: &impl serde::Serialize) -> Result<String, Failure> {
    serde_json::to_string(measurement).map_err(|e| Failure::Machine(format!("cannot write JSON: {e}")))
}

fn sentence(m: &Measurement) -> String {
    let tip = |k: usize| m.tip_displacement_m[k].map(|v| format!("{v:.4}")).join(" ");
    let row = |name: &str, time: f64, rest: &str| format!("  {name:20} {time:8.2} ms {rest}");
    let s = &m.stages;
    let mut lines = vec![
        format!(
            "{}: {} cells, {} nodes, {} threads, {} in {} ({})",
            m.name, m.cells, m.nodes, m.threads, m.solver, m.precision, m.instructions
        ),
        row("step", m.step_ms_median, &format!("median, {:8.2} ms minimum of {}", m.step_ms_min, m.steps - 1)),
    ];
    let stages = [
        ("rotations and forces", s.rotations_and_forces_ms),
        ("assembly", s.assembly_ms),
        ("solve", s.solve_ms),
        ("embedding", s.embedding_ms),
        ("other", s.other_ms),
    ];
    for (stage, t) in stages {
        lines.push(row(stage, t.median, &format!("median, {:8.2} ms minimum", t.min)));
    }
    if let Some(t) = m.galerkin_ms {
        let rest = format!("for each rebuild of the coarse operators; {} steps had one", m.rebuilds);
        lines.push(row("galerkin", t, &rest));
    }
    if let Some(t) = m.constraints_ms {
        lines.push(row("bones", t, "to bind or free nodes, before the next step"));
    }
    let solvers: Vec<_> = m.solves_by.iter().map(|(name, n)| format!("{n} by {name}")).collect();
    lines.push(format!("  iterations {}, residual {:.1e}; solves: {}", m.iterations, m.residual, solvers.join(", ")));
    if let Some(t) = &m.traffic {
        lines.push(format!(
            "  solve moves {:.1} MB a step at {:.1} GB/s, over and over the same {:.1} MB, which this machine reads at {:.1} GB/s",
            t.megabytes_a_step, t.gigabytes_a_second, t.held_megabytes, t.machine_gigabytes_a_second
        ));
    }
    if m.tip_displacement_m != [[0.0; 3]; 2] {
        lines.push(format!("  tip moved ({}) m after 0.25 s, ({}) m after 0.5 s", tip(0), tip(1)));
    }
    if let Some(peak) = m.peak_rss_mib {
        lines.push(format!("  peak memory {peak} MiB"));
    }
    lines.push(format!("  state {}", m.state_hash));
    lines.join("\n")
}
