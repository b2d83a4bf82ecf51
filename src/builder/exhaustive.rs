//! The best tree there is, for a handful of primitives: the limit that heuristics and optimisers are compared with.
//!
//! Dynamic programming over subsets: the least T of a set S of leaves is P(S) plus the least sum over all ways to divide S in two. P of
//! the 2ⁿ boxes is computed once; the 3ⁿ/2 ways take well under a second for n = 14. [`Divisions`] does it for [`optimum`], and for
//! [`crate::optimize::treelets`] on parts of a tree.

use crate::geometry::Aabb;
use crate::geometry::padded::{Extent, PaddedAabb};
use crate::tree::{Node, Tree};
use thiserror::Error;

/// Most primitives: 2.4 million ways to divide a set.
pub const MAX_PRIMITIVES: usize = 14;

#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum ExhaustiveError {
    #[error("{0} primitives: the best of all trees can be found for at most {MAX_PRIMITIVES}")]
    TooMany(usize),
}

/// The best tree and its cost.
#[derive(Clone, Debug)]
pub struct Optimum {
    /// One primitive a leaf.
    pub tree: Tree,
    /// T: Σ P over inner nodes.
    pub cost: f64,
}

/// For every set of leaves the division in two that begins its best tree. A set is a number whose bits are its leaves.
#[derive(Clone, Debug, Default)]
pub struct Divisions {
    /// Least T of each set.
    cost: Vec<f64>,
    /// One side of the best division.
    left: Vec<u32>,
}

impl Divisions {
    /// Finds the best divisions; `probability[set]` is P of the box around each set of at least two leaves.
    pub fn find(&mut self, probability: &[f64]) {
        let sets = probability.len();
        debug_assert!(sets.is_power_of_two());
        self.cost.clear();
        self.cost.resize(sets, 0.0);
        self.left.clear();
        self.left.resize(sets, 0);
        // A set's subsets have smaller numbers.
        for set in (1..sets).filter(|set| !set.is_power_of_two()) {
            // Each division once: the side with the lowest leaf is `set` without a non-empty part of the rest.
            let rest = set & (set - 1);
            let mut least = f64::INFINITY;
            let mut part = rest;
            while part != 0 {
                let sum = self.cost[part] + self.cost[set ^ part];
                if sum < least {
                    (least, self.left[set]) = (sum, (set ^ part) as u32);
                }
                part = (part - 1) & rest;
            }
            self.cost[set] = least + probability[set];
        }
    }

    /// Least T of all leaves together.
    pub fn least(&self) -> f64 {
        self.cost.last().copied().unwrap_or(0.0)
    }

    /// Both sides of a set of at least two leaves.
    pub fn sides(&self, set: usize) -> [usize; 2] {
        let left = self.left[set] as usize;
        [left, set ^ left]
    }
}

/// Boxes around all sets of the leaves; that of the empty set is empty.
pub fn unions<B: Extent>(leaves: impl ExactSizeIterator<Item = B>, bounds: &mut Vec<B>) {
    bounds.clear();
    bounds.push(B::EMPTY);
    for leaf in leaves {
        for set in 0..bounds.len() {
            bounds.push(bounds[set].union(&leaf));
        }
    }
}

/// The tree of least T over `leaves` (a box and the triangle it stands for), one a leaf, with any measure of boxes.
///
/// # Errors
/// More than [`MAX_PRIMITIVES`] leaves.
pub fn optimum(
    leaves: &[(Aabb, u32)],
    mut probability: impl FnMut(&PaddedAabb) -> f64,
) -> Result<Optimum, ExhaustiveError> {
    let count = leaves.len();
    if count > MAX_PRIMITIVES {
        return Err(ExhaustiveError::TooMany(count));
    }
    let mut tree = Tree { nodes: vec![Node::leaf(Aabb::EMPTY, 0, 0)], primitives: Vec::new() };
    if count == 0 {
        return Ok(Optimum { tree, cost: 0.0 });
    }
    let mut bounds = Vec::new();
    unions(leaves.iter().map(|&(bounds, _)| PaddedAabb::from(bounds)), &mut bounds);
    let value = |(set, bounds): (usize, &PaddedAabb)| {
        if set.count_ones() < 2 { 0.0 } else { probability(bounds) }
    };
    let values: Vec<f64> = bounds.iter().enumerate().map(value).collect();
    let mut divisions = Divisions::default();
    divisions.find(&values);
    let mut open = vec![(bounds.len() - 1, 0usize)];
    while let Some((set, place)) = open.pop() {
        let around = Aabb::from(bounds[set]);
        if set.is_power_of_two() {
            tree.nodes[place] = Node::leaf(around, tree.primitives.len() as u32, 1);
            tree.primitives.push(leaves[set.trailing_zeros() as usize].1);
        } else {
            let first = tree.nodes.len();
            tree.nodes[place] = Node::inner(around, first as u32, 2);
            tree.nodes.extend([Node::leaf(Aabb::EMPTY, 0, 0); 2]);
            let [left, right] = divisions.sides(set);
            open.extend([(right, first + 1), (left, first)]);
        }
    }
    Ok(Optimum { tree, cost: divisions.least() })
}
