//! Eight boxes at a time against one ray: the traversal's conservative slab test, bit for bit, in vectors.
//!
//! Every test stands here twice: plain, and with AVX2 for processors that have it. Both do the same operations, so what
//! is counted does not depend on the machine.

use super::segment::Segment;
use crate::geometry::padded::PaddedAabb;

/// Boxes in a block.
pub const LANES: usize = 8;

/// Eight boxes, faces side by side: per axis the lower faces, then the upper faces.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub struct Block {
    faces: [[[f32; LANES]; 2]; 3],
}

impl Block {
    /// Eight boxes that nothing is in.
    pub const EMPTY: Block = Block { faces: [[[f32::INFINITY; LANES], [f32::NEG_INFINITY; LANES]]; 3] };

    #[inline(always)]
    pub fn set(&mut self, lane: usize, bounds: &PaddedAabb) {
        for axis in 0..3 {
            self.faces[axis][0][lane] = bounds.lower[axis];
            self.faces[axis][1][lane] = bounds.upper[axis];
        }
    }

    /// Copies one box of another block.
    #[inline(always)]
    pub fn copy(&mut self, lane: usize, from: &Block, from_lane: usize) {
        for (to, from) in self.faces.as_flattened_mut().iter_mut().zip(from.faces.as_flattened()) {
            to[lane] = from[from_lane];
        }
    }

    /// Bit i: the ray overlaps box i.
    #[inline(always)]
    pub fn overlapped(&self, ray: &Segment) -> u32 {
        let overlaps = self.overlaps(ray);
        (0..LANES).map(|lane| (overlaps[lane] as u32) << lane).sum()
    }

    /// Adds 1 to the counts of the boxes that the ray overlaps.
    #[inline(always)]
    pub fn count(&self, ray: &Segment, counts: &mut [u32; LANES]) {
        for (count, overlaps) in counts.iter_mut().zip(self.overlaps(ray)) {
            *count += overlaps as u32;
        }
    }

    #[inline(always)]
    fn overlaps(&self, ray: &Segment) -> [bool; LANES] {
        let mut entry = [ray.near_inverse.w; LANES];
        let mut exit = [ray.far_inverse.w; LANES];
        for axis in 0..3 {
            let down = (ray.downwards[axis] & 1) as usize;
            let faces = &self.faces[axis];
            for lane in 0..LANES {
                let near = (faces[down][lane] - ray.origin[axis]) * ray.near_inverse[axis];
                let far = (faces[down ^ 1][lane] - ray.origin[axis]) * ray.far_inverse[axis];
                entry[lane] = if near > entry[lane] { near } else { entry[lane] };
                exit[lane] = if far < exit[lane] { far } else { exit[lane] };
            }
        }
        std::array::from_fn(|lane| entry[lane] <= exit[lane])
    }
}

/// The same with AVX2.
#[cfg(target_arch = "x86_64")]
pub mod avx2 {
    use super::{Block, LANES};
    use crate::geometry::padded::PaddedAabb;
    use crate::probability::rays::segment::Segment;
    use std::arch::x86_64::*;

    /// Whether this processor can.
    #[inline(always)]
    pub fn available() -> bool {
        std::arch::is_x86_feature_detected!("avx2")
            && std::arch::is_x86_feature_detected!("bmi1")
            && std::arch::is_x86_feature_detected!("popcnt")
    }

    /// All ones in the lanes of the boxes that the ray overlaps.
    #[target_feature(enable = "avx2")]
    #[inline]
    fn overlaps(block: &Block, ray: &Segment) -> __m256 {
        let mut entry = _mm256_set1_ps(ray.near_inverse.w);
        let mut exit = _mm256_set1_ps(ray.far_inverse.w);
        let origin = ray.origin.to_array();
        let (near_inverse, far_inverse) = (ray.near_inverse.to_array(), ray.far_inverse.to_array());
        for axis in 0..3 {
            let down = (ray.downwards[axis] & 1) as usize;
            let faces = &block.faces[axis];
            // SAFETY: eight floats each, and a block's rows are 32-byte aligned.
            let (near, far) =
                unsafe { (_mm256_load_ps(faces[down].as_ptr()), _mm256_load_ps(faces[down ^ 1].as_ptr())) };
            let origin = _mm256_set1_ps(origin[axis]);
            let near = _mm256_mul_ps(_mm256_sub_ps(near, origin), _mm256_set1_ps(near_inverse[axis]));
            let far = _mm256_mul_ps(_mm256_sub_ps(far, origin), _mm256_set1_ps(far_inverse[axis]));
            // NaN loses: the second operand is returned.
            entry = _mm256_max_ps(near, entry);
            exit = _mm256_min_ps(far, exit);
        }
        _mm256_cmp_ps::<_CMP_LE_OQ>(entry, exit)
    }

    /// [`Block::overlapped`].
    #[target_feature(enable = "avx2")]
    #[inline]
    pub fn overlapped(block: &Block, ray: &Segment) -> u32 {
        _mm256_movemask_ps(overlaps(block, ray)) as u32
    }

    /// Calls [`Block::count`] for each ray.
    #[target_feature(enable = "avx2")]
    #[inline]
    pub fn count_all(block: &Block, rays: impl Iterator<Item = Segment>, counts: &mut [u32; LANES]) {
        let mut sum = _mm256_setzero_si256();
        for ray in rays {
            // All ones are -1.
            sum = _mm256_sub_epi32(sum, _mm256_castps_si256(overlaps(block, &ray)));
        }
        for (count, sum) in counts.iter_mut().zip(bytemuck::cast::<__m256i, [u32; LANES]>(sum)) {
            *count += sum;
        }
    }

    /// Two boxes, made ready for [`Pair::overlapped`].
    #[derive(Clone, Copy)]
    pub struct Pair {
        /// x, y, z and 0 of both.
        lower: __m256,
        upper: __m256,
    }

    impl Pair {
        #[target_feature(enable = "avx2")]
        pub fn new(boxes: [&PaddedAabb; 2]) -> Pair {
            let both = |a: glam::Vec4, b: glam::Vec4| _mm256_set_m128(b.into(), a.into());
            Pair { lower: both(boxes[0].lower, boxes[1].lower), upper: both(boxes[0].upper, boxes[1].upper) }
        }

        /// Whether the ray overlaps each box: 1 or 0.
        #[target_feature(enable = "avx2")]
        #[inline]
        pub fn overlapped(&self, ray: &Segment) -> [usize; 2] {
            let both = |v: glam::Vec4| {
                let v: __m128 = v.into();
                _mm256_set_m128(v, v)
            };
            let (origin, near_inverse, far_inverse) =
                (both(ray.origin), both(ray.near_inverse), both(ray.far_inverse));
            // Where the ray runs downwards the faces change places. (A NaN may have either sign: no face counts there.)
            let downwards = _mm256_castsi256_ps(_mm256_srai_epi32::<31>(_mm256_castps_si256(near_inverse)));
            let change = _mm256_and_ps(_mm256_xor_ps(self.lower, self.upper), downwards);
            let near = _mm256_mul_ps(_mm256_sub_ps(_mm256_xor_ps(self.lower, change), origin), near_inverse);
            let far = _mm256_mul_ps(_mm256_sub_ps(_mm256_xor_ps(self.upper, change), origin), far_inverse);
            // The fourth lanes become the interval, then bound the others: NaN loses here, before lanes meet.
            let near = _mm256_blend_ps::<0b1000_1000>(near, near_inverse);
            let far = _mm256_blend_ps::<0b1000_1000>(far, far_inverse);
            let near = _mm256_max_ps(near, _mm256_permute_ps::<0b11_11_11_11>(near));
            let far = _mm256_min_ps(far, _mm256_permute_ps::<0b11_11_11_11>(far));
            let near = _mm256_max_ps(near, _mm256_permute_ps::<0b10_11_00_01>(near));
            let far = _mm256_min_ps(far, _mm256_permute_ps::<0b10_11_00_01>(far));
            let near = _mm256_max_ps(near, _mm256_permute_ps::<0b01_00_11_10>(near));
            let far = _mm256_min_ps(far, _mm256_permute_ps::<0b01_00_11_10>(far));
            let mask = _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_LE_OQ>(near, far)) as usize;
            [mask & 1, mask >> 7]
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Aabb, Ray, Vec3};
    use crate::probability::rays::segment::Packed;
    use crate::random::Random;
    use crate::traverse::ray::PreparedRay;

    #[test]
    fn all_tests_agree_with_the_traversals() {
        let mut random = Random::new(11);
        let mut random = || random.unit() * 2.0 - 1.0;
        for case in 0..2000 {
            let mut block = Block::EMPTY;
            let boxes: [PaddedAabb; LANES] = std::array::from_fn(|lane| {
                let [a, b] = [0; 2].map(|_| Vec3::new(random(), random(), random()));
                let bounds = Aabb { lower: a.min(b), upper: a.max(b) }.into();
                block.set(lane, &bounds);
                bounds
            });
            let zero = |on: bool, value: f32| if on { 0.0 } else { value };
            let ray = Ray {
                origin: Vec3::new(random(), random(), random()) * 2.0,
                tnear: if case % 11 == 0 { -1.0 } else { 0.0 },
                direction: Vec3::new(zero(case % 3 == 0, random()), zero(case % 5 == 0, random()), random()),
                tfar: if case % 2 == 0 { f32::INFINITY } else { random().abs() },
            };
            let segment = Packed::new(&ray).unwrap().segment();
            let prepared = PreparedRay::new(&ray);
            let truth = boxes.map(|bounds| prepared.entry(&bounds.into(), prepared.tfar).is_some() as u32);
            let mask: u32 = (0..LANES).map(|lane| truth[lane] << lane).sum();
            assert_eq!(block.overlapped(&segment), mask, "{ray:?}");
            let mut counts = [0; LANES];
            block.count(&segment, &mut counts);
            assert_eq!(counts, truth);
            for (bounds, truth) in boxes.iter().zip(truth) {
                assert_eq!(segment.overlaps(bounds), truth == 1);
            }
            #[cfg(target_arch = "x86_64")]
            if avx2::available() {
                // SAFETY: the processor can.
                unsafe {
                    assert_eq!(avx2::overlapped(&block, &segment), mask, "{ray:?}");
                    avx2::count_all(&block, [segment; 3].into_iter(), &mut counts);
                    assert_eq!(counts, truth.map(|overlaps| 4 * overlaps));
                    let pair = avx2::Pair::new([&boxes[0], &boxes[1]]);
                    assert_eq!(pair.overlapped(&segment), [truth[0] as usize, truth[1] as usize], "{ray:?}");
                }
            }
        }
    }
}
