//! bvh: binned SAH with six buckets, one shape a leaf, on the rayon pool.

use super::{Below, Peer, copied};
use bvh::aabb::{Aabb as TheirBox, Bounded};
use bvh::bounding_hierarchy::{BHShape, BoundingHierarchy};
use bvh::bvh::{Bvh, BvhNode};
use embree_trace::geometry::{Aabb, Triangle, Vec3};
use embree_trace::tree::Tree;

pub struct BvhCrate;

/// A triangle's box, computed before as the crate asks for it many times.
pub struct Shape {
    bounds: TheirBox<f32, 3>,
    node: usize,
}

impl Bounded<f32, 3> for Shape {
    fn aabb(&self) -> TheirBox<f32, 3> {
        self.bounds
    }
}

impl BHShape<f32, 3> for Shape {
    fn set_bh_node_index(&mut self, index: usize) {
        self.node = index;
    }

    fn bh_node_index(&self) -> usize {
        self.node
    }
}

impl Peer for BvhCrate {
    type Input = Vec<Shape>;
    /// The tree, and the box of each shape.
    type Built = (Bvh<f32, 3>, Vec<TheirBox<f32, 3>>);

    fn prepare(triangles: &[Triangle]) -> Self::Input {
        let shape = |t: &Triangle| {
            let Aabb { lower, upper } = t.bounds();
            let bounds = TheirBox::with_bounds(lower.to_array().into(), upper.to_array().into());
            Shape { bounds, node: 0 }
        };
        triangles.iter().map(shape).collect()
    }

    fn build(&self, input: &mut Self::Input) -> Self::Built {
        let tree = Bvh::build_par(input);
        (tree, input.iter().map(|shape| shape.bounds).collect())
    }

    fn tree((tree, shapes): &Self::Built) -> Tree {
        let convert = |b: &TheirBox<f32, 3>| Aabb {
            lower: Vec3::new(b.min.x, b.min.y, b.min.z),
            upper: Vec3::new(b.max.x, b.max.y, b.max.z),
        };
        let numbers: Vec<u32> = (0..shapes.len() as u32).collect();
        copied(0, |index| match &tree.nodes[index] {
            BvhNode::Leaf { shape_index, .. } => {
                (convert(&shapes[*shape_index]), Below::Primitives(&numbers[*shape_index..shape_index + 1]))
            }
            BvhNode::Node { child_l_index, child_l_aabb, child_r_index, child_r_aabb, .. } => (
                convert(child_l_aabb).union(&convert(child_r_aabb)),
                Below::Children([*child_l_index, *child_r_index]),
            ),
        })
    }
}
