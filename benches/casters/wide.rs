//! Other crates' trees of eight children a node, with their own traversal and triangle test.

#[cfg(target_feature = "avx2")]
use super::Aligned;
use super::{Caster, ObvhsCaster};
use crate::peers::Peer;
use crate::peers::obvhs_crate::Obvhs;
use embree_trace::format::rays::Record;
use embree_trace::geometry::Triangle;
use obvhs::cwbvh::CwBvh;
use obvhs::cwbvh::builder::build_cwbvh_from_tris;
use std::time::Duration;

/// obvhs' compressed wide tree; triangles in leaf order, as its documentation advises.
pub struct CwBvhCaster {
    tree: CwBvh,
    triangles: Vec<obvhs::triangle::Triangle>,
}

impl CwBvhCaster {
    pub fn new(triangles: &[Triangle], parameters: obvhs::BvhBuildParams) -> CwBvhCaster {
        let input = Obvhs::prepare(triangles);
        let tree = build_cwbvh_from_tris(&input, parameters, &mut Duration::default());
        let triangles = tree.primitive_indices.iter().map(|&index| input[index as usize]).collect();
        CwBvhCaster { tree, triangles }
    }
}

impl Caster for CwBvhCaster {
    fn closest(&mut self, record: &Record) -> f32 {
        let mut hit = obvhs::ray::RayHit::none();
        let triangles = &self.triangles;
        self.tree
            .ray_traverse(ObvhsCaster::ray(record), &mut hit, |ray, index| triangles[index].intersect(ray));
        hit.t
    }

    fn occluded(&mut self, record: &Record) -> bool {
        let triangles = &self.triangles;
        !self.tree.ray_traverse_miss(ObvhsCaster::ray(record), |ray, index| triangles[index].intersect(ray))
    }
}

/// tinybvh's tree of eight for AVX2, which its crate offers only where the whole program is compiled for AVX2
/// (`RUSTFLAGS="-C target-cpu=native"`). No occlusion query, no start of the interval.
#[cfg(target_feature = "avx2")]
pub struct TinyBvhEight(tinybvh_rs::bvh8_cpu::BVH);

#[cfg(target_feature = "avx2")]
impl TinyBvhEight {
    pub fn new(triangles: &[Triangle], spatial: bool) -> TinyBvhEight {
        use tinybvh_rs::{bvh, bvh8_cpu, mbvh};
        let corners: Vec<[f32; 4]> =
            triangles.iter().flat_map(|t| t.0.map(|v| [v.x, v.y, v.z, 0.0])).collect();
        let corners = corners.as_slice().into();
        let built = if spatial { bvh::BVH::new_hq(corners) } else { bvh::BVH::new(corners) };
        let mut binary = built.expect("whole triangles");
        binary.split_leaves(4);
        TinyBvhEight(bvh8_cpu::BVH::new(&mbvh::BVH::new(&binary)).expect("leaves of four at most"))
    }
}

#[cfg(target_feature = "avx2")]
impl Caster for TinyBvhEight {
    fn closest(&mut self, record: &Record) -> f32 {
        Aligned::cast(&self.0, record)
    }

    fn occluded(&mut self, record: &Record) -> bool {
        self.closest(record).is_finite()
    }
}
