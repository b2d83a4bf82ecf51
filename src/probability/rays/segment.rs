//! A recorded ray as builders test it: the traversal's conservative slab test on padded boxes, bit for bit.

use crate::geometry::Ray;
use crate::geometry::padded::PaddedAabb;
use crate::traverse::ray::{PADDING, PreparedRay};
use bytemuck::{Pod, Zeroable};
use glam::Vec4;

/// How many rays of a list are asked for before their turn.
pub(super) const AHEAD: usize = 24;

/// A ray over its effective segment as it is kept, 32 bytes: long lists of rays are read from memory at every node, so their
/// size is what the time at the top of a tree depends on.
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C, align(32))]
pub struct Packed {
    origin_and_tnear: Vec4,
    /// [`PreparedRay::near_inverse`].
    inverse_and_tfar: Vec4,
}

impl Packed {
    /// None for a ray that cannot overlap any box (see [`PreparedRay`]).
    pub fn new(ray: &Ray) -> Option<Packed> {
        let ray = PreparedRay::new(ray);
        (ray.tnear <= ray.tfar).then(|| Packed {
            origin_and_tnear: ray.origin.extend(ray.tnear),
            inverse_and_tfar: ray.near_inverse.extend(ray.tfar),
        })
    }

    /// Asks for the ray to be brought near, without waiting: of a long list, each is elsewhere in memory.
    #[inline(always)]
    pub(super) fn prefetch(&self) {
        #[cfg(target_arch = "x86_64")]
        // SAFETY: a prefetch reads nothing that a program could see, from an address that is valid besides.
        unsafe {
            use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
            _mm_prefetch::<_MM_HINT_T0>(std::ptr::from_ref(self).cast());
        }
    }

    /// What tests need: the same numbers as in a [`PreparedRay`].
    #[inline(always)]
    pub fn segment(&self) -> Segment {
        let (origin, inverse) = (self.origin_and_tnear, self.inverse_and_tfar);
        let downwards = inverse.cmplt(Vec4::ZERO).bitmask();
        Segment {
            origin: origin.with_w(0.0),
            near_inverse: inverse.with_w(origin.w),
            far_inverse: (inverse * (1.0 + PADDING)).with_w(inverse.w),
            downwards: [downwards & 1, downwards >> 1 & 1, downwards >> 2 & 1],
        }
    }
}

/// A ray over its effective segment, ready for box tests.
#[derive(Clone, Copy, Debug)]
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
