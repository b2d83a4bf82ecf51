//! The tree that everything else builds, changes, traverses and measures.
//!
//! A builder returns a [`Tree`], a `.bvh` file is viewed as a [`TreeView`]; both have the same nodes, byte for
//! byte those of the `NODE` section, so that nothing is converted between file and use.

pub mod binary;
pub mod collapse;
pub mod depth_first;
pub mod epo;
pub mod leaves;
pub mod likely;
pub mod places;
pub mod statistics;
pub mod validate;

use crate::geometry::{Aabb, Vec3};
use bytemuck::{Pod, Zeroable};

/// Set in [`Node::count`] of a leaf.
pub const LEAF_BIT: u32 = 1 << 31;

/// One node, as it stands in a `.bvh`: 32 bytes, two to a cache line.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Node {
    pub lower: Vec3,
    /// Inner node: index of the first of `count` adjacent children, greater than the node's own index.
    /// Leaf: index of its first entry of `primitives`.
    pub first: u32,
    pub upper: Vec3,
    /// Number of children, or [`LEAF_BIT`] and the number of primitives.
    pub count: u32,
}

impl Node {
    /// An inner node over `count` children from `first`.
    pub fn inner(bounds: Aabb, first: u32, count: u32) -> Node {
        Node { lower: bounds.lower, first, upper: bounds.upper, count }
    }

    /// A leaf over `count` primitives from `first`.
    pub fn leaf(bounds: Aabb, first: u32, count: u32) -> Node {
        Node { lower: bounds.lower, first, upper: bounds.upper, count: count | LEAF_BIT }
    }

    #[inline]
    pub fn is_leaf(&self) -> bool {
        self.count & LEAF_BIT != 0
    }

    /// Children of an inner node, or primitives of a leaf.
    #[inline]
    pub fn len(&self) -> usize {
        (self.count & !LEAF_BIT) as usize
    }

    /// Whether there is neither child nor primitive below: only the root of an empty scene's tree.
    #[inline]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The indices below: of nodes for an inner node, of `primitives` for a leaf.
    #[inline]
    pub fn range(&self) -> std::ops::Range<usize> {
        self.first as usize..self.first as usize + self.len()
    }

    #[inline]
    pub fn bounds(&self) -> Aabb {
        Aabb { lower: self.lower, upper: self.upper }
    }
}

/// A tree that owns its nodes. Node 0 is the root; there is always one (an empty leaf when there is no primitive).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Tree {
    pub nodes: Vec<Node>,
    /// Triangle indices in leaf order. A triangle may stand in several leaves after spatial splits.
    pub primitives: Vec<u32>,
}

impl Tree {
    pub fn view(&self) -> TreeView<'_> {
        TreeView { nodes: &self.nodes, primitives: &self.primitives }
    }
}

/// A tree borrowed from a [`Tree`] or from a mapped file. Whoever makes one has checked its indices
/// (see [`crate::format::bvh`]); what reads one may rely on it.
#[derive(Clone, Copy, Debug)]
pub struct TreeView<'a> {
    pub nodes: &'a [Node],
    pub primitives: &'a [u32],
}

impl TreeView<'_> {
    /// The level of each node; the root's is 0.
    pub fn levels(&self) -> Vec<u32> {
        let mut levels = vec![0; self.nodes.len()];
        // Children stand behind their parent, so a node's level is known when it is reached.
        for (index, node) in self.nodes.iter().enumerate().filter(|(_, node)| !node.is_leaf()) {
            let below = levels[index] + 1;
            levels[node.range()].fill(below);
        }
        levels
    }
}
