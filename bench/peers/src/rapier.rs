//! The box in rapier3d: corotational cells, its finite element solver.

use crate::boxes::{CUBE, FleshBox};
use crate::scene;
use rapier3d::prelude::*;

/// A world with the box in it.
pub struct Peer {
    world: PhysicsWorld,
    body: SoftBodyHandle,
}

impl Peer {
    /// The bone's particles pinned. Nothing but the box: no collider, no substeps, no damping beside that of implicit Euler, one iteration of the contact solver.
    pub fn new(flesh: &FleshBox, young_modulus: f64, cap: usize) -> Self {
        Self::made(flesh, young_modulus, cap, flesh.bone.clone())
    }

    /// The bone's particles attached to two rigid bodies, which hang on each other and on the world by ball joints.
    pub fn two_way(flesh: &FleshBox, young_modulus: f64, cap: usize) -> Self {
        let mut peer = Self::made(flesh, young_modulus, cap, Vec::new());
        let world = &mut peer.world;
        let [start, end] = flesh.extent;
        let half = 0.25 * (end - start);
        let mut before = world.insert_body(RigidBodyBuilder::fixed().translation(Vector::new(start, 0.0, 0.0)));
        let mut anchor = Vector::ZERO;
        let bones = [start + half, start + 3.0 * half].map(|x| {
            let shape = ColliderBuilder::cuboid(half, CUBE, CUBE).density(scene::DENSITY as f32);
            let shape = shape.collision_groups(InteractionGroups::none());
            let body = RigidBodyBuilder::dynamic().translation(Vector::new(x, 0.0, 0.0)).can_sleep(false);
            let (bone, _) = world.insert(body, shape);
            let joint = SphericalJointBuilder::new().local_anchor1(anchor).local_anchor2(Vector::new(-half, 0.0, 0.0));
            world.insert_impulse_joint(before, bone, joint.contacts_enabled(false));
            (before, anchor) = (bone, Vector::new(half, 0.0, 0.0));
            bone
        });
        let middle = start + 2.0 * half;
        for n in &flesh.bone {
            let bone = bones[usize::from(flesh.nodes[*n as usize][0] > middle)];
            world.soft_bodies[peer.body].attach_particle(*n as usize, bone, &world.bodies);
        }
        peer
    }

    fn made(flesh: &FleshBox, young_modulus: f64, cap: usize, pinned: Vec<u32>) -> Self {
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
            .pinned_particles(pinned)
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
