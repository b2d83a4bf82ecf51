//! What queries cost over one tree, in nanoseconds: the constants of [`crate::cost`] for the tree's
//! width, by kind of query.
//!
//! Everything that is shown as *cost* comes from here, so that it is the number that `bvh-compare`
//! reports.

use crate::cost::{Constants, Costs, Counted, width_class};
use crate::traverse::Counts;
use crate::tree::{Node, TreeView};

/// Triangles that are tested together.
const BLOCK: usize = 4;

/// The constants of one tree.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Price {
    closest_hit: Constants,
    occlusion: Constants,
    /// Children of the widest node.
    width: usize,
}

impl Price {
    /// Of a tree by its widest node; a lone leaf counts as binary.
    pub fn of(tree: TreeView, costs: &Costs) -> Price {
        let inner = tree.nodes.iter().filter(|node| !node.is_leaf());
        let width = inner.map(Node::len).max().unwrap_or(2);
        Price { closest_hit: *costs.of(width, false), occlusion: *costs.of(width, true), width }
    }

    /// Whether Γ compares with that of the other tree: a machine tests the boxes of a node
    /// together, so between trees of different widths their number says nothing.
    pub fn compares_tests(&self, other: &Price) -> bool {
        width_class(self.width) == width_class(other.width)
    }

    fn constants(&self, occlusion: bool) -> &Constants {
        if occlusion { &self.occlusion } else { &self.closest_hit }
    }

    /// Nanoseconds that so many queries of one kind take, of which `counts` were counted.
    pub fn cost(&self, occlusion: bool, queries: u64, counts: Counts) -> f64 {
        self.constants(occlusion).of(&Counted { queries, counts, misses: 0 })
    }

    /// Nanoseconds that a query takes that opens `node` and tests all that is in it, when `share`
    /// of all queries, 0 to 1, ask for occlusion.
    pub fn opening(&self, node: &Node, share: f64) -> f64 {
        let blocks = node.len().div_ceil(BLOCK) as u64;
        let counts = match node.is_leaf() {
            true => Counts { leaf_visits: 1, block_tests: blocks, ..Counts::default() },
            false => Counts { node_visits: 1, ..Counts::default() },
        };
        (1.0 - share) * self.cost(false, 0, counts) + share * self.cost(true, 0, counts)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Aabb, Vec3};

    #[test]
    fn opening_a_node_is_a_visit_and_a_leaf_has_blocks() {
        let bounds = Aabb { lower: Vec3::ZERO, upper: Vec3::ONE };
        let nodes = [Node::inner(bounds, 1, 2), Node::leaf(bounds, 0, 5), Node::leaf(bounds, 5, 4)];
        let price = Price::of(TreeView { nodes: &nodes, primitives: &[0; 9] }, &Costs::default());
        // By hand, from the constants of src/cost.rs: 6.1 a visit; 7.7 and 2.0, or 6.2 and 2.9, a
        // leaf and a block.
        for (node, share, expected) in
            [(0, 0.0, 6.1), (0, 1.0, 6.1), (1, 0.0, 11.7), (1, 1.0, 12.0), (2, 0.5, 0.5 * (9.7 + 9.1))]
        {
            assert!((price.opening(&nodes[node], share) - expected).abs() < 1e-9, "{node} {share}");
        }
        let like = |width: usize| Price { width, ..price };
        assert!(price.compares_tests(&price) && like(5).compares_tests(&like(8)));
        assert!(!price.compares_tests(&like(8)) && !like(4).compares_tests(&like(3 * 4)));
    }
}
