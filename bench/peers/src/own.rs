//! The box in softrig: the same cells, masses and scheme, the bone's nodes prescribed, the default solver.

use crate::boxes::FleshBox;
use crate::scene;
use softrig::body::Body;
use softrig::force::ElasticModel;
use softrig::integrate::{Implicit, Integrator, Scheme, State, StepInput, StepOutput};
use softrig::material::{Material, MaterialMap};
use softrig::simulation::SolverKind;
use softrig_linalg::{DofConstraints, LinearSolver};
use std::error::Error;

/// A body and what steps it.
pub struct Own {
    body: Body<f64>,
    solver: Box<dyn LinearSolver<f64>>,
    integrator: Implicit<f64>,
    state: State<f64>,
    rest: Vec<[f64; 3]>,
    still: Vec<[f64; 3]>,
    weight: Vec<[f64; 3]>,
    old: Vec<usize>,
    /// What the last step did.
    pub output: StepOutput<f64>,
}

impl Own {
    /// Implicit Euler with one linearisation, undamped.
    pub fn new(flesh: &FleshBox, young_modulus: f64, solver: SolverKind) -> Result<Self, Box<dyn Error>> {
        let (mesh, order) = softrig::mesh::renumbered(&flesh.mesh());
        let mut old = vec![0; order.len()];
        order.iter().enumerate().for_each(|(new, n)| old[*n as usize] = new);
        let mut held = vec![false; order.len()];
        flesh.bone.iter().for_each(|n| held[old[*n as usize]] = true);
        let material = Material {
            young_modulus,
            poisson_ratio: scene::POISSON_RATIO,
            density: scene::DENSITY,
            mass_damping: 0.0,
            stiffness_damping: 0.0,
        };
        let rest = mesh.nodes.clone();
        let materials = MaterialMap::uniform(material);
        let body = Body::new(mesh, &materials, ElasticModel::Corotated, DofConstraints::from_mask(held))?;
        Ok(Self {
            solver: solver.build(&body.mesh),
            integrator: Implicit::new(Scheme::ImplicitEuler, 1),
            state: State::at_rest(rest.clone()),
            still: vec![[0.0; 3]; rest.len()],
            weight: body.weight([0.0, -9.81, 0.0]),
            rest,
            old,
            output: StepOutput::default(),
            body,
        })
    }

    /// One step.
    pub fn step(&mut self) -> Result<(), Box<dyn Error>> {
        let input = StepInput {
            target_position: &self.rest,
            target_velocity: &self.still,
            external_force: &self.weight,
            dt: scene::STEP,
            tolerance: scene::TOLERANCE,
        };
        Ok(self.integrator.step(&mut self.body, &mut *self.solver, &input, &mut self.state, &mut self.output)?)
    }

    /// Height of a node [m].
    pub fn height(&self, node: usize) -> f64 {
        self.state.position[self.old[node]][1]
    }
}
