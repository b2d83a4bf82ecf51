//! A binary tree that can be changed: parents, boxes, P of every node and the list of every inner one, all kept up to date.
//!
//! [`Working::new`] reads a [`Tree`]; optimisers move subtrees; [`Working::written`] writes it back, depth first. Leaves never change: their
//! boxes are kept as they were (a spatial split clips them to less than their triangles), and inner boxes are the union of
//! their children's. The root keeps number 0.

use super::measure::Measure;
use crate::geometry::padded::{Extent, PaddedAabb};
use crate::tree::{LEAF_BIT, Node as FileNode, Tree};
use rayon::prelude::*;
use std::time::Instant;

/// No parent.
pub const NONE: u32 = u32::MAX;

/// One cache line: a search sees a few dozen nodes all over the tree, and reads everything about each.
#[derive(Clone, Copy, Debug)]
#[repr(align(64))]
pub struct Node<B> {
    pub bounds: B,
    /// P.
    value: f64,
    pub parent: u32,
    /// Inner: both children. Leaf: its first entry of the primitives, and [`LEAF_BIT`] with their number.
    below: [u32; 2],
}

impl<B> Node<B> {
    #[inline(always)]
    pub fn is_leaf(&self) -> bool {
        self.below[1] & LEAF_BIT != 0
    }

    /// Both children of an inner node.
    #[inline(always)]
    pub fn children(&self) -> [u32; 2] {
        debug_assert!(!self.is_leaf());
        self.below
    }

    /// Primitives of a leaf.
    pub fn primitives(&self) -> std::ops::Range<usize> {
        debug_assert!(self.is_leaf());
        let first = self.below[0] as usize;
        first..first + (self.below[1] & !LEAF_BIT) as usize
    }
}

/// A tree that was written back.
pub struct Written {
    pub tree: Tree,
    /// P of every node.
    pub values: Vec<f64>,
    /// Levels; a lone root has depth 1.
    pub depth: usize,
}

impl Written {
    /// T: Σ P over inner nodes.
    pub fn cost(&self) -> f64 {
        let nodes = self.tree.nodes.iter().zip(&self.values);
        nodes.filter(|(node, _)| !node.is_leaf()).map(|(_, value)| value).sum()
    }
}

/// The tree with its measure.
pub struct Working<'m, M: Measure> {
    pub measure: &'m M,
    pub nodes: Vec<Node<M::Bounds>>,
    /// Of every inner node; a leaf's is empty.
    pub lists: Vec<M::List>,
    /// When to stop, for those who want a tree after so many seconds and not always the same one.
    pub deadline: Option<Instant>,
}

impl<'m, M: Measure> Working<'m, M> {
    /// Reads a tree whose inner nodes all have two children.
    pub fn new(tree: &Tree, measure: &'m M) -> Working<'m, M> {
        let node = |node: &FileNode| {
            let (bounds, below) = if node.is_leaf() {
                let primitives = &tree.primitives[node.range()];
                (measure.leaf(node.bounds().into(), primitives), [node.first, node.count])
            } else {
                (M::Bounds::EMPTY, [node.first, node.first + 1])
            };
            Node { bounds, value: 0.0, parent: NONE, below }
        };
        let mut nodes: Vec<Node<M::Bounds>> = tree.nodes.par_iter().map(node).collect();
        for index in (0..nodes.len()).rev() {
            if !nodes[index].is_leaf() {
                let [left, right] = nodes[index].children().map(|child| child as usize);
                nodes[index].bounds = nodes[left].bounds.union(&nodes[right].bounds);
                nodes[left].parent = index as u32;
                nodes[right].parent = index as u32;
            }
        }
        let count = nodes.len();
        let mut working = Working { measure, nodes, lists: vec![M::List::default(); count], deadline: None };
        let list = measure.within(&measure.whole(), &working.nodes[0].bounds);
        working.nodes[0].value = measure.value(&working.nodes[0].bounds, &list);
        working.lists[0] = list;
        // Children stand behind their parents.
        working.recount(0..count as u32);
        working
    }

    /// Makes the lists and P of all nodes from the list of the root. `order` has parents before children.
    fn recount(&mut self, order: impl IntoIterator<Item = u32>) {
        for index in order {
            if self.node(index).is_leaf() {
                self.lists[index as usize] = M::List::default();
                continue;
            }
            for child in self.node(index).children() {
                let bounds = *self.bounds(child);
                let list = self.measure.within(self.list(index), &bounds);
                self.nodes[child as usize].value = self.measure.value(&bounds, &list);
                self.lists[child as usize] = list;
            }
        }
    }

    /// Whether the deadline is over.
    pub fn out_of_time(&self) -> bool {
        self.deadline.is_some_and(|deadline| Instant::now() >= deadline)
    }

    /// Goes back to an earlier state: `nodes` is a copy of this tree's nodes from then.
    pub fn restore(&mut self, nodes: Vec<Node<M::Bounds>>) {
        self.nodes = nodes;
        self.recount(self.order());
    }

    #[inline(always)]
    pub fn node(&self, index: u32) -> &Node<M::Bounds> {
        &self.nodes[index as usize]
    }

    #[inline(always)]
    pub fn bounds(&self, index: u32) -> &M::Bounds {
        &self.nodes[index as usize].bounds
    }

    #[inline(always)]
    pub fn value(&self, index: u32) -> f64 {
        self.node(index).value
    }

    #[inline(always)]
    pub fn list(&self, index: u32) -> &M::List {
        &self.lists[index as usize]
    }

    /// The other child of the parent.
    pub fn sibling(&self, index: u32) -> u32 {
        let [left, right] = self.node(self.node(index).parent).children();
        if left == index { right } else { left }
    }

    /// T: Σ P over inner nodes. Leaves add the same to every tree that an optimiser can make.
    pub fn cost(&self) -> f64 {
        self.nodes.iter().filter(|node| !node.is_leaf()).map(|node| node.value).sum()
    }

    /// P of every node.
    pub fn values(&self) -> Vec<f64> {
        self.nodes.iter().map(|node| node.value).collect()
    }

    /// Hangs `new` where `old` is below `parent`.
    pub fn replace_child(&mut self, parent: u32, old: u32, new: u32) {
        let below = &mut self.nodes[parent as usize].below;
        let side = (below[1] == old) as usize;
        debug_assert_eq!(below[side], old);
        below[side] = new;
        self.nodes[new as usize].parent = parent;
    }

    /// Makes `parent` the parent of both.
    pub fn adopt(&mut self, parent: u32, children: [u32; 2]) {
        self.nodes[parent as usize].below = children;
        for child in children {
            self.nodes[child as usize].parent = parent;
        }
    }

    /// Gives an inner node a new box; `list` is its list. Returns the old list.
    pub fn set(&mut self, index: u32, bounds: M::Bounds, list: M::List) -> M::List {
        let node = &mut self.nodes[index as usize];
        (node.bounds, node.value) = (bounds, self.measure.value(&bounds, &list));
        std::mem::replace(&mut self.lists[index as usize], list)
    }

    /// Union of the children's boxes.
    pub fn union(&self, [left, right]: [u32; 2]) -> M::Bounds {
        self.bounds(left).union(self.bounds(right))
    }

    /// The tree as builders return it: siblings adjacent, below a pair the whole left subtree, then the whole right one, primitives in
    /// the order of their leaves. `primitives` are those of the tree that was read.
    pub fn written(&self, primitives: &[u32]) -> Written {
        let mut tree = Tree {
            nodes: Vec::with_capacity(self.nodes.len()),
            primitives: Vec::with_capacity(primitives.len()),
        };
        let mut values = Vec::with_capacity(self.nodes.len());
        values.push(self.value(0));
        tree.nodes.push(FileNode::inner(PaddedAabb::EMPTY.into(), 0, 0));
        // Nodes whose place is known, but not what is below.
        let mut places = vec![(0u32, 0usize, 1usize)];
        let mut depth = 0;
        while let Some((index, place, level)) = places.pop() {
            depth = depth.max(level);
            let node = self.node(index);
            tree.nodes[place] = if node.is_leaf() {
                let first = tree.primitives.len();
                tree.primitives.extend_from_slice(&primitives[node.primitives()]);
                FileNode::leaf(M::one(&node.bounds).into(), first as u32, node.primitives().len() as u32)
            } else {
                let first = tree.nodes.len();
                let [left, right] = node.children();
                tree.nodes.extend([FileNode::inner(PaddedAabb::EMPTY.into(), 0, 0); 2]);
                values.extend([self.value(left), self.value(right)]);
                places.extend([(right, first + 1, level + 1), (left, first, level + 1)]);
                FileNode::inner(M::one(&node.bounds).into(), first as u32, 2)
            };
        }
        Written { tree, values, depth }
    }
}

/// Several subtrees, taken out so that each can be changed on its own thread, and put back.
impl<'m, M: Measure> Working<'m, M> {
    /// Disjoint subtrees that together hold all but the top of the tree, each with no more than a 64th of the leaves' and lists' work (unless it is
    /// a single leaf). The choice does not depend on threads. Returns the roots of the subtrees and the inner nodes above them, parents first.
    pub fn cut(&self) -> (Vec<u32>, Vec<u32>) {
        let mut below = vec![0u64; self.nodes.len()];
        let order = self.order();
        for &index in order.iter().rev() {
            let node = self.node(index);
            below[index as usize] = if node.is_leaf() {
                1
            } else {
                let [left, right] = node.children();
                self.measure.work(self.list(index)) + below[left as usize] + below[right as usize]
            };
        }
        let limit = below[0] / 64;
        let (mut roots, mut top) = (Vec::new(), Vec::new());
        let mut open = vec![0u32];
        while let Some(index) = open.pop() {
            if self.node(index).is_leaf() {
                continue;
            }
            if below[index as usize] <= limit {
                roots.push(index);
            } else {
                top.push(index);
                open.extend(self.node(index).children());
            }
        }
        (roots, top)
    }

    /// All nodes, parents before children.
    pub fn order(&self) -> Vec<u32> {
        let mut order = Vec::with_capacity(self.nodes.len());
        order.push(0);
        let mut next = 0;
        while let Some(&index) = order.get(next) {
            if !self.node(index).is_leaf() {
                order.extend(self.node(index).children());
            }
            next += 1;
        }
        order
    }

    /// Does `work` on each of the disjoint subtrees below `roots`, a tree of its own meanwhile, on the threads of the current rayon pool.
    /// `work` is also told which of them it has; what it returns comes in their order.
    pub fn apart<T: Send>(&mut self, roots: &[u32], work: impl Fn(usize, &mut Self) -> T + Sync) -> Vec<T> {
        let mut subtrees: Vec<_> = roots.iter().map(|&root| self.take(root)).collect();
        let done =
            subtrees.par_iter_mut().enumerate().map(|(number, (subtree, _))| work(number, subtree)).collect();
        for (subtree, numbers) in subtrees {
            self.put_back(subtree, &numbers);
        }
        done
    }

    /// Takes the subtree below `root` out as a tree of its own, whose node i was `numbers[i]`. Its lists are moved, and
    /// must come back by [`Self::put_back`] before this tree is used again below `root`.
    fn take(&mut self, root: u32) -> (Working<'m, M>, Vec<u32>) {
        let mut numbers = vec![root];
        let mut nodes = Vec::new();
        while let Some(&number) = numbers.get(nodes.len()) {
            let mut node = *self.node(number);
            if !node.is_leaf() {
                let first = numbers.len() as u32;
                numbers.extend(node.children());
                node.below = [first, first + 1];
            }
            nodes.push(node);
        }
        for index in 0..nodes.len() {
            if !nodes[index].is_leaf() {
                for child in nodes[index].children() {
                    nodes[child as usize].parent = index as u32;
                }
            }
        }
        nodes[0].parent = NONE;
        let lists = numbers.iter().map(|&number| std::mem::take(&mut self.lists[number as usize])).collect();
        (Working { measure: self.measure, nodes, lists, deadline: self.deadline }, numbers)
    }

    /// Puts a subtree back where it was.
    fn put_back(&mut self, subtree: Working<'m, M>, numbers: &[u32]) {
        let parent = self.node(numbers[0]).parent;
        let Working { nodes, lists, .. } = subtree;
        for ((node, list), &number) in nodes.into_iter().zip(lists).zip(numbers) {
            let mut node = node;
            if !node.is_leaf() {
                node.below = node.below.map(|child| numbers[child as usize]);
            }
            node.parent = numbers.get(node.parent as usize).copied().unwrap_or(parent);
            self.nodes[number as usize] = node;
            self.lists[number as usize] = list;
        }
    }
}
