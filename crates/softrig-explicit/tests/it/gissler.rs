//! The formulas of [Gissler2006] against exact rational arithmetic (`gissler.json`).

use serde_json::Value;
use softrig::integrate::State;
use softrig_explicit::constraint::{
    Constraint, ConstraintError, Constraints, carried_force, nail_force, points_to_point_forces, velocity_force,
};
use softrig_explicit::scheme::{Scheme, SecondState};
use softrig_linalg::{Mat3, Vec3};

fn golden() -> Vec<Value> {
    let text = include_str!("../golden/gissler.json");
    let all: Value = serde_json::from_str(text).unwrap();
    all["cases"].as_array().unwrap().clone()
}

fn scheme(case: &Value) -> Scheme {
    match case["integrator"].as_str().unwrap() {
        "verlet" => Scheme::Verlet,
        "midpoint" => Scheme::Midpoint,
        "rk2" => Scheme::RungeKutta2,
        "euler_cromer" => Scheme::EulerCromer,
        "implicit_euler" => Scheme::ImplicitEuler,
        "explicit_euler" => Scheme::ExplicitEuler,
        other => panic!("{other}"),
    }
}

fn v3(v: &Value) -> [f64; 3] {
    std::array::from_fn(|k| v[k].as_f64().unwrap())
}

fn list(v: &Value) -> Vec<f64> {
    v.as_array().unwrap().iter().map(|x| x.as_f64().unwrap()).collect()
}

fn nodes(v: &Value) -> Vec<u32> {
    v.as_array().unwrap().iter().map(|x| x.as_u64().unwrap() as u32).collect()
}

#[track_caller]
fn close(found: [f64; 3], golden: [f64; 3]) {
    let scale = golden.iter().fold(1e-3f64, |m, x| m.max(x.abs()));
    for k in 0..3 {
        assert!((found[k] - golden[k]).abs() <= 1e-12 * scale, "{found:?} {golden:?}");
    }
}

/// A, B, c, d of all six schemes give the golden predictions.
#[test]
fn forms_predict_what_exact_arithmetic_does() {
    let mut seen = 0;
    for case in &golden() {
        let (scheme, h) = (scheme(case), case["h"].as_f64().unwrap());
        for p in case["points"].as_array().unwrap() {
            let J = Mat3(std::array::from_fn(|r| v3(&p["J"][r])));
            let m = p["m"].as_f64().unwrap();
            let form = scheme.form(m, h, J);
            let second = if form.second == SecondState::Velocity { &p["v"] } else { &p["x_prev"] };
            let (x, s, F) = (Vec3(v3(&p["x"])), Vec3(v3(second)), Vec3(v3(&p["F"])));
            if p.get("x_next").is_some() {
                close((form.A[0] * x + form.A[1] * s + F.scale(form.c)).0, v3(&p["x_next"]));
                close((form.B[0] * x + form.B[1] * s + F.scale(form.d)).0, v3(&p["v_next"]));
            }
            if let Some(c) = p.get("c") {
                close([form.c, form.d, 0.0], [c.as_f64().unwrap(), p["d"].as_f64().unwrap(), 0.0]);
                assert!((scheme.gain(1.0 / m, h).position - form.c).abs() <= 1e-15);
            }
            seen += 1;
        }
    }
    assert!(seen >= 26, "{seen} points");
}

/// The printed formulas, one by one.
#[test]
fn constraint_forces_are_the_golden_ones() {
    let mut seen = 0;
    for case in golden().iter().filter(|c| c.get("nail").is_some()) {
        let points = case["points"].as_array().unwrap();
        let x = |i: u32| v3(&points[i as usize]["x_next"]);
        let c = |i: u32| points[i as usize]["c"].as_f64().unwrap();
        let nail = &case["nail"];
        let p = nail["point"].as_u64().unwrap() as u32;
        close(nail_force(v3(&nail["goal"]), x(p), c(p)), v3(&nail["force"]));
        let joined = &case["points_to_point"];
        let ids = nodes(&joined["points"]);
        let predicted: Vec<_> = ids.iter().map(|i| x(*i)).collect();
        let gains: Vec<_> = ids.iter().map(|i| c(*i)).collect();
        let mut force = vec![[0.0; 3]; ids.len()];
        close(points_to_point_forces(&predicted, &gains, &mut force), v3(&joined["goal"]));
        for (i, f) in force.iter().enumerate() {
            close(*f, v3(&joined["forces"][i]));
        }
        for kind in ["line", "triangle", "tet"] {
            let g = &case[kind];
            let point = g["point"].as_u64().unwrap() as u32;
            let (carriers, weights) = (nodes(&g["carriers"]), list(&g["alpha"]));
            let at: Vec<_> = carriers.iter().map(|i| x(*i)).collect();
            let gains: Vec<_> = carriers.iter().map(|i| c(*i)).collect();
            let f = carried_force(x(point), c(point), &at, &gains, &weights);
            close(f, v3(&g["force0"]));
            for (i, a) in weights.iter().enumerate() {
                close(f.map(|f| -a * f), v3(&g["carrier_forces"][i]));
            }
            close(std::array::from_fn(|k| x(point)[k] + c(point) * f[k]), v3(&g["result"]));
            seen += 1;
        }
    }
    assert_eq!(seen, 15);
}

/// The set that bodies use gives the same forces and meets the same places.
#[test]
fn the_set_applies_the_golden_forces() {
    for case in golden().iter().filter(|c| c.get("nail").is_some()) {
        let (scheme, h) = (scheme(case), case["h"].as_f64().unwrap());
        let points = case["points"].as_array().unwrap();
        let inverse: Vec<f64> = points.iter().map(|p| 1.0 / p["m"].as_f64().unwrap()).collect();
        let mut predicted = State::at_rest(points.iter().map(|p| v3(&p["x_next"])).collect());
        predicted.velocity = points.iter().map(|p| v3(&p["v_next"])).collect();
        for kind in ["nail", "points_to_point", "line", "triangle", "tet"] {
            let g = &case[kind];
            let node = g.get("point").map_or(0, |p| p.as_u64().unwrap() as u32);
            let mut set = Constraints::new(points.len());
            let carried = || (nodes(&g["carriers"]), list(&g["alpha"]));
            set.add(match kind {
                "nail" => Constraint::Nail { node, goal: v3(&g["goal"]) },
                "points_to_point" => Constraint::PointsToPoint { nodes: nodes(&g["points"]) },
                "line" => Constraint::PointToLine {
                    node,
                    carriers: carried().0.try_into().unwrap(),
                    weights: carried().1.try_into().unwrap(),
                },
                "triangle" => Constraint::PointToTriangle {
                    node,
                    carriers: carried().0.try_into().unwrap(),
                    weights: carried().1.try_into().unwrap(),
                },
                _ => Constraint::PointToTetrahedron {
                    node,
                    carriers: carried().0.try_into().unwrap(),
                    weights: carried().1.try_into().unwrap(),
                },
            })
            .unwrap();
            let mut next = predicted.clone();
            set.enforce(scheme, h, &inverse, &mut next).unwrap();
            let force = |n: u32| set.force()[n as usize];
            match kind {
                "nail" => {
                    close(force(node), v3(&g["force"]));
                    assert_eq!(next.position[node as usize], v3(&g["goal"]));
                }
                "points_to_point" => {
                    for (i, n) in nodes(&g["points"]).into_iter().enumerate() {
                        close(force(n), v3(&g["forces"][i]));
                        close(next.position[n as usize], v3(&g["goal"]));
                    }
                }
                _ => {
                    close(force(node), v3(&g["force0"]));
                    close(next.position[node as usize], v3(&g["result"]));
                    for (i, n) in carried().0.into_iter().enumerate() {
                        close(force(n), v3(&g["carrier_forces"][i]));
                    }
                }
            }
        }
    }
}

/// With explicit Euler a force moves a node one step later: velocities can be constrained, positions are refused.
#[test]
fn explicit_euler_constrains_velocities_only() {
    let cases = golden();
    let case = cases.iter().find(|c| c["integrator"] == "explicit_euler").unwrap();
    let g = &case["point_velocity"];
    let p = &case["points"][g["point"].as_u64().unwrap() as usize];
    let (m, h) = (p["m"].as_f64().unwrap(), case["h"].as_f64().unwrap());
    let form = Scheme::ExplicitEuler.form(m, h, Mat3::zero());
    let free = (Vec3(v3(&p["v"])) + Vec3(v3(&p["F"])).scale(form.d)).0;
    let goal = v3(&g["goal_velocity"]);
    close(velocity_force(goal, free, form.d), v3(&g["force"]));
    let mut state = State { velocity: vec![free], ..State::at_rest(vec![v3(&p["x"])]) };
    let mut set = Constraints::new(1);
    set.add(Constraint::Velocity { node: 0, goal }).unwrap();
    set.enforce(Scheme::ExplicitEuler, h, &[1.0 / m], &mut state).unwrap();
    assert_eq!(state.velocity[0], goal);
    close(set.force()[0], v3(&g["force"]));
    let mut set = Constraints::new(1);
    set.add(Constraint::Nail { node: 0, goal }).unwrap();
    let refused = set.enforce(Scheme::ExplicitEuler, h, &[1.0 / m], &mut state);
    assert!(matches!(refused, Err(ConstraintError::Unsupported { .. })), "{refused:?}");
}
