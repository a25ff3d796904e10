//! Links solved for dependent nodes, by Gaussian elimination in sparse rows.
//!
//! Rows are taken one after the other. The dependent nodes of earlier rows are substituted, and the node with the largest weight that is
//! left depends on the others from then on. Rows are not substituted into earlier ones: those name later dependent nodes, and are read
//! from the last to the first. So nothing fills in but where links hang on one another.

use super::{Link, LinkError};
use softrig_linalg::Scalar;
use std::collections::BTreeSet;

/// What is left of a weight after substitutions counts as zero below this.
const NOTHING: f64 = 1e-12;
/// Part of the largest coordinate by which links that follow from others may miss their goals.
const SLACK: f64 = 1e-9;
/// Terms per node that are still worth eliminating.
const DENSEST: usize = 64;

/// A row: its pivot is `pivot`, x_pivot = Σ w x_i + o.
#[derive(Clone, Debug)]
struct Row {
    /// Which link it was made of.
    link: usize,
    pivot: u32,
    /// Nodes and their weights in the pivot's place; they may be pivots of later rows.
    terms: Vec<(u32, f64)>,
    /// Rows whose offsets were subtracted, with their factors, ascending.
    before: Vec<(u32, f64)>,
    /// 1 / weight of the pivot in its link.
    scale: f64,
}

/// A link without a node of its own: it holds or it does not.
#[derive(Clone, Debug)]
struct Check {
    link: usize,
    /// Prescribed nodes that are left in it.
    terms: Vec<(u32, f64)>,
    before: Vec<(u32, f64)>,
}

/// Dependent nodes and what they are made of.
#[derive(Clone, Debug, Default)]
pub struct Elimination {
    labels: Vec<u32>,
    rows: Vec<Row>,
    checks: Vec<Check>,
    dependent: Vec<bool>,
}

impl Elimination {
    /// Eliminates links between nodes; `prescribed` says which nodes have their places from elsewhere and cannot depend on others.
    ///
    /// # Errors
    /// [`LinkError::BadTerm`].
    pub fn new(links: &[Link], prescribed: &[bool]) -> Result<Self, LinkError> {
        let n = prescribed.len();
        let mut out = Self { dependent: vec![false; n], ..Self::default() };
        // row of each dependent node
        let mut row_of = vec![u32::MAX; n];
        let mut weight = vec![0.0; n];
        for (index, link) in links.iter().enumerate() {
            check_terms(link, n)?;
            out.labels.push(link.label);
            let mut touched: BTreeSet<u32> = BTreeSet::new();
            let mut pending: BTreeSet<u32> = BTreeSet::new();
            let mut before = Vec::new();
            let add =
                |node: u32, w: f64, weight: &mut [f64], pending: &mut BTreeSet<u32>, touched: &mut BTreeSet<u32>| {
                    weight[node as usize] += w;
                    touched.insert(node);
                    if row_of[node as usize] != u32::MAX {
                        pending.insert(row_of[node as usize]);
                    }
                };
            let largest = link.terms.iter().fold(0.0f64, |m, t| m.max(t.1.abs()));
            for &(node, w) in &link.terms {
                add(node, w, &mut weight, &mut pending, &mut touched);
            }
            // earlier rows first: they name later pivots, never the other way round
            while let Some(r) = pending.pop_first() {
                let row = &out.rows[r as usize];
                let w = std::mem::take(&mut weight[row.pivot as usize]);
                touched.remove(&row.pivot);
                if w.abs() <= NOTHING * largest {
                    continue;
                }
                before.push((r, w));
                for &(node, t) in &row.terms {
                    add(node, w * t, &mut weight, &mut pending, &mut touched);
                }
            }
            let terms: Vec<(u32, f64)> = touched
                .iter()
                .map(|node| (*node, std::mem::take(&mut weight[*node as usize])))
                .filter(|t| t.1.abs() > NOTHING * largest)
                .collect();
            let free = terms.iter().filter(|t| !prescribed[t.0 as usize]);
            // the first of the largest
            let pivot = free.fold(None, |best: Option<(u32, f64)>, t| match best {
                Some(b) if b.1.abs() * (1.0 + 1e-9) >= t.1.abs() => Some(b),
                _ => Some(*t),
            });
            let Some((pivot, w)) = pivot else {
                out.checks.push(Check { link: index, terms, before });
                continue;
            };
            let scale = 1.0 / w;
            let terms = terms.into_iter().filter(|t| t.0 != pivot).map(|(n, t)| (n, -t * scale)).collect();
            row_of[pivot as usize] = out.rows.len() as u32;
            out.dependent[pivot as usize] = true;
            out.rows.push(Row { link: index, pivot, terms, before, scale });
        }
        Ok(out)
    }

    /// Which nodes depend on others.
    #[must_use]
    pub fn dependent(&self) -> &[bool] {
        &self.dependent
    }

    /// How many nodes depend on others: the rank of the links.
    #[must_use]
    pub fn rank(&self) -> usize {
        self.rows.len()
    }

    /// Offsets o of the dependent nodes for these goals, one per link, in the order in which the methods below want them.
    ///
    /// # Errors
    /// [`LinkError::BadGoal`]; [`LinkError::Conflict`] when links contradict one another, `position` having the prescribed nodes where they
    /// will be.
    pub fn offsets<R: Scalar>(&self, goal: &[[f64; 3]], position: &[[R; 3]]) -> Result<Vec<[f64; 3]>, LinkError> {
        let mut size = 0.0f64;
        for (i, label) in self.labels.iter().enumerate() {
            let Some(g) = goal.get(i).filter(|g| g.iter().all(|g| g.is_finite())) else {
                return Err(LinkError::BadGoal { label: *label });
            };
            size = g.iter().fold(size, |m, g| m.max(g.abs()));
        }
        let mut offset: Vec<[f64; 3]> = Vec::with_capacity(self.rows.len());
        let rest = |link: usize, before: &[(u32, f64)], offset: &[[f64; 3]]| -> [f64; 3] {
            let sum = |k: usize| before.iter().map(|(r, w)| w * offset[*r as usize][k]).sum::<f64>();
            std::array::from_fn(|k| goal[link][k] - sum(k))
        };
        for row in &self.rows {
            let o = rest(row.link, &row.before, &offset).map(|g| g * row.scale);
            offset.push(o);
        }
        for check in &self.checks {
            let left = rest(check.link, &check.before, &offset);
            let mut by = 0.0f64;
            let mut reach = size;
            for (k, left) in left.iter().enumerate() {
                let there = check.terms.iter().map(|(n, w)| w * position[*n as usize][k].to_f64()).sum::<f64>();
                reach = check.terms.iter().fold(reach, |m, t| m.max(position[t.0 as usize][k].to_f64().abs()));
                by += (left - there).powi(2);
            }
            let by = by.sqrt();
            let rounding = SLACK.max(8.0 * R::EPSILON.to_f64());
            if by.is_nan() || by > rounding * reach.max(f64::MIN_POSITIVE) {
                return Err(LinkError::Conflict { labels: self.blame(check), by });
            }
        }
        Ok(offset)
    }

    /// The links that a check is a combination of.
    fn blame(&self, check: &Check) -> Vec<u32> {
        let mut share = vec![0.0; self.rows.len()];
        check.before.iter().for_each(|(r, w)| share[*r as usize] += w);
        let mut labels = vec![self.labels[check.link]];
        for r in (0..self.rows.len()).rev() {
            if share[r].abs() <= SLACK {
                continue;
            }
            let row = &self.rows[r];
            labels.push(self.labels[row.link]);
            row.before.iter().for_each(|(b, w)| share[*b as usize] -= share[r] * row.scale * w);
        }
        labels.sort_unstable();
        labels.dedup();
        labels
    }

    /// Puts dependent nodes to where the others want them: x = T y + o.
    pub fn place<R: Scalar>(&self, offset: &[[f64; 3]], position: &mut [[R; 3]]) {
        for (row, o) in self.rows.iter().zip(offset).rev() {
            let mut x = *o;
            for &(node, w) in &row.terms {
                (0..3).for_each(|k| x[k] += w * position[node as usize][k].to_f64());
            }
            position[row.pivot as usize] = x.map(R::from_f64);
        }
    }

    /// x = T y: dependent entries from the others.
    pub fn spread<R: Scalar>(&self, vector: &mut [[R; 3]]) {
        for row in self.rows.iter().rev() {
            let mut x = [0.0; 3];
            for &(node, w) in &row.terms {
                (0..3).for_each(|k| x[k] += w * vector[node as usize][k].to_f64());
            }
            vector[row.pivot as usize] = x.map(R::from_f64);
        }
    }

    /// Tᵀ r: what acts on dependent nodes acts on the others instead.
    pub fn gather<R: Scalar>(&self, vector: &mut [[R; 3]]) {
        for row in &self.rows {
            let r = std::mem::replace(&mut vector[row.pivot as usize], [R::zero(); 3]);
            for &(node, w) in &row.terms {
                (0..3).for_each(|k| vector[node as usize][k] += R::from_f64(w) * r[k]);
            }
        }
    }

    /// Largest distance of a dependent node from where [`Self::place`] would put it.
    #[must_use]
    pub fn miss<R: Scalar>(&self, offset: &[[f64; 3]], position: &[[R; 3]]) -> f64 {
        let mut largest = 0.0f64;
        for (row, o) in self.rows.iter().zip(offset) {
            for k in 0..3 {
                let there = row.terms.iter().map(|(n, w)| w * position[*n as usize][k].to_f64()).sum::<f64>();
                largest = largest.max((position[row.pivot as usize][k].to_f64() - there - o[k]).abs());
            }
        }
        largest
    }

    /// Every node as a sum of nodes that are neither dependent nor prescribed.
    ///
    /// # Errors
    /// [`LinkError::TooDense`].
    pub(super) fn expansions(&self, prescribed: &[bool]) -> Result<Vec<Vec<(u32, f64)>>, LinkError> {
        let n = prescribed.len();
        let mut all: Vec<Vec<(u32, f64)>> = (0..n)
            .map(|i| if prescribed[i] || self.dependent[i] { Vec::new() } else { vec![(i as u32, 1.0)] })
            .collect();
        let mut count = 0;
        for row in self.rows.iter().rev() {
            let mut sum: Vec<(u32, f64)> = Vec::new();
            for &(node, w) in &row.terms {
                sum.extend(all[node as usize].iter().map(|(n, v)| (*n, w * v)));
            }
            sum.sort_by_key(|t| t.0);
            sum.dedup_by(|b, a| {
                a.0 == b.0 && {
                    a.1 += b.1;
                    true
                }
            });
            sum.retain(|t| t.1.abs() > NOTHING);
            count += sum.len();
            if count > DENSEST * n {
                return Err(LinkError::TooDense { terms: count, node_count: n });
            }
            all[row.pivot as usize] = sum;
        }
        Ok(all)
    }
}

fn check_terms(link: &Link, node_count: usize) -> Result<(), LinkError> {
    let label = link.label;
    let mut seen = BTreeSet::new();
    for &(node, w) in &link.terms {
        let what = if node as usize >= node_count {
            "a node that does not exist"
        } else if !w.is_finite() {
            "a weight that is not finite"
        } else if !seen.insert(node) {
            "a node twice"
        } else {
            continue;
        };
        return Err(LinkError::BadTerm { label, what, node, node_count });
    }
    Ok(())
}
