//! A recorded ray as builders test it: the traversal's conservative slab test on padded boxes, bit for bit.

use crate::geometry::Ray;
use crate::geometry::padded::PaddedAabb;
use crate::traverse::ray::PreparedRay;
use glam::Vec4;

/// A ray over its effective segment, 64 bytes.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub struct Segment {
    pub(super) origin: Vec4,
    /// 1 / direction, for distances to near faces; the fourth lane is [`PreparedRay::tnear`].
    pub(super) near_inverse: Vec4,
    /// 1 / direction, padded, for distances to far faces; the fourth lane is [`PreparedRay::tfar`].
    pub(super) far_inverse: Vec4,
    /// Per axis: 1 when the ray runs downwards, so that a box's upper face is the near one.
    pub(super) downwards: [u32; 3],
}

impl Segment {
    /// None for a ray that cannot overlap any box (see [`PreparedRay`]).
    pub fn new(ray: &Ray) -> Option<Segment> {
        let ray = PreparedRay::new(ray);
        (ray.tnear <= ray.tfar).then(|| Segment {
            origin: ray.origin.extend(0.0),
            near_inverse: ray.near_inverse.extend(ray.tnear),
            far_inverse: ray.far_inverse.extend(ray.tfar),
            downwards: ray.downwards.map(|axis| axis as u32),
        })
    }

    /// Whether the segment overlaps a box: [`PreparedRay::entry`] is not `None`.
    #[inline(always)]
    pub fn overlaps(&self, bounds: &PaddedAabb) -> bool {
        let faces = [bounds.lower, bounds.upper];
        let (mut entry, mut exit) = (self.near_inverse.w, self.far_inverse.w);
        for (axis, down) in self.downwards.iter().enumerate() {
            let down = (down & 1) as usize;
            let near = (faces[down][axis] - self.origin[axis]) * self.near_inverse[axis];
            let far = (faces[down ^ 1][axis] - self.origin[axis]) * self.far_inverse[axis];
            entry = if near > entry { near } else { entry };
            exit = if far < exit { far } else { exit };
        }
        entry <= exit
    }
}
