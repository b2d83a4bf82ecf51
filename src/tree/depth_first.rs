//! A tree written anew, depth first: siblings adjacent, below them the whole first subtree, then the next, primitives in the order of
//! their leaves. So the nodes below any node are one range, which is what lets a pass over the tree be divided between threads.

use super::{Node, Tree, TreeView};
use crate::geometry::Aabb;

/// The same tree, node for node, in depth-first order.
pub fn depth_first(tree: TreeView) -> Tree {
    let nothing = Node::leaf(Aabb::EMPTY, 0, 0);
    let mut nodes = Vec::with_capacity(tree.nodes.len());
    let mut primitives = Vec::with_capacity(tree.primitives.len());
    nodes.push(nothing);
    // Nodes whose place is known, but not what is below.
    let mut open = vec![(0usize, 0usize)];
    while let Some((index, place)) = open.pop() {
        let node = &tree.nodes[index];
        nodes[place] = if node.is_leaf() {
            let first = primitives.len();
            primitives.extend_from_slice(&tree.primitives[node.range()]);
            Node { first: first as u32, ..*node }
        } else {
            let first = nodes.len();
            nodes.resize(first + node.len(), nothing);
            open.extend(node.range().zip(first..first + node.len()).rev());
            Node { first: first as u32, ..*node }
        };
    }
    Tree { nodes, primitives }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Vec3;

    #[test]
    fn subtrees_are_ranges_and_nothing_else_changes() {
        let at = |x: u32| Aabb { lower: Vec3::splat(x as f32), upper: Vec3::splat(x as f32 + 1.0) };
        // Breadth first: 0 over (1, 2), 1 over (3, 4), 2 over (5, 6), 3 over (7, 8).
        let inner = |index: u32, first: u32| Node::inner(at(index), first, 2);
        let leaf = |index: u32, first: u32, count: u32| Node::leaf(at(index), first, count);
        let tree = Tree {
            nodes: vec![
                inner(0, 1),
                inner(1, 3),
                inner(2, 5),
                inner(3, 7),
                leaf(4, 2, 1),
                leaf(5, 0, 2),
                leaf(6, 4, 1),
                leaf(7, 5, 1),
                leaf(8, 3, 1),
            ],
            primitives: vec![10, 11, 12, 13, 14, 15],
        };
        let written = depth_first(tree.view());
        let order: Vec<f32> = written.nodes.iter().map(|node| node.lower.x).collect();
        assert_eq!(order, [0.0, 1.0, 2.0, 3.0, 4.0, 7.0, 8.0, 5.0, 6.0]);
        assert_eq!(written.primitives, [15, 13, 12, 10, 11, 14]);
        assert_eq!(written.nodes[2], inner(2, 7));
        assert_eq!(written.nodes[3], inner(3, 5));
        assert_eq!(written.nodes[7], leaf(5, 3, 2));
    }
}
