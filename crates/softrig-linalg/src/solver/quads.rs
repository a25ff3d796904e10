//! Vectors of nodes as the solvers hold them: four numbers per node, the last one zero, on cache-line boundaries. One entry
//! of zeros follows the last node, for whatever refers to a node that is not there.

use crate::Scalar;

/// Bytes of a cache line.
const LINE: usize = 64;

/// One `[R; 4]` per node; a node's four numbers never straddle a cache line.
#[derive(Debug)]
pub(super) struct Quads<R> {
    /// Begins with up to a cache line of padding.
    storage: Vec<R>,
    start: usize,
    count: usize,
}

impl<R: Scalar> Quads<R> {
    /// All zero.
    pub fn zero(count: usize) -> Self {
        let spare = LINE / size_of::<R>();
        let storage = vec![R::zero(); 4 * (count + 1) + spare];
        // an interpreter may decline to say: alignment only matters for speed
        let offset = storage.as_ptr().align_offset(LINE);
        Self { start: if offset < spare { offset } else { 0 }, storage, count }
    }

    #[inline]
    pub fn get(&self) -> &[[R; 4]] {
        self.storage[self.start..self.start + 4 * self.count].as_chunks().0
    }

    /// The same with the zeros behind the last one.
    #[inline]
    pub fn padded(&self) -> &[[R; 4]] {
        self.storage[self.start..self.start + 4 * (self.count + 1)].as_chunks().0
    }

    #[inline]
    pub fn get_mut(&mut self) -> &mut [[R; 4]] {
        self.storage[self.start..self.start + 4 * self.count].as_chunks_mut().0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quads_start_on_a_cache_line_even_after_a_move() {
        let mut q = Quads::<f64>::zero(5);
        q.get_mut()[4] = [1.0; 4];
        let q = Box::new(q);
        assert_eq!(q.get().as_ptr() as usize % LINE, 0);
        assert_eq!(q.get()[4], [1.0; 4]);
        assert_eq!(q.get().len(), 5);
        assert_eq!(q.padded()[5], [0.0; 4]);
    }
}
