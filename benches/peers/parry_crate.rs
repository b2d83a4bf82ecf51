//! parry3d: its binned SAH builder (eight bins on the widest axis), one primitive a leaf, one thread.

use super::Peer;
use embree_trace::geometry::{Aabb, Triangle, Vec3};
use embree_trace::tree::{Node, Tree};
use parry3d::bounding_volume::Aabb as TheirBox;
use parry3d::math::Vector;
use parry3d::partitioning::{Bvh, BvhBuildStrategy, BvhNode, TraversalAction};

pub struct Parry;

impl Peer for Parry {
    type Input = Vec<TheirBox>;
    type Built = Bvh;

    fn prepare(triangles: &[Triangle]) -> Self::Input {
        let corner = |v: Vec3| Vector::new(v.x, v.y, v.z);
        let convert = |t: &Triangle| TheirBox::new(corner(t.bounds().lower), corner(t.bounds().upper));
        triangles.iter().map(convert).collect()
    }

    fn build(&self, input: &mut Self::Input) -> Self::Built {
        Bvh::from_leaves(BvhBuildStrategy::Binned, input)
    }

    /// The crate hides its nodes, but shows pairs of children depth first, left below before right below.
    fn tree(built: &Self::Built) -> Tree {
        let corner = |v: Vector| Vec3::new(v.x, v.y, v.z);
        let bounds = |b: TheirBox| Aabb { lower: corner(b.mins), upper: corner(b.maxs) };
        let mut tree =
            Tree { nodes: vec![Node::inner(bounds(built.root_aabb()), 1, 2)], primitives: Vec::new() };
        let mut parents = vec![0];
        built.traverse(|node: &BvhNode| {
            let index = tree.nodes.len();
            let primitive = tree.primitives.len() as u32;
            tree.nodes.push(match node.leaf_data() {
                Some(_) => Node::leaf(bounds(node.aabb()), primitive, 1),
                None => Node::inner(bounds(node.aabb()), 0, 2),
            });
            tree.primitives.extend(node.leaf_data());
            // Second of a pair: the pair is the children of the parent that waited longest above.
            if index.is_multiple_of(2) {
                let parent: usize = parents.pop().expect("a pair has a parent");
                tree.nodes[parent].first = index as u32 - 1;
                parents.extend([index, index - 1].iter().filter(|&&child| !tree.nodes[child].is_leaf()));
            }
            TraversalAction::Continue
        });
        tree
    }
}
