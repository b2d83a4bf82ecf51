//! Refitting: every box anew from the triangles, bottom up, the tree otherwise as it was (Wald, Boulos and Shirley 2007; paper, section 2.5).

use super::Moving;
use crate::geometry::{Aabb, Triangle};
use crate::tree::Node;
use rayon::prelude::*;

/// The box around a leaf's triangles.
#[inline(always)]
pub(super) fn leaf(node: &Node, primitives: &[u32], triangles: &[Triangle]) -> Aabb {
    let triangles = primitives[node.range()].iter().map(|&index| &triangles[index as usize]);
    triangles.fold(Aabb::EMPTY, |sum, triangle| sum.union(&triangle.bounds()))
}

#[inline(always)]
pub(super) fn set(node: &mut Node, bounds: Aabb) {
    (node.lower, node.upper) = (bounds.lower, bounds.upper);
}

/// The box around nodes.
#[inline(always)]
fn around(nodes: &[Node]) -> Aabb {
    nodes.iter().fold(Aabb::EMPTY, |sum, node| sum.union(&node.bounds()))
}

impl Moving {
    /// Makes every box hold its triangles again, and nothing more, on the threads of the current rayon pool. Leaves of spatial splits, whose
    /// boxes were clipped, hold their triangles whole afterwards: where the cuts would be now, nobody knows.
    ///
    /// # Panics
    /// When there are fewer triangles than the tree names.
    pub fn refit(&mut self, triangles: &[Triangle]) {
        self.put_in_order();
        let (nodes, primitives) = (&mut self.tree.nodes, &self.tree.primitives[..]);
        let children: Vec<usize> =
            self.cut.pieces.iter().map(|(root, _)| nodes[*root as usize].len()).collect();
        let pieces = self.cut.slices(nodes).into_par_iter().zip(&self.cut.pieces).zip(children);
        let boxes: Vec<Aabb> = pieces
            .map(|((nodes, (_, range)), children)| {
                // Children stand behind their parents.
                for place in (0..nodes.len()).rev() {
                    let node = nodes[place];
                    let bounds = if node.is_leaf() {
                        leaf(&node, primitives, triangles)
                    } else {
                        let first = node.first as usize - range.start;
                        around(&nodes[first..first + node.len()])
                    };
                    set(&mut nodes[place], bounds);
                }
                // The root's children are the first of what is below it.
                around(&nodes[..children])
            })
            .collect();
        for ((root, _), bounds) in self.cut.pieces.iter().zip(boxes) {
            set(&mut nodes[*root as usize], bounds);
        }
        for &index in self.cut.top.iter().rev() {
            let node = nodes[index as usize];
            let bounds = if node.is_leaf() {
                leaf(&node, primitives, triangles)
            } else {
                around(&nodes[node.range()])
            };
            set(&mut nodes[index as usize], bounds);
        }
    }
}
