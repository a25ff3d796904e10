//! Constraints of implicit finite-element bodies, by elimination: equal to a dense solve with multipliers, exact, and keeping momentum.

use crate::constraint::Random;
use faer::linalg::solvers::Solve;
use softrig::body::Body;
use softrig::constraint::{Elimination, Link, LinkError};
use softrig::force::{ElasticModel, Increment};
use softrig::integrate::{Implicit, Integrator, Linked, Scheme, State, StepError, StepInput, StepOutput};
use softrig::material::{Material, MaterialMap};
use softrig::mesh::VolumeMesh;
use softrig_explicit::constraint::{Constraint, ConstraintError, Constraints};
use softrig_explicit::objects::{self, Objects, Timed};
use softrig_explicit::sample::five_tets;
use softrig_explicit::stepper::StepperError;
use softrig_linalg::solver::{Direct, Pcg};
use softrig_linalg::{BlockCsr, DofConstraints};

/// Boxes of 2 x 1 x 1 cubes (12 nodes each) beside one another, damped, the first nodes prescribed.
fn boxes(count: usize, model: ElasticModel, prescribed: usize) -> Body<f64> {
    let mut mesh = VolumeMesh::default();
    for i in 0..count {
        let one = five_tets([2, 1, 1], false, |p| [0.2 * p[0] + 0.3 * i as f64, 0.1 * p[1], 0.1 * p[2]]);
        let base = mesh.node_count() as u32;
        mesh.nodes.extend(&one.nodes);
        mesh.tets.extend(one.tets.iter().map(|t| t.map(|n| n + base)));
    }
    let material = Material { young_modulus: 2e4, mass_damping: 0.3, stiffness_damping: 2e-3, ..Material::default() };
    let mask = (0..mesh.node_count()).map(|n| n < prescribed).collect();
    Body::new(mesh, &MaterialMap::uniform(material), model, DofConstraints::from_mask(mask)).unwrap()
}

fn nail(node: u32) -> Link {
    Link { terms: vec![(node, 1.0)], label: 0 }
}

fn on(node: u32, carriers: &[(u32, f64)]) -> Link {
    Link { terms: carriers.iter().copied().chain([(node, -1.0)]).collect(), label: 0 }
}

/// All kinds on three boxes; nodes are in several links, and the last one follows from others.
fn links() -> Vec<Link> {
    vec![
        nail(13),
        on(11, &[(12, 1.0)]),
        on(12, &[(24, 1.0)]),
        on(25, &[(8, 0.25), (9, 0.75)]),
        on(26, &[(4, 0.2), (14, 0.3), (15, 0.5)]),
        on(27, &[(16, 0.1), (17, 0.2), (18, 0.3), (19, 0.4)]),
        // a node of a prescribed one, and a chain through a dependent node
        on(28, &[(0, 0.5), (27, 0.5)]),
        on(11, &[(24, 1.0)]),
    ]
}

fn dense(m: &BlockCsr<f64>) -> faer::Mat<f64> {
    let n = m.pattern.row_count();
    let mut out = faer::Mat::zeros(3 * n, 3 * n);
    for i in 0..n {
        for k in m.pattern.row(i) {
            let j = m.pattern.column()[k] as usize;
            (0..9).for_each(|c| out[(3 * i + c / 3, 3 * j + c % 3)] = m.values[k][c]);
        }
    }
    out
}

fn largest(v: impl IntoIterator<Item = f64>) -> f64 {
    v.into_iter().fold(0.0, |m, v| m.max(v.abs()))
}

/// One step of every scheme equals the solution of (A Cᵀ; C 0) (d; -λ) = (b; g - C x), with A and b put together from the body's forces and
/// stiffness here, for bodies with and without prescribed nodes that are moved, deformed and in motion: displacements and forces to 1e-9.
#[test]
fn eliminated_steps_are_those_of_a_dense_solve_with_multipliers() {
    let mut random = Random::new(3);
    for round in 0..12 {
        let prescribed = if round % 2 == 0 { 2 } else { 0 };
        let mut body = boxes(3, ElasticModel::Corotated, prescribed);
        let n = body.mass.len();
        let scheme = if round % 3 == 0 { Scheme::ImplicitEuler } else { Scheme::Newmark { beta: 0.3025, gamma: 0.6 } };
        let h = 1.0 / 60.0;
        let C = links();
        let (mut links, mut solver) = (Linked::new(Implicit::new(scheme, 1)), Direct::new());
        links.set_links(C.clone());
        let small = |random: &mut Random, by: f64| random.point().map(|p| by * p);
        let mut state = State::at_rest(body.mesh.nodes.clone());
        let external = body.weight([0.0, -9.81, 0.0]);
        let zero = vec![[0.0; 3]; n];
        // three steps: the first one brings the nodes together, the others begin with velocities and accelerations that fit
        for step in 0..3 {
            for i in prescribed..n {
                if step == 0 {
                    let by = small(&mut random, 2e-3);
                    (0..3).for_each(|k| state.position[i][k] += by[k]);
                }
            }
            // near the gaps of the rest shape, and the last one as it has to follow
            let gap =
                |l: &Link, k: usize| l.terms.iter().map(|(i, w)| w * body.mesh.nodes[*i as usize][k]).sum::<f64>();
            let mut goal: Vec<[f64; 3]> = Vec::new();
            for link in &C {
                let by = small(&mut random, 1e-3);
                goal.push(std::array::from_fn(|k| gap(link, k) + by[k]));
            }
            goal[7] = std::array::from_fn(|k| goal[1][k] + goal[2][k]);
            let mut target = body.mesh.nodes.clone();
            (0..prescribed).for_each(|i| target[i][1] += 1e-3 * (step + 1) as f64);
            links.set_goals(&goal, &vec![[0.0; 3]; C.len()]);
            let input = StepInput {
                target_position: &target,
                target_velocity: &zero,
                external_force: &external,
                dt: h,
                tolerance: 1e-13,
                reactions: false,
            };
            if step == 0 {
                // so that the step begins with what the links leave of velocity and acceleration
                let mut first = state.clone();
                let mut output = StepOutput::default();
                links.step(&mut body, &mut solver, &input, &mut first, &mut output).unwrap();
                state = first;
                continue;
            }
            // A d - b = Cᵀ λ, from the body's parts
            let (x, v, a) = (&state.position, &state.velocity, &state.acceleration);
            let (beta, gamma) = match scheme {
                Scheme::Newmark { beta, gamma } => (beta, gamma),
                Scheme::ImplicitEuler => (1.0, 1.0),
            };
            let euler = scheme == Scheme::ImplicitEuler;
            let (vd, vv, va) = (gamma / (beta * h), 1.0 - gamma / beta, h * (1.0 - gamma / (2.0 * beta)));
            let (ad, av, aa) = (1.0 / (beta * h * h), -1.0 / (beta * h), 1.0 - 1.0 / (2.0 * beta));
            let (vv, va, aa) = if euler { (0.0, 0.0, 0.0) } else { (vv, va, aa) };
            let history = body.model.history();
            body.model.linearise(x);
            let mut force = vec![[0.0; 3]; n];
            body.model.force(x, Increment::none(), &mut force);
            let mut matrix = BlockCsr::zero(body.pattern.clone());
            body.model.stiffness(0.0, 0.0, &mut matrix);
            body.model.restore(&history);
            let K = dense(&matrix);
            let rows = 3 * C.len() - 3;
            let size = 3 * n + rows;
            let mut kkt = faer::Mat::zeros(size, size);
            let mut rhs = faer::Mat::zeros(size, 1);
            let held = |i: usize| i < prescribed;
            for i in 0..3 * n {
                if held(i / 3) {
                    kkt[(i, i)] = 1.0;
                    rhs[(i, 0)] = target[i / 3][i % 3] - x[i / 3][i % 3];
                    continue;
                }
                let (node, k) = (i / 3, i % 3);
                let (m, drag) = (body.mass[node], body.drag[node]);
                rhs[(i, 0)] = external[node][k] - force[node][k];
                rhs[(i, 0)] -= (m * av + drag * vv) * v[node][k] + (m * aa + drag * va) * a[node][k];
                for j in 0..3 * n {
                    kkt[(i, j)] = K[(i, j)] * (1.0 + 2e-3 * vd);
                    // prescribed nodes have the velocity they are given: none here
                    let rate = if held(j / 3) { 0.0 } else { vv * v[j / 3][j % 3] + va * a[j / 3][j % 3] };
                    if held(j / 3) {
                        kkt[(i, j)] = K[(i, j)];
                    }
                    rhs[(i, 0)] -= 2e-3 * K[(i, j)] * rate;
                }
                kkt[(i, i)] += ad * m + vd * drag;
            }
            // without the link that follows from others
            for (r, link) in C[..C.len() - 1].iter().enumerate() {
                for k in 0..3 {
                    let row = 3 * n + 3 * r + k;
                    rhs[(row, 0)] = goal[r][k];
                    for &(node, w) in &link.terms {
                        let i = 3 * node as usize + k;
                        kkt[(row, i)] = w;
                        if !held(node as usize) {
                            kkt[(i, row)] = -w;
                        }
                        rhs[(row, 0)] -= w * x[node as usize][k];
                    }
                }
            }
            let solution = kkt.full_piv_lu().solve(&rhs);
            let before = state.clone();
            let mut output = StepOutput::default();
            links.step(&mut body, &mut solver, &input, &mut state, &mut output).unwrap();
            assert!(!output.guarded);
            let d = |i: usize| state.position[i / 3][i % 3] - before.position[i / 3][i % 3];
            let moved = largest((0..3 * n).map(d));
            assert!(moved > 1e-3, "{moved}");
            let off = largest((0..3 * n).map(|i| d(i) - solution[(i, 0)]));
            assert!(off < 1e-9 * moved, "round {round} step {step}: {off:e} of {moved:e}");
            // Cᵀ λ on every node that is not prescribed
            let mut reference = vec![0.0; 3 * n];
            for (r, link) in C[..C.len() - 1].iter().enumerate() {
                for &(node, w) in link.terms.iter().filter(|t| !held(t.0 as usize)) {
                    (0..3).for_each(|k| reference[3 * node as usize + k] += w * solution[(3 * n + 3 * r + k, 0)]);
                }
            }
            let strength = largest(reference.iter().copied());
            assert!(strength > 0.1, "{strength}");
            let off = largest((0..3 * n).map(|i| links.force()[i / 3][i % 3] - reference[i]));
            assert!(off < 1e-9 * strength, "round {round} step {step}: {off:e} N of {strength:e} N");
        }
    }
}

/// Two boxes that fly, turn and wobble, held together by two-way links of every kind: over 10,000 steps each step is within rounding of the
/// links, and the total momentum stays where it was to rounding. In f32 as many digits as that has.
#[test]
fn links_are_exact_and_keep_momentum() {
    let mut body = boxes(2, ElasticModel::Corotated, 0);
    body.drag.fill(0.0);
    let n = body.mass.len();
    let C = vec![
        on(8, &[(12, 1.0)]),
        on(13, &[(9, 0.4), (10, 0.6)]),
        on(11, &[(14, 0.3), (15, 0.2), (16, 0.5)]),
        on(7, &[(17, 0.1), (18, 0.2), (19, 0.3), (12, 0.4)]),
    ];
    let mut links = Linked::new(Implicit::new(Scheme::Newmark { beta: 0.3025, gamma: 0.6 }, 1));
    links.set_links(C.clone());
    let mut random = Random::new(9);
    let velocity = (0..n).map(|_| random.point().map(|p| 0.2 * p)).collect();
    let mut state = State { velocity, ..State::at_rest(body.mesh.nodes.clone()) };
    let zero = vec![[0.0; 3]; n];
    let momentum = |s: &State<f64>| -> [f64; 3] {
        std::array::from_fn(|k| s.velocity.iter().zip(&body.mass).map(|(v, m)| m * v[k]).sum())
    };
    let (start, mass) = (momentum(&state), body.total_mass());
    let masses = body.mass.clone();
    let mut solver = Direct::new();
    let mut widest = 0.0f64;
    for step in 0..10_000 {
        let input = StepInput {
            target_position: &zero,
            target_velocity: &zero,
            external_force: &zero,
            dt: 1.0 / 120.0,
            tolerance: 1e-12,
            reactions: false,
        };
        let mut output = StepOutput::default();
        links.step(&mut body, &mut solver, &input, &mut state, &mut output).unwrap();
        let scale = largest(state.position.iter().flatten().copied());
        for link in &C {
            for k in 0..3 {
                let gap: f64 = link.terms.iter().map(|(i, w)| w * state.position[*i as usize][k]).sum();
                assert!(gap.abs() < 4.0 * f64::EPSILON * scale, "step {step}: {gap:e}");
                let rate: f64 = link.terms.iter().map(|(i, w)| w * state.velocity[*i as usize][k]).sum();
                assert!(rate.abs() < 1e-13, "step {step}: {rate:e}");
            }
        }
        let now: [f64; 3] = std::array::from_fn(|k| state.velocity.iter().zip(&masses).map(|(v, m)| m * v[k]).sum());
        let drift = largest((0..3).map(|k| now[k] - start[k]));
        assert!(drift < 1e-11 * mass * 0.2, "step {step}: {drift:e}");
        let force: [f64; 3] = std::array::from_fn(|k| links.force().iter().map(|f| f[k]).sum());
        let strength = largest(links.force().iter().flatten().copied());
        assert!(largest(force) < 1e-10 * strength.max(1e-6), "step {step}: {force:?} of {strength}");
        widest = widest.max(strength);
    }
    assert!(widest > 0.01, "the links held something: {widest} N");
}

/// Newmark stays of second order under links, implicit Euler of first: errors of a nailed and joined body against steps 16 times as short.
#[test]
fn linked_schemes_keep_their_order() {
    let run = |scheme: Scheme, steps: usize| -> Vec<[f64; 3]> {
        let mut body = boxes(2, ElasticModel::Linear, 0);
        let (mut links, mut solver) = (Linked::new(Implicit::new(scheme, 1)), Direct::new());
        let C = vec![nail(0), nail(1), nail(2), on(8, &[(12, 1.0)]), on(13, &[(9, 0.5), (10, 0.5)])];
        let rest = &body.mesh.nodes;
        let gap = |l: &Link| -> [f64; 3] {
            std::array::from_fn(|k| l.terms.iter().map(|(i, w)| w * rest[*i as usize][k]).sum())
        };
        // gaps stay as they are at rest: nothing is pulled in
        let goal: Vec<[f64; 3]> = C.iter().map(gap).collect();
        links.set_links(C.clone());
        links.set_goals(&goal, &vec![[0.0; 3]; C.len()]);
        let mut state = State::at_rest(rest.clone());
        let external = body.weight([0.0, -9.81, 0.0]);
        let zero = vec![[0.0; 3]; rest.len()];
        for _ in 0..steps {
            let input = StepInput {
                target_position: &zero,
                target_velocity: &zero,
                external_force: &external,
                dt: 0.05 / steps as f64,
                tolerance: 1e-13,
                reactions: false,
            };
            let mut output = StepOutput::default();
            links.step(&mut body, &mut solver, &input, &mut state, &mut output).unwrap();
            assert!(!output.guarded);
        }
        state.position
    };
    for (scheme, order) in [(Scheme::Newmark { beta: 0.25, gamma: 0.5 }, 2.0), (Scheme::ImplicitEuler, 1.0)] {
        let fine = run(scheme, 1024);
        let error = |steps: usize| {
            let x = run(scheme, steps);
            largest(x.iter().zip(&fine).flat_map(|(a, b)| (0..3).map(|k| a[k] - b[k]).collect::<Vec<_>>()))
        };
        let (coarse, half) = (error(32), error(64));
        let found = (coarse / half).log2();
        assert!((found - order).abs() < 0.2, "{scheme:?}: order {found} from {coarse:e} and {half:e}");
    }
}

/// 20,000 random sets of links on eight nodes: what is eliminated is met to rounding, and what is refused has no solution, by dense Gaussian
/// elimination with full pivoting.
#[test]
fn random_links_are_met_or_refused_as_dense_elimination_says() {
    let mut random = Random::new(5);
    let (mut met, mut refused) = (0, 0);
    for round in 0..20_000 {
        let count = 1 + random.below(8);
        let prescribed: Vec<bool> = (0..8).map(|i| i < 2 && round % 2 == 0).collect();
        let mut x: Vec<[f64; 3]> = (0..8).map(|_| random.point()).collect();
        let mut C = Vec::new();
        let mut goal = Vec::new();
        for label in 0..count as u32 {
            let size = 1 + random.below(4);
            let mut nodes: Vec<u32> = (0..8).collect();
            (0..size).for_each(|i| nodes.swap(i, i + random.below(8 - i)));
            // few different weights, so that rows depend on one another
            let terms = nodes[..size].iter().map(|n| (*n, [1.0, -1.0, 0.5, -0.5][random.below(4)])).collect();
            C.push(Link { terms, label });
            goal.push([0.0, if random.below(4) == 0 { 1.0 } else { 0.0 }, 0.0]);
        }
        // prescribed nodes are at zero now and then, so that links on them can hold
        if random.below(2) == 0 {
            (0..2).for_each(|i| x[i] = [0.0; 3]);
        }
        let elimination = Elimination::new(&C, &prescribed).unwrap();
        let has_solution = (0..3).all(|k| {
            let rows = C.iter().zip(&goal).map(|(l, g)| {
                let mut row = vec![0.0; 9];
                row[8] = g[k];
                for &(i, w) in &l.terms {
                    if prescribed[i as usize] { row[8] -= w * x[i as usize][k] } else { row[i as usize] += w }
                }
                row
            });
            solvable(rows.collect())
        });
        match elimination.offsets(&goal, &x) {
            Ok(offset) => {
                assert!(has_solution, "round {round}: {C:?} {goal:?}");
                elimination.place(&offset, &mut x);
                for (l, g) in C.iter().zip(&goal) {
                    for k in 0..3 {
                        let sum: f64 = l.terms.iter().map(|(i, w)| w * x[*i as usize][k]).sum();
                        let size = largest(x.iter().flatten().copied()).max(1.0);
                        assert!((sum - g[k]).abs() < 1e-12 * size, "round {round}: {sum} {g:?}");
                    }
                }
                met += 1;
            }
            Err(LinkError::Conflict { labels, by }) => {
                assert!(!has_solution && by > 0.0, "round {round}: {C:?} {goal:?} {labels:?}");
                // those that are named have none even by themselves
                let named: Vec<Link> = C.iter().filter(|l| labels.contains(&l.label)).cloned().collect();
                let goals: Vec<[f64; 3]> = labels.iter().map(|l| goal[*l as usize]).collect();
                let alone = Elimination::new(&named, &prescribed).unwrap().offsets(&goals, &x);
                assert!(matches!(alone, Err(LinkError::Conflict { .. })), "round {round}: {labels:?}");
                refused += 1;
            }
            Err(e) => panic!("{e}"),
        }
    }
    assert!(met > 2_000 && refused > 2_000, "{met} {refused}");
}

/// Whether rows (a, b) with a x = b have a solution.
fn solvable(mut rows: Vec<Vec<f64>>) -> bool {
    let mut done = 0;
    loop {
        let best = (done..rows.len())
            .flat_map(|r| (0..8).map(move |c| (r, c)))
            .max_by(|a, b| rows[a.0][a.1].abs().total_cmp(&rows[b.0][b.1].abs()));
        let Some((r, c)) = best.filter(|(r, c)| rows[*r][*c].abs() > 1e-9) else { break };
        rows.swap(done, r);
        for r in done + 1..rows.len() {
            let f = rows[r][c] / rows[done][c];
            (0..9).for_each(|k| rows[r][k] -= f * rows[done][k]);
        }
        done += 1;
    }
    rows[done..].iter().all(|r| r[8].abs() < 1e-9)
}

/// Objects whose implicit steps eliminate: nails that move, joints that approach, a node in several constraints; a contradiction is named when
/// it comes on, and nothing has changed then. A ramp of the force is refused. A point still slides on a surface.
#[test]
fn objects_eliminate_their_constraints() {
    let made = || {
        let body = boxes(2, ElasticModel::Corotated, 0);
        let external = body.weight([0.0, -9.81, 0.0]);
        let method = Linked::new(softrig::integrate::Dynamics::Lively.method());
        let implicit = objects::Implicit { body, external, method, solver: Box::new(Pcg::new()), tolerance: 1e-8 };
        Objects::implicit(implicit, 1.0 / 60.0)
    };
    let timed = |constraint: Constraint, start: f64, ramp: f64| Timed {
        constraint,
        start,
        end: f64::INFINITY,
        ramp,
        path: Vec::new(),
    };
    let mut things = made();
    let rest = things.state.position.clone();
    let at = |n: u32| rest[n as usize];
    for n in 0..4 {
        things.add(timed(Constraint::Nail { node: n, goal: at(n) }, 0.0, 0.0)).unwrap();
    }
    // nodes of the second box on the first one, which is a place away; node 8 is in three of them
    things.add(timed(Constraint::PointsToPoint { nodes: vec![8, 12] }, 0.1, 0.2)).unwrap();
    things.add(timed(Constraint::PointsToPoint { nodes: vec![8, 9, 13] }, 0.1, 0.2)).unwrap();
    things.add(timed(Constraint::PointToLine { node: 10, carriers: [8, 14], weights: [0.5, 0.5] }, 0.1, 0.2)).unwrap();
    things.advance(0.6).unwrap();
    let x = &things.state.position;
    let gap = |w: &[(usize, f64)]| largest((0..3).map(|k| w.iter().map(|(i, w)| w * x[*i][k]).sum()));
    assert!(largest((0..4).flat_map(|n| (0..3).map(move |k| (n, k))).map(|(n, k)| x[n][k] - rest[n][k])) < 1e-15);
    for w in [
        vec![(8, 1.0), (12, -1.0)],
        vec![(8, 1.0), (9, -1.0)],
        vec![(8, 1.0), (13, -1.0)],
        vec![(10, -1.0), (8, 0.5), (14, 0.5)],
    ] {
        assert!(gap(&w) < 1e-15, "{w:?}: {:e}", gap(&w));
    }
    // a snapshot goes on with the same bits
    let mut other = made();
    for n in 0..4 {
        other.add(timed(Constraint::Nail { node: n, goal: at(n) }, 0.0, 0.0)).unwrap();
    }
    other.add(timed(Constraint::PointsToPoint { nodes: vec![8, 12] }, 0.1, 0.2)).unwrap();
    other.add(timed(Constraint::PointsToPoint { nodes: vec![8, 9, 13] }, 0.1, 0.2)).unwrap();
    other.add(timed(Constraint::PointToLine { node: 10, carriers: [8, 14], weights: [0.5, 0.5] }, 0.1, 0.2)).unwrap();
    other.advance(0.2).unwrap();
    let snapshot = other.snapshot();
    let mut resumed = things;
    assert!(resumed.restore(&snapshot));
    resumed.advance(0.6).unwrap();
    other.advance(0.6).unwrap();
    assert!(resumed.state == other.state);
    // nails 0 and 4 hold the same node at two places from 0.7 s on
    let mut goal = at(0);
    goal[1] += 0.01;
    other.add(timed(Constraint::PointsToPoint { nodes: vec![0, 7] }, 0.7, 0.0)).unwrap();
    other.add(timed(Constraint::Nail { node: 7, goal }, 0.7, 0.0)).unwrap();
    other.advance(0.65).unwrap();
    let before = other.state.clone();
    let error = other.advance(0.8).unwrap_err();
    let text = error.to_string();
    assert!(matches!(error, StepperError::Constraint(ConstraintError::Contradiction { .. })), "{text}");
    assert!(text.starts_with("nail 0, points-to-point 7 and nail 8 contradict one another by 1.000e-2 m"), "{text}");
    assert!(other.state.time >= before.time && other.state.time < 0.72, "{}", other.state.time);
    // part of a force is none
    let mut set = Constraints::eliminated(24);
    let id = set.add(Constraint::PointsToPoint { nodes: vec![0, 12] }).unwrap();
    set.ramp(id, 5).unwrap();
    let refused = set.link_goals(1e-2, &[1.0; 24], &rest).unwrap_err();
    assert!(matches!(refused, ConstraintError::ForceRamp { .. }), "{refused}");
    // sliding: a local force after the step
    let mut things = made();
    // held at its far end, so that the faces that are slid on are free
    for n in 20..24 {
        things.add(timed(Constraint::Nail { node: n, goal: at(n) }, 0.0, 0.0)).unwrap();
    }
    let faces = softrig::mesh::boundary_faces(&boxes(2, ElasticModel::Linear, 0).mesh).triangles;
    let surface = things.add_surface(faces.into_iter().filter(|t| t[0] >= 12).collect()).unwrap();
    things.add(timed(Constraint::PointToSurface { node: 8, surface }, 0.0, 0.1)).unwrap();
    for frame in 1..6 {
        things.advance(0.05 * f64::from(frame)).unwrap();
    }
    let at = |n: u32| things.state.position[n as usize];
    let mut surface = things.constraints().surface(surface).unwrap().clone();
    surface.fit(&at);
    let off = surface.closest(at(8), &at).unwrap().distance;
    assert!(off < 1e-12, "{off:e}");
}

/// Nonsense is refused by name, and the state stays.
#[test]
fn links_that_are_none_are_refused() {
    let mut body = boxes(2, ElasticModel::Corotated, 0);
    let n = body.mass.len();
    let zero = vec![[0.0; 3]; n];
    let mut state = State::at_rest(body.mesh.nodes.clone());
    let before = state.clone();
    let bad = [
        (nail(99), "does not exist"),
        (on(1, &[(1, 1.0)]), "a node twice"),
        (Link { terms: vec![(1, f64::NAN)], label: 4 }, "link 4: a weight that is not finite"),
        (Link { terms: vec![], label: 6 }, "links [6] contradict one another by 1.000e0 m"),
    ];
    for (link, text) in bad {
        let mut links = Linked::new(Implicit::new(Scheme::ImplicitEuler, 1));
        links.set_links(vec![link]);
        links.set_goals(&[[0.0, 1.0, 0.0]], &[[0.0; 3]]);
        let input = StepInput {
            target_position: &zero,
            target_velocity: &zero,
            external_force: &zero,
            dt: 0.01,
            tolerance: 1e-6,
            reactions: false,
        };
        let error = links.step(&mut body, &mut Pcg::new(), &input, &mut state, &mut StepOutput::default()).unwrap_err();
        assert!(matches!(error, StepError::Link { .. }) && error.to_string().contains(text), "{error}");
        assert!(state == before);
    }
}
