//! Leaves of several primitives, made from a finished tree where they cost less.
//!
//! Optimisers move leaves about and gain most when each holds one reference; afterwards [`merge_leaves`] decides, from the bottom up, which
//! subtrees are better tested as a list. That choice is the best for the topology, as the one that builders make themselves.

use super::{Node, Tree};

/// Turns subtrees over at most `max_leaf` different triangles into leaves, where that does not raise the SAH cost:
/// `c_p` · P · triangles for a leaf, `c_i` · P · children and what is below for an inner node. `probabilities` has P of every node. A
/// triangle of which several parts come to one leaf stands in it once.
pub fn merge_leaves(tree: &Tree, probabilities: &[f64], c_i: f64, c_p: f64, max_leaf: usize) -> Tree {
    // Different triangles below a node, in ascending order, as a range of `members`; none when there are too many.
    let mut members: Vec<u32> = Vec::new();
    let mut below: Vec<Option<std::ops::Range<usize>>> = vec![None; tree.nodes.len()];
    let mut costs = vec![0.0; tree.nodes.len()];
    let mut merged = vec![false; tree.nodes.len()];
    // Children stand behind their parents.
    for (index, node) in tree.nodes.iter().enumerate().rev() {
        let first = members.len();
        if node.is_leaf() {
            members.extend_from_slice(&tree.primitives[node.range()]);
        } else {
            costs[index] =
                c_i * node.len() as f64 * probabilities[index] + costs[node.range()].iter().sum::<f64>();
            if below[node.range()].iter().any(Option::is_none) {
                continue;
            }
            for child in node.range() {
                if let Some(range) = below[child].clone() {
                    members.extend_from_within(range);
                }
            }
        }
        let distinct = sort_and_dedup(&mut members, first);
        if node.is_leaf() {
            costs[index] = c_p * node.len() as f64 * probabilities[index];
        }
        if distinct > max_leaf {
            members.truncate(first);
            continue;
        }
        below[index] = Some(first..members.len());
        let as_leaf = c_p * distinct as f64 * probabilities[index];
        if !node.is_leaf() && as_leaf <= costs[index] {
            merged[index] = true;
            costs[index] = as_leaf;
        }
    }
    copied(tree, |index| if merged[index] { below[index].clone().map(|range| &members[range]) } else { None })
}

/// Brings what is behind `first` in ascending order, each once; returns how many are left.
fn sort_and_dedup(members: &mut Vec<u32>, first: usize) -> usize {
    members[first..].sort_unstable();
    let mut end = first;
    for place in first..members.len() {
        if end == first || members[end - 1] != members[place] {
            members[end] = members[place];
            end += 1;
        }
    }
    members.truncate(end);
    end - first
}

/// The tree in the layout of builders (siblings adjacent, below a pair the whole left subtree, then the right one), with
/// leaves over the triangles that `leaf` gives for some inner nodes.
fn copied<'a>(tree: &'a Tree, leaf: impl Fn(usize) -> Option<&'a [u32]>) -> Tree {
    let mut out = Tree { nodes: Vec::new(), primitives: Vec::with_capacity(tree.primitives.len()) };
    out.nodes.push(tree.nodes[0]);
    // Nodes that have a place, but not what is below.
    let mut open = vec![(0, 0)];
    while let Some((from, to)) = open.pop() {
        let node = tree.nodes[from];
        let primitives = if node.is_leaf() { Some(&tree.primitives[node.range()]) } else { leaf(from) };
        if let Some(primitives) = primitives {
            out.nodes[to] = Node::leaf(node.bounds(), out.primitives.len() as u32, primitives.len() as u32);
            out.primitives.extend_from_slice(primitives);
        } else {
            let first = out.nodes.len();
            out.nodes[to].first = first as u32;
            out.nodes.extend_from_slice(&tree.nodes[node.range()]);
            open.extend(node.range().zip(first..first + node.len()).rev());
        }
    }
    out
}
