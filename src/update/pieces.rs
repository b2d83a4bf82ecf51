//! A depth-first tree cut into subtrees that threads can change side by side, and the few nodes above them.
//!
//! The nodes below a subtree's root are one range of the tree's nodes, so each thread gets its own slice. The cut does not depend on the
//! number of threads.

use crate::tree::Node;
use std::ops::Range;

/// Subtrees have at most this share of all nodes.
const PIECES: usize = 64;
/// Or so few: a task has to be worth its start.
const SMALL: usize = 512;

/// The cut.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Cut {
    /// Roots of subtrees, in the order of what is below them, and the range of that.
    pub pieces: Vec<(u32, Range<usize>)>,
    /// All nodes that are in no piece and no piece's root, parents before children.
    pub top: Vec<u32>,
}

impl Cut {
    /// Cuts a tree in depth-first order.
    pub fn of(nodes: &[Node]) -> Cut {
        let limit = (nodes.len() / PIECES).max(SMALL);
        let mut cut = Cut::default();
        let mut open = vec![0u32];
        while let Some(index) = open.pop() {
            let node = &nodes[index as usize];
            let below = node.first as usize..end(nodes, node);
            if !node.is_leaf() && below.len() <= limit {
                cut.pieces.push((index, below));
            } else {
                cut.top.push(index);
                if !node.is_leaf() {
                    open.extend(node.range().map(|child| child as u32).rev());
                }
            }
        }
        cut
    }

    /// The level of each piece's root; that of the tree's is 1.
    pub fn levels(&self, nodes: &[Node]) -> Vec<usize> {
        let mut levels = vec![0; self.pieces.len()];
        let mut open = vec![(0u32, 1)];
        let place: std::collections::HashMap<u32, usize> =
            self.pieces.iter().enumerate().map(|(place, (root, _))| (*root, place)).collect();
        while let Some((index, level)) = open.pop() {
            let node = &nodes[index as usize];
            match place.get(&index) {
                Some(&place) => levels[place] = level,
                None if !node.is_leaf() => open.extend(node.range().map(|child| (child as u32, level + 1))),
                None => {}
            }
        }
        levels
    }

    /// The nodes below each piece's root.
    pub fn slices<'a>(&self, mut nodes: &'a mut [Node]) -> Vec<&'a mut [Node]> {
        let mut passed = 0;
        let mut slices = Vec::with_capacity(self.pieces.len());
        for (_, range) in &self.pieces {
            let (_, rest) = nodes.split_at_mut(range.start - passed);
            let (slice, rest) = rest.split_at_mut(range.len());
            slices.push(slice);
            (nodes, passed) = (rest, range.end);
        }
        slices
    }
}

/// Behind the last node below an inner one; anything for a leaf.
fn end(nodes: &[Node], node: &Node) -> usize {
    let mut node = node;
    loop {
        if node.is_leaf() {
            return node.first as usize;
        }
        // The last child that has something below it ends last; when none has, the children do.
        match nodes[node.range()].iter().rev().find(|child| !child.is_leaf()) {
            Some(child) => node = child,
            None => return node.range().end,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::builder::{self, Config};
    use crate::geometry::{Triangle, Vec3};
    use crate::progress::Progress;
    use crate::random::Random;

    #[test]
    fn every_node_is_in_one_place() {
        let mut random = Random::new(4);
        for count in [1, 2, 300, 5000, 60_000] {
            let triangles: Vec<Triangle> = (0..count)
                .map(|_| Triangle([0; 3].map(|_| Vec3::from_array([0; 3].map(|_| random.unit())))))
                .collect();
            let mut tree = builder::build(&triangles, &Config::default(), &Progress::hidden()).unwrap();
            let cut = Cut::of(&tree.nodes);
            let mut seen = vec![0; tree.nodes.len()];
            for index in cut.top.iter().chain(cut.pieces.iter().map(|(root, _)| root)) {
                seen[*index as usize] += 1;
            }
            for (root, range) in &cut.pieces {
                seen[range.clone()].iter_mut().for_each(|seen| *seen += 1);
                // All that is below, and nothing else.
                for index in range.clone().chain([*root as usize]) {
                    let node = &tree.nodes[index];
                    assert!(
                        node.is_leaf()
                            || (range.start <= node.first as usize && node.range().end <= range.end)
                    );
                }
            }
            assert!(seen.iter().all(|seen| *seen == 1), "{count}");
            let lengths: Vec<usize> = cut.pieces.iter().map(|(_, range)| range.len()).collect();
            let slices = cut.slices(&mut tree.nodes);
            assert_eq!(slices.iter().map(|slice| slice.len()).collect::<Vec<_>>(), lengths);
            assert!(count < 60_000 || cut.pieces.len() >= 32);
        }
    }
}
