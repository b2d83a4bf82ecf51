//! Whether a tree is one: structure, content and boxes, checked without trusting anything that built it.

use super::{Node, Tree};
use crate::geometry::{Aabb, Triangle};
use thiserror::Error;

/// The first thing that is wrong with a tree.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum InvalidTree {
    #[error("there is no node")]
    NoRoot,
    #[error("node {0} is empty, but not the root of an empty tree")]
    EmptyNode(usize),
    #[error("inner node {node} has {count} children from {first}: not between it and the end, {nodes}")]
    Children { node: usize, first: usize, count: usize, nodes: usize },
    #[error("leaf {node} has {count} primitives from {first}: there are {primitives}")]
    Primitives { node: usize, first: usize, count: usize, primitives: usize },
    #[error("node {node} has {parents} parents")]
    Parents { node: usize, parents: u32 },
    #[error("entry {entry} of the primitives is in {leaves} leaves")]
    Entry { entry: usize, leaves: u32 },
    #[error("entry {entry} of the primitives is triangle {triangle} of {triangles}")]
    Triangle { entry: usize, triangle: u32, triangles: usize },
    #[error("triangle {triangle} is in {leaves} leaves")]
    Leaves { triangle: usize, leaves: u32 },
    #[error("triangle {0} is not finite, but in a leaf")]
    NotFinite(usize),
    #[error("the box of node {node} is {found:?}; what is below fills {expected:?}")]
    Bounds { node: usize, found: Aabb, expected: Aabb },
    #[error("the depth is {depth}, more than {limit}")]
    Depth { depth: usize, limit: usize },
}

/// Checks a tree without spatial splits against its triangles: children stand behind their parent and have no other;
/// every finite triangle is in exactly one leaf, no other triangle in any; every box is exactly the smallest around
/// what is below (so it contains all of it, and no builder was wasteful); at most `depth_limit` levels.
///
/// # Errors
/// The first violation.
pub fn validate(tree: &Tree, triangles: &[Triangle], depth_limit: usize) -> Result<(), InvalidTree> {
    structure(tree, depth_limit)?;
    content(tree, triangles)?;
    boxes(tree, triangles)
}

fn structure(tree: &Tree, limit: usize) -> Result<(), InvalidTree> {
    let nodes = tree.nodes.len();
    if nodes == 0 {
        return Err(InvalidTree::NoRoot);
    }
    let mut parents = vec![0u32; nodes];
    let mut level = vec![1usize; nodes];
    let mut leaves = vec![0u32; tree.primitives.len()];
    for (index, node) in tree.nodes.iter().enumerate() {
        let (first, count) = (node.first as usize, node.len());
        if count == 0 && !(node.is_leaf() && nodes == 1 && tree.primitives.is_empty()) {
            return Err(InvalidTree::EmptyNode(index));
        }
        if level[index] > limit {
            return Err(InvalidTree::Depth { depth: level[index], limit });
        }
        if node.is_leaf() {
            let primitives = tree.primitives.len();
            let entries = leaves.get_mut(node.range()).ok_or(InvalidTree::Primitives {
                node: index,
                first,
                count,
                primitives,
            })?;
            entries.iter_mut().for_each(|leaves| *leaves += 1);
        } else {
            if first <= index || first + count > nodes {
                return Err(InvalidTree::Children { node: index, first, count, nodes });
            }
            for child in node.range() {
                parents[child] += 1;
                level[child] = level[index] + 1;
            }
        }
    }
    for (node, &parents) in parents.iter().enumerate() {
        if parents != (node != 0) as u32 {
            return Err(InvalidTree::Parents { node, parents });
        }
    }
    match leaves.iter().position(|&leaves| leaves != 1) {
        Some(entry) => Err(InvalidTree::Entry { entry, leaves: leaves[entry] }),
        None => Ok(()),
    }
}

fn content(tree: &Tree, triangles: &[Triangle]) -> Result<(), InvalidTree> {
    let mut leaves = vec![0u32; triangles.len()];
    for (entry, &triangle) in tree.primitives.iter().enumerate() {
        let triangles = triangles.len();
        *leaves.get_mut(triangle as usize).ok_or(InvalidTree::Triangle { entry, triangle, triangles })? += 1;
    }
    for (index, (triangle, &leaves)) in triangles.iter().zip(&leaves).enumerate() {
        match (triangle.is_finite(), leaves) {
            (true, 1) | (false, 0) => {}
            (true, leaves) => return Err(InvalidTree::Leaves { triangle: index, leaves }),
            (false, _) => return Err(InvalidTree::NotFinite(index)),
        }
    }
    Ok(())
}

fn boxes(tree: &Tree, triangles: &[Triangle]) -> Result<(), InvalidTree> {
    let around = |boxes: &mut dyn Iterator<Item = Aabb>| boxes.fold(Aabb::EMPTY, |sum, b| sum.union(&b));
    for (index, node) in tree.nodes.iter().enumerate() {
        let expected = if node.is_leaf() {
            let primitives = &tree.primitives[node.range()];
            around(&mut primitives.iter().map(|&triangle| triangles[triangle as usize].bounds()))
        } else {
            around(&mut tree.nodes[node.range()].iter().map(Node::bounds))
        };
        let found = node.bounds();
        if found != expected {
            return Err(InvalidTree::Bounds { node: index, found, expected });
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Vec3;

    /// Two triangles that are finite and one that is not, under a root with two leaves.
    fn scene() -> (Tree, Vec<Triangle>) {
        let at = |x: f32| Triangle([Vec3::splat(x), Vec3::new(x + 1.0, x, x), Vec3::new(x, x + 1.0, x)]);
        let triangles = vec![at(0.0), Triangle([Vec3::NAN; 3]), at(5.0)];
        let (left, right) = (triangles[0].bounds(), triangles[2].bounds());
        let nodes =
            vec![Node::inner(left.union(&right), 1, 2), Node::leaf(left, 0, 1), Node::leaf(right, 1, 1)];
        (Tree { nodes, primitives: vec![0, 2] }, triangles)
    }

    #[test]
    fn each_violation_is_found() {
        let (tree, triangles) = scene();
        assert_eq!(validate(&tree, &triangles, 2), Ok(()));
        assert_eq!(validate(&tree, &triangles, 1), Err(InvalidTree::Depth { depth: 2, limit: 1 }));
        let broken = |change: fn(&mut Tree)| {
            let mut tree = tree.clone();
            change(&mut tree);
            let error = validate(&tree, &triangles, 9).expect_err("broken");
            error.to_string()
        };
        for (change, message) in [
            ((|t| t.nodes.clear()) as fn(&mut Tree), "there is no node"),
            (|t| t.nodes[1].count = crate::tree::LEAF_BIT, "node 1 is empty"),
            (|t| t.nodes[0].first = 0, "inner node 0 has 2 children from 0"),
            (|t| t.nodes[0].count = 3, "inner node 0 has 3 children from 1"),
            (|t| t.nodes[2].first = 2, "leaf 2 has 1 primitives from 2"),
            (|t| t.nodes.push(t.nodes[2]), "node 3 has 0 parents"),
            (|t| t.nodes[2].first = 0, "entry 0 of the primitives is in 2 leaves"),
            (|t| t.primitives.push(1), "entry 2 of the primitives is in 0 leaves"),
            (|t| t.primitives[1] = 7, "entry 1 of the primitives is triangle 7 of 3"),
            (|t| t.primitives[1] = 0, "triangle 0 is in 2 leaves"),
            (|t| t.primitives[1] = 1, "triangle 1 is not finite"),
            (|t| t.nodes[2].upper.x += 1.0, "the box of node 0"),
            (|t| t.nodes[2].lower.y += 0.5, "the box of node 2"),
        ] {
            let error = broken(change);
            assert!(error.starts_with(message), "{error}, expected {message}");
        }
    }
}
