//! Lists on the stack.

use std::mem::MaybeUninit;
use std::ops::Deref;

/// At most `MOST` values in a row on the stack. Unlike an array it costs nothing to make, however large it may get.
#[derive(Debug)]
pub struct Stacked<T, const MOST: usize> {
    items: [MaybeUninit<T>; MOST],
    /// How many of the items are there: the first ones.
    len: usize,
}

impl<T: Copy, const MOST: usize> Stacked<T, MOST> {
    /// None yet.
    #[inline(always)]
    #[must_use]
    pub fn new() -> Self {
        Self { items: [const { MaybeUninit::uninit() }; MOST], len: 0 }
    }

    /// Puts one behind the others.
    ///
    /// # Panics
    /// When there are `MOST` already.
    #[inline(always)]
    pub fn push(&mut self, item: T) {
        self.items[self.len].write(item);
        self.len += 1;
    }
}

impl<T: Copy, const MOST: usize> Default for Stacked<T, MOST> {
    #[inline(always)]
    fn default() -> Self {
        Self::new()
    }
}

impl<T: Copy, const MOST: usize> Deref for Stacked<T, MOST> {
    type Target = [T];
    #[inline(always)]
    fn deref(&self) -> &[T] {
        // SAFETY: `push` alone counts, one by one and not beyond the array, and what it counts it has written.
        unsafe { std::slice::from_raw_parts(self.items.as_ptr().cast::<T>(), self.len) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What was pushed can be read, and nothing else.
    #[test]
    fn a_list_holds_what_was_pushed() {
        let mut list = Stacked::<[f64; 4], 8>::new();
        assert!(list.is_empty());
        (0..8).for_each(|i| list.push([f64::from(i); 4]));
        assert_eq!(list.len(), 8);
        assert!(list.iter().zip(0..8).all(|(v, i)| *v == [f64::from(i); 4]));
        assert!(std::panic::catch_unwind(move || list.push([0.0; 4])).is_err(), "it is full");
    }
}
