//! Refitting with tree rotations in the same pass: Kopta, Ize, Spjut, Brunvand, Davis and Kensler, "Fast, Effective BVH Updates for Animated
//! Scenes", I3D 2012 (the technical report of 2011 is the paper's [5]).
//!
//! Bottom up, each inner node first gets its box, then at most one rotation: a child changes places with a grandchild below the other child, or two
//! grandchildren below different children do, whichever shrinks the children's boxes most in surface area. Time is linear, and
//! nothing is stored beside the tree: nodes change places in the array, and what is below them stays where it is. Subtrees that threads took
//! side by side keep their nodes to themselves; their roots may change places.
//!
//! With rays for the probability, [`super::policy`] refits and then asks [`crate::optimize::rotations`], which keeps lists of rays.

use super::Moving;
use super::refit::{leaf, set};
use crate::builder::MAX_DEPTH;
use crate::geometry::padded::PaddedAabb;
use crate::geometry::{Aabb, Triangle};
use crate::tree::Node;
use glam::Vec4Swizzles;
use rayon::prelude::*;

/// A rotation has to shrink the boxes by this share of the node's own area: less is rounding.
const WORTHWHILE: f32 = 1e-4;

/// Half the surface area of a box that is not empty.
#[inline(always)]
fn half_area(bounds: &PaddedAabb) -> f32 {
    let e = bounds.upper - bounds.lower;
    // The fourth lane is 0.
    e.dot(e.yzxw())
}

#[inline(always)]
fn padded(node: &Node) -> PaddedAabb {
    node.bounds().into()
}

/// What a visit found.
#[derive(Clone, Copy)]
struct Visited {
    /// Levels of the subtree, or more: those of grandchildren that changed places are not known.
    height: usize,
    rotations: usize,
}

/// Nodes that are visited together: all below one node, or the top of the tree.
struct Pass<'a> {
    nodes: &'a mut [Node],
    /// The number of the first of them.
    base: usize,
    primitives: &'a [u32],
    triangles: &'a [Triangle],
    /// Roots of subtrees that were visited before. They may change places, but nothing below them does: it stays a range of nodes.
    done: Vec<(u32, Visited)>,
}

impl Pass<'_> {
    /// Gives the subtree of a node its boxes, and rotates in it. `level` is that of the node, the root's being 1.
    fn visit(&mut self, index: usize, level: usize) -> Visited {
        if let Some((_, visited)) = self.done.iter().find(|(root, _)| *root as usize == index) {
            return *visited;
        }
        let node = self.nodes[index - self.base];
        if node.is_leaf() {
            set(&mut self.nodes[index - self.base], leaf(&node, self.primitives, self.triangles));
            return Visited { height: 1, rotations: 0 };
        }
        let below = self.below(&node, level);
        let [left, right] = self.children(&node).map(|child| self.nodes[child].bounds());
        set(&mut self.nodes[index - self.base], left.union(&right));
        below
    }

    /// Visits both children of a node, and rotates there.
    #[inline(always)]
    fn below(&mut self, node: &Node, level: usize) -> Visited {
        let first = node.first as usize;
        let [left, right] = [self.visit(first, level + 1), self.visit(first + 1, level + 1)];
        let heights = [left.height, right.height];
        let rotations = left.rotations + right.rotations;
        match self.rotate(node, heights, level) {
            Some(height) => Visited { height, rotations: rotations + 1 },
            None => Visited { height: 1 + heights[0].max(heights[1]), rotations },
        }
    }

    /// Places of a node's children.
    #[inline(always)]
    fn children(&self, node: &Node) -> [usize; 2] {
        let first = node.first as usize - self.base;
        [first, first + 1]
    }

    /// The best rotation at a node whose children have the `heights`. Returns the node's height afterwards when there was one.
    #[inline(always)]
    fn rotate(&mut self, node: &Node, heights: [usize; 2], level: usize) -> Option<usize> {
        let children = self.children(node);
        let bounds = children.map(|child| padded(&self.nodes[child]));
        let areas = bounds.each_ref().map(half_area);
        let grandchildren = children.map(|place| {
            let child = self.nodes[place];
            let closed = self.done.iter().any(|(root, _)| *root as usize == place + self.base);
            (!child.is_leaf() && !closed).then(|| self.children(&child))
        });
        let grown = |a: &PaddedAabb, b: usize| half_area(&a.union(&padded(&self.nodes[b])));
        let highest = 1 + heights[0].max(heights[1]);
        let (mut best, mut exchange) = (0.0, None);
        for side in 0..2 {
            // A child goes below its sibling, one of whose children comes up: the child's subtree ends a level deeper.
            let Some(pair) = grandchildren[1 - side] else { continue };
            if level + 1 + heights[side] >= MAX_DEPTH {
                continue;
            }
            for number in 0..2 {
                let gain = areas[1 - side] - grown(&bounds[side], pair[1 - number]);
                if gain > best {
                    (best, exchange) =
                        (gain, Some(([children[side], pair[number]], highest.max(2 + heights[side]))));
                }
            }
        }
        if let [Some(left), Some(right)] = grandchildren {
            for number in 0..2 {
                let boxes = [left[1], left[0]].map(|place| padded(&self.nodes[place]));
                let gain = areas[0] + areas[1]
                    - grown(&boxes[0], right[number])
                    - grown(&boxes[1], right[1 - number]);
                if gain > best {
                    (best, exchange) = (gain, Some(([left[0], right[number]], highest)));
                }
            }
        }
        let whole = half_area(&bounds[0].union(&bounds[1]));
        let ([a, b], height) = exchange.filter(|_| best > WORTHWHILE * whole)?;
        self.nodes.swap(a, b);
        for (root, _) in &mut self.done {
            // Closed subtrees keep their places in this list, whatever node they hang from now.
            let place = *root as usize - self.base;
            let place = if place == a {
                b
            } else if place == b {
                a
            } else {
                place
            };
            *root = (place + self.base) as u32;
        }
        for child in children {
            let node = self.nodes[child];
            let closed = self.done.iter().any(|(root, _)| *root as usize == child + self.base);
            if !node.is_leaf() && !closed {
                let [left, right] = self.children(&node).map(|place| self.nodes[place].bounds());
                set(&mut self.nodes[child], left.union(&right));
            }
        }
        Some(height)
    }
}

impl Moving {
    /// Refits, and rotates at every node at most once, on the threads of the current rayon pool. Returns how many rotations there were. The tree
    /// does not depend on the number of threads, and stays within [`MAX_DEPTH`] levels if it was.
    ///
    /// # Panics
    /// When a node has not two children, or there are fewer triangles than the tree names.
    pub fn rotate(&mut self, triangles: &[Triangle]) -> usize {
        let (nodes, primitives) = (&mut self.tree.nodes, &self.tree.primitives[..]);
        let levels = self.cut.levels(nodes);
        let roots: Vec<Node> = self.cut.pieces.iter().map(|(root, _)| nodes[*root as usize]).collect();
        let pieces = self.cut.slices(nodes).into_par_iter().zip(&self.cut.pieces).zip(roots).zip(levels);
        let visited: Vec<(Visited, Aabb)> = pieces
            .map(|(((nodes, (_, range)), root), level)| {
                let mut pass = Pass { nodes, base: range.start, primitives, triangles, done: Vec::new() };
                let visited = pass.below(&root, level);
                let [left, right] = pass.children(&root).map(|child| pass.nodes[child].bounds());
                (visited, left.union(&right))
            })
            .collect();
        let mut done = Vec::with_capacity(visited.len());
        for ((root, _), (visited, bounds)) in self.cut.pieces.iter().zip(visited) {
            set(&mut nodes[*root as usize], bounds);
            done.push((*root, visited));
        }
        let mut pass = Pass { nodes, base: 0, primitives, triangles, done };
        let rotations = pass.visit(0, 1).rotations;
        for ((root, _), (now, _)) in self.cut.pieces.iter_mut().zip(pass.done) {
            *root = now;
        }
        self.ordered &= rotations == 0;
        rotations
    }
}
