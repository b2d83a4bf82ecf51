//! Walking about in a tree: up, down, to a sibling, to the leaf of a triangle, and what is below a node.
//!
//! A [`Walk`] knows the parents and the places of the triangles of one tree, and answers for any node; a [`Cursor`] stands
//! at one node and remembers where it came from. Trees may be binary or wide, and as deep as they have nodes: nothing recurses.

use crate::tree::TreeView;
use crate::tree::places::Places;
use std::ops::Range;

/// The parent of the root.
const NONE: u32 = u32::MAX;

/// A tree with the way back up. Takes 4 bytes a node, and what [`Places`] take.
#[derive(Clone, Debug)]
pub struct Walk<'a> {
    tree: TreeView<'a>,
    parents: Vec<u32>,
    places: Places,
}

impl<'a> Walk<'a> {
    /// Of a tree over `triangles` triangles, whose indices have been checked.
    pub fn new(tree: TreeView<'a>, triangles: usize) -> Walk<'a> {
        let mut parents = vec![NONE; tree.nodes.len()];
        for (index, node) in tree.nodes.iter().enumerate().filter(|(_, node)| !node.is_leaf()) {
            parents[node.range()].fill(index as u32);
        }
        Walk { tree, parents, places: Places::of(tree, triangles) }
    }

    pub fn tree(&self) -> TreeView<'a> {
        self.tree
    }

    pub fn places(&self) -> &Places {
        &self.places
    }

    /// None of the root.
    #[inline]
    pub fn parent(&self, node: u32) -> Option<u32> {
        let parent = self.parents[node as usize];
        (parent != NONE).then_some(parent)
    }

    /// None of a leaf.
    #[inline]
    pub fn children(&self, node: u32) -> Range<u32> {
        let node = &self.tree.nodes[node as usize];
        if node.is_leaf() { 0..0 } else { node.first..node.first + node.count }
    }

    /// Which of its parent's children a node is; 0 for the root.
    pub fn number(&self, node: u32) -> u32 {
        self.parent(node).map_or(0, |parent| node - self.tree.nodes[parent as usize].first)
    }

    /// The node `steps` to the right among its siblings, round about; of the root, the root.
    pub fn sibling(&self, node: u32, steps: i64) -> u32 {
        let Some(parent) = self.parent(node) else { return node };
        let siblings = self.children(parent);
        let place = i64::from(node - siblings.start) + steps;
        siblings.start + place.rem_euclid(siblings.len() as i64) as u32
    }

    /// From a node up to the root, the node itself first.
    pub fn upwards(&self, node: u32) -> impl Iterator<Item = u32> {
        std::iter::successors(Some(node), |&node| self.parent(node))
    }

    /// From the root down to a node, both included.
    pub fn path(&self, node: u32) -> Vec<u32> {
        let mut path: Vec<u32> = self.upwards(node).collect();
        path.reverse();
        path
    }

    /// The level of a node; the root's is 0.
    pub fn level(&self, node: u32) -> usize {
        self.upwards(node).count() - 1
    }

    /// The nodes `levels` below a node, from left to right, at most `most`: with 0, the node itself. Leaves on the way are not among them.
    pub fn below(&self, node: u32, levels: usize, most: usize) -> Vec<u32> {
        let mut found = Vec::new();
        let mut open = vec![(node, levels)];
        while let Some((node, levels)) = open.pop()
            && found.len() < most
        {
            if levels == 0 {
                found.push(node);
            } else {
                open.extend(self.children(node).rev().map(|child| (child, levels - 1)));
            }
        }
        found
    }

    /// The triangles in the leaves below a node, leaves from left to right: one that has several leaves, several times.
    #[inline]
    pub fn triangles(&self, node: u32) -> &[u32] {
        &self.places.triangles()[self.places.below(node as usize)]
    }

    /// The leaves that hold a triangle, from left to right.
    pub fn leaves_of(&self, triangle: u32) -> impl Iterator<Item = u32> {
        self.places.of_triangle(triangle).iter().map(|&place| self.leaf_at(place))
    }

    /// The leaf that has a place.
    fn leaf_at(&self, place: u32) -> u32 {
        let mut node = 0;
        loop {
            let mut children = self.children(node);
            let next = children.find(|&child| self.places.below(child as usize).contains(&(place as usize)));
            match next {
                Some(child) => node = child,
                None => return node,
            }
        }
    }

    /// The lowest node that has both below it, or is one of them.
    pub fn common(&self, a: u32, b: u32) -> u32 {
        // Parents stand before their children.
        let (mut a, mut b) = (a, b);
        while a != b {
            let lower = a.max(b);
            let up = self.parent(lower).unwrap_or(0);
            if lower == a { a = up } else { b = up }
        }
        a
    }
}

/// A place in a tree: one node, and the way down that was last taken.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Cursor {
    /// From the root to the node, and on to where it came up from.
    trail: Vec<u32>,
    /// How many of them lead to the node.
    length: usize,
}

impl Default for Cursor {
    /// At the root.
    fn default() -> Cursor {
        Cursor { trail: vec![0], length: 1 }
    }
}

impl Cursor {
    pub fn node(&self) -> u32 {
        self.trail[self.length - 1]
    }

    /// From the root down to the node, both included.
    pub fn path(&self) -> &[u32] {
        &self.trail[..self.length]
    }

    /// Goes to any node.
    pub fn go(&mut self, walk: &Walk, node: u32) {
        let path = walk.path(node);
        if !self.trail.starts_with(&path) {
            self.trail = path;
            self.length = self.trail.len();
        } else {
            self.length = path.len();
        }
    }

    /// Goes to child `number` (0 the left one, 1 the right one of a binary tree), if there is one; false when there is not.
    pub fn child(&mut self, walk: &Walk, number: u32) -> bool {
        let Some(child) = walk.children(self.node()).nth(number as usize) else { return false };
        self.trail.truncate(self.length);
        self.trail.push(child);
        self.length += 1;
        true
    }

    /// Goes back down to where it came up from, else to the first child; false at a leaf.
    pub fn down(&mut self, walk: &Walk) -> bool {
        if self.length < self.trail.len() {
            self.length += 1;
            return true;
        }
        self.child(walk, 0)
    }

    /// Goes to the parent; false at the root.
    pub fn up(&mut self) -> bool {
        let is_root = self.length == 1;
        self.length -= usize::from(!is_root);
        !is_root
    }

    /// Goes `steps` to the right among the siblings, round about; false when there is none.
    pub fn sideways(&mut self, walk: &Walk, steps: i64) -> bool {
        let (from, to) = (self.node(), walk.sibling(self.node(), steps));
        if to != from {
            self.trail.truncate(self.length);
            self.trail[self.length - 1] = to;
        }
        to != from
    }

    /// Goes to a leaf that holds the triangle: the next one, when it stands at one already; false when there is none.
    pub fn leaf_of(&mut self, walk: &Walk, triangle: u32) -> bool {
        let leaves: Vec<u32> = walk.leaves_of(triangle).collect();
        let here = leaves.iter().position(|&leaf| leaf == self.node());
        let next = here.map_or(0, |here| (here + 1) % leaves.len());
        leaves.get(next).map(|&leaf| self.go(walk, leaf)).is_some()
    }
}
