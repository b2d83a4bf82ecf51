//! tinybvh-rs: tinybvh's binned SAH builder (its reference one: the crate does not expose the AVX builder), with threads
//! of its own on large scenes, whatever the rayon pool has.

use super::{Below, Peer, copied};
use embree_trace::geometry::{Aabb, Triangle, Vec3};
use embree_trace::tree::Tree;
use tinybvh_rs::bvh::BVH;

pub struct TinyBvh;

impl Peer for TinyBvh {
    type Input = Vec<[f32; 4]>;
    /// Nodes and triangle indices: the crate's own type cannot outlive its input.
    type Built = (Vec<tinybvh_rs::bvh::Node>, Vec<u32>);

    fn prepare(triangles: &[Triangle]) -> Self::Input {
        triangles.iter().flat_map(|t| t.0.map(|v| [v.x, v.y, v.z, 0.0])).collect()
    }

    fn build(&self, input: &mut Self::Input) -> Self::Built {
        let bvh = BVH::new(input.as_slice().into()).expect("whole triangles");
        (bvh.nodes().to_vec(), bvh.indices().to_vec())
    }

    fn tree((nodes, indices): &Self::Built) -> Tree {
        copied(0, |index| {
            let node = &nodes[index];
            let bounds = Aabb { lower: Vec3::from(node.min), upper: Vec3::from(node.max) };
            let first = node.left_first as usize;
            if node.is_leaf() {
                (bounds, Below::Primitives(&indices[first..first + node.tri_count as usize]))
            } else {
                (bounds, Below::Children([first, first + 1]))
            }
        })
    }
}
