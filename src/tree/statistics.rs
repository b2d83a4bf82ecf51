//! What a tree looks like, without any ray: counts, depth, SAH cost.

use super::TreeView;

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

/// SAH cost (Goldsmith and Salmon 1987): Σ inner area/root area · `c_i` · children + Σ leaf area/root area · `c_p` · primitives.
/// 0 for a tree whose root has no area.
pub fn sah_cost(tree: TreeView, c_i: f64, c_p: f64) -> f64 {
    let root_area = tree.nodes.first().map_or(0.0, |root| root.bounds().area() as f64);
    if !root_area.is_finite() || root_area <= 0.0 {
        return 0.0;
    }
    let cost: f64 = tree
        .nodes
        .iter()
        .map(|node| node.bounds().area() as f64 * node.len() as f64 * if node.is_leaf() { c_p } else { c_i })
        .sum();
    cost / root_area
}
