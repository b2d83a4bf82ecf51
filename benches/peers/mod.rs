//! Other people's trees, one adapter a file: built by their crate, then copied node by node into a [`Tree`], so that one
//! judge sees all.

pub mod bvh_crate;
pub mod obvhs_crate;
pub mod parry_crate;
pub mod tinybvh_crate;

use embree_trace::geometry::{Aabb, Triangle};
use embree_trace::tree::{Node, Tree};

/// A crate that builds binary trees over triangles.
pub trait Peer {
    /// The triangles as the crate wants them.
    type Input: Send;
    /// The tree as the crate has it.
    type Built;

    fn prepare(triangles: &[Triangle]) -> Self::Input;

    /// What is measured. Uses the threads of the current rayon pool where the crate does.
    fn build(&self, input: &mut Self::Input) -> Self::Built;

    fn tree(built: &Self::Built) -> Tree;
}

/// What a peer's node has below it.
pub enum Below<'a> {
    Children([usize; 2]),
    Primitives(&'a [u32]),
}

/// Copies a tree, given its root and how to look at a node by number.
pub fn copied<'a>(root: usize, node: impl Fn(usize) -> (Aabb, Below<'a>)) -> Tree {
    let mut tree = Tree { nodes: vec![Node::leaf(Aabb::EMPTY, 0, 0)], primitives: Vec::new() };
    let mut open = vec![(root, 0)];
    while let Some((from, to)) = open.pop() {
        let (bounds, below) = node(from);
        match below {
            Below::Children([left, right]) => {
                let first = tree.nodes.len();
                tree.nodes[to] = Node::inner(bounds, first as u32, 2);
                tree.nodes.extend([Node::leaf(Aabb::EMPTY, 0, 0); 2]);
                open.extend([(right, first + 1), (left, first)]);
            }
            Below::Primitives(primitives) => {
                tree.nodes[to] = Node::leaf(bounds, tree.primitives.len() as u32, primitives.len() as u32);
                tree.primitives.extend_from_slice(primitives);
            }
        }
    }
    tree
}
