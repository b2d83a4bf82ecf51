//! A ray made ready for box tests, and the box test in its plain form.
//!
//! The test is the slab test with the padding of Ize, "Robust BVH Ray Traversal", JCGT 2013: the far distances are
//! enlarged by more than the rounding of both sides, so that no box that the exact ray touches is lost. The vector
//! forms ([`super::pairs`], [`super::groups`]) do the same operations in the same order, so all forms decide alike,
//! bit for bit. That is what makes counts independent of a tree's layout.

use crate::geometry::{Aabb, Ray, Vec3};
use bytemuck::{Pod, Zeroable};
use glam::Vec4;

/// Relative enlargement of far distances: a near distance has at most 3 roundings (difference, inverse, product), a far
/// one 4 (its padded inverse is rounded too), so 7 × 2⁻²⁴ is needed and 8 × 2⁻²⁴ given.
pub(crate) const PADDING: f32 = 8.0 / (1 << 24) as f32;

/// Direction components outside of this range (zero apart) have no inverse that is exact to one rounding.
pub(crate) const INVERTIBLE: std::ops::RangeInclusive<f32> = 1e-30..=1e30;

/// A query's ray with what box tests need of it.
///
/// Three cases need care, and none of them costs the inner loop a branch:
/// - A zero component of the direction has an infinite inverse. 0 · ∞, a ray inside a face's plane, is NaN, and NaN
///   loses every comparison of the test: that face does not bound the ray.
/// - A component that is too small or large to be inverted well gets a NaN inverse: no face of that axis bounds the ray.
///   So do all three when `tnear` is negative, where the padding would work the wrong way. Such rays visit more
///   boxes than they need and lose no hit.
/// - A ray that cannot hit anything (non-finite origin or direction, NaN or empty interval) has an interval that
///   fails every test.
///
/// Vectors and numbers stand side by side, so that whoever reads four at once finds them written at once: a processor waits for what was
/// written in smaller parts.
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C, align(16))]
pub struct PreparedRay {
    pub origin: Vec3,
    /// Start of the interval, finite and at most its end; +inf for a ray that cannot hit anything.
    pub tnear: f32,
    pub direction: Vec3,
    /// End of the interval, finite; -inf for a ray that cannot hit anything.
    pub tfar: f32,
    /// 1 / direction, for distances to near faces.
    pub(crate) near_inverse: Vec3,
    /// 1, or 2⁶⁴ where `tnear` is so small that its product with a triangle's denominator has no normal number: there the test of
    /// triangles compares both sides times this. A processor takes longer for one denormal number than for a triangle.
    pub(crate) magnified: f32,
    /// 1 / direction, padded, for distances to far faces.
    pub(crate) far_inverse: Vec3,
    pub(crate) unused: f32,
}

/// [`PreparedRay::magnified`] of starts below [`MAGNIFIED_BELOW`].
pub(crate) const MAGNIFIER: f32 = (1u64 << 32) as f32 * (1u64 << 32) as f32;
pub(crate) const MAGNIFIED_BELOW: f32 = 1e-18;

impl PreparedRay {
    #[inline]
    pub fn new(ray: &Ray) -> PreparedRay {
        let [origin, direction]: [Vec4; 2] = bytemuck::cast(*ray);
        let finite = (origin.is_finite_mask() & direction.is_finite_mask()).bitmask() & 0b111 == 0b111;
        // A hit has a finite t; with an infinite end, boxes beside an axis-parallel ray (at distance +inf) would pass.
        let (tnear, tfar) = if finite && ray.tnear <= ray.tfar {
            (ray.tnear.max(f32::MIN), ray.tfar.min(f32::MAX))
        } else {
            (f32::INFINITY, f32::NEG_INFINITY)
        };
        let magnitude = direction.abs();
        let (least, most) = (Vec4::splat(*INVERTIBLE.start()), Vec4::splat(*INVERTIBLE.end()));
        let invertible = magnitude.cmpge(least) & magnitude.cmple(most) | magnitude.cmpeq(Vec4::ZERO);
        let none = Vec4::splat(f32::NAN);
        // The fourth number is no part of the direction, and its inverse might be denormal.
        let inverse = Vec4::select(invertible, Vec4::ONE / direction.with_w(1.0), none);
        let inverse = if tnear < 0.0 { none } else { inverse };
        let magnified = if tnear.abs() < MAGNIFIED_BELOW { MAGNIFIER } else { 1.0 };
        let (near, far) = (inverse.with_w(magnified), inverse.with_w(0.0) * (1.0 + PADDING));
        bytemuck::cast([origin.with_w(tnear), direction.with_w(tfar), near, far])
    }

    /// Per axis: 1 when the ray runs downwards, so that a box's upper face is the near one.
    #[inline(always)]
    pub(crate) fn downwards(&self) -> [usize; 3] {
        self.near_inverse.to_array().map(|inverse| usize::from(inverse < 0.0))
    }

    /// Where the ray enters `bounds`, if it does within [tnear, `tfar`]; tnear when it starts inside.
    ///
    /// Never greater for a box than for another one inside it, rounding included: every operation is monotone.
    #[inline]
    pub fn entry(&self, bounds: &Aabb, tfar: f32) -> Option<f32> {
        let faces = [bounds.lower.to_array(), bounds.upper.to_array()];
        let (mut entry, mut exit) = (self.tnear, tfar);
        let downwards = self.downwards();
        for axis in 0..3 {
            let near = faces[downwards[axis]][axis];
            let far = faces[1 - downwards[axis]][axis];
            let near = (near - self.origin[axis]) * self.near_inverse[axis];
            let far = (far - self.origin[axis]) * self.far_inverse[axis];
            // Written so that NaN changes nothing, as MAXPS and MINPS do with the running value as second operand.
            entry = if near > entry { near } else { entry };
            exit = if far < exit { far } else { exit };
        }
        (entry <= exit).then_some(entry)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn prepared(origin: [f32; 3], direction: [f32; 3], tnear: f32, tfar: f32) -> PreparedRay {
        PreparedRay::new(&Ray { origin: origin.into(), direction: direction.into(), tnear, tfar })
    }

    const UNIT: Aabb = Aabb { lower: Vec3::ZERO, upper: Vec3::ONE };

    #[test]
    fn enters_at_the_near_face() {
        let ray = prepared([-1.0, 0.5, 0.5], [2.0, 0.0, 0.0], 0.0, f32::INFINITY);
        assert_eq!(ray.entry(&UNIT, ray.tfar), Some(0.5));
        assert_eq!(ray.entry(&UNIT, 0.5), Some(0.5), "the end of the interval belongs to it");
        assert_eq!(ray.entry(&UNIT, 0.49), None);
        let inside = prepared([0.5, 0.5, 0.5], [2.0, 0.0, 0.0], 0.125, 9.0);
        assert_eq!(inside.entry(&UNIT, 9.0), Some(0.125));
        let behind = prepared([2.0, 0.5, 0.5], [1.0, 0.0, 0.0], 0.0, 9.0);
        assert_eq!(behind.entry(&UNIT, 9.0), None);
    }

    #[test]
    fn axis_parallel_rays_beside_a_box_miss_it_and_in_its_faces_touch_it() {
        for zero in [0.0, -0.0] {
            let hits = |y: f32| {
                let ray = prepared([-1.0, y, 0.5], [1.0, zero, zero], 0.0, f32::INFINITY);
                ray.entry(&UNIT, ray.tfar).is_some()
            };
            assert!(hits(0.0) && hits(1.0) && hits(0.5));
            assert!(!hits(-1e-6) && !hits(1.000001));
        }
    }

    #[test]
    fn rays_that_cannot_hit_fail_every_test() {
        let everything = Aabb { lower: Vec3::NEG_INFINITY, upper: Vec3::INFINITY };
        let (o, d) = ([0.0; 3], [1.0, 1.0, 1.0]);
        for ray in [
            prepared([f32::NAN, 0.0, 0.0], d, 0.0, 1.0),
            prepared([f32::INFINITY, 0.0, 0.0], d, 0.0, 1.0),
            prepared(o, [1.0, f32::NAN, 0.0], 0.0, 1.0),
            prepared(o, [1.0, f32::INFINITY, 0.0], 0.0, 1.0),
            prepared(o, d, f32::NAN, 1.0),
            prepared(o, d, 0.0, f32::NAN),
            prepared(o, d, 2.0, 1.0),
            prepared(o, d, f32::INFINITY, f32::INFINITY),
            prepared(o, d, 0.0, f32::NEG_INFINITY),
        ] {
            assert_eq!(ray.entry(&everything, ray.tfar), None, "{ray:?}");
        }
    }

    #[test]
    fn odd_rays_lose_no_box() {
        // Each of these passes through (0.5, 0.5, 0.5) within its interval.
        for (origin, direction, tnear, tfar) in [
            ([2.0, 0.5, 0.5], [1.0, 0.0, 0.0], -5.0, 5.0),
            ([-0.5, 0.5, 0.5], [1.0, 1e-42, 0.0], 0.0, 5.0),
            ([0.5, 0.5, 0.5], [1e-42, 0.0, 0.0], 0.0, 1.0),
            ([0.5, 0.5, 0.5], [0.0, 0.0, 0.0], 0.0, f32::INFINITY),
            ([-0.5, 0.5, 0.5], [3e38, 0.0, 0.0], 0.0, 1.0),
            ([-0.5, 0.5, 0.5], [1e-30, 0.0, 0.0], 0.0, f32::MAX),
        ] {
            let ray = prepared(origin, direction, tnear, tfar);
            assert!(ray.entry(&UNIT, ray.tfar).is_some(), "{ray:?}");
        }
    }

    #[test]
    fn no_box_that_the_exact_ray_touches_is_lost() {
        // Boxes with a corner on the ray, computed in double precision and rounded outwards.
        let mut state = 1u64;
        let mut random = || {
            state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            (state >> 40) as f32 / (1 << 23) as f32 - 1.0
        };
        for _ in 0..20_000 {
            let ray = prepared(
                [random() * 100.0, random(), random() * 1e-3],
                [random(), random(), random()],
                0.0,
                f32::INFINITY,
            );
            let t = f64::from(random().abs() * 50.0);
            let point = ray.origin.as_dvec3() + t * ray.direction.as_dvec3();
            let round = |value: f64, up: bool| {
                let near = value as f32;
                match (f64::from(near) < value, up) {
                    (true, true) => near.next_up(),
                    (false, false) if f64::from(near) > value => near.next_down(),
                    _ => near,
                }
            };
            let side = [random() > 0.0, random() > 0.0, random() > 0.0];
            let mut bounds = Aabb { lower: Vec3::ZERO, upper: Vec3::ZERO };
            for axis in 0..3 {
                // The box lies wholly on one side of the point, on each axis: only its corner touches the ray.
                let corner = round(point[axis], side[axis]);
                let other = if side[axis] { corner - 10.0 } else { corner + 10.0 };
                bounds.lower[axis] = corner.min(other);
                bounds.upper[axis] = corner.max(other);
            }
            assert!(ray.entry(&bounds, ray.tfar).is_some(), "{ray:?} {bounds:?}");
        }
    }
}
