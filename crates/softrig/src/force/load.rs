//! Which forces of the cells are asked for, and what these read of the nodes. `tet.rs` and `hex.rs` say what each of them is for their
//! cells.
//!
//! The cells of a chunk have many corners and few nodes: vectors are read once for each node, into a list that stays in the nearest cache,
//! and from there four cells at a time.

use super::assembly::Increment;
use softrig_linalg::{Scalar, Stacked, Vec3, Wide};

/// Vectors of the nodes of a chunk, at most `MOST`; the fourth number is idle.
pub(super) type Vectors<R, const MOST: usize> = Stacked<[R; 4], MOST>;

/// Those that [`Load::gather`] makes.
pub(super) struct Near<R: Scalar, const MOST: usize> {
    /// Positions, or what is multiplied.
    pub x: Vectors<R, MOST>,
    /// Displacements, if they count.
    pub d: Vectors<R, MOST>,
    /// Velocities, if they count.
    pub v: Vectors<R, MOST>,
}

impl<R: Scalar, const MOST: usize> Near<R, MOST> {
    #[inline(always)]
    pub(super) fn new() -> Self {
        Self { x: Stacked::new(), d: Stacked::new(), v: Stacked::new() }
    }
}

/// Appends the vectors of the nodes of a chunk.
#[inline(always)]
pub(super) fn gather<R: Scalar, const MOST: usize>(nodes: &[u32], from: &[[R; 3]], to: &mut Vectors<R, MOST>) {
    for n in nodes {
        let [x, y, z] = from[*n as usize];
        to.push([x, y, z, R::zero()]);
    }
}

/// Vectors at corner `a` of `W` cells; behind the last cell comes the last one again.
#[inline(always)]
pub(super) fn corner<R: Scalar, const W: usize, const N: usize>(
    from: &[[R; 4]],
    local: &[[u16; N]],
    first: usize,
    a: usize,
) -> Vec3<Wide<R, W>> {
    let mut out = Vec3([Wide([R::zero(); W]); 3]);
    let last = local.len() - 1;
    for k in 0..W / 4 {
        let mut rows = [&from[local[last][a] as usize]; 4];
        for i in 0..4 {
            rows[i] = &from[local[(first + 4 * k + i).min(last)][a] as usize];
        }
        let numbers = R::transposed(rows);
        for c in 0..3 {
            out.0[c].0.as_chunks_mut::<4>().0[k] = numbers[c];
        }
    }
    for i in W - W % 4..W {
        let from = from[local[(first + i).min(last)][a] as usize];
        for c in 0..3 {
            out.0[c].0[i] = from[c];
        }
    }
    out
}

/// Forces of cells, by what they read of the nodes.
pub(super) trait Load<R: Scalar>: Copy + Send + Sync {
    /// Reads it for the nodes of a chunk; the lists are empty before.
    fn gather<const MOST: usize>(&self, nodes: &[u32], near: &mut Near<R, MOST>);
}

/// `f_int(x) + K d + C v`, and the energy at x.
#[derive(Clone, Copy)]
pub(super) struct Internal<'a, R> {
    /// x [m], one per node.
    pub position: &'a [[R; 3]],
    pub increment: Increment<'a, R>,
    /// Whether the rotations of cells follow their deformation.
    pub rotate: bool,
}

impl<R: Scalar> Load<R> for Internal<'_, R> {
    #[inline(always)]
    fn gather<const MOST: usize>(&self, nodes: &[u32], near: &mut Near<R, MOST>) {
        gather(nodes, self.position, &mut near.x);
        if let Some(d) = self.increment.displacement {
            gather(nodes, d, &mut near.d);
        }
        if let Some(v) = self.increment.velocity {
            gather(nodes, v, &mut near.v);
        }
    }
}

/// `(1 + rate (b + damping)) K x`, and no energy.
#[derive(Clone, Copy)]
pub(super) struct Product<'a, R> {
    /// Any vectors, one per node.
    pub x: &'a [[R; 3]],
    pub rate: R,
    pub damping: R,
}

impl<R: Scalar> Load<R> for Product<'_, R> {
    #[inline(always)]
    fn gather<const MOST: usize>(&self, nodes: &[u32], near: &mut Near<R, MOST>) {
        gather(nodes, self.x, &mut near.x);
    }
}
