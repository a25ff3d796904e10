//! The box in softrig: the same cells, masses, scheme and numbers of 32 bits, the bone's nodes prescribed.

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
    body: Body<f32>,
    solver: Box<dyn LinearSolver<f32>>,
    integrator: Implicit<f32>,
    state: State<f32>,
    rest: Vec<[f32; 3]>,
    still: Vec<[f32; 3]>,
    weight: Vec<[f32; 3]>,
    old: Vec<usize>,
    /// What the last step did.
    pub output: StepOutput<f32>,
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
        let rest: Vec<[f32; 3]> = mesh.nodes.iter().map(|x| x.map(|x| x as f32)).collect();
        let materials = MaterialMap::uniform(material);
        let body = Body::new(mesh, &materials, ElasticModel::Corotated, DofConstraints::from_mask(held))?;
        Ok(Self {
            solver: solver.build(&body.mesh),
            integrator: Implicit::new(Scheme::ImplicitEuler, 1),
            state: State::at_rest(rest.clone()),
            still: vec![[0.0f32; 3]; rest.len()],
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
            reactions: false,
        };
        Ok(self.integrator.step(&mut self.body, &mut *self.solver, &input, &mut self.state, &mut self.output)?)
    }

    /// Height of a node [m].
    pub fn height(&self, node: usize) -> f64 {
        f64::from(self.state.position[self.old[node]][1])
    }
}
