//! `softrig papers`: the tables and figures of the papers, from our own code.

mod g10;
mod picture;
mod plot;
mod results;
mod s06;
mod t09;
mod timing;

use crate::args::{PaperName, PapersArgs};
use crate::failure::{Failure, Outcome};
use crate::load::shared_folder;
use crate::ui;
use plot::{Curve, Plot};
use results::Results;
use std::path::PathBuf;

/// What every paper gets.
struct Job {
    /// Small bodies and few steps.
    quick: bool,
    /// Where the bodies of the papers are.
    shared: PathBuf,
}

/// Reproduces the named papers, or all.
///
/// # Errors
/// [`Failure`] with the exit code; what is finished by then stays.
pub fn run(args: &PapersArgs) -> Outcome {
    let all = [PaperName::G10, PaperName::T09, PaperName::S06];
    let papers = if args.papers.is_empty() { &all[..] } else { &args.papers[..] };
    let job = Job { quick: args.quick, shared: shared_folder(args.shared.as_deref()) };
    for paper in papers {
        let (name, reproduce): (&str, fn(&Job, &Results) -> Outcome) = match paper {
            PaperName::G10 => ("g10", g10::run),
            PaperName::T09 => ("t09", t09::run),
            PaperName::S06 => ("s06", s06::run),
        };
        let results = Results::new(args.output.join(name), args.force)?;
        reproduce(&job, &results)?;
        ui::result(format_args!("{}", results.folder().display()));
    }
    Ok(())
}

fn failed(what: &str, error: &dyn std::error::Error) -> Failure {
    Failure::Simulation(format!("{what}: {error}"))
}
