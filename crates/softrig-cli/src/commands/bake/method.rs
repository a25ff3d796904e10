//! The method a scene chooses, put into the simulation.

use crate::args::{BakeArgs, MethodName};
use crate::failure::{Failure, Outcome};
use crate::scene::Scene;
use softrig::material::MaterialMap;
use softrig::simulation::{Simulation, SimulationSettings, SolverKind};
use softrig_explicit::method::{Method, Stepping};
use softrig_linalg::Scalar;

/// Lets the scene's method compute the flesh.
///
/// # Errors
/// [`Failure::Input`] when it cannot take this body.
pub fn choose<R: Scalar>(scene: &Scene, materials: &MaterialMap, simulation: &mut Simulation<R>) -> Outcome {
    let s = &scene.simulation;
    let method = match s.method {
        MethodName::Implicit => return Ok(()),
        MethodName::Elements => Method::Elements,
        MethodName::Clustered => Method::Clustered,
        MethodName::Modal => Method::Modal(s.modes),
        MethodName::MassPoints => Method::MassPoints,
    };
    if method == Method::MassPoints && !simulation.body.mesh.hexes.is_empty() {
        return Err(Failure::Input(
            "unsupported: mass points on hexahedra; use tetrahedra (--kind tet, or kind = \"tet\" under [body])".into(),
        ));
    }
    let stepping = Stepping { scheme: s.scheme.into(), too_long: s.too_long.into() };
    let made = method.integrator(&mut simulation.body, materials, stepping);
    simulation.set_integrator(made.map_err(|e| Failure::Input(format!("{}: {e}", scene.character.display())))?);
    Ok(())
}

/// What a method leaves out is not written as if it were there.
///
/// # Errors
/// [`Failure::Usage`] names it.
pub fn check_sides(scene: &Scene, args: &BakeArgs) -> Outcome {
    let sides = [(&args.forces, "--forces"), (&args.skeleton, "--skeleton"), (&args.reactions, "--reactions")];
    if let Some((_, what)) = sides.iter().find(|(path, _)| scene.has_objects() && path.is_some()) {
        return Err(Failure::Usage(format!(
            "unsupported: {what} of a scene of objects, which has no bones; leave it out"
        )));
    }
    if scene.simulation.method == MethodName::Modal && args.forces.is_some() {
        let text = "unsupported: --forces with the method `modal`, whose modes do not resolve the forces on bones; use another method";
        return Err(Failure::Usage(text.into()));
    }
    Ok(())
}

/// Linear solver, for the report.
pub fn solver(scene: &Scene, settings: &SimulationSettings) -> &'static str {
    match (scene.simulation.method, settings.solver) {
        (MethodName::Implicit, SolverKind::Direct) => SolverKind::Direct.name(),
        // systems without dependent nodes have no grids
        (MethodName::Implicit, _) if scene.has_objects() => SolverKind::Pcg.name(),
        (MethodName::Implicit, kind) => kind.name(),
        _ => "none",
    }
}

/// How time passes, for the report.
pub fn dynamics(scene: &Scene, settings: &SimulationSettings) -> &'static str {
    match scene.simulation.method {
        MethodName::Implicit => settings.dynamics.name(),
        MethodName::Modal => "exact",
        _ => softrig_explicit::scheme::Scheme::from(scene.simulation.scheme).name(),
    }
}
