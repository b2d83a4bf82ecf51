//! The best tree there is, for a handful of primitives: the limit that heuristics and optimisers are compared with.
//!
//! Dynamic programming over subsets: the least T of a set S of leaves is P(S) plus the least sum over all ways to divide S in two. P of
//! the 2ⁿ boxes is computed once; the 3ⁿ/2 ways take well under a second for n = 14.

use crate::geometry::Aabb;
use crate::geometry::padded::PaddedAabb;
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
    let sets = 1usize << count;
    let mut bounds = vec![PaddedAabb::EMPTY; sets];
    let mut cost = vec![0.0f64; sets];
    let mut left = vec![0usize; sets];
    // A set's subsets have smaller numbers.
    for set in 1..sets {
        let lowest = set & set.wrapping_neg();
        let rest = set ^ lowest;
        bounds[set] = bounds[rest].union(&leaves[lowest.trailing_zeros() as usize].0.into());
        if rest == 0 {
            continue;
        }
        // Each division once: the side with the lowest leaf is `set` without a non-empty part of the rest.
        let mut least = f64::INFINITY;
        let mut part = rest;
        while part != 0 {
            let sum = cost[part] + cost[set ^ part];
            if sum < least {
                (least, left[set]) = (sum, set ^ part);
            }
            part = (part - 1) & rest;
        }
        cost[set] = least + probability(&bounds[set]);
    }
    let mut open = vec![(sets - 1, 0usize)];
    while let Some((set, place)) = open.pop() {
        let around = Aabb::from(bounds[set]);
        if set.is_power_of_two() {
            tree.nodes[place] = Node::leaf(around, tree.primitives.len() as u32, 1);
            tree.primitives.push(leaves[set.trailing_zeros() as usize].1);
        } else {
            let first = tree.nodes.len();
            tree.nodes[place] = Node::inner(around, first as u32, 2);
            tree.nodes.extend([Node::leaf(Aabb::EMPTY, 0, 0); 2]);
            open.extend([(set ^ left[set], first + 1), (left[set], first)]);
        }
    }
    Ok(Optimum { tree, cost: cost[sets - 1] })
}
