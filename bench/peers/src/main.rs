//! softrig beside rapier3d: one flesh box with a bone in it, the same mesh, material, scheme and tolerance, steps of both in turn
//! in one process on one thread.
//!
//! `cargo run --release --manifest-path bench/peers/Cargo.toml`

mod boxes;
mod own;
mod rapier;
mod scene;
mod two_way;

use boxes::FleshBox;
use clap::Parser;
use softrig::simulation::SolverKind;
use std::error::Error;
use std::time::Instant;

/// softrig beside rapier3d on the same box.
#[derive(Parser)]
struct Arguments {
    /// Steps of 1/60 s; the first is not timed.
    #[arg(long, default_value_t = 120)]
    steps: usize,
    /// Young's modulus [Pa].
    #[arg(long, default_value_t = 3e4)]
    young_modulus: f64,
    /// How many iterations rapier's conjugate gradients may take.
    #[arg(long, default_value_t = 300)]
    cap: usize,
    /// Bones that the flesh moves, instead of bones that stand still.
    #[arg(long)]
    two_way: bool,
    /// How often softrig linearises a step with --two-way; rapier3d does once.
    #[arg(long, default_value_t = 1)]
    linearisations: usize,
    /// softrig's linear solver; the default one with --two-way.
    #[arg(long, value_parser = solver, default_value = "multigrid")]
    solver: SolverKind,
    /// Cubes of five tetrahedra along x, y and z; can be given more than once.
    #[arg(long, value_parser = cubes, default_values = ["24x8x8", "42x12x12", "54x16x16"])]
    cubes: Vec<[usize; 3]>,
}

fn solver(text: &str) -> Result<SolverKind, String> {
    let all = [SolverKind::Multigrid, SolverKind::Pcg, SolverKind::Direct, SolverKind::Auto];
    all.into_iter().find(|k| k.name() == text).ok_or_else(|| format!("one of {}", all.map(SolverKind::name).join(", ")))
}

fn cubes(text: &str) -> Result<[usize; 3], String> {
    let counts: Option<Vec<usize>> =
        text.split('x').map(|n| n.parse().ok().filter(|n| (2..=400).contains(n))).collect();
    counts.and_then(|c| c.try_into().ok()).ok_or_else(|| "three numbers from 2 to 400, as in 42x12x12".into())
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments = Arguments::parse();
    // one thread in both engines, and all on that thread: loops that are handed to it from another wait for it each time.
    // rapier's own threads are a feature that is off
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
    pool.install(|| compare_all(&arguments).map_err(|e| e.to_string()))?;
    Ok(())
}

fn compare_all(arguments: &Arguments) -> Result<(), Box<dyn Error>> {
    if arguments.two_way {
        println!(
            "| tetrahedra | softrig [ms] | rapier3d [ms] | ratio | sag of softrig [mm] | of rapier3d [mm] | iterations of softrig | bound by softrig | attached in rapier3d |"
        );
        println!("|---|---|---|---|---|---|---|---|---|");
        return arguments.cubes.iter().try_for_each(|c| compare_two_way(*c, arguments));
    }
    println!(
        "| tetrahedra | softrig [ms] | rapier3d [ms] | ratio | sag of softrig [mm] | of rapier3d [mm] | iterations of softrig |"
    );
    println!("|---|---|---|---|---|---|---|");
    arguments.cubes.iter().try_for_each(|c| compare(*c, arguments))
}

/// Both engines on one box, a line of the table.
fn compare(cubes: [usize; 3], arguments: &Arguments) -> Result<(), Box<dyn Error>> {
    let flesh = FleshBox::new(cubes);
    let mut own = own::Own::new(&flesh, arguments.young_modulus, arguments.solver)?;
    let mut peer = rapier::Peer::new(&flesh, arguments.young_modulus, arguments.cap);
    let own_step = |own: &mut own::Own| own.step().map(|()| own.output.iterations);
    let (times, iterations) = alternate(arguments.steps, &mut own, own_step, &mut peer)?;
    println!(
        "| {} | {} | {:.2} | {:.2} | {:.1} |",
        flesh.tets.len(),
        both(times),
        1e3 * flesh.sag(|n| own.height(n)),
        1e3 * flesh.sag(|n| peer.height(n)),
        iterations,
    );
    Ok(())
}

/// The same with bones that move.
fn compare_two_way(cubes: [usize; 3], arguments: &Arguments) -> Result<(), Box<dyn Error>> {
    let flesh = FleshBox::new(cubes);
    let mut own = two_way::TwoWayBox::new(&flesh, arguments.young_modulus, arguments.linearisations)?;
    let mut peer = rapier::Peer::two_way(&flesh, arguments.young_modulus, arguments.cap);
    let own_step = |own: &mut two_way::TwoWayBox| own.step().map(|report| report.iterations);
    let (times, iterations) = alternate(arguments.steps, &mut own, own_step, &mut peer)?;
    println!(
        "| {} | {} | {:.2} | {:.2} | {:.1} | {} | {} |",
        flesh.tets.len(),
        both(times),
        1e3 * flesh.sag(|n| own.height(n)),
        1e3 * flesh.sag(|n| peer.height(n)),
        iterations,
        own.bound(),
        flesh.bone.len(),
    );
    Ok(())
}

/// Steps both engines in turn: median and minimum of their times [ms], and mean iterations of a step of softrig, which `step` returns.
/// The first step is not counted.
fn alternate<O>(
    steps: usize,
    own: &mut O,
    step: impl Fn(&mut O) -> Result<usize, Box<dyn Error>>,
    peer: &mut rapier::Peer,
) -> Result<([[f64; 2]; 2], f64), Box<dyn Error>> {
    let mut times = [Vec::new(), Vec::new()];
    let mut iterations = 0;
    for k in 0..steps.max(2) {
        let start = Instant::now();
        let taken = step(own)?;
        let between = Instant::now();
        peer.step();
        if k > 0 {
            times[0].push((between - start).as_secs_f64() * 1e3);
            times[1].push(between.elapsed().as_secs_f64() * 1e3);
            iterations += taken;
        }
    }
    let counted = times[0].len();
    Ok((times.map(statistics), iterations as f64 / counted as f64))
}

/// Median and minimum.
fn statistics(mut times: Vec<f64>) -> [f64; 2] {
    times.sort_by(f64::total_cmp);
    [times[times.len() / 2], times[0]]
}

/// Columns of both engines' times and their ratio.
fn both([[own, own_least], [peer, peer_least]]: [[f64; 2]; 2]) -> String {
    let (ratio, ratio_least) = (own / peer, own_least / peer_least);
    format!("{own:.1}, {own_least:.1} | {peer:.1}, {peer_least:.1} | {ratio:.3}, {ratio_least:.3}")
}
