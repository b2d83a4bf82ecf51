//! Wide trees for training queries: a binary tree collapsed by how likely area and queries say that its nodes are visited, children in the order
//! that suits occlusion queries ([`likely`]).

use crate::geometry::{Ray, Triangle};
use crate::traverse::Prepared;
use crate::tree::collapse::{CollapseError, Config, collapse};
use crate::tree::{Tree, likely};

/// `tree`, which is binary with one triangle a leaf, with at most `config.width` children a node. A node's probability is its area over the root's; with
/// training queries (their effective segments) it is `weight` · share of them that overlap it + (1 - `weight`) · area.
///
/// # Errors
/// When the tree is not binary, or a number of `config` is out of range.
pub fn collapsed(
    tree: &Tree,
    triangles: &[Triangle],
    rays: &[Ray],
    weight: f64,
    config: &Config,
) -> Result<Tree, CollapseError> {
    let whole = f64::from(tree.nodes[0].bounds().area()).max(f64::MIN_POSITIVE);
    let area = |node: usize| f64::from(tree.nodes[node].bounds().area()) / whole;
    let sorted = |tree: Tree| likely::likeliest_first(&tree, triangles);
    if rays.is_empty() {
        return collapse(tree.view(), area, config).map(sorted);
    }
    let overlaps = Prepared::new(tree.view(), triangles, &[]).overlaps(rays);
    let share = |node: usize| overlaps[node] as f64 / rays.len() as f64;
    collapse(tree.view(), |node| weight * share(node) + (1.0 - weight) * area(node), config).map(sorted)
}
