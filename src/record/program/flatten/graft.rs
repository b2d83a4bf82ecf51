//! Trees put together: instanced ones into the leaves of the top-level one, and two under one root.

use super::Placed;
use crate::geometry::Aabb;
use crate::record::program::capture::{Capture, INSTANCE};
use crate::tree::{Node, Tree};
use std::collections::HashMap;

/// The top-level tree with the instanced ones in it.
pub struct Graft<'a> {
    top: &'a Capture,
    placed: &'a [Placed<'a>],
    /// Numbers of instances by their geomID.
    numbers: HashMap<u32, usize>,
    tree: Tree,
}

/// A node of one of the trees that is still to be copied, to node `to`.
struct Pending {
    /// Which instance's tree; `None` for the top-level one.
    instance: Option<usize>,
    from: usize,
    to: usize,
}

impl<'a> Graft<'a> {
    pub fn new(top: &'a Capture, placed: &'a [Placed<'a>]) -> Graft<'a> {
        let numbers =
            placed.iter().enumerate().map(|(number, placed)| (placed.part.geometry, number)).collect();
        Graft { top, placed, numbers, tree: Tree::default() }
    }

    pub fn run(mut self) -> Tree {
        self.tree.nodes.push(Node::leaf(Aabb::EMPTY, 0, 0));
        let mut pending = vec![Pending { instance: None, from: 0, to: 0 }];
        while let Some(next) = pending.pop() {
            self.copy(&next, &mut pending);
        }
        self.hold();
        self.tree
    }

    /// Adds `count` children to node `parent`, to be filled; returns the first.
    fn children(&mut self, parent: usize, bounds: Aabb, count: usize) -> usize {
        let first = self.tree.nodes.len();
        self.tree.nodes[parent] = Node::inner(bounds, first as u32, count as u32);
        self.tree.nodes.resize(first + count, Node::leaf(Aabb::EMPTY, 0, 0));
        first
    }

    fn copy(&mut self, next: &Pending, pending: &mut Vec<Pending>) {
        let placed = next.instance.map(|index| &self.placed[index]);
        let source = placed.map_or(self.top, |placed| placed.of);
        let node = source.nodes[next.from];
        let bounds = match placed {
            Some(placed) if !node.bounds().is_empty() => placed.transform.bounds(&node.bounds()),
            _ => node.bounds(),
        };
        if !node.is_leaf() {
            let first = self.children(next.to, bounds, node.len());
            let instance = next.instance;
            // Backwards, so that the first child is copied first and lies next to its parent.
            pending.extend(node.range().enumerate().rev().map(|(child, from)| Pending {
                instance,
                from,
                to: first + child,
            }));
            return;
        }
        let entries = &source.primitives[node.range()];
        if placed.is_none() && entries.iter().any(|entry| entry & INSTANCE != 0) {
            return self.copy_instances(entries, bounds, next.to, pending);
        }
        let offset = placed.map_or(0, |placed| placed.part.first_triangle);
        let first = self.tree.primitives.len() as u32;
        self.tree.primitives.extend(entries.iter().map(|entry| entry + offset));
        self.tree.nodes[next.to] = Node::leaf(bounds, first, node.len() as u32);
    }

    /// A leaf of instances: the roots of their trees are its children, or, when it has only one, that root is the leaf.
    fn copy_instances(&mut self, entries: &[u32], bounds: Aabb, to: usize, pending: &mut Vec<Pending>) {
        let instances: Vec<usize> = entries
            .iter()
            .filter_map(|entry| self.numbers.get(&(entry & !INSTANCE)).copied())
            .filter(|&index| !self.placed[index].of.primitives.is_empty())
            .collect();
        match instances[..] {
            [] => self.tree.nodes[to] = Node::leaf(bounds, self.tree.primitives.len() as u32, 0),
            [only] => pending.push(Pending { instance: Some(only), from: 0, to }),
            _ => {
                let first = self.children(to, bounds, instances.len());
                pending.extend(instances.iter().enumerate().rev().map(|(child, &index)| Pending {
                    instance: Some(index),
                    from: 0,
                    to: first + child,
                }));
            }
        }
    }

    /// Lets every box hold its children's: Embree's transformed boxes and ours are not rounded alike.
    fn hold(&mut self) {
        for index in (0..self.tree.nodes.len()).rev() {
            let node = self.tree.nodes[index];
            if node.is_leaf() {
                continue;
            }
            let all = self.tree.nodes[node.range()]
                .iter()
                .fold(node.bounds(), |all, child| all.union(&child.bounds()));
            (self.tree.nodes[index].lower, self.tree.nodes[index].upper) = (all.lower, all.upper);
        }
    }
}

/// Both trees under one added root; the triangles of `second` are numbered by their place in `numbers`.
pub fn join(first: Tree, second: Tree, numbers: &[u32]) -> Tree {
    let renumbered = second.primitives.iter().map(|&index| numbers[index as usize]);
    // A tree of nothing hides nothing.
    if second.primitives.is_empty() {
        return first;
    } else if first.primitives.is_empty() {
        return Tree { primitives: renumbered.collect(), nodes: second.nodes };
    }
    let entries = first.primitives.len() as u32;
    let mut primitives = first.primitives;
    primitives.extend(renumbered);
    // The added root, both roots, what is below the first, what is below the second.
    let moved = |mut node: Node, nodes: usize, entries: u32| {
        node.first += if node.is_leaf() { entries } else { nodes as u32 };
        node
    };
    let below = first.nodes.len() + 1;
    let a = first.nodes.iter().map(|&node| moved(node, 2, 0));
    let b = second.nodes.iter().map(|&node| moved(node, below, entries));
    let bounds = first.nodes[0].bounds().union(&second.nodes[0].bounds());
    let mut nodes = vec![Node::inner(bounds, 1, 2)];
    nodes.extend(a.clone().take(1).chain(b.clone().take(1)));
    nodes.extend(a.skip(1).chain(b.skip(1)));
    Tree { nodes, primitives }
}
