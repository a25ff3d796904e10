//! Counts what advancing a simulation takes from the heap: nothing, once the first frames are done.
//!
//! A binary of its own, because a counting allocator serves a whole process.
#![allow(clippy::unwrap_used, reason = "helpers of tests fail as tests do")]

use softrig::body::Body;
use softrig::couple::{BindSettings, Binding};
use softrig::force::ElasticModel;
use softrig::integrate::{Scheme, State, StepInput, StepOutput, implicit};
use softrig::material::{Material, MaterialMap};
use softrig::mesh::{CellKind, LatticeOptions, Resolution, VolumeMesh, bar, renumbered, tetrahedralize, voxelize};
use softrig::rig::{JointSetup, RootKind, automatic};
use softrig::simulation::{ClipMotion, Coupling, Simulation, SimulationSettings, SolverKind, TwoWay, TwoWayScheme};
use softrig_linalg::{DofConstraints, Scalar};
use std::alloc::{GlobalAlloc, Layout, System};
use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};
use std::sync::{Mutex, PoisonError};

/// The system's allocator, counting what it is asked for.
struct Counting;

static COUNT: AtomicUsize = AtomicUsize::new(0);
static BYTES: AtomicUsize = AtomicUsize::new(0);
static LARGEST: AtomicUsize = AtomicUsize::new(0);
/// Bytes that are held now.
static HELD: AtomicUsize = AtomicUsize::new(0);
/// The tests count for the whole process.
static ONE_AT_A_TIME: Mutex<()> = Mutex::new(());
/// Most bytes of a body with its solver, in f64 and in f32: what it holds today and a little more, so that it does not grow unseen. Where they are is in
/// `docs/performance.md`.
const MOST_PER_NODE: [usize; 2] = [2500, 2450];

fn note(size: usize) {
    COUNT.fetch_add(1, Relaxed);
    BYTES.fetch_add(size, Relaxed);
    LARGEST.fetch_max(size, Relaxed);
}

// SAFETY: every call goes on to the system's allocator as it came; counting touches no memory but three atomics. There is no
// way to count allocations without this trait, whose methods are unsafe; it exists in this test only.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        note(layout.size());
        HELD.fetch_add(layout.size(), Relaxed);
        // SAFETY: the caller keeps the promises of this trait, which are those of the system's allocator
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        note(layout.size());
        HELD.fetch_add(layout.size(), Relaxed);
        // SAFETY: as above
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn realloc(&self, memory: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        note(size);
        HELD.fetch_add(size, Relaxed);
        HELD.fetch_sub(layout.size(), Relaxed);
        // SAFETY: as above
        unsafe { System.realloc(memory, layout, size) }
    }

    unsafe fn dealloc(&self, memory: *mut u8, layout: Layout) {
        HELD.fetch_sub(layout.size(), Relaxed);
        // SAFETY: as above
        unsafe { System.dealloc(memory, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Allocations while something ran.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Taken {
    count: usize,
    bytes: usize,
    largest: usize,
}

fn taken(work: impl FnOnce()) -> Taken {
    [&COUNT, &BYTES, &LARGEST].into_iter().for_each(|c| c.store(0, Relaxed));
    work();
    Taken { count: COUNT.load(Relaxed), bytes: BYTES.load(Relaxed), largest: LARGEST.load(Relaxed) }
}

struct Run {
    nodes: usize,
    steps: usize,
    advance: Taken,
    /// The frame that took least.
    least: Taken,
    frame: Taken,
}

/// Frames 5 to 10 of the walk, after the first ones have filled every buffer.
fn run(mesh: impl Fn(VolumeMesh) -> VolumeMesh, cells: usize, solver: SolverKind, two_way: bool) -> Run {
    let character = softrig::sample::character();
    let options = LatticeOptions { resolution: Resolution::Cells(cells), ..LatticeOptions::default() };
    let mesh = mesh(voxelize(&character.surface(true), &options).unwrap());
    let binding = Binding::new(&character, &mesh, &BindSettings::default()).unwrap();
    let materials = MaterialMap::uniform(Material::default());
    let settings = SimulationSettings { solver, ..SimulationSettings::default() };
    let nodes = mesh.node_count();
    let mut simulation = Simulation::<f64>::new(&character, mesh, binding, &materials, settings).unwrap();
    let motion = ClipMotion::new(&character.skeleton, &character.clips[0]);
    if two_way {
        let bones: Vec<_> = simulation.binding.bones.iter().map(|b| b.joint).collect();
        let mut joints = vec![JointSetup::default(); character.skeleton.joint_count()];
        for choice in automatic(&character.skeleton, &bones, &character.clips) {
            joints[choice.joint.index()] = JointSetup { drive: 0.7, ..choice.setup };
        }
        let two = TwoWay { scheme: TwoWayScheme::Monolithic, joints, root: RootKind::Driven };
        simulation.couple(&Coupling::TwoWay(two), vec![]).unwrap();
    }
    simulation.start(&motion).unwrap();
    let at = |f: usize| f as f64 / 30.0;
    for f in 1..5 {
        simulation.advance(&motion, at(f)).unwrap();
        simulation.frame(f);
    }
    let mut out = Run {
        nodes,
        steps: 0,
        advance: Taken::default(),
        least: Taken { count: usize::MAX, ..Taken::default() },
        frame: Taken::default(),
    };
    let add = |sum: &mut Taken, more: Taken| {
        *sum = Taken {
            count: sum.count + more.count,
            bytes: sum.bytes + more.bytes,
            largest: sum.largest.max(more.largest),
        };
    };
    for f in 5..10 {
        let mut report = None;
        let frame = taken(|| report = Some(simulation.advance(&motion, at(f)).unwrap()));
        if frame.count < out.least.count {
            out.least = frame;
        }
        add(&mut out.advance, frame);
        out.steps += report.unwrap().substeps;
        add(
            &mut out.frame,
            taken(|| {
                simulation.frame(f);
            }),
        );
    }
    out
}

/// Steps take nothing, frames a map for each joint; what grows with nodes or cells is kept from the first frames on. On one
/// thread, because a pool of several allocates for its own queues when it likes.
#[test]
fn no_step_after_the_first_frames_allocates() {
    let _alone = ONE_AT_A_TIME.lock().unwrap_or_else(PoisonError::into_inner);
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).stack_size(8 << 20).build().unwrap();
    pool.install(|| {
        let kinds: [(&str, fn(VolumeMesh) -> VolumeMesh, SolverKind, bool); 4] = [
            ("hex, multigrid", |m| m, SolverKind::Multigrid, false),
            ("hex, pcg", |m| m, SolverKind::Pcg, false),
            ("tet, multigrid", |m| tetrahedralize(&m), SolverKind::Multigrid, false),
            ("hex, two-way", |m| m, SolverKind::Multigrid, true),
        ];
        for (name, mesh, solver, two_way) in kinds {
            let (small, large) = (run(mesh, 1000, solver, two_way), run(mesh, 2000, solver, two_way));
            for r in [&small, &large] {
                println!(
                    "{name}, {} nodes, 5 frames of {} steps: advance {:?}, frame {:?}",
                    r.nodes, r.steps, r.advance, r.frame
                );
                // coupled steps make what preconditions them anew now and then
                let asked = if two_way { r.least } else { r.advance };
                assert_eq!(asked, Taken::default(), "{name}: {} nodes", r.nodes);
                // carrying the skin takes the map of every joint
                let joints = softrig::sample::character().skeleton.joint_count();
                assert!(r.frame.largest <= 300 * joints, "{name}: {:?} with {} nodes", r.frame, r.nodes);
            }
            assert!(large.nodes > small.nodes + 500 && large.steps == small.steps, "{name}");
            assert_eq!((small.least, small.frame), (large.least, large.frame), "{name}");
        }
    });
}

/// What a body of tetrahedra, its integrator, its solver and all levels hold once steps are made, with the default solver. What a caller hands
/// over (where the body is, where it is held, and its weight) is not theirs.
#[allow(clippy::print_stdout, reason = "a measurement")]
fn held_per_node<R: Scalar>() -> usize {
    let start = HELD.load(Relaxed);
    // in the order of nodes and cells that benches use
    let (mesh, _) = renumbered(&bar([44, 11, 23], [0.4, 0.1, 0.2], CellKind::Tet4));
    let (nodes, tets) = (mesh.node_count(), mesh.tets.len());
    assert!(tets >= 65_000, "{tets}");
    let held = DofConstraints::from_mask(mesh.nodes.iter().map(|x| x[0] == 0.0).collect());
    let rest: Vec<[R; 3]> = mesh.nodes.iter().map(|x| x.map(R::from_f64)).collect();
    let mut body =
        Body::<R>::new(mesh, &MaterialMap::uniform(Material::default()), ElasticModel::Corotated, held).unwrap();
    let of_body = HELD.load(Relaxed) - start - size_of_val(&rest[..]);
    let caller = HELD.load(Relaxed);
    let weight = body.weight([0.0, -9.81, 0.0]);
    let still = vec![[R::zero(); 3]; nodes];
    let mut state = State::at_rest(rest.clone());
    let caller = HELD.load(Relaxed) - caller;
    let mut solver = SolverKind::Multigrid.build::<R>(&body.mesh);
    let mut integrator = implicit::<R>(Scheme::ImplicitEuler, 1);
    let mut output = StepOutput::default();
    for _ in 0..3 {
        let input = StepInput {
            target_position: &rest,
            target_velocity: &still,
            external_force: &weight,
            dt: 1.0 / 60.0,
            tolerance: 1e-3,
            reactions: false,
        };
        integrator.step(&mut body, &mut *solver, &input, &mut state, &mut output).unwrap();
    }
    let held = HELD.load(Relaxed) - start - caller - size_of_val(&rest[..]);
    let (per_node, of_body) = (held / nodes, of_body / nodes);
    println!("{tets} tetrahedra, {nodes} nodes in {}: {per_node} bytes per node, {of_body} of the body", R::NAME);
    per_node
}

#[test]
fn a_body_and_its_solver_hold_a_bounded_number_of_bytes_per_node() {
    let _alone = ONE_AT_A_TIME.lock().unwrap_or_else(PoisonError::into_inner);
    for (held, most) in [held_per_node::<f64>(), held_per_node::<f32>()].into_iter().zip(MOST_PER_NODE) {
        assert!(held <= most, "{held} bytes per node");
    }
}
