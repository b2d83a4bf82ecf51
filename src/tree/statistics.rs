//! What a tree looks like, without any ray: counts, depth, SAH cost.

use super::{Node, TreeView};
use crate::geometry::DVec3;

/// Counts of a tree.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Statistics {
    pub nodes: usize,
    pub leaves: usize,
    /// Levels; a lone root has depth 1.
    pub depth: usize,
    /// Largest number of children of an inner node.
    pub max_children: usize,
    /// Largest number of primitives in a leaf.
    pub max_leaf: usize,
}

impl Statistics {
    /// Counts in one pass. Children stand behind their parent, so a node's level is known when it is reached.
    pub fn of(tree: TreeView) -> Statistics {
        let mut statistics = Statistics { nodes: tree.nodes.len(), ..Statistics::default() };
        let mut level = vec![1u32; tree.nodes.len()];
        for (index, node) in tree.nodes.iter().enumerate() {
            statistics.depth = statistics.depth.max(level[index] as usize);
            if node.is_leaf() {
                statistics.leaves += 1;
                statistics.max_leaf = statistics.max_leaf.max(node.len());
            } else {
                statistics.max_children = statistics.max_children.max(node.len());
                for child in node.range() {
                    level[child] = level[index] + 1;
                }
            }
        }
        statistics
    }
}

/// Half the surface area of a node's box, in double precision: coordinates of 1e38 are legal, their products are not in single.
pub fn half_area(node: &Node) -> f64 {
    let edge = (node.upper.as_dvec3() - node.lower.as_dvec3()).max(DVec3::ZERO);
    edge.x * edge.y + edge.y * edge.z + edge.z * edge.x
}

/// A node's term of the SAH cost, not divided by the root's area: half its area · `c_i` · children, or · `c_p` · primitives.
pub fn node_cost(node: &Node, c_i: f64, c_p: f64) -> f64 {
    half_area(node) * node.len() as f64 * if node.is_leaf() { c_p } else { c_i }
}

/// SAH cost (Goldsmith and Salmon 1987): Σ inner area/root area · `c_i` · children + Σ leaf area/root area · `c_p` · primitives.
/// 0 for a tree whose root has no area.
pub fn sah_cost(tree: TreeView, c_i: f64, c_p: f64) -> f64 {
    let root_area = tree.nodes.first().map_or(0.0, half_area);
    if !root_area.is_finite() || root_area <= 0.0 {
        return 0.0;
    }
    let cost: f64 = tree.nodes.iter().map(|node| node_cost(node, c_i, c_p)).sum();
    cost / root_area
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Aabb, Vec3};
    use crate::tree::Tree;

    /// A root of 2 × 1 × 1 over two unit cubes with 1 and 3 primitives, times `scale`.
    fn two_cubes(scale: f32) -> Tree {
        let cube = |x: f32| Aabb {
            lower: scale * Vec3::new(x, 0.0, 0.0),
            upper: scale * Vec3::new(x + 1.0, 1.0, 1.0),
        };
        let nodes = vec![
            Node::inner(cube(0.0).union(&cube(1.0)), 1, 2),
            Node::leaf(cube(0.0), 0, 1),
            Node::leaf(cube(1.0), 1, 3),
        ];
        Tree { nodes, primitives: vec![0, 1, 2, 3] }
    }

    #[test]
    fn counts_are_those_of_the_tree() {
        let statistics = Statistics::of(two_cubes(1.0).view());
        let expected = Statistics { nodes: 3, leaves: 2, depth: 2, max_children: 2, max_leaf: 3 };
        assert_eq!(statistics, expected);
    }

    #[test]
    fn sah_cost_is_the_formulas_at_any_scale() {
        // Areas 10 and 6, 6: 2 box tests, and 6/10 · (1 + 3) primitive tests.
        for scale in [1.0, 1e-18, 1e37] {
            let cost = sah_cost(two_cubes(scale).view(), 0.6, 1.0);
            assert!((cost - (0.6 * 2.0 + 0.6 * 4.0)).abs() < 1e-6, "{cost}");
        }
        assert_eq!(sah_cost(two_cubes(0.0).view(), 0.6, 1.0), 0.0);
    }
}
