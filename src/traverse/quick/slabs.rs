//! Eight boxes against one ray with one rounding a face: face · scale + shift, where [`PreparedRay::entry`] has (face - origin) · inverse.
//!
//! A near distance is never greater than that one's, and a far distance never less, so a box that is overlapped there is overlapped here,
//! and is entered no later. With u = 2⁻²⁴, i the inverse, o the origin, f a face, F the greatest face of the tree on that axis, S = (F + |o|) |i|,
//! and D = (f - o) i without rounding:
//!
//! - There, a near distance is D (1 + a)(1 + b) with |a|, |b| ≤ u, so it is off by less than 2.1 u S; a far one is greater by 8 u, and
//!   has two roundings more, so it is less than D + 12.1 u S.
//! - Here, scale = i and shift = -(o i) ∓ pad. The product is off by u S at most, the shift by u (S + pad), the sum by u (S + pad): together by
//!   less than 4 u S. So 16.1 u S would do as a pad on either side, and 24 u S are given: what S itself lost in rounding is far less than the rest.
//! - Below the least normal number errors are absolute, and less than the least normal number, four of which are part of the pad.
//!
//! One scale for both faces, and shifts that hold what is allowed for, leave registers for the triangles.
//!
//! Distances that are not negative compare like the integers of the same bits, which takes a quarter of the time. Negative ones lose against
//! tnear among the near, and miss among the far, whichever of them is taken.

use super::super::groups::Group;
use super::super::ray::PreparedRay;
use glam::Vec4;
use std::arch::x86_64::*;

/// 2⁻²⁴: the relative error of one rounding.
const UNIT: f32 = 1.0 / (1 << 24) as f32;

/// Bytes from a lower to the upper face of the same axis, and from axis to axis, in a group.
const SIDE: usize = 8 * size_of::<f32>();
const AXIS: usize = 2 * SIDE;

/// A ray as groups are tested against it.
#[derive(Clone, Copy, Debug)]
pub struct SlabRay {
    scale: [__m256; 3],
    near_shift: [__m256; 3],
    far_shift: [__m256; 3],
    /// Where in a group the near faces of each axis are, in bytes: below 3 * [`AXIS`].
    near: [usize; 3],
    tnear: __m256i,
}

/// What a test found: a box is overlapped where it is left no earlier than entered.
#[derive(Clone, Copy, Debug)]
pub struct Met {
    pub entry: __m256i,
    pub exit: __m256i,
}

impl SlabRay {
    /// None for rays that start before 0, run parallel to an axis, or whose numbers are too large. `extent` is the greatest face of the
    /// tree on each axis, whatever its sign; its fourth number is 0.
    #[target_feature(enable = "avx2,fma")]
    #[inline]
    pub fn new(ray: &PreparedRay, extent: Vec4) -> Option<SlabRay> {
        let [origin, _, inverse, _]: [Vec4; 4] = bytemuck::cast(*ray);
        // Of the fourth numbers one is no number of a vector, and might be denormal.
        let (origin, scale) = (origin.with_w(1.0), inverse.with_w(1.0));
        let size = (extent + origin.abs()) * scale.abs();
        // NaN fails, too.
        let able = size.cmplt(Vec4::splat(f32::MAX / 4.0)).bitmask() == 0b1111;
        if !(able && ray.tnear >= 0.0) {
            return None;
        }
        let pad = size * (24.0 * UNIT) + 4.0 * f32::MIN_POSITIVE;
        let shift = -(origin * scale);
        let downwards = scale.is_negative_bitmask() as usize;
        let side = |axis: usize| (downwards >> axis & 1) * SIDE;
        Some(SlabRay {
            scale: splat(scale),
            near_shift: splat(shift - pad),
            far_shift: splat(shift + pad),
            near: [side(0), AXIS + side(1), 2 * AXIS + side(2)],
            // -0 becomes 0: as an integer it is the least of all.
            tnear: _mm256_castps_si256(_mm256_set1_ps(ray.tnear + 0.0)),
        })
    }

    /// Which boxes the ray overlaps within [tnear, `tfar`], and where it enters them. Lanes without a child hold a box that no ray meets.
    #[target_feature(enable = "avx2,fma")]
    #[inline]
    pub fn test(&self, group: &Group<8>, tfar: f32) -> Met {
        let [x, y, z] = self.near;
        let faces: *const u8 = (&raw const group.faces).cast();
        let distances = |at: usize, scale: __m256, shift: __m256| {
            // SAFETY: `at` is one of the six places where eight faces begin, aligned as the group is.
            let faces = unsafe { _mm256_load_ps(faces.add(at).cast()) };
            _mm256_castps_si256(_mm256_fmadd_ps(faces, scale, shift))
        };
        let near_x = distances(x, self.scale[0], self.near_shift[0]);
        let near_y = distances(y, self.scale[1], self.near_shift[1]);
        let near_z = distances(z, self.scale[2], self.near_shift[2]);
        let far_x = distances(x ^ SIDE, self.scale[0], self.far_shift[0]);
        let far_y = distances(y ^ SIDE, self.scale[1], self.far_shift[1]);
        let far_z = distances(z ^ SIDE, self.scale[2], self.far_shift[2]);
        let tfar = _mm256_castps_si256(_mm256_set1_ps(tfar));
        let entry = _mm256_max_epi32(_mm256_max_epi32(near_x, near_y), _mm256_max_epi32(near_z, self.tnear));
        let exit = _mm256_min_epi32(_mm256_min_epi32(far_x, far_y), _mm256_min_epi32(far_z, tfar));
        Met { entry, exit }
    }

    /// The lanes that the ray enters after its start, as bits.
    #[target_feature(enable = "avx2,fma")]
    #[inline]
    pub fn entered_later(&self, met: &Met) -> u32 {
        bits(_mm256_cmpgt_epi32(met.entry, self.tnear))
    }
}

impl Met {
    /// The lanes that are overlapped, as bits.
    #[target_feature(enable = "avx2,fma")]
    #[inline]
    pub fn mask(&self) -> u32 {
        bits(_mm256_cmpgt_epi32(self.entry, self.exit)) ^ 0xff
    }

    /// Where the ray enters each, as integers of the same bits.
    #[inline(always)]
    pub fn entries(&self) -> [i32; 8] {
        // SAFETY: both are 32 bytes of plain numbers.
        unsafe { std::mem::transmute(self.entry) }
    }
}

/// The first three numbers, eight times each.
#[target_feature(enable = "avx2")]
#[inline]
fn splat(vector: Vec4) -> [__m256; 3] {
    let vector: __m128 = vector.into();
    [
        _mm256_broadcastss_ps(vector),
        _mm256_broadcastss_ps(_mm_permute_ps::<0b01_01_01_01>(vector)),
        _mm256_broadcastss_ps(_mm_permute_ps::<0b10_10_10_10>(vector)),
    ]
}

/// The sign of each lane.
#[target_feature(enable = "avx2,fma")]
#[inline]
fn bits(lanes: __m256i) -> u32 {
    _mm256_movemask_ps(_mm256_castsi256_ps(lanes)) as u32
}

const _: () = assert!(size_of::<Group<8>>() == 3 * AXIS + 64);

#[cfg(test)]
mod tests {
    use super::super::super::form::Below;
    use super::*;
    use crate::geometry::{Aabb, Ray, Vec3};
    use crate::random::Random;

    /// A number of either sign and any magnitude within 2 to the power of ± `range`.
    fn number(random: &mut Random, range: f64) -> f32 {
        (random.signed().signum() * (range * random.signed()).exp2()) as f32
    }

    #[target_feature(enable = "avx2,fma")]
    fn compare(random: &mut Random) -> [u32; 3] {
        let (mut both, mut here_only, mut refused) = (0, 0, 0);
        for round in 0..40_000 {
            // From everyday numbers to those whose products underflow or overflow.
            let range = [2.0, 12.0, 60.0, 140.0][round % 4];
            let vector = |random: &mut Random, range| Vec3::from_array([0; 3].map(|_| number(random, range)));
            let origin = vector(random, range);
            let direction = vector(random, range.min(99.0));
            let tnear = [0.0, -0.0, number(random, range).abs()][round % 3];
            let ray = PreparedRay::new(&Ray { origin, tnear, direction, tfar: f32::INFINITY });
            let mut boxes = [Aabb::EMPTY; 8];
            let mut group = Group { faces: [[[0.0; 8]; 2]; 3], below: [Below::NOTHING; 8] };
            for (lane, bounds) in boxes.iter_mut().enumerate() {
                // Corners at points of the ray, sizes from nothing to large, some with a face through the origin; and some anywhere.
                let along = origin + direction * number(random, range);
                let at = if lane == 3 { vector(random, range) } else { along };
                let size = vector(random, range) * [0.0, 1e-7, 1e-3, 1.0][lane % 4];
                *bounds = Aabb::EMPTY.grown(at + size).grown(if lane == 7 { origin } else { at });
                for axis in 0..3 {
                    group.faces[axis][0][lane] = bounds.lower[axis];
                    group.faces[axis][1][lane] = bounds.upper[axis];
                }
            }
            let extent =
                boxes.iter().fold(Vec3::ZERO, |extent, of| extent.max(of.lower.abs()).max(of.upper.abs()));
            let Some(slabs) = SlabRay::new(&ray, extent.extend(0.0)) else {
                refused += 1;
                continue;
            };
            let tfar = number(random, range).abs();
            let met = slabs.test(&group, tfar);
            for (lane, bounds) in boxes.iter().enumerate().filter(|(_, bounds)| !bounds.is_empty()) {
                let here = (met.mask() >> lane & 1 != 0)
                    .then(|| f32::from_bits(met.entries()[lane].cast_unsigned()));
                match (here, ray.entry(bounds, tfar)) {
                    (Some(here), Some(there)) => {
                        assert!(here <= there, "{here} {there} {ray:?} {bounds:?}");
                        assert_eq!(slabs.entered_later(&met) >> lane & 1 != 0, here > ray.tnear);
                        both += 1;
                    }
                    (None, Some(there)) => panic!("lost, entered at {there}: {ray:?} {bounds:?} {tfar}"),
                    // What is allowed for goes by the greatest box, so boxes must be of like sizes.
                    (Some(_), None) => here_only += u32::from(lane == 3 && round % 4 == 0),
                    (None, None) => {}
                }
            }
        }
        [both, here_only, refused]
    }

    #[test]
    fn no_box_is_lost_and_none_is_entered_later() {
        if !(is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma")) {
            return;
        }
        // SAFETY: the processor has both features.
        let [both, here_only, refused] = unsafe { compare(&mut Random::new(11)) };
        assert!(both > 20_000 && refused < 20_000, "{both} {refused}");
        assert!(here_only < 50, "{here_only} boxes that the ray does not graze are met here only");
    }

    #[test]
    fn odd_rays_are_refused() {
        if !(is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma")) {
            return;
        }
        let refused = |origin: f32, direction: f32, tnear: f32| {
            let [origin, direction] = [Vec3::splat(origin), Vec3::new(1.0, direction, 1.0)];
            let ray = PreparedRay::new(&Ray { origin, tnear, direction, tfar: 9.0 });
            // SAFETY: the processor has both features.
            unsafe { SlabRay::new(&ray, Vec4::new(1.0, 1.0, 1.0, 0.0)) }.is_none()
        };
        assert!(!refused(1.0, 1.0, 0.0) && !refused(0.0, -1e-9, 5.0));
        assert!(refused(1.0, 0.0, 0.0) && refused(1.0, -0.0, 0.0) && refused(1.0, 1e-42, 0.0));
        assert!(refused(1.0, 1.0, -1e-9) && refused(1e20, 1e-25, 0.0) && refused(f32::INFINITY, 1.0, 0.0));
    }

    /// Not a test: `near` leads behind the group, against its contract, and `test` reads there. A sanitizer must see it, or it sees nothing.
    #[test]
    #[ignore = "a defect that is planted for tools/sanitizers, which alone runs it"]
    fn planted_defect() {
        if !(is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma")) {
            return;
        }
        let ray = Ray { origin: Vec3::ONE, tnear: 0.0, direction: Vec3::ONE, tfar: 9.0 };
        let group = Box::new(Group { faces: [[[0.0; 8]; 2]; 3], below: [Below::NOTHING; 8] });
        // SAFETY: there is none; see above.
        let met = unsafe {
            let mut slabs = SlabRay::new(&PreparedRay::new(&ray), Vec4::ZERO).unwrap();
            slabs.near = [size_of::<Group<8>>(), AXIS, 2 * AXIS];
            slabs.test(std::hint::black_box(&group), 9.0)
        };
        std::hint::black_box(met);
    }
}
