//! Parts of solvers for those who iterate themselves: a preconditioner, and products with a whole system.
//!
//! A system that is larger than the nodes (joints on top of them, springs between them) is solved by an iteration around both.

use super::cubes::FreeCubes;
use super::free::FreePattern;
use super::pcg::kernel::{Inverse, Product};
use super::quads::Quads;
use super::sliced::{ROWS, Sliced};
use super::{LinearSystem, SolveError};
use crate::par::Each;
use crate::{Scalar, run_wide};
use rayon::prelude::*;

/// An approximate inverse of a system on its free nodes: symmetric positive definite up to rounding.
pub trait Preconditioner<R: Scalar> {
    /// Takes the numbers of a system on the pattern and constraints its solver was prepared for. What is costly and may lag
    /// behind is kept from earlier calls until the solver is told to forget.
    ///
    /// # Errors
    /// [`SolveError`] when the solver was not prepared for it, or it is not positive definite.
    fn load(&mut self, system: &mut dyn LinearSystem<R>) -> Result<(), SolveError>;

    /// Node of each free row.
    fn free_nodes(&self) -> &[u32];

    /// `z ≈ A⁻¹ r` on free rows; the fourth numbers are zero.
    fn apply(&mut self, r: &[[f32; 4]], z: &mut [[f32; 4]]);
}

/// Products with a system on all of its nodes, constrained ones included, in numbers of type `A`. Bitwise equal for any thread
/// count.
#[derive(Debug)]
pub struct Operator<A> {
    /// The numbering of the nodes, and the blocks where the system has entries only.
    all: FreePattern,
    cubes: Option<FreeCubes<A>>,
    stored: Option<Stored<A>>,
    x: Quads<A>,
    y: Quads<A>,
}

#[derive(Debug)]
struct Stored<A> {
    matrix: Sliced<A>,
    inverse: Vec<Inverse<A>>,
    identity: Vec<bool>,
}

impl<A: Scalar> Default for Operator<A> {
    fn default() -> Self {
        Self { all: FreePattern::default(), cubes: None, stored: None, x: Quads::zero(0), y: Quads::zero(0) }
    }
}

impl<A: Scalar> Operator<A> {
    /// Takes the numbers of a system: its cubes where it has them, all entries otherwise.
    pub fn load<R: Scalar>(&mut self, system: &mut dyn LinearSystem<R>) {
        if let Some(matrix) = system.cubes() {
            self.stored = None;
            let n = matrix.pattern.node_count;
            if !self.cubes.as_ref().is_some_and(|c| c.belongs_to(&matrix.pattern)) {
                // the cubes need the numbering of the nodes only
                self.all = FreePattern::numbering((0..n as u32).collect());
                self.cubes = Some(FreeCubes::new(&matrix.pattern, &self.all));
            }
            if let Some(cubes) = &mut self.cubes {
                cubes.load(matrix, &self.all);
            }
            self.make_room(n);
            return;
        }
        self.cubes = None;
        let rows = system.rows();
        let n = rows.pattern().row_count();
        let blocks = self.all.block_count();
        let same = self.stored.is_some() && blocks == rows.pattern().block_count() && self.all.row_count() == n;
        if !same {
            self.all = FreePattern::in_order(rows.pattern(), (0..n as u32).collect());
            let made = Sliced::new(&self.all.blocks(rows.pattern()), &[0, n as u32]);
            self.stored =
                Some(Stored { matrix: made, inverse: vec![[[A::zero(); 4]; 3]; n], identity: vec![false; n] });
        }
        if let Some(stored) = &mut self.stored {
            // a diagonal block without an inverse belongs to a node that takes no part
            let _ = stored.matrix.load(&self.all, rows, &mut stored.inverse, &mut stored.identity);
        }
        self.make_room(n);
    }

    fn make_room(&mut self, nodes: usize) {
        if self.x.get().len() != nodes {
            (self.x, self.y) = (Quads::zero(nodes), Quads::zero(nodes));
        }
    }

    /// What [`Self::product`] multiplies, one entry per node; fourth numbers must be zero.
    pub fn input(&mut self) -> &mut [[A; 4]] {
        self.x.get_mut()
    }

    /// `A x` for the x that [`Self::input`] was given; zero before a system was loaded.
    pub fn product(&mut self) -> &[[A; 4]] {
        if let Some(cubes) = &mut self.cubes {
            cubes.product(self.x.padded(), self.y.get_mut());
        } else if let Some(Stored { matrix, .. }) = &self.stored {
            let x = self.x.get();
            let rows = self.y.get_mut().par_chunks_mut(ROWS).zip(x.par_chunks(ROWS));
            rows.enumerate().each(|(chunk, (y, own))| {
                run_wide::<A, _>(Product { matrix, chunk, x, own, y });
            });
        }
        self.y.get()
    }

    /// Adds to the last product at one node.
    pub fn add(&mut self, node: usize, v: [A; 3]) {
        let y = &mut self.y.get_mut()[node];
        (0..3).for_each(|k| y[k] += v[k]);
    }

    /// The x that was multiplied, and the last product.
    pub fn both(&self) -> (&[[A; 4]], &[[A; 4]]) {
        (self.x.get(), self.y.get())
    }
}
