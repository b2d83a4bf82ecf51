//! Any tree made binary, with one primitive a leaf: what is below one node stays below one node.

use super::collapse::MAX_WIDTH;
use super::{Node, Tree, TreeView};
use crate::geometry::{Aabb, Triangle};

/// Something to be put below a binary node.
#[derive(Clone, Copy, Debug)]
struct Item {
    bounds: Aabb,
    below: Below,
    primitives: usize,
}

#[derive(Clone, Copy, Debug)]
enum Below {
    Node(usize),
    Primitive(u32),
}

/// Up to so many things, the children of the widest node, every division is tried; more are halved by position.
const EXHAUSTIVE: usize = MAX_WIDTH;

/// Makes any tree binary, with one primitive a leaf. What is below one node stays below one node; its children, and the primitives
/// of a leaf, are divided so that Σ area · primitives is least.
pub fn binary(tree: TreeView, triangles: &[Triangle]) -> Tree {
    let mut primitives = vec![0usize; tree.nodes.len()];
    for (index, node) in tree.nodes.iter().enumerate().rev() {
        primitives[index] = if node.is_leaf() { node.len() } else { primitives[node.range()].iter().sum() };
    }
    let item = |index: usize| Item {
        bounds: tree.nodes[index].bounds(),
        below: Below::Node(index),
        primitives: primitives[index],
    };
    let mut result =
        Tree { nodes: vec![tree.nodes[0]], primitives: Vec::with_capacity(tree.primitives.len()) };
    let mut open = vec![(vec![item(0)], 0)];
    while let Some((mut items, to)) = open.pop() {
        while let [Item { below: Below::Node(index), .. }] = items[..] {
            let node = &tree.nodes[index];
            if node.is_empty() {
                break;
            }
            items = if node.is_leaf() {
                let clipped = |primitive: u32| {
                    let bounds = triangles[primitive as usize].bounds().intersection(&node.bounds());
                    Item { bounds, below: Below::Primitive(primitive), primitives: 1 }
                };
                tree.primitives[node.range()].iter().map(|&primitive| clipped(primitive)).collect()
            } else {
                node.range().map(item).collect()
            };
            if let [only] = &mut items[..] {
                // The box of a lone child or primitive is its parent's.
                only.bounds = node.bounds();
            }
        }
        let bounds = result.nodes[to].bounds();
        match items[..] {
            [Item { below: Below::Node(_), .. }] => result.nodes[to] = Node::leaf(bounds, 0, 0),
            [Item { below: Below::Primitive(primitive), .. }] => {
                result.nodes[to] = Node::leaf(bounds, result.primitives.len() as u32, 1);
                result.primitives.push(primitive);
            }
            _ => {
                let right = divided(&mut items);
                let first = result.nodes.len();
                result.nodes[to] = Node::inner(bounds, first as u32, 2);
                result.nodes.extend([&items, &right].map(|side| Node::leaf(together(side), 0, 0)));
                open.extend([(right, first + 1), (items, first)]);
            }
        }
    }
    result
}

fn together(items: &[Item]) -> Aabb {
    items.iter().fold(Aabb::EMPTY, |all, item| all.union(&item.bounds))
}

/// Takes the right side out of `items`, of which there are at least two.
fn divided(items: &mut Vec<Item>) -> Vec<Item> {
    if items.len() > EXHAUSTIVE {
        let extent = together(items).extent();
        let axis = extent.max_position();
        let place = |item: &Item| item.bounds.lower[axis] + item.bounds.upper[axis];
        items.sort_by(|a, b| place(a).total_cmp(&place(b)));
        return items.split_off(items.len() / 2);
    }
    let side = |chosen: u32, of: u32| {
        let inside =
            items.iter().enumerate().filter(|(place, _)| chosen >> place & 1 == of).map(|(_, item)| item);
        let (bounds, primitives) = inside.fold((Aabb::EMPTY, 0), |(bounds, primitives), item| {
            (bounds.union(&item.bounds), primitives + item.primitives)
        });
        f64::from(bounds.area()) * primitives as f64
    };
    // The first one is always on the left: every division once.
    let divisions = (1..1u32 << (items.len() - 1)).map(|chosen| chosen << 1);
    let best = divisions.min_by(|&a, &b| (side(a, 0) + side(a, 1)).total_cmp(&(side(b, 0) + side(b, 1))));
    let chosen = best.unwrap_or(2);
    let mut place = 0;
    let right = items.extract_if(.., |_| {
        place += 1;
        chosen >> (place - 1) & 1 == 1
    });
    right.collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Vec3;

    #[test]
    fn a_tree_of_nothing_and_one_of_a_leaf() {
        let empty = Tree { nodes: vec![Node::leaf(Aabb::EMPTY, 0, 0)], primitives: Vec::new() };
        assert_eq!(binary(empty.view(), &[]), empty);
        let triangles: Vec<Triangle> = (0..40u8)
            .map(|x| Triangle([Vec3::X, Vec3::Y, Vec3::Z].map(|v| v + Vec3::X * f32::from(x))))
            .collect();
        let everything = triangles.iter().fold(Aabb::EMPTY, |all, triangle| all.union(&triangle.bounds()));
        let lone = Tree { nodes: vec![Node::leaf(everything, 0, 40)], primitives: (0..40).collect() };
        let single = binary(lone.view(), &triangles);
        assert_eq!((single.nodes.len(), single.primitives.len()), (79, 40));
    }
}
