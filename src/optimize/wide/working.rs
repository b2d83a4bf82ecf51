//! A wide tree that can be taken apart: every node owns what is below it, so that subtrees can be changed on different threads, and every
//! reference to a triangle keeps its own box, which after a spatial split is smaller than the triangle's.

use super::likelihood::Likelihood;
use crate::cost::Constants;
use crate::geometry::Triangle;
use crate::geometry::padded::PaddedAabb;
use crate::tree::{Node as FileNode, Tree, TreeView};
use rayon::prelude::*;

/// What trees may look like, and what things cost.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Prices {
    /// Most children of a node.
    pub width: usize,
    /// Most references of a leaf that is made here. Leaves that are larger already may stay.
    pub max_leaf: usize,
    /// A visit of an inner node.
    pub visit: f64,
    /// A visit of a leaf.
    pub leaf: f64,
    /// A block of triangles.
    pub block: f64,
}

/// Triangles of a block.
pub const LANES: usize = 4;

impl Prices {
    /// With costs of `constants`.
    pub fn new(width: usize, max_leaf: usize, constants: &Constants) -> Prices {
        let Constants { visit, leaf, block, .. } = *constants;
        Prices { width, max_leaf, visit, leaf, block }
    }

    /// What a leaf of so many references costs, P times.
    #[inline]
    pub fn of_leaf(&self, p: f64, references: usize) -> f64 {
        p * (self.leaf + self.block * references.div_ceil(LANES) as f64)
    }
}

/// A triangle, or the part of it that a spatial split left in a leaf.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reference {
    pub bounds: PaddedAabb,
    pub triangle: u32,
}

#[derive(Clone, Debug, PartialEq)]
pub enum Below {
    Inner(Vec<Node>),
    Leaf(Vec<Reference>),
}

/// A subtree.
#[derive(Clone, Debug, PartialEq)]
pub struct Node {
    pub bounds: PaddedAabb,
    pub p: f64,
    /// Of the subtree.
    pub cost: f64,
    pub below: Below,
}

/// A tree with more rays than this at a node is worth several threads there.
pub const PARALLEL: usize = 256;

impl Node {
    /// A leaf, with its cost.
    pub fn leaf(bounds: PaddedAabb, p: f64, references: Vec<Reference>, prices: &Prices) -> Node {
        let cost = prices.of_leaf(p, references.len());
        Node { bounds, p, cost, below: Below::Leaf(references) }
    }

    /// An inner node over finished children.
    pub fn inner(bounds: PaddedAabb, p: f64, children: Vec<Node>, prices: &Prices) -> Node {
        let cost = p * prices.visit + children.iter().map(|child| child.cost).sum::<f64>();
        Node { bounds, p, cost, below: Below::Inner(children) }
    }

    pub fn is_leaf(&self) -> bool {
        matches!(self.below, Below::Leaf(_))
    }

    /// Children of an inner node.
    pub fn children(&self) -> &[Node] {
        match &self.below {
            Below::Inner(children) => children,
            Below::Leaf(_) => &[],
        }
    }

    /// References of a leaf.
    pub fn references(&self) -> &[Reference] {
        match &self.below {
            Below::Inner(_) => &[],
            Below::Leaf(references) => references,
        }
    }

    /// Makes the cost from that of the children.
    pub fn settle(&mut self, prices: &Prices) {
        self.cost = match &self.below {
            Below::Inner(children) => {
                self.p * prices.visit + children.iter().map(|child| child.cost).sum::<f64>()
            }
            Below::Leaf(references) => prices.of_leaf(self.p, references.len()),
        };
    }

    /// Counts P and cost of the whole subtree anew; `list` are the rays of a box around it.
    pub fn recount(&mut self, likelihood: &Likelihood, list: &[u32], prices: &Prices) {
        let own = likelihood.within(list, &self.bounds);
        self.p = likelihood.of(&self.bounds, own.len());
        if let Below::Inner(children) = &mut self.below {
            let each = |child: &mut Node| child.recount(likelihood, &own, prices);
            if own.len() > PARALLEL {
                children.par_iter_mut().for_each(each);
            } else {
                children.iter_mut().for_each(each);
            }
        }
        self.settle(prices);
    }

    /// Reads a tree of any width, without P and cost. The box of a reference is its leaf's, or, where it shares the leaf, what
    /// that has in common with the triangle's; all boxes above are the smallest around them.
    pub fn read(tree: TreeView, triangles: &[Triangle]) -> Node {
        let mut read: Vec<Option<Node>> = vec![None; tree.nodes.len()];
        // Children stand behind their parents.
        for (index, node) in tree.nodes.iter().enumerate().rev() {
            let (bounds, below) = if node.is_leaf() {
                let references = references(tree, node, triangles);
                (around(&references), Below::Leaf(references))
            } else {
                let children: Vec<Node> = node.range().filter_map(|child| read[child].take()).collect();
                let bounds = children.iter().fold(PaddedAabb::EMPTY, |all, child| all.union(&child.bounds));
                (bounds, Below::Inner(children))
            };
            read[index] = Some(Node { bounds, p: 0.0, cost: 0.0, below });
        }
        read.swap_remove(0).unwrap_or_else(Node::nothing)
    }

    /// The tree of no triangle.
    pub fn nothing() -> Node {
        Node { bounds: PaddedAabb::EMPTY, p: 0.0, cost: 0.0, below: Below::Leaf(Vec::new()) }
    }

    /// The tree as builders return it: depth first, siblings beside each other, primitives in the order of the leaves.
    pub fn written(&self) -> Tree {
        let mut tree = Tree { nodes: vec![FileNode::leaf(self.bounds.into(), 0, 0)], primitives: Vec::new() };
        let mut open = vec![(self, 0)];
        while let Some((node, place)) = open.pop() {
            match &node.below {
                Below::Leaf(references) => {
                    let first = tree.primitives.len() as u32;
                    tree.nodes[place] = FileNode::leaf(node.bounds.into(), first, references.len() as u32);
                    tree.primitives.extend(references.iter().map(|reference| reference.triangle));
                }
                Below::Inner(children) => {
                    let first = tree.nodes.len();
                    tree.nodes[place] =
                        FileNode::inner(node.bounds.into(), first as u32, children.len() as u32);
                    let unknown = |child: &Node| FileNode::leaf(child.bounds.into(), 0, 0);
                    tree.nodes.extend(children.iter().map(unknown));
                    open.extend(children.iter().zip(first..tree.nodes.len()).rev());
                }
            }
        }
        tree
    }
}

/// The references of a leaf.
pub fn references(tree: TreeView, leaf: &FileNode, triangles: &[Triangle]) -> Vec<Reference> {
    let bounds = leaf.bounds();
    let reference = |&triangle: &u32| {
        let common = triangles[triangle as usize].bounds().intersection(&bounds);
        // What other programs cut may lie a rounding error beside its leaf.
        let whole = leaf.len() == 1 || common.is_empty();
        Reference { bounds: if whole { bounds } else { common }.into(), triangle }
    };
    tree.primitives[leaf.range()].iter().map(reference).collect()
}

/// Adds `more` to references of a leaf. A triangle of which both have a part stands there once, with the box around both.
pub fn unite(references: &mut Vec<Reference>, more: &[Reference]) {
    for reference in more {
        match references.iter_mut().find(|known| known.triangle == reference.triangle) {
            Some(known) => known.bounds = known.bounds.union(&reference.bounds),
            None => references.push(*reference),
        }
    }
}

/// How many references there are when `more` are added.
pub fn united(references: &[Reference], more: &[Reference]) -> usize {
    let known = |reference: &&Reference| references.iter().any(|known| known.triangle == reference.triangle);
    references.len() + more.len() - more.iter().filter(known).count()
}

/// The box around references.
pub fn around(references: &[Reference]) -> PaddedAabb {
    references.iter().fold(PaddedAabb::EMPTY, |all, reference| all.union(&reference.bounds))
}
