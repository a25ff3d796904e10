//! Rows that come in from several threads, in any order.

use super::{Fault, SLICE, Sliced, Step};
use crate::Scalar;
use crate::solver::free::{BlockRows, FreePattern};
use crate::solver::pcg::kernel::{Inverse, inverse_of_block};
use std::ops::Range;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, PoisonError};

/// A matrix that is being given its rows, with their inverted diagonal blocks and identity marks.
pub(in crate::solver) struct Fill<'a, A> {
    pattern: &'a BlockRows,
    layout: &'a super::Layout,
    taken: &'a [AtomicBool],
    values: Shared<Step<A>>,
    inverse: Shared<Inverse<A>>,
    identity: Shared<bool>,
    fault: Mutex<Option<Fault>>,
}

/// A list whose entries different threads write.
struct Shared<T>(*mut T);

// SAFETY: `Fill::take` writes what belongs to a row only after it has claimed the row, so no two threads write the same entry; nobody
// reads before `Fill` is gone, which borrows the lists.
unsafe impl<T: Send> Sync for Shared<T> {}
// SAFETY: as above.
unsafe impl<T: Send> Send for Shared<T> {}

impl<'a, A: Scalar> Fill<'a, A> {
    /// For all rows of the pattern, which is that of the matrix.
    pub fn new(
        matrix: &'a mut Sliced<A>,
        pattern: &'a BlockRows,
        inverse: &'a mut [Inverse<A>],
        identity: &'a mut [bool],
    ) -> Self {
        let Sliced { layout, values, taken } = matrix;
        let rows = pattern.row_count();
        let whole = taken.len() == rows && inverse.len() == rows && identity.len() == rows;
        assert!(whole && values.len() == layout.column.len(), "a matrix is filled on its own pattern");
        taken.iter_mut().for_each(|t| *t.get_mut() = false);
        Self {
            pattern,
            layout,
            taken,
            values: Shared(values.as_mut_ptr()),
            inverse: Shared(inverse.as_mut_ptr()),
            identity: Shared(identity.as_mut_ptr()),
            fault: Mutex::new(None),
        }
    }

    /// Takes the blocks of a node's row in the whole system, if the node has one here; `columns` are the nodes of `blocks`.
    #[inline(always)]
    pub fn take_node<R: Scalar>(&self, free: &FreePattern, node: usize, columns: &[u32], blocks: &[[R; 9]]) {
        let Some(row) = free.row_of(node) else { return };
        if !free.is_masked() && free.row(row).len() == columns.len() {
            // all of its columns are free
            self.take(row, blocks.iter().map(|block| block.map(|v| A::from_f64(v.to_f64()))));
        } else {
            self.take(row, free.blocks_of(row, columns, blocks));
        }
    }

    /// Takes the blocks of a row, in the order of the pattern. A row that comes again changes nothing.
    #[inline(always)]
    pub fn take(&self, row: usize, blocks: impl Iterator<Item = [A; 9]>) {
        if self.taken[row].swap(true, Ordering::Relaxed) {
            return;
        }
        let (steps, lane) = self.layout.place(row);
        let blocks_of_row = self.pattern.row(row);
        let own = self.pattern.diagonal[row] as usize - blocks_of_row.start;
        let count = blocks_of_row.len().min(steps.len());
        // zero times anything finite is zero
        let (mut finite, mut diagonal) = ([A::zero(); 9], [A::zero(); 9]);
        let mut came = 0;
        for (k, block) in blocks.take(count).enumerate() {
            for i in 0..9 {
                finite[i] += block[i] * A::zero();
            }
            if k == own {
                diagonal = block;
            }
            self.write(steps.start + k, lane, &block);
            came += 1;
        }
        let is_finite = finite.into_iter().fold(A::zero(), |a, b| a + b) == A::zero();
        let empty = is_finite && diagonal == [A::zero(); 9] && self.is_empty(steps.start..steps.start + came, lane);
        if empty {
            (0..3).for_each(|i| diagonal[4 * i] = A::one());
            self.write(steps.start + own, lane, &diagonal);
        }
        let inverted = inverse_of_block(diagonal.map(Scalar::to_f64));
        // SAFETY: both lists have one entry per row (asserted in `new`; `taken`, which has as many, was indexed by this one), and this
        // row was claimed above.
        unsafe {
            *self.inverse.0.add(row) = inverted.unwrap_or_default();
            *self.identity.0.add(row) = empty;
        }
        let found = match inverted {
            _ if came < count => Fault::Missing { row },
            _ if !is_finite => Fault::NotFinite { row },
            None => Fault::NotPositiveDefinite { row },
            Some(_) => return,
        };
        self.blame(found);
    }

    /// Are these blocks of a row that the caller has claimed and written all zero?
    #[cold]
    fn is_empty(&self, mut steps: Range<usize>, lane: usize) -> bool {
        // SAFETY: as in `write`; who has claimed a row may also read what it has written there.
        let numbers = |step: usize| unsafe { self.values.0.add(step).cast::<A>().add(lane) };
        // SAFETY: as above, nine numbers for each block.
        steps.all(|step| (0..9).all(|i| unsafe { *numbers(step).add(SLICE * i) } == A::zero()))
    }

    #[inline(always)]
    fn write(&self, step: usize, lane: usize, block: &[A; 9]) {
        debug_assert!(step < self.layout.column.len() && lane < SLICE);
        // SAFETY: `step` is one of the steps of a row of the layout, of which there are as many as values (asserted in `new`), `lane`
        // is its place among the eight of a slice; both belong to a row that the caller has claimed.
        unsafe {
            let numbers = self.values.0.add(step).cast::<A>().add(lane);
            for (i, v) in block.iter().enumerate() {
                *numbers.add(SLICE * i) = *v;
            }
        }
    }

    /// Rows come in any order: the first of those something is wrong with is named.
    #[cold]
    fn blame(&self, found: Fault) {
        let mut fault = self.fault.lock().unwrap_or_else(PoisonError::into_inner);
        if fault.as_ref().is_none_or(|f| found.row() < f.row()) {
            *fault = Some(found);
        }
    }

    /// Have all rows come, and are they what they should be?
    ///
    /// # Errors
    /// The first fault.
    pub fn finish(self) -> Result<(), Fault> {
        if let Some(row) = self.taken.iter().position(|t| !t.load(Ordering::Relaxed)) {
            self.blame(Fault::Missing { row });
        }
        self.fault.into_inner().unwrap_or_else(PoisonError::into_inner).map_or(Ok(()), Err)
    }
}
