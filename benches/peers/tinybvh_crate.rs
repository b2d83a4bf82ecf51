//! tinybvh-rs: tinybvh's binned SAH builder (its reference one: the crate does not expose the AVX builder), with threads
//! of its own on large scenes, whatever the rayon pool has; and its builder with spatial splits.

use super::{Below, Peer, copied};
use embree_trace::geometry::{Aabb, Triangle, Vec3};
use embree_trace::tree::Tree;
use tinybvh_rs::bvh::BVH;

pub struct TinyBvh {
    pub spatial: bool,
}

impl Peer for TinyBvh {
    type Input = Vec<[f32; 4]>;
    /// Nodes and triangle indices: the crate's own type cannot outlive its input.
    type Built = (Vec<tinybvh_rs::bvh::Node>, Vec<u32>);

    fn prepare(triangles: &[Triangle]) -> Self::Input {
        triangles.iter().flat_map(|t| t.0.map(|v| [v.x, v.y, v.z, 0.0])).collect()
    }

    fn build(&self, input: &mut Self::Input) -> Self::Built {
        let corners = input.as_slice().into();
        let bvh = if self.spatial { BVH::new_hq(corners) } else { BVH::new(corners) };
        let bvh = bvh.expect("whole triangles");
        let entries = |node: &tinybvh_rs::bvh::Node| (node.left_first + node.tri_count) as usize;
        let leaves = bvh.nodes().iter().filter(|node| node.is_leaf());
        let count = leaves.map(entries).max().unwrap_or(0);
        // SAFETY: the crate shows as many indices as there are triangles, but its leaves refer to all that tinybvh allocated
        // and filled, more after spatial splits; the tree is alive.
        let indices = unsafe { std::slice::from_raw_parts(bvh.indices().as_ptr(), count) };
        (bvh.nodes().to_vec(), indices.to_vec())
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
