//! For tests: scenes, rays, and a working tree recounted from nothing.

use super::measure::{Estimate, Measure, RayMeasure};
use super::working::{NONE, Working};
use crate::geometry::{Aabb, Ray, Triangle, Vec3};
use crate::random::Random;
use crate::tree::{Node, Tree};

pub fn triangles(count: usize, seed: u64) -> Vec<Triangle> {
    let mut random = Random::stream(seed, &[7]);
    let mut vector = |scale: f32| Vec3::from_array([0; 3].map(|_| random.unit())) * scale;
    (0..count)
        .map(|_| {
            let at = vector(1.0);
            Triangle([at, at + vector(0.2), at + vector(0.2)])
        })
        .collect()
}

/// Segments through the unit cube, most of them from one side.
pub fn rays(count: usize, seed: u64) -> Vec<Ray> {
    let mut random = Random::stream(seed, &[8]);
    let mut vector = || Vec3::from_array([0; 3].map(|_| random.unit()));
    (0..count)
        .map(|_| {
            let (from, to) = (vector() * Vec3::new(0.1, 1.0, 1.0), vector());
            Ray { origin: from, tnear: 0.0, direction: to - from, tfar: 0.2 + vector().x }
        })
        .collect()
}

/// A tree that has much to be mended: triangles in the order they came, halved.
pub fn poor_tree(triangles: &[Triangle]) -> Tree {
    let mut tree = Tree { nodes: vec![Node::leaf(Aabb::EMPTY, 0, 0)], primitives: vec![] };
    let mut open = vec![(0..triangles.len(), 0usize)];
    while let Some((range, place)) = open.pop() {
        let bounds = triangles[range.clone()].iter().fold(Aabb::EMPTY, |sum, t| sum.union(&t.bounds()));
        if range.len() == 1 {
            tree.nodes[place] = Node::leaf(bounds, tree.primitives.len() as u32, 1);
            tree.primitives.push(range.start as u32);
        } else {
            let first = tree.nodes.len();
            let middle = range.start + range.len() / 2;
            tree.nodes[place] = Node::inner(bounds, first as u32, 2);
            tree.nodes.extend([Node::leaf(Aabb::EMPTY, 0, 0); 2]);
            open.extend([(middle..range.end, first + 1), (range.start..middle, first)]);
        }
    }
    tree
}

/// Half rays, half area.
pub fn blend(tree: &Tree, rays: &[Ray]) -> RayMeasure {
    RayMeasure::new(rays, Estimate::Blend { weight: 0.5 }, &tree.nodes[0].bounds().into())
}

/// Links, boxes, values and lists of every node, each made again from nothing.
pub fn assert_consistent<M: Measure>(working: &Working<M>)
where
    M::List: PartialEq + std::fmt::Debug,
{
    let order = working.order();
    assert_eq!(order.len(), working.nodes.len(), "every node is reached once");
    let whole = working.measure.whole();
    for index in order {
        let node = working.node(index);
        let list = working.measure.within(&whole, &node.bounds);
        assert_eq!(working.value(index), working.measure.value(&node.bounds, &list), "value of {index}");
        if index == 0 {
            assert_eq!(node.parent, NONE);
        }
        if node.is_leaf() {
            assert_eq!(*working.list(index), M::List::default());
        } else {
            assert_eq!(*working.list(index), list, "list of {index}");
            assert_eq!(node.bounds, working.union(node.children()), "box of {index}");
            for child in node.children() {
                assert_eq!(working.node(child).parent, index);
            }
        }
    }
}
