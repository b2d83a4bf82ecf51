//! From a binary tree to the one that a program follows: collapsed and optimised as a wide tree, children in the order that suits its
//! occlusion queries.

use super::judge::Scene;
use crate::cost::Costs;
use crate::geometry::Ray;
use crate::optimize::slots;
use crate::optimize::wide::working::Prices;
use crate::optimize::wide::{self, WEIGHT};
use crate::training::occlusions::Occlusion;
use crate::traverse::Prepared;
use crate::tree::collapse::{self, CollapseError};
use crate::tree::{Tree, TreeView};
use std::time::Instant;

/// What the machine that follows the tree likes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shape {
    /// Most children of a node.
    pub width: usize,
    /// Most triangles in a leaf.
    pub max_leaf: usize,
    pub costs: Costs,
}

impl Shape {
    /// Checks the sizes, before any work.
    ///
    /// # Errors
    /// The first that is out of range.
    pub fn check(&self) -> Result<(), CollapseError> {
        let Shape { width, max_leaf, .. } = *self;
        collapse::Config { width, max_leaf, ..collapse::Config::vector(2) }.check()
    }
}

/// Most triangles in a leaf where nothing else is asked for: four blocks.
pub const MAX_LEAF: usize = 16;

/// How much is tried for the wide tree.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Effort {
    /// Rounds of tournaments of subtrees; 0 is leaves only.
    pub rounds: usize,
    pub deadline: Option<Instant>,
}

/// The queries that it is for.
#[derive(Clone, Copy, Debug)]
pub struct Queries<'a> {
    /// Effective segments; none for a tree from area.
    pub segments: &'a [Ray],
    pub occlusions: &'a [Occlusion],
    /// Share of the queries that ask for occlusion, 0 to 1.
    pub share: f64,
}

/// Finishes `tree`. The stored order of children is the order in which occlusion queries are to visit them ([`slots`]).
///
/// # Errors
/// When a size is out of range, or the tree is wider than it may be.
pub fn finish(
    scene: Scene,
    tree: TreeView,
    queries: &Queries,
    shape: &Shape,
    effort: &Effort,
) -> Result<Tree, CollapseError> {
    let Shape { width, max_leaf, costs } = shape;
    let prices = Prices::new(*width, *max_leaf, &costs.mixed(*width, queries.share));
    let Effort { rounds, deadline } = *effort;
    let config = wide::Config { weight: WEIGHT, rounds, deadline, ..wide::Config::new(prices) };
    let wide = wide::optimize(tree, scene.triangles, queries.segments, &config)?.tree;
    let by_size = slots::smallest_first(wide.view());
    if queries.occlusions.is_empty() {
        return Ok(by_size);
    }
    let prepared = Prepared::new(by_size.view(), scene.triangles, scene.geometries);
    Ok(slots::choose(&prepared, by_size.view(), queries.occlusions, costs.of(*width, true)).tree)
}
