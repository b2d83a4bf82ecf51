//! Children in the order in which an occlusion query is best to try them, from areas alone: likely occluders that are cheap to ask first.
//!
//! How likely a box holds an occluder of a ray that meets it is estimated from the surface in it. Of a leaf, a ray of random direction hits
//! 2 · surface / box area triangles on average (Cauchy: a mean projection is a quarter of a convex body's surface), so at most that is the
//! probability. Of an inner node, children are taken as independent, and met in proportion to their areas. The expected cost below a node
//! follows from the same numbers, as the first occluder ends the query. With independent trials, probability over cost, highest first, is
//! the order that costs least (SRDH's and RTSAH's rule, there with rays or visibility: Ize and Hansen, "RTSAH Traversal Order for Occlusion
//! Rays", Eurographics 2011).

use super::{Node, Tree};
use crate::geometry::Triangle;

/// What is known of a subtree for a ray that meets its box.
#[derive(Clone, Copy, Debug, Default)]
struct Prospect {
    /// Of an occluder.
    probability: f64,
    /// Of looking for it: node visits and blocks of four triangles.
    cost: f64,
}

impl Prospect {
    fn merit(&self) -> f64 {
        self.probability / self.cost.max(f64::MIN_POSITIVE)
    }
}

/// The same tree with the children of every node sorted, the best first. Nodes stand depth first, siblings beside each other.
pub fn likeliest_first(tree: &Tree, triangles: &[Triangle]) -> Tree {
    let area = |node: &Node| f64::from(node.bounds().area());
    let mut prospects = vec![Prospect::default(); tree.nodes.len()];
    let mut children = Vec::new();
    // Children stand behind their parents.
    for (index, node) in tree.nodes.iter().enumerate().rev() {
        prospects[index] = if node.is_leaf() {
            Prospect {
                probability: share(2.0 * surface(tree, node, triangles), area(node)),
                cost: node.len().div_ceil(4) as f64,
            }
        } else {
            children.clear();
            children.extend(node.range());
            sort(&mut children, &prospects);
            let (mut open, mut cost) = (1.0, 1.0);
            for &child in &children {
                let met = share(area(&tree.nodes[child]), area(node));
                cost += open * met * prospects[child].cost;
                open *= 1.0 - met * prospects[child].probability;
            }
            Prospect { probability: 1.0 - open, cost }
        };
    }
    let mut result =
        Tree { nodes: vec![tree.nodes[0]], primitives: Vec::with_capacity(tree.primitives.len()) };
    let mut open = vec![(0, 0)];
    while let Some((from, to)) = open.pop() {
        let node = &tree.nodes[from];
        if node.is_leaf() {
            result.nodes[to].first = result.primitives.len() as u32;
            result.primitives.extend_from_slice(&tree.primitives[node.range()]);
        } else {
            children.clear();
            children.extend(node.range());
            sort(&mut children, &prospects);
            let first = result.nodes.len();
            result.nodes[to].first = first as u32;
            result.nodes.extend(children.iter().map(|&child| tree.nodes[child]));
            open.extend(children.iter().enumerate().map(|(place, &child)| (child, first + place)).rev());
        }
    }
    result
}

fn sort(children: &mut [usize], prospects: &[Prospect]) {
    children.sort_by(|&a, &b| prospects[b].merit().total_cmp(&prospects[a].merit()));
}

/// `part` of `whole`, at most 1; 0 of nothing.
fn share(part: f64, whole: f64) -> f64 {
    if whole > 0.0 { (part / whole).min(1.0) } else { 0.0 }
}

/// The area of a leaf's triangles, of each in proportion to how much of its box is in the leaf's, which after spatial splits is not all of it.
fn surface(tree: &Tree, leaf: &Node, triangles: &[Triangle]) -> f64 {
    let inside = |&primitive: &u32| {
        let triangle = &triangles[primitive as usize];
        let bounds = triangle.bounds();
        let common = bounds.intersection(&leaf.bounds());
        let part = share(common.area().into(), bounds.area().into());
        0.5 * f64::from(triangle.scaled_normal().length()) * part
    };
    tree.primitives[leaf.range()].iter().map(inside).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Aabb, Vec3};

    /// A tree of one node over these leaves.
    fn flat(leaves: &[(Aabb, Vec<u32>)]) -> Tree {
        let bounds = leaves.iter().fold(Aabb::EMPTY, |all, (bounds, _)| all.union(bounds));
        let mut tree = Tree { nodes: vec![Node::inner(bounds, 1, leaves.len() as u32)], primitives: vec![] };
        for (bounds, primitives) in leaves {
            tree.nodes.push(Node::leaf(*bounds, tree.primitives.len() as u32, primitives.len() as u32));
            tree.primitives.extend(primitives);
        }
        tree
    }

    fn triangle(scale: f32, at: Vec3) -> Triangle {
        Triangle([Vec3::ZERO, Vec3::X, Vec3::Y].map(|corner| at + scale * corner))
    }

    #[test]
    fn what_fills_its_box_comes_first_and_what_costs_more_later() {
        let far = 10.0 * Vec3::X;
        // 0 in its own box; 1 in a box that is mostly empty; 0 again among four others of no area, in two blocks.
        let triangles = [triangle(1.0, Vec3::ZERO), triangle(1.0, far), triangle(0.0, Vec3::ZERO)];
        let own = triangles[0].bounds();
        let roomy = triangles[1].bounds().union(&triangle(9.0, far).bounds());
        let tree = flat(&[(roomy, vec![1]), (own, vec![0, 2, 2, 2, 2]), (own, vec![0])]);
        let sorted = likeliest_first(&tree, &triangles);
        assert_eq!(sorted.primitives, [0, 0, 2, 2, 2, 2, 1]);
        assert_eq!(sorted.nodes[1..].iter().map(Node::len).collect::<Vec<_>>(), [1, 5, 1]);
        assert_eq!(likeliest_first(&sorted, &triangles), sorted);
    }

    #[test]
    fn degenerate_boxes_and_trees() {
        let triangles = [triangle(0.0, Vec3::ONE), triangle(1.0, Vec3::ZERO)];
        let tree = flat(&[(triangles[0].bounds(), vec![0]), (triangles[1].bounds(), vec![1])]);
        assert_eq!(likeliest_first(&tree, &triangles).primitives, [1, 0]);
        let empty = Tree { nodes: vec![Node::leaf(Aabb::EMPTY, 0, 0)], primitives: vec![] };
        assert_eq!(likeliest_first(&empty, &[]), empty);
    }
}
