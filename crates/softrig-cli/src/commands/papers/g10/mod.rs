//! Georgii, Lagler, Dick, Westermann 2010: Table 1, Figures 1, 2, 5 and 6. `docs/methods/g10.md` maps the equations to our files.

mod bodies;
mod figure1;
mod figure2;
mod figure5;
mod figure6;
mod table1;

use super::{Curve, Job, Plot, Results, failed};
use crate::failure::Outcome;

/// All of it.
pub fn run(job: &Job, results: &Results) -> Outcome {
    table1::run(job, results)?;
    figure1::run(job, results)?;
    figure2::run(job, results)?;
    figure5::run(job, results)?;
    figure6::run(job, results)
}
