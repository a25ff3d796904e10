//! Disjoint sets of numbers, with the same labels whatever the order of joins.

/// Union-find over `0..len`; the root of a set is its smallest member.
pub(crate) struct Sets {
    parent: Vec<u32>,
}

impl Sets {
    /// Every number alone.
    pub(crate) fn new(len: usize) -> Self {
        Self { parent: (0..len as u32).collect() }
    }

    /// Smallest member of the set of `i`.
    pub(crate) fn root(&mut self, mut i: u32) -> u32 {
        while self.parent[i as usize] != i {
            // path halving
            self.parent[i as usize] = self.parent[self.parent[i as usize] as usize];
            i = self.parent[i as usize];
        }
        i
    }

    /// Makes one set of two.
    pub(crate) fn join(&mut self, a: u32, b: u32) {
        let (a, b) = (self.root(a), self.root(b));
        self.parent[a.max(b) as usize] = a.min(b);
    }

    /// Number of its set for each member, and how many sets there are; sets are numbered by their smallest members.
    pub(crate) fn labels(mut self) -> (Vec<u32>, usize) {
        let mut count = 0;
        let mut label = vec![0; self.parent.len()];
        for i in 0..label.len() {
            let root = self.root(i as u32) as usize;
            if root == i {
                label[i] = count;
                count += 1;
            } else {
                label[i] = label[root];
            }
        }
        (label, count as usize)
    }
}
