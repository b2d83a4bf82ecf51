//! obvhs: PLOC, then reinsertion; presets from fastest to medium.

use super::{Below, Peer, copied};
use embree_trace::geometry::{Aabb, Triangle, Vec3};
use embree_trace::tree::Tree;
use obvhs::BvhBuildParams;
use obvhs::bvh2::Bvh2;
use obvhs::bvh2::builder::build_bvh2_from_tris;
use std::time::Duration;

pub struct Obvhs(pub BvhBuildParams);

impl Peer for Obvhs {
    type Input = Vec<obvhs::triangle::Triangle>;
    type Built = Bvh2;

    fn prepare(triangles: &[Triangle]) -> Self::Input {
        let corner = |v: Vec3| v.to_array().into();
        let convert = |t: &Triangle| obvhs::triangle::Triangle {
            v0: corner(t.0[0]),
            v1: corner(t.0[1]),
            v2: corner(t.0[2]),
        };
        triangles.iter().map(convert).collect()
    }

    fn build(&self, input: &mut Self::Input) -> Self::Built {
        build_bvh2_from_tris(input, self.0, &mut Duration::default())
    }

    fn tree(built: &Self::Built) -> Tree {
        copied(0, |index| {
            let node = &built.nodes[index];
            let corner = |v: [f32; 3]| Vec3::from(v);
            let bounds = node.aabb();
            let bounds = Aabb { lower: corner(bounds.min.to_array()), upper: corner(bounds.max.to_array()) };
            let first = node.first_index as usize;
            if node.is_leaf() {
                (bounds, Below::Primitives(&built.primitive_indices[first..first + node.prim_count as usize]))
            } else {
                (bounds, Below::Children([first, first + 1]))
            }
        })
    }
}
