//! A tree of boxes: which items hold a point, which is nearest.

use glam::DVec3;

const LEAF: usize = 4;

struct Branch {
    lo: DVec3,
    hi: DVec3,
    first: u32,
    last: u32,
    /// Second child; the first follows its parent. 0 for leaves.
    right: u32,
}

/// Boxes in a tree. Answers do not depend on its shape.
pub(crate) struct Bvh {
    order: Vec<u32>,
    branches: Vec<Branch>,
}

impl Bvh {
    /// Builds the tree of the boxes (lowest corner, highest corner) of all items.
    pub(crate) fn new(boxes: &[(DVec3, DVec3)]) -> Self {
        let mut out = Self { order: (0..boxes.len() as u32).collect(), branches: Vec::new() };
        if !boxes.is_empty() {
            let mut order = std::mem::take(&mut out.order);
            out.build(boxes, &mut order, 0);
            out.order = order;
        }
        out
    }

    fn build(&mut self, boxes: &[(DVec3, DVec3)], own: &mut [u32], first: usize) {
        let start = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        let (lo, hi) = own.iter().fold(start, |(l, h), i| (l.min(boxes[*i as usize].0), h.max(boxes[*i as usize].1)));
        let index = self.branches.len();
        self.branches.push(Branch { lo, hi, first: first as u32, last: (first + own.len()) as u32, right: 0 });
        if own.len() > LEAF {
            let size = (hi - lo).to_array();
            let axis = (0..3).fold(0, |m, k| if size[k] > size[m] { k } else { m });
            let middle = |i: &u32| boxes[*i as usize].0[axis] + boxes[*i as usize].1[axis];
            let half = own.len() / 2;
            own.select_nth_unstable_by(half, |a, b| middle(a).total_cmp(&middle(b)));
            let (left, right) = own.split_at_mut(half);
            self.build(boxes, left, first);
            self.branches[index].right = self.branches.len() as u32;
            self.build(boxes, right, first + half);
        }
    }

    /// Calls `visit` for every item of the leaves whose box, grown by `slack`, holds `p`.
    pub(crate) fn around(&self, p: DVec3, slack: f64, mut visit: impl FnMut(u32)) {
        let mut stack = [0u32; 64];
        let mut top = usize::from(!self.branches.is_empty());
        while top > 0 {
            top -= 1;
            let index = stack[top];
            let b = &self.branches[index as usize];
            if (p + slack).cmplt(b.lo).any() || (p - slack).cmpgt(b.hi).any() {
                continue;
            }
            if b.right == 0 {
                self.order[b.first as usize..b.last as usize].iter().for_each(|i| visit(*i));
            } else {
                stack[top] = b.right;
                stack[top + 1] = index + 1;
                top += 2;
            }
        }
    }

    /// Item with the smallest `distance2` to `p`, the lowest one of equals. `distance2` must be at least that to the item's box.
    pub(crate) fn nearest(&self, p: DVec3, mut distance2: impl FnMut(u32) -> f64) -> Option<(u32, f64)> {
        let gap = |b: &Branch| (b.lo - p).max(p - b.hi).max(DVec3::ZERO).length_squared();
        let mut best: Option<(u32, f64)> = None;
        let mut stack = [0u32; 64];
        let mut top = usize::from(!self.branches.is_empty());
        while top > 0 {
            top -= 1;
            let index = stack[top];
            let b = &self.branches[index as usize];
            // boxes at the same distance are visited: a lower number may be inside. Rounding must not hide one either.
            if best.is_some_and(|(_, d)| gap(b) > d * (1.0 + 1e-12)) {
                continue;
            }
            if b.right == 0 {
                for i in &self.order[b.first as usize..b.last as usize] {
                    let d = distance2(*i);
                    if best.is_none_or(|(j, e)| d < e || (d == e && *i < j)) {
                        best = Some((*i, d));
                    }
                }
            } else {
                let (near, far) = (index + 1, b.right);
                let swap = gap(&self.branches[near as usize]) > gap(&self.branches[far as usize]);
                stack[top] = if swap { near } else { far };
                stack[top + 1] = if swap { far } else { near };
                top += 2;
            }
        }
        best
    }
}

/// Point of a triangle nearest to `p` [Ericson2005, 5.1.5].
pub(crate) fn nearest_on_triangle(t: [DVec3; 3], p: DVec3) -> DVec3 {
    let [a, b, c] = t;
    let (ab, ac, ap) = (b - a, c - a, p - a);
    let (d1, d2) = (ab.dot(ap), ac.dot(ap));
    if d1 <= 0.0 && d2 <= 0.0 {
        return a;
    }
    let bp = p - b;
    let (d3, d4) = (ab.dot(bp), ac.dot(bp));
    if d3 >= 0.0 && d4 <= d3 {
        return b;
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        return a + ab * (d1 / (d1 - d3));
    }
    let cp = p - c;
    let (d5, d6) = (ab.dot(cp), ac.dot(cp));
    if d6 >= 0.0 && d5 <= d6 {
        return c;
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        return a + ac * (d2 / (d2 - d6));
    }
    let va = d3 * d6 - d5 * d4;
    if va <= 0.0 && d4 >= d3 && d5 >= d6 {
        return b + (c - b) * ((d4 - d3) / ((d4 - d3) + (d5 - d6)));
    }
    let sum = va + vb + vc;
    a + ab * (vb / sum) + ac * (vc / sum)
}
