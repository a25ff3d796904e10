//! The box in rapier3d: corotational cells, its finite element solver, the bone's particles pinned.

use crate::boxes::FleshBox;
use crate::scene;
use rapier3d::prelude::*;

/// A world with the box in it.
pub struct Peer {
    world: PhysicsWorld,
    body: SoftBodyHandle,
}

impl Peer {
    /// Nothing but the box: no collider, no substeps, no damping beside that of implicit Euler, one iteration of the contact solver.
    pub fn new(flesh: &FleshBox, young_modulus: f64, cap: usize) -> Self {
        let positions = flesh.nodes.iter().map(|x| Vector::new(x[0], x[1], x[2])).collect();
        let material = SoftBodyMaterial {
            young_modulus: young_modulus as f32,
            poisson_ratio: scene::POISSON_RATIO as f32,
            elastic_damping_ratio: 0.0,
            ..SoftBodyMaterial::default()
        };
        let mut builder = SoftBodyBuilder::new(positions)
            .cells(flesh.tets.clone())
            .masses(flesh.masses(scene::DENSITY))
            .pinned_particles(flesh.bone.iter().copied())
            .material(material);
        builder.cell_model = SoftBodyCellModel::Corotational;
        builder.solver = SoftBodySolver::Fem;
        builder.collider_template = None;
        builder.particle_settings.can_sleep = false;
        let mut world = PhysicsWorld::new();
        world.integration_parameters.dt = scene::STEP as f32;
        world.integration_parameters.num_solver_iterations = 1;
        world.integration_parameters.soft_bodies.fem.max_linear_iterations = cap;
        world.integration_parameters.soft_bodies.fem.linear_tolerance = scene::TOLERANCE as f32;
        let body = world.insert_soft_body(builder);
        Self { world, body }
    }

    /// One step.
    pub fn step(&mut self) {
        self.world.step();
    }

    /// Height of a node [m].
    pub fn height(&self, node: usize) -> f64 {
        f64::from(self.world.soft_bodies[self.body].particle_position(node).y)
    }
}
