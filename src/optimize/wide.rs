//! An optimiser of wide trees: of what a traversal follows, not of the binary tree that it was collapsed from.
//!
//! What it lowers is visit · Σ P over inner nodes + Σ P · (leaf + block · blocks) over leaves, P being a blend of recorded rays and area
//! ([`likelihood`]), the constants those of [`crate::cost`]. For trees that differ by a move this ranks as time does; whole trees are better judged by
//! counting real queries.
//!
//! Data flows so: a tree is read into a [`working`] tree, where every reference keeps its box; a binary one is collapsed on the way
//! ([`forest`]). Then rounds ([`mod@round`]) of [`leaves`] (what is in which leaf of a node) and [`tournament`] (how subtrees hang together) change it node by
//! node, from the root down. Disjoint subtrees go on different threads and know nothing of each other, so the result is the same for any number of
//! threads; each change is made only where it is cheaper, so whenever a deadline ends it, the tree is no worse than before.

#[cfg(test)]
mod checks;
pub mod forest;
pub mod hierarchy;
pub mod leaves;
pub mod likelihood;
pub mod round;
pub mod tournament;
pub mod working;

use crate::builder::MAX_DEPTH;
use crate::geometry::padded::PaddedAabb;
use crate::geometry::{Ray, Triangle};
use crate::tree::collapse::CollapseError;
use crate::tree::statistics::Statistics;
use crate::tree::{Node as FileNode, Tree, TreeView, collapse};
use forest::{Forest, Join, Sides};
use leaves::Leaves;
use likelihood::Likelihood;
use round::{Known, Round};
use std::time::Instant;
use tournament::Tournament;
use working::{Node, Prices};

/// What to lower, and how long to try.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Config {
    pub prices: Prices,
    /// Share of the rays in P; the rest is area's.
    pub weight: f64,
    /// Rounds of tournaments, each between rounds of leaves; with none only leaves change.
    pub rounds: usize,
    pub tournament: tournament::Config,
    /// When to stop, finished or not. Two runs with a deadline may give different trees.
    pub deadline: Option<Instant>,
}

/// Share of the rays in P that held-out queries like best.
pub const WEIGHT: f64 = 0.8;

impl Config {
    pub fn new(prices: Prices) -> Config {
        let tournament = tournament::Config::default();
        Config { prices, weight: WEIGHT, rounds: 2, tournament, deadline: None }
    }
}

/// A finished tree.
#[derive(Clone, Debug, PartialEq)]
pub struct Optimized {
    pub tree: Tree,
    /// Cost of the collapsed tree, and after each round.
    pub costs: Vec<f64>,
}

/// Rounds that lower the cost by a smaller share are the last.
const LEAST_GAIN: f64 = 1e-3;

/// Makes the wide tree of `tree`, which is collapsed if it is binary and kept as it is if it is wide already, and optimises it for
/// `rays` (effective segments), on the threads of the current rayon pool.
///
/// # Errors
/// When `tree` has wider nodes than it may have, or a size is out of range.
pub fn optimize(
    tree: TreeView,
    triangles: &[Triangle],
    rays: &[Ray],
    config: &Config,
) -> Result<Optimized, CollapseError> {
    let prices = &config.prices;
    collapse::Config { max_leaf: prices.max_leaf, ..collapse::Config::vector(prices.width) }.check()?;
    let too_wide = |node: &FileNode| !node.is_leaf() && node.len() > prices.width;
    if let Some(node) = tree.nodes.iter().position(too_wide) {
        return Err(CollapseError::TooWide { node, children: tree.nodes[node].len(), width: prices.width });
    }
    let mut root = Node::read(tree, triangles);
    let likelihood = Likelihood::new(rays, config.weight, &root.bounds);
    let everything = likelihood.everything();
    root.recount(&likelihood, &everything, prices);
    if tree.nodes.iter().all(|node| node.is_leaf() || node.len() == 2) {
        root = collapsed(root, prices);
    }
    let mut costs = vec![root.cost];
    let mut best = root.written();
    let depth = |tree: &Tree| Statistics::of(tree.view()).depth;
    let limit = MAX_DEPTH.max(depth(&best));
    let known = Known { likelihood: &likelihood, prices, deadline: config.deadline };
    let leaves = Leaves { known };
    let tournament = Tournament { known, config: &config.tournament };
    for round in 0..=config.rounds {
        let before = root.cost;
        if round > 0 {
            tournament.run(&mut root, &everything);
        }
        leaves.run(&mut root, &everything);
        let written = root.written();
        if depth(&written) > limit {
            break;
        }
        best = written;
        costs.push(root.cost);
        if round > 0 && root.cost > before * (1.0 - LEAST_GAIN) {
            break;
        }
    }
    Ok(Optimized { tree: best, costs })
}

/// A binary tree with P and costs, collapsed.
fn collapsed(root: Node, prices: &Prices) -> Node {
    let (mut joins, mut parts) = (Vec::new(), Vec::new());
    flatten(root, &mut joins, &mut parts);
    let tree = {
        let known: Vec<&Node> = parts.iter().collect();
        Forest::new(&joins, &known, prices)
    };
    tree.tree(parts).unwrap_or_else(Node::nothing)
}

/// Adds the joins of a binary subtree, the root's last, and its leaves; returns the place of the root's.
fn flatten(node: Node, joins: &mut Vec<Join>, parts: &mut Vec<Node>) -> usize {
    let (bounds, p): (PaddedAabb, f64) = (node.bounds, node.p);
    let below = match node.below {
        working::Below::Inner(children) => {
            let places: Vec<usize> = children.into_iter().map(|child| flatten(child, joins, parts)).collect();
            match places[..] {
                [a, b] => Sides::Pair(a, b),
                _ => Sides::Pair(0, 0),
            }
        }
        below => {
            parts.push(Node { below, ..node });
            Sides::Part(parts.len() - 1)
        }
    };
    joins.push(Join { bounds, p, below });
    joins.len() - 1
}
